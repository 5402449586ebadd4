//! The two ends of an exchange: a simulated P-NET server node and a remote client.
//!
//! The demo, the tests and the commands `node` and `request` use them. The router itself does not.
//! Invariant: a node answers only correct requests to its own address, and on the Secure port only
//! those with its password.

mod client;
mod client_node;
mod counts;
mod faults;
mod node;

pub use client::{Client, ExchangeError, Request, Target};
pub use client_node::ClientNode;
pub use counts::NodeCounts;
pub use faults::{Faults, NotAShare, Share};
pub use node::{NodeError, NodeSettings, ServerNode};

#[cfg(test)]
mod tests;
