//! The programs against the core: what the program passes, the core passes, and what it does not pass it
//! leaves untouched. Needs the right to load programs.

use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::time::Duration;

use super::layout::Entry;
use super::*;
use crate::nat::{
    Arrival, Chance, Core, Counters, Credential, Direction, Effects, Limits, ListenerId, Mapping,
    MappingId, Net, NetId, NetKind, Payload, ResponseTimes, Rules, SocketKind, UpstreamId,
};
use crate::pnet::wire::{self, Datagram, Header, Password};

const PASSWORD: &[u8; 8] = b"service!";
const CLIENT: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(198, 51, 100, 7), 50_000);
const PUBLIC: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(192, 0, 2, 1), 20_004);
const UPSTREAM: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(172, 17, 17, 254), 50_001);
const SERVER: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(172, 17, 17, 4), 34_379);
const NODE: u8 = 4;
/// The loopback interface, by which frames come in a test run.
const LOOPBACK: u32 = 1;
/// To which hardware address datagrams leave, and from which.
const HARDWARE: [u8; 12] = [2, 0, 0, 0, 0, 7, 2, 0, 0, 0, 0, 1];

/// A flow that both carry.
struct Both {
    offload: Arc<Offload>,
    counters: Arc<Counters>,
    core: Core,
    now: Instant,
    via: UpstreamId,
    shared: Lent<crate::nat::SharedFlow>,
    entries: [Entry; 2],
}

struct Sockets;

impl Effects for Sockets {
    fn open_upstream(&mut self, _: &Table, _: UpstreamId, _: NetId, _: SocketKind) -> Option<u16> {
        Some(UPSTREAM.port())
    }

    fn close_upstream(&mut self, _: UpstreamId) {}
}

fn table() -> Arc<Table> {
    let password = Password::new(*PASSWORD);
    let credential = Credential { name: "service".into(), password, device_password: None };
    let net = Net {
        allow: vec!["0.0.0.0/0".parse().unwrap()],
        credentials: vec![credential],
        ..Net::new("section-1", NetKind::UdpRange { start_port: 20_000 })
    };
    let mapping = Mapping {
        net: NetId(0),
        node_address: NODE,
        local_address: None,
        public_port: PUBLIC.port(),
        server: SERVER.into(),
    };
    Arc::new(Table::new(Header::default(), vec![net], vec![mapping]))
}

impl Both {
    /// Where programs may not be loaded, says so and returns `None`.
    fn new() -> Option<Self> {
        let (table, now) = (table(), Instant::now());
        let offload = match Offload::load(&table, 16, now) {
            Ok(offload) => Arc::new(offload),
            Err(error) => {
                assert!(std::env::var("PNET_NAT_TESTS").as_deref() != Ok("all"), "{error}");
                println!("left out: {error}");
                return None;
            }
        };
        let limits = Limits {
            max_flows: 16,
            wrong_password_burst: u16::MAX,
            wrong_password_address_burst: u32::MAX,
            wrong_password_interval: Duration::from_secs(1),
        };
        let own = Arc::new(Counters::new(&table));
        let rules = Rules::new(Arc::clone(&table), limits);
        let mut core = Core::new(rules, own, now, Chance::from_seed(1));
        let mut octets = datagram([&[2, NODE], &[3, 0xB3, 0xFD, 0xB1]], &[1, 2, 3], PASSWORD);
        let payload = &mut Payload::from(&mut octets[..]);
        let to = core.request(now, &arrival(), payload, &mut Sockets).unwrap();
        core.request_sent(now, MappingId(0), to.asks, 20);

        let lender = Arc::clone(&offload) as Arc<dyn SharedCounters>;
        let counters = Arc::new(Counters::of_offload(&table, lender));
        let shared = offload.flows.lend().unwrap();
        let [node, credential] = counters.places(MappingId(0), NetId(0), 0).unwrap();
        let entry = |direction, comes: [SocketAddrV4; 2], leaves: [SocketAddrV4; 2]| {
            let key = |[source, destination]: [SocketAddrV4; 2]| Key { source, destination };
            let (comes, leaves) = (key(comes), key(leaves));
            let (flow, password) = (shared.place(), *PASSWORD);
            let header = Header::default().0;
            let node_address = NODE;
            Entry {
                password,
                header,
                comes,
                leaves,
                direction,
                node_address,
                flow,
                node,
                credential,
            }
        };
        let entries = [
            entry(Direction::Request, [CLIENT, PUBLIC], [UPSTREAM, SERVER]),
            entry(Direction::Response, [SERVER, UPSTREAM], [PUBLIC, CLIENT]),
        ];
        for entry in &entries {
            let octets = entry.to_octets();
            bpf::update(offload.entries.as_fd(), &entry.comes.to_octets(), &octets.0).unwrap();
        }
        let both = Self { offload, counters, core, now, via: to.via, shared, entries };
        both.lend_way(u64::MAX, LOOPBACK);
        Some(both)
    }

