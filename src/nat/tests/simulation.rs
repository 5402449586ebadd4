//! A simulation of clients, nodes, time, limits and new configurations around two cores. After
//! every step, the rules of the relay are checked.
//!
//! A run that fails prints its seed, and `SIMULATION_SEED=… cargo test simulation` replays it. What
//! the simulation expects of a datagram comes from how it made the datagram, never from the code
//! under test.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Debug;
use std::hash::{DefaultHasher, Hasher};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use fastrand::Rng;

use super::fixture::{Worker, credential, datagram, mapping};
use crate::nat::*;
use crate::pnet::wire::{Header, MAX_DATAGRAM, Password};

const RUNS: u64 = 40;
const STEPS: usize = 4_000;
const SECOND: Duration = Duration::from_secs(1);
/// N-9.
const REST: Duration = Duration::from_secs(120);

const CLIENTS: [&str; 10] = [
    "198.51.100.1:1000",
    "198.51.100.1:1001",
    "198.51.100.2:1000",
    "198.51.100.2:1001",
    "198.51.100.3:1000",
    "198.51.100.4:1000",
    "198.51.100.5:1000",
    "198.51.100.6:1000",
    "203.0.113.1:1000", // outside every allow list
    "203.0.113.2:1000",
];
const PUBLIC: [&str; 2] = ["192.0.2.1", "192.0.2.2"];
/// One of the router's own addresses, which some nets allow.
const INSIDE: &str = "198.51.100.254";

/// What the relay must do with a request that the simulation made.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Expect {
    /// Forward it, or drop it because a limit is reached.
    Pass,
    /// Drop it for this reason, or for one that is checked before.
    Drop(DropReason),
}

/// A request that waits for an answer. It has no index of a table, because tables change.
#[derive(Clone)]
struct Asked {
    worker: usize,
    client: SocketAddr,
    public_address: IpAddr,
    public_port: u16,
    to: ToServer,
    sent: Instant,
    /// As the client sent it, and as the server got it.
    octets: [Vec<u8>; 2],
}

/// What of a flow stays the same in a reload.
#[derive(Clone, Debug, PartialEq)]
struct Lasting {
    client: SocketAddr,
    public_address: IpAddr,
    net: String,
    mapping: (u8, u16, SocketAddr),
    passwords: [[u8; 8]; 2],
    upstream_port: u16,
}

/// What can have a limit of requests.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Limited {
    Net(String),
    /// Client, public address and public port.
    Flow(SocketAddr, IpAddr, u16),
}

/// The sockets as the simulation sees them.
struct FakeEffects {
    rng: Rng,
    limit: usize,
    ports: BTreeMap<UpstreamId, u16>,
    /// Ports that a configuration has wanted. No socket gets them any more.
    wanted: BTreeSet<u16>,
    opened_flows: usize,
    closed_flows: usize,
    /// Throttlings that have begun and not ended.
    throttled: usize,
}

impl Effects for FakeEffects {
    fn open_upstream(
        &mut self,
        _: &Table,
        id: UpstreamId,
        _: NetId,
        kind: SocketKind,
    ) -> Option<u16> {
        assert!(kind.ipv4 && !self.ports.contains_key(&id), "opened twice");
        if self.ports.len() >= self.limit {
            return None;
        }
        // Few ports, so that the kernel would give freed ones again soon.
        let port = std::iter::repeat_with(|| self.rng.u16(50_000..50_200))
            .find(|port| self.ports.values().chain(&self.wanted).all(|other| other != port))?;
        self.ports.insert(id, port);
        Some(port)
    }

    fn close_upstream(&mut self, id: UpstreamId) {
        self.ports.remove(&id).expect("closes what it opened");
    }

    fn has_upstream_port(&self, port: u16) -> bool {
        self.ports.values().any(|&other| other == port)
    }

    fn is_own_address(&mut self, address: SocketAddr) -> bool {
        address.ip() == INSIDE.parse::<IpAddr>().unwrap()
    }

    fn flow_opened(&mut self, _: &Table, flow: &FlowRecord) {
        assert!(self.ports.values().any(|&port| port == flow.upstream_port));
        self.opened_flows += 1;
    }

    fn flow_closed(&mut self, table: &Table, flow: &FlowRecord, reason: CloseReason) {
        let net = table.net(table.mapping(flow.mapping).net);
        assert!(reason != CloseReason::Idle || flow.idle >= net.idle_timeout, "N-2: too early");
        self.closed_flows += 1;
    }

