//! Sockets, and the only unsafe code: batches in, batches out, one worker a core.

#[allow(unsafe_code)]
mod address;
#[allow(unsafe_code)]
mod batch;
mod descriptors;
mod router;
#[allow(unsafe_code)]
mod socket;
mod steer;
mod worker;

pub use descriptors::TooFewDescriptors;
pub use router::{Router, StartError};
