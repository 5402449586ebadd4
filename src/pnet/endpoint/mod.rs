//! The ends of the wire: what a P-NET node on an IP net does with datagrams, without I/O or clock.
//!
//! A [`Server`] judges the datagrams that come to its two ports, and makes the responses. The caller
//! has the sockets: it hands over each datagram with its sender, and the time since any moment of
//! its choice. What the data of a request mean is up to a [`Service`], for the standard does not say
//! which one a control-status stands for. The other end is in [`client`].
//!
//! A server that sends the data of each request back:
//!
//! ```
//! use std::time::Duration;
//!
//! use pnet_nat::pnet::endpoint::{Port, Server};
//! use pnet_nat::pnet::ip_net_table::{Fields, IpNetTable};
//! use pnet_nat::pnet::wire::{Header, IpNetId, MAX_DATAGRAM, NodeAddress, Password};
//!
//! # let request = b"\x02\0\0\0\x0B\x04\x05\x02\x21\x8B\x83\x9F\x00\x03abcPNETPASS";
//! # let client = "198.51.100.9:50000".parse().unwrap();
//! let table = IpNetTable::of_device([172, 17, 17, 4].into(), 0, &[Fields::UNUSED; 124])?;
//! let mut server = Server::new(table, Header::default(), vec![Password::new(*b"PNETPASS")]);
//! // In a loop, for each datagram from a socket:
//! let indicated = server.receive(Duration::ZERO, Port::Secure, client, request)?;
//! let mut octets = [0; MAX_DATAGRAM];
//! if let Some(requester) = &indicated.requester {
//!     let length = requester.respond(indicated.data_octets, &mut octets)?;
//!     // Send octets[..length] to requester.address(), from the port that the request came to.
//! #   assert_eq!(requester.address(), client);
//! #   assert!(octets[..length].ends_with(b"abcPNETPASS"));
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod client;
mod dynamic_clients;
mod server;
mod service;
#[cfg(test)]
mod tests;

pub use dynamic_clients::{DynamicClient, DynamicClients};
pub use server::{Ignored, Indicated, Port, Requester, Server};
pub use service::{Data, Echo, Memory, Service};