    /// The ways out of both directions.
    fn lend_way(&self, lease: u64, interface: u32) {
        for way in &self.offload.flows.all()[self.shared.place() as usize].ways {
            way.lease.store(lease, Relaxed);
            way.interface.store(interface, Relaxed);
            for (word, octets) in way.hardware.iter().zip(HARDWARE.chunks(4)) {
                word.store(u32::from_ne_bytes(octets.try_into().unwrap()), Relaxed);
            }
        }
    }

    /// What the program does with a frame: the new frame, if it passes.
    fn program(&self, frame: &[u8]) -> Option<Vec<u8>> {
        let (result, after) = bpf::test_run(self.offload.passing.as_fd(), frame).unwrap();
        match result {
            7 => Some(after),
            -1 => {
                assert_eq!(after, frame, "it takes the long way untouched");
                None
            }
            other => panic!("the program returns {other}"),
        }
    }

    /// Whether the core passes the payload of a frame of this direction.
    fn core(&mut self, direction: Direction, payload: &[u8]) -> bool {
        let mut octets = payload.to_vec();
        let payload = &mut Payload::from(&mut octets[..]);
        match direction {
            Direction::Request => {
                self.core.request(self.now, &arrival(), payload, &mut Sockets).is_ok()
            }
            Direction::Response => {
                self.core.response(self.now, self.via, SERVER.into(), payload).is_ok()
            }
        }
    }

    fn check_passed(&self, direction: Direction, before: &[u8], after: &[u8]) {
        let entry = &self.entries[direction as usize];
        let Key { source, destination } = entry.leaves;
        let payload = &before[42..];
        assert_eq!(after, frame(HARDWARE, source, destination, payload), "{payload:02x?}");
    }
}

fn arrival() -> Arrival {
    Arrival {
        listener: ListenerId(0),
        mapping: MappingId(0),
        public_address: (*PUBLIC.ip()).into(),
        client: SocketAddr::V4(CLIENT),
    }
}

fn datagram([destinations, rest]: [&[u8]; 2], data: &[u8], password: &[u8]) -> Vec<u8> {
    let control = [0x02, data.len() as u8];
    [&Header::default().0[..], destinations, rest, &control, data, password].concat()
}

fn sum(octets: &[u8]) -> u16 {
    let mut sum: u32 = octets
        .chunks(2)
        .map(|word| u32::from(word[0]) << 8 | word.get(1).copied().map_or(0, u32::from))
        .sum();
    while sum > 0xFFFF {
        sum = (sum & 0xFFFF) + (sum >> 16);
    }
    sum as u16
}

/// An Ethernet frame as the relay's host would send it.
fn frame(
    hardware: [u8; 12],
    source: SocketAddrV4,
    destination: SocketAddrV4,
    payload: &[u8],
) -> Vec<u8> {
    let udp_length = (8 + payload.len()) as u16;
    let addresses = [source.ip().octets(), destination.ip().octets()].concat();
    let mut ip = [
        &[0x45, 0][..],
        &(20 + udp_length).to_be_bytes(),
        &[0, 0, 0x40, 0, 64, 17, 0, 0],
        &addresses,
    ]
    .concat();
    let checksum = !sum(&ip);
    ip[10..12].copy_from_slice(&checksum.to_be_bytes());
    let ports = [source.port().to_be_bytes(), destination.port().to_be_bytes()].concat();
    let mut udp = [&ports[..], &udp_length.to_be_bytes(), &[0, 0], payload].concat();
    let pseudo = [&addresses[..], &[0, 17], &udp_length.to_be_bytes(), &udp].concat();
    let checksum = match !sum(&pseudo) {
        0 => 0xFFFF,
        checksum => checksum,
    };
    udp[6..8].copy_from_slice(&checksum.to_be_bytes());
    [&hardware[..], &[8, 0], &ip, &udp].concat()
}

/// A frame as it comes in: in a test run, hardware addresses are zero.
fn coming(direction: Direction, payload: &[u8]) -> Vec<u8> {
    let [source, destination] = match direction {
        Direction::Request => [CLIENT, PUBLIC],
        Direction::Response => [SERVER, UPSTREAM],
    };
    frame([0; 12], source, destination, payload)
}

