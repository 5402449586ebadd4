//! The two ends of an exchange on tokio's sockets: a P-NET server node and a remote client.
//!
//! The demo, the tests and the commands `node` and `request` use them. The router itself does not.
//! Invariant: a node answers only correct requests to its own address, and on the Secure port only
//! those with its password.
//!
//! A server that answers with the sum of the octets that it gets. [`NodeSettings`] holds what else it
//! can do; a [`Service`](crate::pnet::endpoint::Service) makes the data of its responses:
//!
//! ```no_run
//! use pnet_nat::peer::{NodeSettings, ServerNode};
//! use pnet_nat::pnet::endpoint::Indicated;
//! use pnet_nat::pnet::wire::Password;
//!
//! #[tokio::main(flavor = "current_thread")]
//! async fn main() -> Result<(), Box<dyn std::error::Error>> {
//!     let passwords = vec![Password::new(*b"PNETPASS")];
//!     let settings = NodeSettings::new([172, 17, 17, 4].into(), passwords);
//!     let sum = |request: &Indicated<'_>| {
//!         let sum = request.data_octets.iter().fold(0, |sum: u8, octet| sum.wrapping_add(*octet));
//!         Some([sum].into_iter().collect())
//!     };
//!     Ok(ServerNode::bind(settings, sum)?.serve().await?)
//! }
//! ```
//!
//! A client that asks this node through its NAT router:
//!
//! ```no_run
//! use std::time::Duration;
//!
//! use pnet_nat::peer::{Client, Request, Target};
//! use pnet_nat::pnet::wire::Password;
//!
//! #[tokio::main(flavor = "current_thread")]
//! async fn main() -> Result<(), Box<dyn std::error::Error>> {
//!     let password = Some(Password::new(*b"PNETPASS"));
//!     let mut client = Client::bind(Target::new("203.0.113.5".parse()?, 20000, password)).await?;
//!     let request =
//!         Request { node_address: 4, beyond: &[], control_status: 0, data_octets: &[1, 2, 3] };
//!     let (response, round_trip) = client.exchange(&request, Duration::from_secs(1)).await?;
//!     println!("{:?} after {round_trip:?}", response.data_octets);
//!     Ok(())
//! }
//! ```
//!
//! [`ClientNode`] has all requests of a client on one socket, with a window and retries.

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

/// Waits until this time, or for ever.
pub(crate) async fn until(time: Option<tokio::time::Instant>) {
    match time {
        Some(time) => tokio::time::sleep_until(time).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests;
