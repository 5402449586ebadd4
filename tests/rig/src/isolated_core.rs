//! A core with one net of simulated nodes, and clients that talk to them, for the benchmarks of the
//! core and the test of its allocations.
//!
//! There is no socket and no clock here. The octets are written by hand, so that the codec does not
//! test itself.

use std::collections::BTreeSet;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};

use fastrand::Rng;
use ipnet::IpNet;
use pnet_nat::nat::{
    Arrival, Chance, Core, Counters, Credential, DropReason, Effects, Limits, ListenerId, Mapping,
    MappingId, Net, NetId, NetKind, Payload, Records, RequestRate, Rules, SocketKind, Succession,
    Table, ToClient, ToServer, Transition, UpstreamId,
};
use pnet_nat::pnet::wire::{Header, Password};

/// What clients send.
pub const PASSWORD: &[u8; 8] = b"PNETPASS";
/// What nodes expect if they have another password.
pub const DEVICE_PASSWORD: &[u8; 8] = b"plant-pw";

/// A flow ends after this time without a datagram.
pub const IDLE_TIMEOUT: Duration = Duration::from_secs(300);
/// A socket is closed this long after its last flow has ended (N-9).
pub const REST: Duration = Duration::from_secs(120);

const PUBLIC: Ipv4Addr = Ipv4Addr::new(203, 0, 113, 5);
const START_PORT: u16 = 20_000;
const SERVER_PORT: u16 = 34_379;
/// Clients at one address, each with its own port.
const PORTS_OF_AN_ADDRESS: u32 = 250;

/// What differs between the cases.
#[derive(Clone)]
pub struct Site {
    /// The number of nodes. Their addresses begin with 1.
    pub nodes: u8,
    /// Flows that may be open at once.
    pub max_flows: u32,
    /// Requests that the net, and each flow, may send.
    pub max_requests: Option<RequestRate>,
    /// Upstream sockets that may be open at once.
    pub sockets: usize,
    /// Whether the nodes expect another password than the clients send.
    pub device_password: bool,
    /// What clients send.
    pub password: &'static [u8; 8],
    /// Whether the nodes are in another plant, so that clients send no password.
    pub is_remote: bool,
    /// Whether there are PROFINET devices, without passwords, instead of nodes.
    pub is_profinet: bool,
    /// Networks that clients may come from.
    pub allow: Vec<IpNet>,
}

impl Default for Site {
    fn default() -> Self {
        Self {
            nodes: 16,
            max_flows: 1_000_000,
            max_requests: None,
            sockets: 100_000,
            device_password: false,
            password: PASSWORD,
            is_remote: false,
            is_profinet: false,
            allow: vec!["10.0.0.0/8".parse().unwrap()],
        }
    }
}

impl Site {
    fn table_and_limits(&self) -> (Arc<Table>, Limits) {
        let start_port = START_PORT;
        let kind = match (self.is_remote, self.is_profinet) {
            (true, _) => NetKind::Remote { start_port },
            (_, true) => NetKind::ProfinetDevice { records: Records::default() },
            _ => NetKind::UdpRange { start_port },
        };
        let mut credentials = vec![Credential {
            name: "service".into(),
            password: Password::new(*self.password),
            device_password: self.device_password.then(|| Password::new(*DEVICE_PASSWORD)),
        }];
        if self.is_profinet {
            credentials.clear();
        }
        let net = Net {
            allow: self.allow.clone(),
            credentials,
            allow_without_password: self.is_profinet,
            require_response_password: !self.is_profinet,
            idle_timeout: IDLE_TIMEOUT,
            max_flows: self.max_flows,
            max_requests: self.max_requests,
            max_flow_requests: self.max_requests,
            ..Net::new("section-1", kind)
        };
        let mapping = |node_address| Mapping {
            net: NetId(0),
            node_address,
            local_address: None,
            public_port: START_PORT + u16::from(node_address),
            server: server(node_address),
        };
        let mappings = (1..=self.nodes).map(mapping).collect();
        let table = Arc::new(Table::new(Header::default(), vec![net], mappings));
        let limits = Limits {
            max_flows: u32::MAX,
            wrong_password_burst: 10,
            wrong_password_address_burst: 5120,
            wrong_password_interval: Duration::from_secs(6),
        };
        (table, limits)
    }
}

/// A core, and the time.
pub struct Rig {
    /// What is tested or measured.
    pub core: Core,
    /// Its upstream sockets.
    pub effects: NoSockets,
    /// The simulated time.
    pub now: Instant,
    rules: Rules,
    counters: Arc<Counters>,
}

/// Upstream sockets that are only counted.
pub struct NoSockets {
    open: usize,
    limit: usize,
}

impl Effects for NoSockets {
    fn open_upstream(&mut self, _: &Table, id: UpstreamId, _: NetId, _: SocketKind) -> Option<u16> {
        let free = self.open < self.limit;
        self.open += usize::from(free);
        free.then_some(id.0 as u16)
    }

    fn close_upstream(&mut self, _: UpstreamId) {
        self.open -= 1;
    }

    fn has_upstream_port(&self, port: u16) -> bool {
        usize::from(port) < self.open
    }
}

