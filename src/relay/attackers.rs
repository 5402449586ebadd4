//! What each attacker of SECURITY.md can do to the core, and what he cannot: one who forges where
//! his datagrams come from, one who holds another password of the net, one who changes ports.
//!
//! Their datagrams are well-formed, so that nothing but the rule under test can refuse them.

use std::net::{IpAddr, SocketAddr, SocketAddrV6};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::wire::{DlRoute, Header, Password};

use super::*;

const SERVICE: &[u8; 8] = b"service!";
const OTHER: &[u8; 8] = b"another!";
const WRONG: &[u8; 8] = b"guessed!";
const PUBLIC: &str = "192.0.2.1";
const CLIENT: &str = "198.51.100.7:50000";
/// The kernel has no way to these, or would have to broadcast.
const NO_WAY: [&str; 2] = ["198.51.100.255", "203.0.113.9"];

/// As many sockets as are asked for.
#[derive(Default)]
struct Sockets {
    opened: u16,
    looked_for: usize,
}

impl Shell for Sockets {
    fn open_upstream(&mut self, _: UpstreamId, _: bool) -> Option<u16> {
        self.opened += 1;
        Some(50_000 + self.opened)
    }

    fn close_upstream(&mut self, _: UpstreamId) {}

    fn can_answer(&mut self, arrival: &Arrival) -> bool {
        self.looked_for += 1;
        !NO_WAY.contains(&arrival.client.ip().to_string().as_str())
    }

    fn flow_opened(&mut self, _: &Table, _: &FlowRecord) {}

    fn flow_closed(&mut self, _: &Table, _: &FlowRecord, _: CloseReason) {}
}

/// A relay with one net, and the time.
struct World {
    core: Core,
    counters: Arc<Counters>,
    shell: Sockets,
    now: Instant,
}

/// One net with node 4; `change` makes it the scenario's.
fn rules(change: impl FnOnce(&mut Net)) -> Rules {
    let credential = |name: &str, password: &[u8; 8]| Credential {
        name: name.into(),
        password: Password::new(*password),
        device_password: None,
    };
    let mut net = Net {
        name: "section-1".into(),
        kind: NetKind::UdpRange { start_port: 40_000 },
        allow: vec!["0.0.0.0/0".parse().unwrap(), "::/0".parse().unwrap()],
        credentials: vec![credential("service", SERVICE), credential("other", OTHER)],
        allow_without_password: false,
        require_response_password: false,
        idle_timeout: Duration::from_secs(300),
        max_flows: 100,
        max_requests: None,
        max_flow_requests: None,
    };
    change(&mut net);
    let mapping = Mapping {
        net: NetId(0),
        node_address: 4,
        public_port: 40_004,
        server: "172.17.17.4:34379".parse().unwrap(),
    };
    let limits = Limits {
        max_flows: 1000,
        wrong_password_burst: 3,
        wrong_password_address_burst: 6,
        wrong_password_interval: Duration::from_secs(3600),
    };
    Rules::new(Arc::new(Table::new(Header::default(), vec![net], vec![mapping])), limits)
}

/// A request to node 4, and just as well its answer.
fn octets(password: &[u8]) -> Vec<u8> {
    let route = DlRoute::new(&[11, 4, 2], &[11, 3]).unwrap().to_route().unwrap();
    let mut octets = Header::default().0.to_vec();
    octets.extend(route.as_route().as_bytes());
    octets.extend([0x02, 0]);
    octets.extend(password);
    octets
}

impl World {
    fn new(change: impl FnOnce(&mut Net)) -> Self {
        let rules = rules(change);
        let counters = Arc::new(Counters::new(&rules.table));
        let now = Instant::now();
        let random = Chance::from_seed(1);
        let core = Core::new(rules, Arc::clone(&counters), now, random);
        Self { core, counters, shell: Sockets::default(), now }
    }

    /// A request that nobody sends on yet.
    fn ask_from(
        &mut self,
        client: SocketAddr,
        public: &str,
        password: &[u8; 8],
    ) -> Result<ToServer, DropReason> {
        let arrival = Arrival {
            listener: ListenerId(0),
            mapping: MappingId(0),
            public_address: public.parse::<IpAddr>().unwrap(),
            client,
        };
        self.core.request(self.now, &arrival, &mut octets(password), &mut self.shell)
    }