    fn throttling_begun(&mut self, _: &Table, throttled: &Throttled, _: MappingId) {
        assert_eq!((throttled.age, throttled.refused), (Duration::ZERO, 1));
        self.throttled += 1;
    }

    fn throttling_ended(&mut self, throttled: &Throttled) {
        assert!(throttled.refused > 0);
        self.throttled -= 1;
    }
}

struct World {
    rng: Rng,
    now: Instant,
    /// The newest.
    rules: Rules,
    /// Open flows after the last step. A lower limit does not close them.
    open_before: Vec<u64>,
    /// What workers went over from within the last second, and when.
    lately: Vec<(Instant, Rules)>,
    /// When requests passed in the last second: of each net, and of each flow.
    passed: BTreeMap<Limited, Vec<Instant>>,
    workers: Vec<Worker<FakeEffects>>,
    /// What each worker has been told to go over to, and has not yet.
    next: Vec<Option<Succession>>,
    under_way: Vec<Asked>,
    /// Who used a (worker, upstream port, server) last, and when (N-9).
    users: BTreeMap<(usize, u16, SocketAddr), (SocketAddr, Instant)>,
    next_number: u32,
    /// Of all verdicts so far.
    digest: DefaultHasher,
    forwarded: usize,
    delivered: usize,
    /// Answers among these that came to a port that was wanted for something else.
    last_answers: usize,
    reasons: [usize; DropReason::COUNT],
}

/// A random configuration. It may want a certain port for the press.
fn table(rng: &mut Rng, wanted: Option<u16>) -> Table {
    let wide = rng.u32(0..4) > 0;
    let clients = if wide { "198.51.100.0/24" } else { "198.51.100.0/30" };
    // Around the plant, without naming it.
    let allow = vec![clients.parse().unwrap(), "172.16.0.0/12".parse().unwrap()];
    // Requests come in bursts of about ten.
    let mut rate = |most| rng.bool().then(|| RequestRate::new(rng.u32(1..=most)));
    let (max_requests, max_flow_requests) = (rate(6), rate(2));
    let idle_timeout = Duration::from_secs(if rng.u32(0..4) == 0 { 40 } else { 150 });
    let net = |name: &str, kind, credentials, require_response_password, max_flows| Net {
        allow: allow.clone(),
        credentials,
        require_response_password,
        idle_timeout,
        max_flows,
        max_requests,
        max_flow_requests,
        ..Net::new(name, kind)
    };
    let mut range = vec![
        credential("service", b"service!", None),
        credential("rotated", b"rotated!", Some(b"device!!")),
    ];
    match rng.u32(0..6) {
        0 => drop(range.remove(0)),
        1 => drop(range.remove(1)),
        2 => range[1].device_password = Some(Password::new(*b"device-2")),
        3 => range.reverse(),
        _ => {}
    }
    let mut remote =
        vec![credential("new", b"remote-1", None), credential("old", b"remote-2", None)];
    if rng.u32(0..4) == 0 {
        remote.rotate_left(1);
    }
    let press = vec![credential("press", b"press!!!", None)];
    let mut mappings = vec![
        mapping(0, 1, 40_001, "172.17.17.1:34379"),
        mapping(0, 2, 40_002, "172.17.17.2:34379"),
        mapping(0, 33, 40_033, "172.17.17.33:34379"),
        mapping(1, 7, wanted.unwrap_or(40_200), "172.17.18.7:34379"),
        remote_mapping(5),
        remote_mapping(6),
    ];
    match rng.u32(0..6) {
        0 => drop(mappings.remove(rng.usize(0..6))),
        1 => mappings[2].server = "172.17.17.34:34379".parse().unwrap(),
        2 => mappings.rotate_left(1),
        _ => {}
    }
    let section = NetKind::UdpRange { start_port: 40_000 };
    let nets = vec![
        net("section-1", section, range, false, rng.u32(4..14)),
        net("press", NetKind::Server, press, true, 3),
        net("plant-2", NetKind::Remote { start_port: 40_000 }, remote, false, rng.u32(3..8)),
    ];
    Table::new(Header::default(), nets, mappings)
}

/// A node of another plant, at an address of its own.
fn remote_mapping(node_address: u8) -> Mapping {
    let server = format!("203.0.113.5:{}", 40_000 + u16::from(node_address));
    let local_address = Some([127, 17, 2, node_address].into());
    Mapping { local_address, ..mapping(2, node_address, 34_378, &server) }
}

fn limits(rng: &mut Rng) -> Limits {
    Limits {
        max_flows: rng.u32(5..15),
        wrong_password_burst: 2,
        wrong_password_address_burst: 1024,
        wrong_password_interval: Duration::from_secs(60),
    }
}

