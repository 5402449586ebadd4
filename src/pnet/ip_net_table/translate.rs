//! What a table is for: where a package goes (PAS 8, 10), and whether its sender is known (PAS 9).

use std::net::{Ipv4Addr, SocketAddrV4};

use super::IpNetTable;
use super::row::Row;
use crate::pnet::wire::{BNA, IpNetId, NodeAddress};

/// The last octet of the address that every node of a subnet listens to (R-42, PAS 10).
const TO_ALL: u8 = 255;

/// Who a package is for, on its net.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Destination {
    /// One node.
    Node(NodeAddress),
    /// Every node: the Broadcast-Node-address, [`BNA`].
    Broadcast,
}

/// A number that a package over IP cannot be addressed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a package is for a node from 1 to 125, or for 126, which is every node (PAS 8, 10)")]
pub struct NotADestination;

impl Destination {
    /// The node address that stands for it in a route.
    pub const fn number(self) -> u8 {
        match self {
            Self::Node(node_address) => node_address.get(),
            Self::Broadcast => BNA,
        }
    }
}

impl TryFrom<u8> for Destination {
    type Error = NotADestination;

    fn try_from(number: u8) -> Result<Self, NotADestination> {
        match number {
            BNA => Ok(Self::Broadcast),
            _ => NodeAddress::new(number).map(Self::Node).ok_or(NotADestination),
        }
    }
}

/// The methods of PAS 8. Method c, a UDP Range net without a router, is not legal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Method {
    /// An IP Range net, the node's own.
    A,
    /// An IP Range net behind a router.
    B,
    /// A UDP Range net, which is always behind a router.
    D,
}

impl Method {
    /// Its letter in PAS 8.
    pub const fn letter(self) -> char {
        match self {
            Self::A => 'a',
            Self::B => 'b',
            Self::D => 'd',
        }
    }
}

/// Where a package is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Translation {
    /// How it was found.
    pub method: Method,
    /// The address that it is sent to.
    pub address: Ipv4Addr,
    /// The UDP port that it is sent to.
    pub port: u16,
    /// The router on the own net to which the IP packet goes first; none on the own net.
    pub next_hop: Option<NodeAddress>,
    /// Whether the package carries a password.
    pub use_password: bool,
}

/// Why a table has no way to a destination.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TranslateError {
    /// The row stands for no net.
    #[error("row {0}, Nettype: the net is unused (PAS 5.2.4)")]
    UnusedNet(IpNetId),
    /// 125 is no row: a server remembers where such a client is.
    #[error("row {0}, IPNetID: the net of dynamic clients has no row (PAS 9)")]
    DynamicClients(IpNetId),
    /// Only an IP Range net takes broadcasts.
    #[error("row {0}, Nettype: a broadcast needs an IP Range net (PAS 10)")]
    BroadcastOverUdpRange(IpNetId),
}

/// Who sent a package, as the package and its datagram say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sender {
    /// The IPNetID at the front of the source route.
    pub net: IpNetId,
    /// The node address that follows it.
    pub node_address: NodeAddress,
    /// Where the datagram came from.
    pub address: SocketAddrV4,
    /// Whether the package has a password, be it right or wrong.
    pub has_password: bool,
}

impl IpNetTable {
    /// Where a package for this destination on this net goes.
    ///
    /// Fails if the net is unused, for that of dynamic clients, and for a broadcast to a UDP Range net. For
    /// a broadcast to a net behind a router that router is the next hop; whether it passes broadcasts
    /// on is up to the router.
    pub fn translate(
        &self,
        net: IpNetId,
        destination: Destination,
    ) -> Result<Translation, TranslateError> {
        if net == IpNetId::DYNAMIC_CLIENTS {
            return Err(TranslateError::DynamicClients(net));
        }
        match (self.row(net), destination) {
            (Row::Unused, _) => Err(TranslateError::UnusedNet(net)),
            (Row::IpRange(row), _) => Ok(Translation {
                method: if row.router.is_none() { Method::A } else { Method::B },
                address: row.address(match destination {
                    Destination::Node(node_address) => node_address.get(),
                    Destination::Broadcast => TO_ALL,
                }),
                port: row.port,
                next_hop: row.router,
                use_password: row.use_password,
            }),
            (Row::UdpRange(row), Destination::Node(node_address)) => Ok(Translation {
                method: Method::D,
                address: row.address,
                port: row.port(node_address),
                next_hop: Some(row.router),
                use_password: row.use_password,
            }),
            (Row::UdpRange(_), Destination::Broadcast) => {
                Err(TranslateError::BroadcastOverUdpRange(net))
            }
        }
    }

    /// Whether a server with this table knows the sender of a request, and so answers it through the
    /// table. The others are dynamic clients.
    pub fn is_known_client(&self, sender: &Sender) -> bool {
        let Row::IpRange(row) = self.row(sender.net) else { return false };
        *sender.address.ip() == row.address(sender.node_address.get())
            && sender.address.port() == row.port
            && !sender.has_password
    }
}
