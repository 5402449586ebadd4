//! How a request arrived, and what its addresses alone tell about it.

use std::net::{IpAddr, SocketAddr};

use crate::nat::effects::Effects;
use crate::nat::flow::Endpoints;
use crate::nat::ids::{ListenerId, MappingId};

/// How a request arrived.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// The socket that received it.
    pub listener: ListenerId,
    /// The element of the NAT table that the socket stands for.
    pub mapping: MappingId,
    /// The address of the router that the client sent to; the answer has to leave from it. It is
    /// unspecified when the client sent to a broadcast or multicast address.
    pub public_address: IpAddr,
    /// The client's address and port.
    pub client: SocketAddr,
}

impl Arrival {
    /// Whether the request was sent to this router alone.
    #[inline]
    pub(super) fn is_unicast(&self) -> bool {
        !self.public_address.is_unspecified()
    }

    /// Whether the relay sent the request itself, as far as the datagram shows it: it has the port
    /// of an upstream socket, and the source address that a host uses towards its own addresses.
    #[inline]
    pub(super) fn is_loop(&self, effects: &impl Effects) -> bool {
        let ip = self.client.ip();
        effects.has_upstream_port(self.client.port())
            && (ip == self.public_address || ip.to_canonical().is_loopback())
    }

    /// Whether the relay sent the request itself, even if its source address was translated to
    /// another one of the router's. This asks the system, but only about ports of upstream sockets.
    pub(super) fn comes_back(&self, effects: &mut impl Effects) -> bool {
        effects.has_upstream_port(self.client.port()) && effects.is_own_address(self.client)
    }

    /// Whether the client's address shows that no answer can reach it: nothing listens on port 0,
    /// no host has such an address, and a datagram from a link-local address does not leave the
    /// link.
    #[inline]
    pub(super) fn is_unanswerable(&self) -> bool {
        let no_host = match self.client.ip().to_canonical() {
            IpAddr::V4(client) => {
                let [first, ..] = client.octets();
                first == 0 || first >= 224 // this network; multicast, reserved, broadcast
            }
            IpAddr::V6(client) => {
                client.is_unspecified()
                    || client.is_multicast()
                    || is_link_local(self.public_address) && !client.is_unicast_link_local()
            }
        };
        no_host || self.client.port() == 0
    }

    /// What the flow of this request is found by.
    #[inline]
    pub(super) fn endpoints(&self) -> Endpoints {
        Endpoints {
            client: self.client,
            public_address: self.public_address,
            listener: self.listener,
        }
    }
}

fn is_link_local(address: IpAddr) -> bool {
    matches!(address, IpAddr::V6(address) if address.is_unicast_link_local())
}