impl World {
    fn new(seed: u64) -> Self {
        let mut rng = Rng::with_seed(seed);
        let now = Instant::now();
        let limits = limits(&mut rng);
        let rules = Rules::new(Arc::new(table(&mut rng, None)), limits);
        let workers = (0..2).map(|_| {
            let seed = rng.u64(..);
            let effects = FakeEffects {
                rng: rng.fork(),
                limit: 8,
                ports: BTreeMap::new(),
                wanted: BTreeSet::new(),
                opened_flows: 0,
                closed_flows: 0,
                throttled: 0,
            };
            Worker::new(&rules, now, seed, effects)
        });
        let workers = workers.collect();
        Self {
            rng,
            now,
            open_before: vec![0; rules.table.nets().len() + 1],
            rules,
            lately: Vec::new(),
            passed: BTreeMap::new(),
            workers,
            next: vec![None, None],
            under_way: Vec::new(),
            users: BTreeMap::new(),
            next_number: 0,
            digest: DefaultHasher::new(),
            forwarded: 0,
            delivered: 0,
            last_answers: 0,
            reasons: [0; DropReason::COUNT],
        }
    }

    fn step(&mut self) {
        match self.rng.u32(0..100) {
            0..40 => self.good_request(),
            40..58 => self.bad_request(),
            58..80 => self.answer(),
            80..84 => self.bad_response(),
            84..87 => self.go_over(),
            87..96 => self.pass_time(1..5_000),
            96..98 => self.pass_time(1_000..200_000),
            98 => match self.rng.u32(0..3) {
                0 => self.under_way.clear(), // the nodes lost power
                _ => {
                    let limit = self.rng.usize(0..12);
                    self.workers.iter_mut().for_each(|worker| worker.effects.limit = limit);
                }
            },
            _ => self.reload(),
        }
        self.check();
    }

    fn arrival(&mut self) -> (usize, Arrival) {
        let client: SocketAddr = self.rng.choice(CLIENTS).unwrap().parse().unwrap();
        // As the kernel does it: a client belongs to one worker.
        let worker = usize::from(client.port() % 2);
        let table = &self.workers[worker].rules.table;
        let mapping = MappingId(self.rng.u32(0..table.mappings().len() as u32));
        let public_address: IpAddr = self.rng.choice(PUBLIC).unwrap().parse().unwrap();
        let public_address = table.mapping(mapping).local_address.unwrap_or(public_address);
        let listener = listener(table.mapping(mapping));
        (worker, Arrival { listener, mapping, public_address, client })
    }

    fn credential(&mut self, worker: usize, arrival: &Arrival) -> usize {
        let table = &self.workers[worker].rules.table;
        let net = table.net(table.mapping(arrival.mapping).net);
        match net.kind.is_remote() {
            true => 0, // the first one is put on
            false => self.rng.usize(0..net.credentials.len()),
        }
    }

    /// A request in IP format with a number of its own in its data.
    fn datagram(&mut self, worker: usize, arrival: &Arrival, password: &[u8]) -> Vec<u8> {
        let node = self.workers[worker].rules.table.mapping(arrival.mapping).node_address;
        self.next_number += 1;
        datagram([&[11, node, 2, 33], &[11, 3, 31]], &self.next_number.to_be_bytes(), password)
    }

    fn good_request(&mut self) {
        let (worker, arrival) = self.arrival();
        let credential = self.credential(worker, &arrival);
        let table = Arc::clone(&self.workers[worker].rules.table);
        let net = table.net(table.mapping(arrival.mapping).net);
        let password = as_client_sends(net, credential);
        let octets = self.datagram(worker, &arrival, &password);
        let expect = if net.allow.iter().any(|network| network.contains(&arrival.client.ip())) {
            Expect::Pass
        } else {
            Expect::Drop(DropReason::SourceNotAllowed)
        };
        self.request(worker, arrival, octets, credential, expect);
    }

