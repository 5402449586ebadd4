//! Where a request goes: the route that it carries, and the way of its datagram.

use std::net::SocketAddr;

use crate::pnet::ip_net_table::{Destination, IpNetTable, TranslateError};
use crate::pnet::wire::{BNA, Elements, IpNetId, Password};

/// The way of a datagram. It comes from a row of the IPNetTable, or somebody knows it.
#[derive(Clone, Debug)]
pub struct Way {
    /// Where it is sent.
    pub address: SocketAddr,
    /// The password at its end, if it has one.
    pub password: Option<Password>,
}

/// Destination Route (PAS 6.1.1.1.1.6), and the way to its first node.
#[derive(Clone, Debug)]
pub struct DestinationRoute {
    /// The way of the datagram.
    pub way: Way,
    /// The IPNetID of the net, as the client numbers it.
    pub ip_net_id: IpNetId,
    /// The server node in that net, or all of them.
    pub node: Destination,
    /// What lies behind that node: ports and node addresses.
    pub beyond: Elements,
}

/// Why a table gives no way to a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoWay {
    /// The table has none.
    #[error(transparent)]
    Translate(#[from] TranslateError),
    /// The row has UsePW set.
    #[error("row {0}, UsePW: packages to this net carry a password, and there is none (PAS 7)")]
    NoPassword(IpNetId),
}

impl DestinationRoute {
    /// The route to a node by a client's IPNetTable (R-16 to R-19, PAS 8). The password is used only if
    /// the row says so.
    ///
    /// Fails if the table has no way there, and if it takes a password that is not given.
    pub fn by_table(
        table: &IpNetTable,
        ip_net_id: IpNetId,
        node: Destination,
        password: Option<&Password>,
    ) -> Result<Self, NoWay> {
        let translation = table.translate(ip_net_id, node)?;
        let password = match (translation.use_password, password) {
            (false, _) => None,
            (true, None) => return Err(NoWay::NoPassword(ip_net_id)),
            (true, Some(password)) => Some(password.clone()),
        };
        let address = (translation.address, translation.port).into();
        let way = Way { address, password };
        Ok(Self { way, ip_net_id, node, beyond: Elements::new() })
    }

    /// Whether one of its node addresses is the BNA. Nobody answers a broadcast (R-28, PAS
    /// 6.1.1.1.1.5).
    pub fn names_broadcast(&self) -> bool {
        self.node == Destination::Broadcast || self.beyond.contains(&BNA)
    }
}
