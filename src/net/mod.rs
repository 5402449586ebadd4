//! Sockets, and the only unsafe code: batches in, batches out, workers that share
//! nothing.

#[allow(unsafe_code)]
mod address;
mod audit;
#[allow(unsafe_code)]
mod batch;
mod busy;
mod complaints;
mod descriptors;
mod flood;
mod place;
mod prefilter;
mod public;
mod router;
#[allow(unsafe_code)]
mod socket;
mod steer;
mod upstream;
mod worker;

pub use descriptors::TooFewDescriptors;
pub use public::KernelDrops;
pub use router::{Bound, Router, StartError};