    fn bad_request(&mut self) {
        let (worker, mut arrival) = self.arrival();
        let credential = self.credential(worker, &arrival);
        let table = Arc::clone(&self.workers[worker].rules.table);
        let net = table.net(table.mapping(arrival.mapping).net);
        let is_remote = net.kind.is_remote();
        let password = as_client_sends(net, credential);
        let mut octets = self.datagram(worker, &arrival, &password);
        let len = octets.len();
        let reason = match self.rng.u32(0..16) {
            0 | 1 | 9 if is_remote => {
                octets.extend(self.rng.choice([b"remote-1", b"service!"]).unwrap());
                DropReason::PasswordUnexpected
            }
            0 => {
                octets[len - 1] ^= 1 << self.rng.u32(0..8);
                DropReason::PasswordWrong
            }
            1 => {
                octets.truncate(len - 8);
                DropReason::PasswordMissing
            }
            2 => {
                octets.truncate(self.rng.usize(0..if is_remote { 8 } else { 16 }));
                DropReason::TooShort
            }
            3 => {
                octets.resize(self.rng.usize(MAX_DATAGRAM + 1..=128), 0);
                DropReason::TooLong
            }
            4 => {
                octets[self.rng.usize(0..4)] ^= 1 << self.rng.u32(0..8);
                DropReason::BadHeader
            }
            5 => {
                octets[6] = 0; // remaining-route-length
                DropReason::BadRoute
            }
            6 => {
                octets[9] &= 0x7f; // two sources left of three, then one: Complex
                octets[10] &= 0x7f;
                DropReason::RouteFormat
            }
            7 => {
                octets.push(0);
                DropReason::BadLength
            }
            8 => {
                octets[5] = if octets[5] == 99 { 98 } else { 99 };
                DropReason::NodeMismatch
            }
            9 => {
                // What is withdrawn is so at once.
                let passwords = [b"service!", b"rotated!", b"device!!", b"device-2", b"press!!!"];
                let known = |other: &[u8; 8]| {
                    net.credentials.iter().any(|credential| credential.password.octets() == other)
                };
                let other = self.rng.choice(passwords).filter(|other| !known(other));
                let Some(other) = other else { return };
                octets[len - 8..].copy_from_slice(other);
                DropReason::PasswordWrong
            }
            10 => {
                octets[self.rng.choice([4, 5, 7, 8]).unwrap()] = self.rng.u8(126..=127);
                DropReason::Broadcast
            }
            11 => {
                let ports = self.workers[worker].effects.ports.values().copied();
                let Some(port) = self.rng.choice(ports.collect::<Vec<_>>()) else { return };
                let address = self.rng.choice([arrival.public_address, INSIDE.parse().unwrap()]);
                arrival.client = (address.unwrap(), port).into();
                DropReason::Loop
            }
            12 => {
                arrival.public_address = Ipv4Addr::UNSPECIFIED.into();
                DropReason::NotUnicast
            }
            13 => {
                arrival.client.set_port(0);
                DropReason::Unanswerable
            }
            14 => {
                arrival.client = "172.17.17.44:34379".parse().unwrap(); // a node's
                DropReason::SourceNotAllowed
            }
            _ => {
                octets = std::iter::repeat_with(|| self.rng.u8(..)).take(len).collect();
                octets[0] = 0xff;
                DropReason::BadHeader
            }
        };
        self.request(worker, arrival, octets, credential, Expect::Drop(reason));
    }

