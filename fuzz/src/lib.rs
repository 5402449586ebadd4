//! What has to hold whatever comes in, one module a target: each takes any octets and panics where
//! something is wrong.
//!
//! `cargo fuzz` looks for such octets; `tests/fuzz.rs` of the router puts the corpus through the
//! same functions, and random changes of it.

pub mod codec;
pub mod configuration;
pub mod core;