    fn ask(&mut self, client: &str, password: &[u8; 8]) -> Result<ToServer, DropReason> {
        let client: SocketAddr = client.parse().unwrap();
        let public = if client.is_ipv4() { PUBLIC } else { "2001:db8::1" };
        self.ask_from(client, public, password)
    }

    fn sent(&mut self, to: ToServer) {
        self.core.request_sent(self.now, MappingId(0), to.asks, 24);
    }

    fn flows(&self) -> usize {
        self.core.flows(self.now).count()
    }

    fn node(&self) -> &NodeCounters {
        self.counters.node(MappingId(0))
    }
}

#[test]
fn who_forges_a_source_that_no_answer_reaches() {
    let mut world = World::new(|net| net.max_flows = 1);
    let forged = [
        "198.51.100.7:0",
        "0.0.0.0:50000",
        "0.1.2.3:50000",
        "224.0.0.1:50000",
        "239.255.255.255:50000",
        "240.0.0.1:50000",
        "255.255.255.255:50000",
        "198.51.100.255:50000",
        "203.0.113.9:50000",
        "[2001:db8::7]:0",
        "[::]:50000",
        "[ff02::1]:50000",
        "[ff0e::7]:50000",
        "[::ffff:255.255.255.255]:50000",
    ];
    for client in forged {
        assert_eq!(world.ask(client, SERVICE), Err(DropReason::Unanswerable), "{client}");
    }
    assert_eq!(world.flows(), 0);
    assert!(world.ask(CLIENT, SERVICE).is_ok(), "nothing was used up");
    let received = world.node().direction(Direction::Request).received.get();
    assert_eq!(received, forged.len() as u64 + 1);
}

#[test]
fn an_address_of_a_link_is_for_that_link() {
    let mut world = World::new(|_| {});
    let global: SocketAddr = "[2001:db8::7]:50000".parse().unwrap();
    let of_the_link: SocketAddr = SocketAddrV6::new("fe80::7".parse().unwrap(), 50000, 0, 2).into();
    let mut passes = |client, public| world.ask_from(client, public, SERVICE).is_ok();
    assert!(!passes(global, "fe80::1"));
    assert!(passes(of_the_link, "fe80::1"));
    assert!(passes(of_the_link, "2001:db8::1"));
    assert!(passes(global, "2001:db8::1"));
}

/// Only who has the password has the kernel look for the way, and only once.
#[test]
fn strangers_have_no_way_looked_for() {
    let mut world = World::new(|_| {});
    assert_eq!(world.ask("198.51.100.255:7", WRONG), Err(DropReason::PasswordWrong));
    assert_eq!(world.shell.looked_for, 0);
    (0..3).for_each(|_| assert!(world.ask(CLIENT, SERVICE).is_ok()));
    assert_eq!(world.shell.looked_for, 1);
}

#[test]
fn what_was_not_sent_was_not_asked() {
    let mut world = World::new(|_| {});
    world.ask(CLIENT, SERVICE).unwrap();
    world.core.send_failed(MappingId(0), Direction::Request);
    let asked =
        |world: &World| (world.node().last_request.get(), world.node().unanswered_since.get());
    assert_eq!(asked(&world), (0, 0));
    assert!(!world.core.awaits_answers(world.now), "nothing to wait for at the end");

    // The response time is that of the one that was sent.
    world.now += Duration::from_secs(2);
    let to = world.ask(CLIENT, SERVICE).unwrap();
    world.sent(to);
    assert!(world.core.awaits_answers(world.now));
    assert_ne!(asked(&world), (0, 0));
    world.now += Duration::from_millis(3);
    world.core.response(world.now, to.via, to.server, &mut octets(SERVICE)).unwrap();
    let nanos: u64 = world.node().response_times.buckets().map(|(_, nanos)| nanos).sum();
    assert_eq!(Duration::from_nanos(nanos), Duration::from_millis(3));
}

#[test]
fn who_forges_a_nodes_address() {
    let mut world = World::new(|_| {});
    for client in ["172.17.17.44:34379", "172.17.17.4:34379", "172.17.17.200:50000"] {
        assert_eq!(world.ask(client, SERVICE), Err(DropReason::SourceNotAllowed), "{client}");
    }
    let mut world = World::new(|net| net.allow.push("172.17.17.200/29".parse().unwrap()));
    assert!(world.ask("172.17.17.200:50000", SERVICE).is_ok(), "N-4");
    let node = world.ask("172.17.17.44:34379", SERVICE);
    assert_eq!(node, Err(DropReason::SourceNotAllowed));
}