    fn request(
        &mut self,
        worker: usize,
        arrival: Arrival,
        octets: Vec<u8>,
        credential: usize,
        expect: Expect,
    ) {
        let Worker { core, effects, rules, .. } = &mut self.workers[worker];
        let table = Arc::clone(&rules.table);
        let limits = rules.limits;
        let mapping = table.mapping(arrival.mapping);
        let net = table.net(mapping.net);
        let mut room = [&octets[..], &[0; Password::LEN]].concat();
        let mut payload = Payload::new(&mut room, octets.len());
        let known = core.flows(self.now).any(|flow| {
            (flow.client, flow.public_address, flow.mapping)
                == (arrival.client, arrival.public_address, arrival.mapping)
        });
        let verdict = core.request(self.now, &arrival, &mut payload, effects);
        let passed = payload.to_vec();
        note(&mut self.digest, &(arrival, verdict, &passed));
        if let Err(reason) = verdict {
            self.reasons[reason as usize] += 1;
        }
        let limited = [
            (Limited::Net(net.name.clone()), net.max_requests),
            (
                Limited::Flow(arrival.client, arrival.public_address, mapping.public_port),
                net.max_flow_requests,
            ),
        ];
        let rates = limited.map(|(limited, rate)| {
            let passed = self.passed.entry(limited).or_default();
            passed.extend(verdict.is_ok().then_some(self.now));
            passed.retain(|&at| self.now - at < SECOND);
            rate.map(|rate| (rate.per_second() as usize, passed.len()))
        });
        self.lately.retain(|(at, _)| self.now - *at < SECOND);
        if self.lately.is_empty() && self.next.iter().all(Option::is_none) {
            let within = |&(rate, passed): &(usize, usize)| passed <= 2 * rate;
            assert!(rates.iter().flatten().all(within), "(rate, passed): {rates:?}");
            if verdict == Err(DropReason::RequestLimit) {
                let used_up = |&(rate, passed): &(usize, usize)| passed >= rate;
                assert!(rates.iter().flatten().any(used_up), "(rate, passed): {rates:?}");
            }
        } else if let Some(most) = self.most_requests(mapping.net) {
            let passed = self.passed[&Limited::Net(net.name.clone())].len();
            assert!(passed <= 2 * most, "a reload fills no bucket: {passed} of {most} a second");
        }
        match (expect, verdict) {
            (Expect::Pass, Err(DropReason::RequestLimit)) => {
                assert!(rates.iter().any(Option::is_some), "nothing is limited");
            }
            (Expect::Pass, Ok(to)) => {
                assert_eq!(to.server, mapping.server, "R-9");
                let head = passed.len() - 8;
                assert_eq!(passed[..head], octets[..head], "R-8");
                let at_server = net.credentials[credential].at_server().octets();
                assert_eq!(&passed[head..], at_server);
                let Worker { core, effects, .. } = &mut self.workers[worker];
                let port = effects.ports[&to.via];
                let key = (worker, port, to.server);
                if let Some((client, last)) = self.users.insert(key, (arrival.client, self.now))
                    && client != arrival.client
                {
                    let idle = self.now - last;
                    assert!(idle >= REST, "N-9: another client's port after {idle:?}");
                }
                if self.rng.u32(0..20) == 0 {
                    core.send_failed(arrival.mapping, Direction::Request);
                    return;
                }
                core.request_sent(self.now, arrival.mapping, to.asks, passed.len());
                self.forwarded += 1;
                self.under_way.push(Asked {
                    worker,
                    client: arrival.client,
                    public_address: arrival.public_address,
                    public_port: mapping.public_port,
                    to,
                    sent: self.now,
                    octets: [octets, passed],
                });
            }
            (Expect::Pass, Err(reason)) => {
                let want_of_room =
                    [DropReason::FlowLimit, DropReason::UpstreamExhausted, DropReason::Throttled];
                assert!(want_of_room.contains(&reason), "{reason:?}");
                assert!(!known, "N-8: an open flow is served whatever is full, not {reason:?}");
                let open = self.open_flows();
                let full = open[usize::from(mapping.net.0)] >= u64::from(net.max_flows)
                    || open[open.len() - 1] >= u64::from(limits.max_flows);
                let budget = &self.workers[worker].rules.budget;
                let full = full || !budget.has_room_for_lease(mapping.net);
                assert!(full || reason != DropReason::FlowLimit, "{open:?}");
                let effects = &self.workers[worker].effects;
                let sockets_left = effects.ports.len() < effects.limit;
                assert!(!(sockets_left && reason == DropReason::UpstreamExhausted));
            }
            (Expect::Drop(expected), Err(reason)) => {
                let before = [DropReason::SourceNotAllowed, DropReason::Throttled];
                assert!(
                    reason == expected || (!known && before.contains(&reason)),
                    "{reason:?} instead of {expected:?}"
                );
            }
            (Expect::Drop(expected), Ok(_)) => panic!("passed instead of {expected:?}"),
        }
    }

    /// A node answers one of the requests, with the password or without one.
    fn answer(&mut self) {
        if self.under_way.is_empty() {
            return;
        }
        let asked = self.under_way.swap_remove(self.rng.usize(0..self.under_way.len()));
        if self.now - asked.sent >= REST {
            return; // later than any node answers, and than N-9 protects
        }
        let [as_sent, as_got] = asked.octets;
        let mut octets = as_got;
        let without_password = self.rng.u32(0..10) == 0;
        if without_password {
            octets.truncate(octets.len() - 8);
        }
        let len = octets.len();
        let Worker { core, rules, .. } = &self.workers[asked.worker];
        let table = Arc::clone(&rules.table);
        // Also one that is closed but for its last answers.
        let known = core.takes_answers(asked.client, asked.to.server);
        let port = self.workers[asked.worker].effects.ports.get(&asked.to.via);
        let is_shown = core.flows(self.now).any(|flow| Some(&flow.upstream_port) == port);
        match self.response(asked.worker, asked.to.via, asked.to.server, &mut octets) {
            Ok(to) => {
                assert!(known, "an answer through a flow that is withdrawn");
                let mapping = table.mapping(to.mapping);
                assert_eq!(
                    (to.client, to.public_address, mapping.public_port, mapping.server),
                    (asked.client, asked.public_address, asked.public_port, asked.to.server),
                    "an answer to another client, or from another port"
                );
                assert_eq!(to.via, listener(mapping), "the socket of the port");
                assert!(!(without_password && table.net(mapping.net).require_response_password));
                let len = len.min(as_sent.len()); // a remote net takes the password off
                assert_eq!(octets, as_sent[..len], "R-8");
                self.delivered += 1;
                self.last_answers += usize::from(!is_shown);
            }
            Err(DropReason::UnknownFlow | DropReason::PasswordMismatch) => {}
            Err(reason) => panic!("a good answer was dropped: {reason:?}"),
        }
    }

