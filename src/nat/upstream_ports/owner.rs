//! Who uses an upstream socket, and what for.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

/// Stands for all addresses of remote nets. No client sends to it.
const UNSPECIFIED: IpAddr = IpAddr::V4(Ipv4Addr::UNSPECIFIED);

/// The client that has a lease, and where the client sends to. So a late answer to a flow that
/// was closed and opened again still leaves from the right address and port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::nat) struct Owner {
    pub client: SocketAddr,
    pub public_address: IpAddr,
    pub public_port: u16,
    /// Whether each node has an address of its own here, as in a remote net.
    pub has_local_address: bool,
}

/// What an upstream socket carries. Flows share a socket only with their like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SocketKind {
    /// IPv4, otherwise IPv6.
    pub ipv4: bool,
    /// Whether datagrams may be longer than those of P-NET.
    pub is_long: bool,
}

impl Owner {
    /// What a client's affinity is found by. A client that asks nodes at different addresses in a
    /// remote net comes from one port all the same.
    pub(super) fn affinity(self) -> (SocketAddr, IpAddr) {
        let address = if self.has_local_address { UNSPECIFIED } else { self.public_address };
        (self.client, address)
    }
}
