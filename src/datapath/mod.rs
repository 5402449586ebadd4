//! The datapath carries datagrams between sockets and the [NAT](crate::nat).
//!
//! `router` is the control plane: it starts workers, gives them another configuration and tells how
//! they are. `socket` is a datapath of UDP sockets; the only unsafe code of the program is in
//! `socket::sys`. `kernel_filter` makes the small programs that the kernel runs on those sockets.
//! `offload` is a datapath in the kernel, for flows that the core has opened.

mod active_config;
mod activity;
mod commands;
mod kernel_filter;
mod last_reload;
mod offload;
mod reload;
mod router;
mod socket;
mod throttlings;

pub use active_config::ActiveConfig;
pub use last_reload::LastReload;
#[cfg(any(test, fuzzing))]
pub use offload::holds as offload_holds;
pub use offload::{OffloadError, OffloadState};
pub use reload::{Reloaded, Stopping};
#[cfg(feature = "cli")]
pub(crate) use router::descriptors_needed;
pub use router::{Bound, Router};
pub use socket::descriptors::TooFewDescriptors;
pub use socket::filtered::KernelDrops;
#[cfg(feature = "cli")]
pub(crate) use socket::port_pool::{USUAL_PORT_RANGE, port_range, port_ranges};
pub use socket::setup::StartError;
pub use socket::sys::large_blocks::LargeBlocksApart;
pub(crate) use throttlings::Throttling;
