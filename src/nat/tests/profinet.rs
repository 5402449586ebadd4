//! A PROFINET device behind the NAT: its answers come from any port, and nothing but reading goes in.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use fastrand::Rng;

use super::fixture::*;
use crate::nat::*;
use crate::profinet::rpc::{Flags1, Header, Interface, PacketType, ReadImplicit, Rpc};
use crate::profinet::{ByteOrder, ObjectUuid, Uuid};

const DEVICE: &str = "172.17.17.7";

fn net() -> Net {
    Net {
        allow: vec!["198.51.100.0/24".parse().unwrap()],
        allow_without_password: true,
        idle_timeout: Duration::from_secs(60),
        max_flows: 100,
        ..Net::new("drive-7", NetKind::ProfinetDevice { records: Records::default() })
    }
}

fn rules() -> Rules {
    let device = mapping(0, 0, 45_007, "172.17.17.7:34964");
    let other = mapping(1, 4, 20_004, "172.17.17.7:34379"); // a P-NET node at the same address
    let section = Net { name: "section-1".into(), ..super::fixture::net() };
    Rules::new(table(vec![net(), section], vec![device, other]), LIMITS)
}

fn read(activity: u128, sequence: u32, index: u16) -> Vec<u8> {
    let order = if sequence.is_multiple_of(2) { ByteOrder::Big } else { ByteOrder::Little };
    let read = ReadImplicit {
        order,
        object: ObjectUuid { instance: 1, device: 2, vendor: 3 }.to_uuid(),
        activity: Uuid::new(activity),
        sequence,
        api: 0,
        slot: 0,
        subslot: 1,
        index,
        record_length: 1000,
        target_ar: Uuid::NIL,
    };
    let mut octets = vec![0; ReadImplicit::LEN];
    read.emit(&mut octets).unwrap();
    octets
}

/// What a device sends about a call.
fn told(activity: u128, sequence: u32, packet_type: PacketType, flags1: u8) -> Vec<u8> {
    let header = Header {
        packet_type,
        flags1: Flags1(flags1),
        activity: Uuid::new(activity),
        sequence,
        ..Header::request(ByteOrder::Big, Interface::Device.uuid(), ReadImplicit::OPERATION)
    };
    let stub: &[u8] = if packet_type == PacketType::Response { &[0; 20] } else { &[] };
    let mut buffer = [0; 200];
    let length = header.emit(stub, &mut buffer).unwrap();
    buffer[..length].to_vec()
}

struct World {
    worker: Worker,
    now: Instant,
}

impl World {
    fn new() -> Self {
        let now = Instant::now();
        Self { worker: Worker::new(&rules(), now, 0, Sockets::default()), now }
    }

    fn ask(&mut self, octets: &[u8]) -> Result<ToServer, DropReason> {
        let arrival = arrival(CLIENT.parse().unwrap());
        let to = self.worker.request(self.now, &arrival, &mut octets.to_vec())?;
        self.worker.core.request_sent(self.now, MappingId(0), to.asks, octets.len());
        Ok(to)
    }

    fn tell(&mut self, via: UpstreamId, port: u16, octets: &[u8]) -> Result<ToClient, DropReason> {
        let device = format!("{DEVICE}:{port}").parse().unwrap();
        let back = self.worker.response(self.now, via, device, &mut octets.to_vec())?;
        self.worker.core.response_sent(back.mapping, octets.len());
        Ok(back)
    }

    fn node(&self) -> &NodeCounters {
        self.worker.counters.node(MappingId(0))
    }
}

