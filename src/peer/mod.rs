//! The two ends of an exchange: a simulated P-NET server node and a remote client.
//!
//! The demo, the tests and the commands `node` and `request` talk through them; the router itself
//! uses nothing of this. Invariant: a node is silent on everything but a sound request to its own
//! address, on the Secure port with its password.

mod client;
mod node;

pub use client::{Answer, Client, ExchangeError, Request, Target};
pub use node::{NodeCounts, NodeSettings, Reply, ServerNode, echo};

#[cfg(test)]
mod tests;
