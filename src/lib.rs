//! `pnet-nat`: the NAT router of P-NET on IP (IEC PAS 62412).
//!
//! A remote client reaches a server node of a plant at *public address : start port + node
//! address*. This crate checks every datagram, passes it to the node's Secure UDP port, keeps the
//! way back, and counts everything. Reading order for newcomers: [`pnet::wire`], `nat`, `datapath`,
//! then the rest.
//!
//! | feature | what it adds |
//! |---|---|
//! | none | [`pnet`] and [`profinet`]: the protocols, without I/O and with few dependencies |
//! | `relay` | the NAT, its sockets, its configuration, and what is told of it; it asks nodes, so with `peer` |
//! | `peer` | a client and a server node on tokio's sockets |
//! | `cli` | the program |

pub mod pnet;
pub mod profinet;

#[cfg(any(feature = "relay", feature = "peer"))]
pub mod listen;

#[cfg(feature = "peer")]
pub mod peer;

#[cfg(feature = "relay")]
pub mod admin;
#[cfg(feature = "relay")]
pub mod config;
#[cfg(feature = "relay")]
pub mod datapath;
#[cfg(feature = "relay")]
mod harmless;
#[cfg(feature = "relay")]
pub mod logging;
#[cfg(feature = "relay")]
pub mod nat;
#[cfg(feature = "relay")]
pub mod observe;
#[cfg(feature = "relay")]
pub mod probe;
#[cfg(feature = "relay")]
pub mod reload;
#[cfg(feature = "relay")]
pub mod sandbox;
#[cfg(feature = "relay")]
pub mod service;
#[cfg(feature = "relay")]
pub mod thread;

#[cfg(feature = "cli")]
pub mod cli;

/// The commit that this is built from; empty where that is not known.
#[cfg(feature = "relay")]
const COMMIT: &str = env!("PNET_NAT_COMMIT");
