//! Sockets, and the only unsafe code: batches in, batches out, workers that share
//! nothing.

#[allow(unsafe_code)]
mod address;
mod audit;
#[allow(unsafe_code)]
mod batch;
mod bind;
mod bpf;
mod busy;
mod complaints;
mod descriptors;
mod filtered;
mod flood;
mod helping;
mod in_force;
mod listen;
mod place;
mod ports;
mod prefilter;
mod public;
mod reload;
mod router;
#[allow(unsafe_code)]
mod socket;
mod steer;
mod strays;
mod tick;
mod upstream;
#[allow(unsafe_code)]
mod wait;
mod way_back;
mod worker;

pub use bind::StartError;
pub use descriptors::TooFewDescriptors;
pub use filtered::KernelDrops;
pub use in_force::InForce;
pub(crate) use listen::chain;
pub use listen::{ListenError, may_pass, tcp, udp};
pub use reload::{LastReload, ReloadError};
pub use router::{Bound, Router};
