//! `pnet-nat`: the NAT router of P-NET on IP (IEC PAS 62412).
//!
//! A remote client reaches a server node of a plant at *public address : start port + node
//! address*. This crate checks every datagram, passes it to the node's Secure UDP port, keeps the
//! way back, and counts everything. The binary is a thin shell around these modules; reading
//! order for newcomers: [`pnet::wire`], [`nat`], [`datapath`], then the rest.

pub mod admin;
pub mod cli;
pub mod config;
pub mod datapath;
mod harmless;
pub mod logging;
pub mod nat;
pub mod observe;
pub mod peer;
pub mod pnet;
pub mod reload;
pub mod sandbox;
pub mod service;
pub mod thread;

/// The commit that this is built from; empty where that is not known.
const COMMIT: &str = env!("PNET_NAT_COMMIT");