/// A plain port forward drops these: the answer comes from another port than was asked.
#[test]
fn p_8_an_answer_may_come_from_any_port_and_its_call_goes_on_there() {
    for port in [34_964, 49_153, 9_001] {
        let mut world = World::new();
        let to = world.ask(&read(1, 0, 0xAFF0)).unwrap();
        assert_eq!(to.server, "172.17.17.7:34964".parse().unwrap());
        assert!(to.asks.is_some());
        let working = told(1, 0, PacketType::Working, 0);
        let back = world.tell(to.via, port, &working).unwrap();
        assert_eq!((back.client.to_string(), back.mapping), (CLIENT.into(), MappingId(0)));
        let ping = world.ask(&told(1, 0, PacketType::Ping, 0)).unwrap();
        assert_eq!((ping.via, ping.server.port(), ping.asks), (to.via, port, None));
        world.tell(to.via, port, &told(1, 0, PacketType::Response, 0)).unwrap();
        let answers: u64 = world.node().response_times.buckets().sum();
        assert_eq!(answers, 1, "once, with its answer");
        let next = world.ask(&read(1, 1, 0xAFF1)).unwrap();
        assert_eq!(
            (next.via, next.server.port()),
            (to.via, 34_964),
            "a new call begins where all do"
        );
    }
}

#[test]
fn what_belongs_to_no_call_is_dropped_and_changes_nothing() {
    let mut world = World::new();
    assert_eq!(world.ask(&told(1, 0, PacketType::Ping, 0)), Err(DropReason::UnknownExchange));
    assert_eq!(world.worker.flows(world.now), 0, "no flow is opened for it");
    let to = world.ask(&read(1, 0, 0xAFF0)).unwrap();
    for (octets, reason) in [
        (told(2, 0, PacketType::Response, 0), DropReason::UnknownExchange),
        (told(1, 1, PacketType::Response, 0), DropReason::UnknownExchange),
        (told(1, 0, PacketType::Request, 0), DropReason::PacketType),
        (response(b""), DropReason::TooShort),
    ] {
        assert_eq!(world.tell(to.via, 49_153, &octets), Err(reason));
    }
    let stranger = "172.17.17.8:34964".parse().unwrap();
    let mut answer = told(1, 0, PacketType::Response, 0);
    let refused = world.worker.response(world.now, to.via, stranger, &mut answer);
    assert_eq!(refused, Err(DropReason::UnknownFlow));
    world.now += Duration::from_secs(11);
    let late = world.tell(to.via, 49_153, &told(1, 0, PacketType::Response, 0));
    assert_eq!(late, Err(DropReason::UnknownExchange));
    assert_eq!(world.ask(&read(1, 2, 0xF821)).unwrap_err(), DropReason::RecordNotAllowed);
}

/// P-NET and PROFINET at one address do not get into each other's way.
#[test]
fn two_protocols_at_one_address_have_sockets_of_their_own() {
    let mut world = World::new();
    let profinet = world.ask(&read(1, 0, 0xAFF0)).unwrap();
    let to_node = Arrival {
        listener: ListenerId(1),
        mapping: MappingId(1),
        ..arrival(CLIENT.parse().unwrap())
    };
    let p_net = world.worker.request(world.now, &to_node, &mut request(PASSWORD)).unwrap();
    assert_ne!(profinet.via, p_net.via);
    assert_eq!(world.tell(p_net.via, 34_964, &response(PASSWORD)), Err(DropReason::UnknownFlow));
    let back = world.tell(p_net.via, 34_379, &response(PASSWORD)).unwrap();
    assert_eq!(back.mapping, MappingId(1));
}

/// Another set of records is in force at once, also for what is under way.
#[test]
fn records_that_are_withdrawn_are_so_at_once() {
    let mut world = World::new();
    let to = world.ask(&read(1, 0, 0xAFF0)).unwrap();
    let records: Records = [Record::Im1].into_iter().collect();
    let changed = Net { kind: NetKind::ProfinetDevice { records }, ..net() };
    let device = mapping(0, 0, 45_007, "172.17.17.7:34964");
    let next = world.worker.rules.followed_by(table(vec![changed], vec![device]), LIMITS);
    let next = world.worker.succession(&next, &Default::default());
    world.worker.reload(world.now, next);
    let answer = world.tell(to.via, 49_153, &told(1, 0, PacketType::Response, 0));
    assert_eq!(answer, Err(DropReason::UnknownFlow));
    assert_eq!(world.ask(&read(1, 1, 0xAFF0)).unwrap_err(), DropReason::RecordNotAllowed);
    assert!(world.ask(&read(1, 2, 0xAFF1)).is_ok());
}

