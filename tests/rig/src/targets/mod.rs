//! What has to hold for any input, one module for each fuzz target. A target takes any octets and
//! panics if something is wrong.
//!
//! `cargo fuzz` looks for such octets. `tests/fuzz.rs` runs the same functions with the corpus and
//! with random changes of it.

pub mod codec;
pub mod configuration;
pub mod core;
pub mod endpoints;
pub mod ip_net_table;
pub mod profinet;
pub mod profinet_device;
pub mod profinet_rpc;

mod input;
mod sockets;