/// A payload that is nearly right, or right.
fn payload(random: &mut fastrand::Rng, direction: Direction) -> Vec<u8> {
    let element = |random: &mut fastrand::Rng| match random.u8(..20) {
        0 => random.u8(124..128),
        _ => random.u8(..126),
    };
    let first = if random.u8(..20) == 0 { random.u8(..) } else { NODE };
    let mut route = vec![element(random), first];
    if direction == Direction::Response {
        route[1] = element(random);
    }
    if random.u8(..4) == 0 {
        route.extend([element(random) | 0x80, element(random) | 0x80]);
    } else {
        let sources = random.usize(1..6);
        let destinations = random.usize(..23);
        route.push((destinations + sources) as u8);
        route.extend((0..destinations).map(|_| element(random)));
        route.extend((0..sources).map(|_| element(random) | 0x80));
    }
    let data: Vec<u8> = (0..random.usize(..64)).map(|_| random.u8(..)).collect();
    let mut octets = datagram([&route, &[]], &data, PASSWORD);
    match random.u8(..8) {
        0 => {
            let place = random.usize(..octets.len());
            octets[place] ^= 1 << random.u8(..8);
        }
        1 => octets.truncate(random.usize(..octets.len())),
        2 => octets.extend((0..random.usize(1..9)).map(|_| random.u8(..))),
        3 => {
            let place = random.usize(4..octets.len().min(40));
            octets[place] = random.u8(..);
        }
        _ => {}
    }
    octets
}

/// Whether the program leaves to the core what the core passes: a request that wants no answer, an answer
/// without a password, and one to a broadcast address.
fn is_left_to_the_core(direction: Direction, payload: &[u8]) -> bool {
    let datagram = Datagram::parse(payload, Header::default()).unwrap();
    let route = datagram.route();
    match direction {
        Direction::Request => route.sources().last() == Some(wire::NCNA),
        Direction::Response => {
            datagram.password().is_none()
                || route.destinations().any(|element| element >= wire::BNA)
        }
    }
}

/// Random payloads that are nearly right, in both directions.
#[test]
fn the_program_passes_what_the_core_passes() {
    let Some(mut both) = Both::new() else { return };
    let mut random = fastrand::Rng::with_seed(7);
    let mut passed = [0, 0];
    let mut octets = [0, 0];
    for number in 0..100_000 {
        let direction = Direction::ALL[number % 2];
        let payload = payload(&mut random, direction);
        let before = coming(direction, &payload);
        let by_program = both.program(&before);
        let by_core = both.core(direction, &payload);
        if let Some(after) = &by_program {
            assert!(by_core, "{direction:?}: {payload:02x?}");
            both.check_passed(direction, &before, after);
            passed[direction as usize] += 1;
            octets[direction as usize] += payload.len() as u64;
        } else if by_core {
            assert!(is_left_to_the_core(direction, &payload), "{direction:?}: {payload:02x?}");
        }
    }
    println!("{passed:?} passed");
    assert!(passed.iter().all(|&passed| passed > 15_000), "{passed:?}");
    let traffic = both.shared.traffic();
    assert_eq!([traffic.requests, traffic.responses], passed);
    assert_eq!(traffic.octets, octets.iter().sum::<u64>());
    assert_eq!(both.counters.accepted(NetId(0))[0].get(), passed[0]);
    for direction in Direction::ALL {
        let counters = both.counters.node(MappingId(0)).direction(direction);
        let counted = [&counters.received, &counters.forwarded, &counters.forwarded_bytes];
        let (passed, octets) = (passed[direction as usize], octets[direction as usize]);
        assert_eq!(counted.map(Counter::get), [passed, passed, octets]);
    }
}