    /// A datagram at an upstream socket that must not reach any client.
    fn bad_response(&mut self) {
        let worker = self.rng.usize(0..self.workers.len());
        let ports = &self.workers[worker].effects.ports;
        let Some(&via) = self.rng.choice(ports.keys().collect::<Vec<_>>()) else { return };
        let table = Arc::clone(&self.workers[worker].rules.table);
        let server = self.rng.choice(table.mappings()).unwrap().server;
        let (other, arrival) = self.arrival();
        let mut octets = self.datagram(other, &arrival, b"nobody's");
        let (server, reasons): (SocketAddr, &[_]) = match self.rng.u32(0..4) {
            0 => ("172.17.17.99:34379".parse().unwrap(), &[DropReason::UnknownFlow]),
            1 => (SocketAddr::new(server.ip(), 34_378), &[DropReason::UnknownFlow]),
            2 => (server, &[DropReason::UnknownFlow, DropReason::PasswordMismatch]),
            _ => {
                octets.truncate(self.rng.usize(0..octets.len() - 8));
                let cut = [DropReason::UnknownFlow, DropReason::TooShort];
                let mut reasons = cut.to_vec();
                reasons.extend([DropReason::BadRoute, DropReason::BadLength]);
                (server, reasons.leak())
            }
        };
        let verdict = self.response(worker, via, server, &mut octets);
        let reason = verdict.expect_err("a bad response passed");
        assert!(reasons.contains(&reason), "{reason:?}");
    }

    fn response(
        &mut self,
        worker: usize,
        via: UpstreamId,
        server: SocketAddr,
        octets: &mut Vec<u8>,
    ) -> Result<ToClient, DropReason> {
        let Worker { core, effects, .. } = &mut self.workers[worker];
        let mut payload = Payload::from(&mut octets[..]);
        let verdict = core.response(self.now, via, server, &mut payload);
        let len = payload.len();
        octets.truncate(len);
        note(&mut self.digest, &(via, server, verdict, &octets));
        match verdict {
            Ok(to) => {
                core.response_sent(to.mapping, octets.len());
                let used = (to.client, self.now);
                self.users.insert((worker, effects.ports[&via], server), used);
            }
            Err(reason) => self.reasons[reason as usize] += 1,
        }
        verdict
    }

    fn pass_time(&mut self, milliseconds: std::ops::Range<u64>) {
        self.now += Duration::from_millis(self.rng.u64(milliseconds));
        // Or the worker has something else to do first.
        let to_the_end = self.rng.u32(0..4) > 0;
        for (index, Worker { core, effects, rules, .. }) in self.workers.iter_mut().enumerate() {
            let table = &rules.table;
            let idle = |flow: &FlowRecord| {
                let server = table.mapping(flow.mapping).server;
                self.now - self.users[&(index, flow.upstream_port, server)].1
            };
            let lively = |flow: &FlowRecord| {
                idle(flow) < table.net(table.mapping(flow.mapping).net).idle_timeout
            };
            let expected = core.flows(self.now).filter(lively).count();
            // The first round may be the rest of one that began earlier.
            for _ in 0..2 {
                while core.expire(self.now, effects) && to_the_end {}
            }
            let left = core.flows(self.now).filter(lively).count();
            assert_eq!(left, expected, "N-2, N-3: closed too early");
            // A shorter time-out is found when a flow goes over to it.
            if to_the_end && core.going_over.is_none() {
                assert_eq!(core.flows(self.now).count(), left, "N-2: idle for too long");
            }
        }
    }

