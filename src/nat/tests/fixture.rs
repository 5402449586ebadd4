//! What the scenarios stand on: one net with node 4 on a public port, a client, the octets of a
//! request and of its answer, and a worker around the core.

use std::collections::BTreeSet;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::nat::*;
use crate::pnet::wire::{DlRoute, Header, Password};

pub(super) const PASSWORD: &[u8; 8] = b"service!";
pub(super) const CLIENT: &str = "198.51.100.7:50000";
pub(super) const PUBLIC: &str = "192.0.2.1";

/// Limits that no scenario reaches by accident.
pub(super) const LIMITS: Limits = Limits {
    max_flows: 1000,
    wrong_password_burst: 100,
    wrong_password_address_burst: 10_000,
    wrong_password_interval: Duration::from_secs(1),
};

pub(super) fn credential(
    name: &str,
    password: &[u8; 8],
    device_password: Option<&[u8; 8]>,
) -> Credential {
    Credential {
        name: name.into(),
        password: Password::new(*password),
        device_password: device_password.map(|octets| Password::new(*octets)),
    }
}

/// A net that everybody may use who knows [`PASSWORD`].
pub(super) fn net() -> Net {
    Net {
        allow: vec!["0.0.0.0/0".parse().unwrap(), "::/0".parse().unwrap()],
        credentials: vec![credential("service", PASSWORD, None)],
        max_flows: 100,
        ..Net::new("section-1", NetKind::UdpRange { start_port: 20_000 })
    }
}

pub(super) fn mapping(net: u16, node_address: u8, public_port: u16, server: &str) -> Mapping {
    let (local_address, server) = (None, server.parse().unwrap());
    Mapping { net: NetId(net), node_address, local_address, public_port, server }
}

/// Node 4 of the first net.
pub(super) fn node_4() -> Mapping {
    mapping(0, 4, 20_004, "172.17.17.4:34379")
}

pub(super) fn table(nets: Vec<Net>, mappings: Vec<Mapping>) -> Arc<Table> {
    Arc::new(Table::new(Header::default(), nets, mappings))
}

/// How a request of this client to the first mapping arrives.
pub(super) fn arrival(client: SocketAddr) -> Arrival {
    Arrival {
        listener: ListenerId(0),
        mapping: MappingId(0),
        public_address: PUBLIC.parse().unwrap(),
        client,
    }
}

/// A request to node 4, from node 3 of the client's IP net.
pub(super) fn request(password: &[u8]) -> Vec<u8> {
    datagram([&[11, 4, 2], &[11, 3]], &[], password)
}

/// The answer to [`request`].
pub(super) fn response(password: &[u8]) -> Vec<u8> {
    datagram([&[11, 3], &[11, 4, 2]], &[], password)
}

/// A datagram with these destinations and sources.
pub(super) fn datagram(
    [destinations, sources]: [&[u8]; 2],
    data_octets: &[u8],
    password: &[u8],
) -> Vec<u8> {
    let route = DlRoute::new(destinations, sources).unwrap().to_route().unwrap();
    let (header, control) = (Header::default(), [0x02, data_octets.len() as u8]);
    [&header.0, route.as_route().as_bytes(), &control, data_octets, password].concat()
}

/// As many sockets as the core asks for, and what it reported.
#[derive(Default)]
pub(super) struct Sockets {
    /// Addresses to which the system has no route.
    pub(super) no_way: &'static [&'static str],
    /// How often the core asked for the route to a client.
    pub(super) looked_for: usize,
    /// Public ports of closed flows.
    pub(super) closed: Vec<(u16, CloseReason)>,
    pub(super) closed_sockets: Vec<UpstreamId>,
}

impl Effects for Sockets {
    fn open_upstream(&mut self, _: &Table, id: UpstreamId, _: NetId, _: SocketKind) -> Option<u16> {
        Some(50_000 + id.0 as u16)
    }

    fn close_upstream(&mut self, id: UpstreamId) {
        self.closed_sockets.push(id);
    }

    fn can_answer(&mut self, _: ListenerId, _: IpAddr, client: SocketAddr) -> bool {
        self.looked_for += 1;
        !self.no_way.contains(&client.ip().to_string().as_str())
    }

    fn flow_closed(&mut self, table: &Table, flow: &FlowRecord, reason: CloseReason) {
        self.closed.push((table.mapping(flow.mapping).public_port, reason));
    }
}

/// A worker: its core and what is around it.
pub(super) struct Worker<E = Sockets> {
    pub(super) core: Core,
    pub(super) rules: Rules,
    pub(super) counters: Arc<Counters>,
    pub(super) effects: E,
}

impl<E: Effects> Worker<E> {
    pub(super) fn new(rules: &Rules, now: Instant, seed: u64, effects: E) -> Self {
        let counters = Arc::new(Counters::new(&rules.table));
        let chance = Chance::from_seed(seed);
        let core = Core::new(rules.clone(), Arc::clone(&counters), now, chance);
        Self { core, rules: rules.clone(), counters, effects }
    }

    pub(super) fn request(
        &mut self,
        now: Instant,
        arrival: &Arrival,
        octets: &mut [u8],
    ) -> Result<ToServer, DropReason> {
        self.core.request(now, arrival, &mut Payload::from(octets), &mut self.effects)
    }

    /// What the worker goes over to when these are the new rules, without the sockets `gone`.
    pub(super) fn succession(&self, rules: &Rules, gone: &BTreeSet<ListenerId>) -> Succession {
        Succession {
            rules: rules.clone(),
            counters: Arc::new(self.counters.followed_by(&self.rules.table, &rules.table)),
            transition: Arc::new(Transition::new(&self.rules, rules, gone.clone())),
        }
    }

    pub(super) fn reload(&mut self, now: Instant, next: Succession) {
        (self.rules, self.counters) = (next.rules.clone(), Arc::clone(&next.counters));
        self.core.reload(now, next, &mut self.effects);
    }

    /// Lets some more flows go over to the new rules.
    pub(super) fn go_over(&mut self, now: Instant) -> Option<usize> {
        self.core.go_over(now, &mut self.effects)
    }

    /// Something that a server sent to an upstream socket.
    pub(super) fn response(
        &mut self,
        now: Instant,
        via: UpstreamId,
        server: SocketAddr,
        octets: &mut [u8],
    ) -> Result<ToClient, DropReason> {
        self.core.response(now, via, server, &mut Payload::from(octets))
    }

    pub(super) fn expire(&mut self, now: Instant) {
        while self.core.expire(now, &mut self.effects) {}
    }

    /// The number of open flows.
    pub(super) fn flows(&self, now: Instant) -> usize {
        self.core.flows(now).count()
    }
}
