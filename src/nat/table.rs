//! The NAT table: which public port stands for which server node, and who may use it.
//!
//! A [`Table`] is immutable and already validated; `config` makes it, every worker shares it.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use foldhash::fast::FixedState;
use ipnet::IpNet;
use subtle::ConditionallySelectable;

use super::allowed_sources::Sources;
use super::gcra::RequestRate;
use super::ids::{MappingId, NetId};
use super::protocol::{Header, Password};

/// What stands behind a net's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NetKind {
    /// A block of public ports: public port = start port + node address (PAS 5.2.6, 8 d).
    UdpRange {
        /// UDPPort of the client's IPNetTable.
        start_port: u16,
    },
    /// One server outside any range.
    Server,
}

/// Clients and rules of one plant section, or of one single server.
#[derive(Clone, Debug)]
pub struct Net {
    /// Name in metrics, logs and the API; unique in the table.
    pub name: String,
    /// UDP Range net or single server.
    pub kind: NetKind,
    /// Networks that clients may come from; see [`Table::allows`].
    pub allow: Vec<IpNet>,
    /// Passwords that open the net; empty only with `allow_without_password`.
    pub credentials: Vec<Credential>,
    /// Requests without a password are passed on (against PAS 7, so only when asked for by name).
    pub allow_without_password: bool,
    /// A response without a password is dropped.
    pub require_response_password: bool,
    /// A flow ends after this long without a datagram either way (RFC 4787 REQ-5).
    pub idle_timeout: Duration,
    /// Flows that may be open at once.
    pub max_flows: u32,
    /// Requests that may pass, of all clients together; none: any number.
    pub max_requests: Option<RequestRate>,
    /// Requests that may pass of each flow; none: any number.
    pub max_flow_requests: Option<RequestRate>,
}

impl Net {
    /// A net that no client may use yet: it has no networks and no passwords. Flows end after five
    /// minutes (RFC 4787 REQ-5 recommends them), and nothing has a limit.
    pub fn new(name: impl Into<String>, kind: NetKind) -> Self {
        Self {
            name: name.into(),
            kind,
            allow: Vec::new(),
            credentials: Vec::new(),
            allow_without_password: false,
            require_response_password: false,
            idle_timeout: Duration::from_secs(5 * 60),
            max_flows: u32::MAX,
            max_requests: None,
            max_flow_requests: None,
        }
    }

    /// Index of the credential with this password. Every password of the net is compared, so that
    /// the time taken tells nothing about any of them.
    #[inline]
    pub fn credential(&self, password: &[u8; Password::LEN]) -> Option<u16> {
        let mut found = u16::MAX;
        for (index, credential) in (0..).zip(&self.credentials) {
            found.conditional_assign(&index, credential.password.matches(password));
        }
        (found != u16::MAX).then_some(found)
    }
}

/// One of a net's passwords.
#[derive(Clone, Debug)]
pub struct Credential {
    /// Name in metrics and logs.
    pub name: String,
    /// What clients send.
    pub password: Password,
    /// What the servers expect, where it differs: put in on the way in, taken out on the way back.
    pub device_password: Option<Password>,
}

impl Credential {
    /// What the servers expect and answer with.
    pub fn at_server(&self) -> &Password {
        self.device_password.as_ref().unwrap_or(&self.password)
    }
}

/// One element of the NAT table (PAS 5.2.6): a public port and the server node behind it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mapping {
    /// The net it belongs to.
    pub net: NetId,
    /// P-NET node address, 1..=125.
    pub node_address: u8,
    /// UDP port on the Internet side.
    pub public_port: u16,
    /// The server's address and Secure UDP port.
    pub server: SocketAddr,
}

/// Bounds that hold for the router as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Flows that may be open at once, over all nets.
    pub max_flows: u32,
    /// Wrong passwords that an address and port may send before it is throttled.
    pub wrong_password_burst: u16,
    /// Wrong passwords that an address as a whole (of IPv6, its /64) may send before it is throttled.
    /// All of them are forgiven in the time in which all of a sender's are.
    pub wrong_password_address_burst: u32,
    /// One wrong password of an address and port is forgiven in each such interval.
    pub wrong_password_interval: Duration,
}

/// The whole NAT table. Public ports and servers are unique in it.
#[derive(Debug)]
pub struct Table {
    /// What every datagram begins with.
    pub header: Header,
    nets: Vec<Net>,
    mappings: Vec<Mapping>,
    sources: Vec<Arc<Sources>>,
    /// Net by net.
    by_net: Vec<MappingId>,
    /// Only looked up in, by addresses that the operator has written.
    by_server: HashMap<SocketAddr, MappingId, FixedState>,
}

impl Table {
    /// The table of these nets and mappings.
    pub fn new(header: Header, nets: Vec<Net>, mappings: Vec<Mapping>) -> Self {
        let ids = (0..).map(MappingId);
        let mut by_net: Vec<_> = ids.clone().take(mappings.len()).collect();
        by_net.sort_by_key(|id| mappings[id.0 as usize].net.0);
        let by_server = mappings.iter().map(|mapping| mapping.server).zip(ids).collect();
        let sources = Sources::of(&nets, &mappings);
        Self { header, nets, mappings, sources, by_net, by_server }
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

    /// Whether a client at this address may use the net: a network of its `allow` holds the address,
    /// and where that is in the plant, one that lies in the plant.
    #[inline]
    pub fn allows(&self, net: NetId, source: IpAddr) -> bool {
        self.sources[usize::from(net.0)].contains(source)
    }

    /// The mapping with this index.
    pub fn mapping(&self, id: MappingId) -> Mapping {
        self.mappings[id.0 as usize]
    }

    /// The mapping whose server has this address, if one has.
    pub fn mapping_of_server(&self, server: SocketAddr) -> Option<MappingId> {
        self.by_server.get(&server).copied()
    }
}