    /// The operator brings a new configuration. The workers go over to it one after the other.
    fn reload(&mut self) {
        while self.next.iter().any(Option::is_some) {
            self.go_over();
        }
        for Worker { core, effects, .. } in &mut self.workers {
            while core.going_over.is_some() {
                core.go_over(self.now, effects);
            }
        }
        let limits = limits(&mut self.rng);
        // The port of a socket that waits for an answer, now and then.
        let wanted = self.rng.choice(&self.under_way).filter(|_| self.rng.u32(0..4) > 0);
        let wanted = wanted
            .and_then(|asked| self.workers[asked.worker].effects.ports.get(&asked.to.via).copied());
        for Worker { effects, .. } in &mut self.workers {
            effects.wanted.extend(wanted);
        }
        let rules = self.rules.followed_by(Arc::new(table(&mut self.rng, wanted)), limits);
        let (old, new) = (&self.rules.table, &rules.table);
        let listeners = |table: &Table| -> BTreeSet<_> {
            table.mappings().iter().copied().map(listener).collect()
        };
        let gone = listeners(old).difference(&listeners(new)).copied().collect();
        let succession = |worker: &Worker<_>| Some(worker.succession(&rules, &gone));
        self.next = self.workers.iter().map(succession).collect();
        self.rules = rules;
    }

    /// A worker goes over to the new configuration, or some more of its flows do.
    fn go_over(&mut self) {
        let (now, index) = (self.now, self.rng.usize(0..self.workers.len()));
        let worker = &mut self.workers[index];
        let Some(next) = self.next[index].take() else {
            worker.go_over(now);
            return;
        };
        let old = worker.rules.clone();
        let lasting = |worker: &Worker<_>| -> Vec<_> {
            worker.core.flows(now).map(|flow| lasting(&worker.rules.table, &flow)).collect()
        };
        let before = lasting(worker);
        worker.reload(now, next);
        let (after, new) = (lasting(worker), &worker.rules.table);
        for flow in &before {
            assert_eq!(after.contains(flow), is_good(new, flow), "{flow:?}");
        }
        assert!(after.iter().all(|flow| before.contains(flow)), "flows out of nowhere");
        self.lately.push((now, old));
    }

    /// The most requests a second that a net may have had under the rules of the last second; none
    /// when some set no limit.
    fn most_requests(&self, net: NetId) -> Option<usize> {
        let rules = self.workers.iter().map(|worker| &worker.rules);
        let rules = rules.chain(self.lately.iter().map(|(_, rules)| rules));
        let rates: Option<Vec<_>> = rules.map(|rules| rules.table.net(net).max_requests).collect();
        rates?.into_iter().map(|rate| rate.per_second() as usize).max()
    }

    /// Open flows of each net, and of all.
    fn open_flows(&self) -> Vec<u64> {
        let open =
            |net| self.workers.iter().map(|worker| worker.counters.net(net).flows.get()).sum();
        let mut open: Vec<u64> =
            (0..self.rules.table.nets().len() as u16).map(|net| open(NetId(net))).collect();
        open.push(open.iter().sum());
        open
    }

    fn check(&mut self) {
        let leases: usize = self.workers.iter().map(|worker| worker.core.upstreams.leases()).sum();
        assert_eq!(self.rules.budget.leases_taken(), leases, "each lease has its place");
        for Worker { core, counters, effects, rules, .. } in &self.workers {
            core.check_invariants(self.now);
            let (told, flows) =
                (effects.opened_flows - effects.closed_flows, core.flows(self.now).count());
            // What is withdrawn is shown no more, and is closed in its turn.
            assert!(flows == told || (flows < told && core.going_over.is_some()), "N-10");
            assert_eq!(effects.throttled == 0, core.throttle.is_quiet());
            let nodes = rules.table.mapping_ids().map(|id| counters.node(id));
            for node in nodes.chain([&*counters.stray]) {
                for direction in Direction::ALL.map(|direction| node.direction(direction)) {
                    let accounted = direction.forwarded.get() + direction.dropped_total();
                    assert_eq!(direction.received.get(), accounted, "the law of the counters");
                }
            }
        }
        let open = self.open_flows();
        for (index, (&open, &before)) in open.iter().zip(&self.open_before).enumerate() {
            let limit = |rules: &Rules| match rules.table.nets().get(index) {
                Some(net) => net.max_flows,
                None => rules.limits.max_flows,
            };
            let limit = self.workers.iter().map(|worker| limit(&worker.rules)).max();
            let most = limit.map(u64::from).max(Some(before));
            assert!(Some(open) <= most, "N-8: {open} flows, limit {limit:?}");
        }
        self.open_before = open;
    }

    /// Each dropped datagram is in the list of who was refused, except those that belong to no net.
    /// The list goes on over reloads.
    fn check_refused(&self) {
        let noted = |Worker { counters, .. }: &Worker<_>| {
            let listed: u64 = counters.refusals.list().map(|refusal| refusal.count).sum();
            let strays = counters.stray.direction(Direction::Response).dropped_total();
            listed + counters.refusals.not_listed.get() + strays
        };
        let noted: u64 = self.workers.iter().map(noted).sum();
        assert_eq!(noted, self.reasons.iter().sum::<usize>() as u64);
        for refusal in self.workers.iter().flat_map(|worker| worker.counters.refusals.list()) {
            assert!(0 < refusal.first && refusal.first <= refusal.last, "{refusal:?}");
        }
    }
}