impl Rig {
    /// A core without flows.
    pub fn new(site: &Site) -> Self {
        let (table, limits) = site.table_and_limits();
        let rules = Rules::new(table, limits);
        let counters = Arc::new(Counters::new(&rules.table));
        let now = Instant::now();
        let core = Core::new(rules.clone(), Arc::clone(&counters), now, Chance::from_seed(1));
        Self { core, effects: NoSockets { open: 0, limit: site.sockets }, now, rules, counters }
    }

    /// What the core goes over to when the net becomes this one.
    pub fn succession(&mut self, site: &Site) -> Succession {
        let (table, limits) = site.table_and_limits();
        let rules = self.rules.followed_by(table, limits);
        let counters = self.counters.followed_by(&self.rules.table, &rules.table);
        let transition = Arc::new(Transition::new(&self.rules, &rules, BTreeSet::new()));
        (self.rules, self.counters) = (rules, Arc::new(counters));
        let (rules, counters) = (self.rules.clone(), Arc::clone(&self.counters));
        Succession { rules, counters, transition }
    }

    /// A request, in octets without room behind them.
    #[inline]
    pub fn request(
        &mut self,
        arrival: &Arrival,
        octets: &mut [u8],
    ) -> Result<ToServer, DropReason> {
        self.core.request(self.now, arrival, &mut Payload::from(octets), &mut self.effects)
    }

    /// Something that a server sent to an upstream socket.
    #[inline]
    pub fn response(
        &mut self,
        via: UpstreamId,
        server: SocketAddr,
        octets: &mut [u8],
    ) -> Result<ToClient, DropReason> {
        self.core.response(self.now, via, server, &mut Payload::from(octets))
    }

    /// Closes all that has to be closed by now.
    pub fn expire(&mut self) {
        while self.core.expire(self.now, &mut self.effects) {}
    }

    /// Opens flow `number` with its first request.
    pub fn open(&mut self, number: u32, nodes: u8) -> Flow {
        let (client, node_address) = (number / u32::from(nodes), number % u32::from(nodes));
        let (client, node_address) = (client_endpoint(client), node_address as u8 + 1);
        let arrival = arrival(client, node_address);
        let mut octets = request(node_address);
        let to = self.request(&arrival, &mut octets).unwrap();
        assert_eq!(to.server, server(node_address));
        Flow { client, node_address, to }
    }

    /// Opens flows until so many are open: every client talks to every node.
    pub fn open_all(&mut self, flows: u32, nodes: u8) -> Vec<Flow> {
        (0..flows).map(|number| self.open(number, nodes)).collect()
    }
}

/// A client's address and port, and the node that it talks to.
#[derive(Clone, Copy)]
pub struct Flow {
    /// Where its requests come from.
    pub client: SocketAddr,
    /// The node that it leads to.
    pub node_address: u8,
    /// Where its requests go.
    pub to: ToServer,
}

impl Flow {
    /// How its requests arrive.
    pub fn arrival(&self) -> Arrival {
        arrival(self.client, self.node_address)
    }
}

/// A request of this client to this node's public port.
pub fn arrival(client: SocketAddr, node_address: u8) -> Arrival {
    let index = u32::from(node_address) - 1;
    Arrival {
        listener: ListenerId(index),
        mapping: MappingId(index),
        public_address: IpAddr::V4(PUBLIC),
        client,
    }
}

/// The address and port of the client with this number, in 10.0.0.0/8.
pub fn client_endpoint(number: u32) -> SocketAddr {
    let address = Ipv4Addr::from_bits(0x0a00_0001 + number / PORTS_OF_AN_ADDRESS);
    (address, 20_000 + (number % PORTS_OF_AN_ADDRESS) as u16).into()
}

/// The Secure port of a node.
pub fn server(node_address: u8) -> SocketAddr {
    (Ipv4Addr::new(172, 17, 17, node_address), SERVER_PORT).into()
}

/// A request with 16 data octets: 38 octets, as a client that reads a few variables sends.
pub fn request(node_address: u8) -> [u8; 38] {
    let route = [0x02, node_address, 0x05, 0x02, 0x33, 0xfd, 0x81, 0xb1];
    datagram(&route, &[7; 16], PASSWORD).try_into().unwrap()
}

/// The answer to [`request`], with this password.
pub fn response(node_address: u8, password: &[u8; 8]) -> [u8; 38] {
    let route = [0x31, 0x01, 0x05, 0x7d, 0xb3, 0x82, 0x80 | node_address, 0x82];
    datagram(&route, &[9; 16], password).try_into().unwrap()
}

/// The largest request: 107 octets, a route of 30 and 63 data octets.
pub fn largest_request(node_address: u8) -> [u8; 107] {
    let mut route = [0x81; 30];
    route[..3].copy_from_slice(&[0x02, node_address, 27]);
    datagram(&route, &[7; 63], PASSWORD).try_into().unwrap()
}

/// Header, route, control-status, data-field-format, data octets, password.
pub fn datagram(route: &[u8], data_octets: &[u8], password: &[u8]) -> Vec<u8> {
    let control = [0x02, data_octets.len() as u8];
    [&[2, 0, 0, 0], route, &control, data_octets, password].concat()
}

/// These octets, and up to 120 random ones after them.
pub fn garbage(random: &mut Rng, start: &[u8]) -> Vec<u8> {
    let more = random.usize(16..120);
    let noise = std::iter::repeat_with(|| random.u8(..)).take(more);
    start.iter().copied().chain(noise).collect()
}
