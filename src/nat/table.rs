//! The NAT table: which public port stands for which server node, and which clients may use it.
//!
//! A [`Table`] does not change and is already validated. `config` makes it; all workers share it.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use foldhash::fast::FixedState;

use super::allowed_sources::Sources;
use super::ids::{MappingId, NetId};
use super::net::{Mapping, Net};
use super::protocol::Header;
use super::upstream_ports::SocketKind;

/// Limits of the router as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Flows that may be open at once, over all nets.
    pub max_flows: u32,
    /// Wrong passwords that an address and port may send before they are throttled.
    pub wrong_password_burst: u16,
    /// Wrong passwords that an address (IPv6: a /64) may send from all its ports before it is
    /// throttled. All of them are forgiven in the same time as all of one address and port.
    pub wrong_password_address_burst: u32,
    /// In each interval of this length, one wrong password of an address and port is forgiven.
    pub wrong_password_interval: Duration,
}

/// The whole NAT table. Each public port and each server is in it once.
#[derive(Debug)]
pub struct Table {
    /// The header that every datagram begins with.
    pub header: Header,
    nets: Vec<Net>,
    mappings: Vec<Mapping>,
    sources: Vec<Arc<Sources>>,
    /// The mappings in the order of their nets.
    by_net: Vec<MappingId>,
    /// By the address and port that the server answers from. The operator has written all its keys,
    /// so nobody can make their hashes collide.
    by_server: HashMap<SocketAddr, MappingId, FixedState>,
}

/// The address of a server that answers from any port.
#[inline]
pub(super) fn any_port(server: SocketAddr) -> SocketAddr {
    SocketAddr::new(server.ip(), 0)
}

impl Table {
    /// The table of these nets and mappings.
    pub fn new(header: Header, nets: Vec<Net>, mappings: Vec<Mapping>) -> Self {
        let ids = (0..).map(MappingId);
        let mut by_net: Vec<_> = ids.clone().take(mappings.len()).collect();
        by_net.sort_by_key(|id| mappings[id.0 as usize].net.0);
        let sources = Sources::of(&nets, &mappings);
        let by_server = HashMap::default();
        let mut table = Self { header, nets, mappings, sources, by_net, by_server };
        table.by_server =
            table.mappings.iter().map(|mapping| table.answers_from(mapping)).zip(ids).collect();
        table
    }

    /// Where a mapping's server answers from. The port is 0 when it may be any.
    #[inline]
    pub(super) fn answers_from(&self, mapping: &Mapping) -> SocketAddr {
        match self.net(mapping.net).kind.answers_from_any_port() {
            true => any_port(mapping.server),
            false => mapping.server,
        }
    }

    /// The nets, in the order of their [`NetId`].
    pub fn nets(&self) -> &[Net] {
        &self.nets
    }

    /// The mappings, in the order of their [`MappingId`].
    pub fn mappings(&self) -> &[Mapping] {
        &self.mappings
    }

    /// The indices of all nets, in their order.
    pub fn net_ids(&self) -> impl Iterator<Item = NetId> + use<> {
        (0..self.nets.len()).map(|index| NetId(index as u16))
    }

    /// The indices of all mappings, in their order.
    pub fn mapping_ids(&self) -> impl Iterator<Item = MappingId> + use<> {
        (0..self.mappings.len()).map(|index| MappingId(index as u32))
    }

    /// What identifies each node, also in other tables: the name of its net, and its node address. In the
    /// order of the mappings.
    pub fn node_names(&self) -> impl Iterator<Item = (&str, u8)> {
        let name = |mapping: &Mapping| (&*self.net(mapping.net).name, mapping.node_address);
        self.mappings.iter().map(name)
    }

    /// The indices of one net's mappings, in their order.
    pub fn mappings_of(&self, net: NetId) -> impl Iterator<Item = MappingId> + '_ {
        let net_of = |id: &MappingId| self.mapping(*id).net.0;
        let first = self.by_net.partition_point(|id| net_of(id) < net.0);
        let end = self.by_net.partition_point(|id| net_of(id) <= net.0);
        self.by_net[first..end].iter().copied()
    }

    /// The net with this index.
    pub fn net(&self, id: NetId) -> &Net {
        &self.nets[usize::from(id.0)]
    }

    /// Whether a client at this address may use the net: one of the networks in `allow` contains
    /// the address. For an address inside the plant, only networks inside the plant count (N-4).
    #[inline]
    pub fn allows(&self, net: NetId, source: IpAddr) -> bool {
        self.sources[usize::from(net.0)].contains(source)
    }

    /// The mapping with this index.
    pub fn mapping(&self, id: MappingId) -> Mapping {
        self.mappings[id.0 as usize]
    }

    /// The kind of upstream socket that a mapping's server needs.
    pub fn socket_kind(&self, mapping: &Mapping) -> SocketKind {
        let is_long = self.net(mapping.net).kind.has_long_datagrams();
        SocketKind { ipv4: mapping.server.is_ipv4(), is_long }
    }

    /// The mapping of the server that answers from this address and port.
    pub fn mapping_of_server(&self, server: SocketAddr) -> Option<MappingId> {
        let found = self.by_server.get(&server).or_else(|| self.by_server.get(&any_port(server)));
        found.copied()
    }
}
