//! What the load generator, the simulated nodes and the yardstick relay share.

pub mod datagram;
pub mod net;