/// Any datagrams, most of them nearly sound, in any order: only reading reaches the device, answers
/// reach the client that asked, and everything is counted.
#[test]
fn whatever_comes_only_reading_goes_in_and_everything_is_counted() {
    const CLIENTS: [&str; 3] = ["198.51.100.7:50000", "198.51.100.8:50000", "203.0.113.9:50000"];
    let mut rng = Rng::new();
    let seed = rng.u64(..);
    rng.seed(seed);
    println!("seed {seed}");
    let mut world = World::new();
    let mut asked: BTreeMap<(u128, u32), (String, UpstreamId)> = BTreeMap::new();
    let (mut there, mut back) = (0, 0);
    for _ in 0..20_000 {
        world.now += Duration::from_millis(rng.u64(0..200));
        while rng.u32(0..50) == 0 && world.worker.core.expire(world.now, &mut world.worker.effects)
        {
        }
        let client = rng.choice(CLIENTS).unwrap();
        // Each client has activities of its own.
        let activity = u128::from(rng.u8(0..4)) << 8 | u128::from(client.as_bytes()[11]);
        let sequence = rng.u32(0..4);
        let mut octets = match rng.u32(0..4) {
            0 => told(activity, sequence, *rng.choice(&PacketType::ALL).unwrap(), rng.u8(..)),
            _ => read(activity, sequence, rng.choice([0xAFF0, 0xF841, 0xE040]).unwrap()),
        };
        for _ in 0..rng.usize(0..3) {
            let at = rng.usize(0..octets.len());
            octets[at] = rng.u8(..);
        }
        if rng.u32(0..3) > 0 {
            let arrival = arrival(client.parse().unwrap());
            let verdict = world.worker.request(world.now, &arrival, &mut octets);
            let Ok(to) = verdict else { continue };
            there += 1;
            assert!(client.starts_with("198.51.100."), "R: allow");
            let rpc = Rpc::parse(&octets).expect("it is checked whole");
            let header = rpc.header();
            let reads = ReadImplicit::OPERATION == header.operation
                && header.interface == Interface::Device.uuid();
            let looks = matches!(header.operation, 2 | 4)
                && header.interface == Interface::EndpointMapper.uuid();
            assert!(reads || looks, "{header:?}");
            if let Ok(Some(read)) = ReadImplicit::parse(&rpc) {
                assert!(matches!(read.index, 0xAFF0..=0xAFF5 | 0x8000.. ), "{read:?}");
                assert_ne!(read.index, 0xE040);
            }
            let key = (u128::from_be_bytes(header.activity.octets()), header.sequence);
            asked.insert(key, (client.into(), to.via));
            world.worker.core.request_sent(world.now, MappingId(0), to.asks, octets.len());
        } else {
            let Some((&key, (owner, via))) = rng.choice(asked.iter().collect::<Vec<_>>()) else {
                continue;
            };
            let packet_type = rng.choice([PacketType::Response, PacketType::Working]).unwrap();
            let answer = told(key.0, key.1, packet_type, 0);
            let (owner, via) = (owner.clone(), *via);
            if let Ok(to) = world.tell(via, rng.u16(1..), &answer) {
                back += 1;
                assert_eq!(to.client.to_string(), owner, "an answer to another client");
            }
        }
        world.worker.core.check_invariants(world.now);
    }
    assert!(there > 1000 && back > 500, "{there} {back}");
    for direction in Direction::ALL {
        let counters = world.node().direction(direction);
        let accounted = counters.forwarded.get() + counters.dropped_total();
        assert_eq!(counters.received.get(), accounted, "the law of the counters");
    }
}