/// The public socket of a port. It keeps its name as long as there is one.
fn listener(mapping: Mapping) -> ListenerId {
    let node = mapping.local_address.map_or(0, |_| mapping.node_address);
    ListenerId(u32::from(mapping.public_port) << 8 | u32::from(node))
}

/// The end of a client's request.
fn as_client_sends(net: &Net, credential: usize) -> Vec<u8> {
    match net.kind.is_remote() {
        true => Vec::new(),
        false => net.credentials[credential].password.octets().to_vec(),
    }
}

/// Adds to a digest what was seen.
fn note(digest: &mut DefaultHasher, seen: &impl Debug) {
    digest.write(format!("{seen:?}").as_bytes());
}

fn lasting(table: &Table, flow: &FlowRecord) -> Lasting {
    let mapping = table.mapping(flow.mapping);
    let net = table.net(mapping.net);
    let credential = &net.credentials[flow.credential.unwrap()];
    Lasting {
        client: flow.client,
        public_address: flow.public_address,
        net: net.name.clone(),
        mapping: (mapping.node_address, mapping.public_port, mapping.server),
        passwords: [&credential.password, credential.at_server()]
            .map(|password| *password.octets()),
        upstream_port: flow.upstream_port,
    }
}

/// Whether a flow has its mapping, its passwords and its client's address in this table.
fn is_good(table: &Table, flow: &Lasting) -> bool {
    table.mappings().iter().any(|mapping| {
        let net = table.net(mapping.net);
        let passwords = |credential: &Credential| {
            [&credential.password, credential.at_server()].map(|password| *password.octets())
        };
        (mapping.node_address, mapping.public_port, mapping.server) == flow.mapping
            && net.name == flow.net
            && net.allow.iter().any(|network| network.contains(&flow.client.ip()))
            && net.credentials.iter().any(|credential| passwords(credential) == flow.passwords)
    })
}

fn run(seed: u64) -> World {
    /// Tells the seed when a step panics.
    struct Seed(u64);
    impl Drop for Seed {
        fn drop(&mut self) {
            if std::thread::panicking() {
                println!("replay with SIMULATION_SEED={}", self.0);
            }
        }
    }
    let seed = Seed(seed);
    let mut world = World::new(seed.0);
    (0..STEPS).for_each(|_| world.step());
    world.check_refused();
    world
}

#[test]
fn simulation_holds_the_rules_after_every_step() {
    if let Ok(seed) = std::env::var("SIMULATION_SEED") {
        let world = run(seed.parse().expect("SIMULATION_SEED is a number"));
        return println!("digest {:016x}", world.digest.finish());
    }
    let (mut forwarded, mut delivered, mut last_answers) = (0, 0, 0);
    let mut reasons = [0; DropReason::COUNT];
    for _ in 0..RUNS {
        let world = run(Rng::new().u64(..));
        forwarded += world.forwarded;
        delivered += world.delivered;
        last_answers += world.last_answers;
        (0..reasons.len()).for_each(|reason| reasons[reason] += world.reasons[reason]);
    }
    // A simulation in which nothing happens proves nothing.
    assert!(forwarded > 10_000 && delivered > 5_000, "{forwarded} {delivered}");
    assert!(last_answers > 0, "no port was ever wanted while answers were due");
    for reason in DropReason::REQUEST.into_iter().chain(DropReason::RESPONSE) {
        assert!(
            reasons[reason as usize] > 0 || reason == DropReason::SendFailed,
            "{reason:?} never happened"
        );
    }
}

/// Otherwise the seed that a failing run prints would be of no use.
#[test]
fn one_seed_is_one_path_in_every_process() {
    let digest = || {
        let test = "nat::tests::simulation::simulation_holds_the_rules_after_every_step";
        let mut replay = Command::new(std::env::current_exe().unwrap());
        replay.args(["--exact", test, "--nocapture"]).env("SIMULATION_SEED", "62412");
        let output = String::from_utf8(replay.output().unwrap().stdout).unwrap();
        let digest = output.lines().find_map(|line| Some(line.split_once("digest ")?.1.to_owned()));
        digest.unwrap_or_else(|| panic!("{output}"))
    };
    assert_eq!(digest(), digest());
}