/// What only the kernel can check, and what it can do alone: all of these go up to it untouched.
#[test]
fn packets_that_are_not_plain_take_the_long_way() {
    let Some(both) = Both::new() else { return };
    let payload = datagram([&[2, NODE], &[2, 0xB3, 0xFD]], &[1, 2, 3], PASSWORD);
    let good = coming(Direction::Request, &payload);
    assert!(both.program(&good).is_some());
    let with = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut frame = good.clone();
        change(&mut frame);
        let sum = !sum(&[&frame[14..24], &[0, 0], &frame[26..34]].concat());
        frame[24..26].copy_from_slice(&sum.to_be_bytes());
        frame
    };
    let wrong_sum = {
        let mut frame = good.clone();
        frame[25] ^= 1;
        frame
    };
    let frames: [(&str, Vec<u8>); 14] = [
        ("to another station", [&[2, 0, 0, 0, 0, 9], &good[6..]].concat()),
        ("to all stations", [&[0xFF; 6], &good[6..]].concat()),
        ("IPv6", with(&|frame| frame[12..14].copy_from_slice(&[0x86, 0xDD]))),
        ("IP options", with(&|frame| frame[14] = 0x46)),
        ("more fragments", with(&|frame| frame[20] = 0x20)),
        ("a later fragment", with(&|frame| frame[21] = 1)),
        ("the last hop", with(&|frame| frame[22] = 1)),
        ("TCP", with(&|frame| frame[23] = 6)),
        ("no UDP checksum", with(&|frame| frame[40..42].fill(0))),
        ("a UDP length that is too short", with(&|frame| frame[39] -= 1)),
        ("a total length that is too long", with(&|frame| frame[17] += 1)),
        ("octets behind the packet", with(&|frame| frame.push(0))),
        ("a wrong sum of the IP header", wrong_sum),
        ("another client", with(&|frame| frame[29] ^= 1)),
    ];
    for (what, frame) in frames {
        assert_eq!(both.program(&frame), None, "{what}");
    }
    both.lend_way(u64::MAX, LOOPBACK + 1);
    assert_eq!(both.program(&good), None, "it comes by another interface");
    both.lend_way(1, LOOPBACK);
    assert_eq!(both.program(&good), None, "the lease is over");
    both.lend_way(u64::MAX, LOOPBACK);
    assert!(both.program(&good).is_some());
    for entry in &both.entries {
        bpf::delete(both.offload.entries.as_fd(), &entry.comes.to_octets()).unwrap();
    }
    assert_eq!(both.program(&good), None, "the flow is not in the kernel any more");
    assert_eq!(both.shared.traffic().requests, 2);
}

/// The kernel has other buckets for nothing: those of the core, found in another way.
#[test]
fn response_times_fall_into_the_buckets_of_the_core() {
    let Some(both) = Both::new() else { return };
    let times = &both.counters.node(MappingId(0)).response_times;
    let response = datagram([&[0x31, 1], &[3, 0x7D, 0xB3, 0x82]], &[], PASSWORD);
    let response = coming(Direction::Response, &response);
    let mut before: Vec<u64> = times.buckets().collect();
    let mut elapsed = 1;
    while elapsed < 30_000_000_000 {
        let asked = u64::try_from(both.now.elapsed().as_nanos()).unwrap() + 1;
        both.shared.unanswered.store(asked.wrapping_sub(elapsed), Relaxed);
        let sum = times.sum_nanos();
        assert!(both.program(&response).is_some());
        let took = times.sum_nanos() - sum;
        assert!((elapsed..elapsed + 1_000_000_000).contains(&took), "{took} of {elapsed}");
        let after: Vec<u64> = times.buckets().collect();
        let bucket = before.iter().zip(&after).position(|(before, after)| before != after);
        assert_eq!(bucket, Some(ResponseTimes::bucket(took)), "{took}");
        before = after;
        elapsed = elapsed * 51 / 50 + 1;
    }
}

/// A datagram of the relay's own shows how those of its direction leave.
#[test]
fn the_way_out_is_learned_from_what_the_relay_sends() {
    let Some(both) = Both::new() else { return };
    both.lend_way(0, 0);
    let flow = &both.offload.flows.all()[both.shared.place() as usize];
    let payload = datagram([&[2, NODE], &[2, 0xB3, 0xFD]], &[1, 2, 3], PASSWORD);
    let learn = |frame: &[u8]| {
        let (result, after) = bpf::test_run(both.offload.learning.as_fd(), frame).unwrap();
        assert_eq!((result, after), (-1, frame.to_vec()), "it never changes anything");
        flow.ways.each_ref().map(|way| way.lease.load(Relaxed))
    };
    let to_another = SocketAddrV4::new(*SERVER.ip(), SERVER.port() + 1);
    assert_eq!(learn(&frame(HARDWARE, UPSTREAM, to_another, &payload)), [0, 0]);
    let to_all = [[0xFF; 6], [2, 0, 0, 0, 0, 1]].concat().try_into().unwrap();
    assert_eq!(learn(&frame(to_all, UPSTREAM, SERVER, &payload)), [0, 0]);

    let before = u64::try_from(both.now.elapsed().as_nanos()).unwrap();
    let [request, response] = learn(&frame(HARDWARE, UPSTREAM, SERVER, &payload));
    let lease = request - before;
    assert!((1_500_000_000..4_000_000_000).contains(&lease), "{lease}");
    assert_eq!(response, 0);
    let way = &flow.ways[Direction::Request as usize];
    let hardware = way.hardware.each_ref().map(|word| word.load(Relaxed).to_ne_bytes());
    assert_eq!(hardware.as_flattened(), HARDWARE);
    assert_eq!(way.interface.load(Relaxed), LOOPBACK);
    let [_, response] = learn(&frame(HARDWARE, PUBLIC, CLIENT, &payload));
    assert!(response > 0);
    assert!(both.program(&coming(Direction::Request, &payload)).is_some(), "both are known");
}
