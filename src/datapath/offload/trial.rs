//! The programs and a core side by side, on one flow: what the program passes the core passes, as it has to
//! leave; what it does not pass it leaves untouched. For tests and for fuzzing.

use std::cell::RefCell;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use super::layout::{Ends, Terms};
use super::*;
use crate::nat::{
    Arrival, Chance, Core, Counters, Credential, Direction, Effects, Limits, ListenerId, Mapping,
    MappingId, Net, NetId, NetKind, Payload, Rules, SharedFlow, SocketKind, UpstreamId,
};
use crate::pnet::wire::{self, Datagram, Header, Password};

pub(super) const PASSWORD: &[u8; 8] = b"service!";
pub(super) const CLIENT: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(198, 51, 100, 7), 50_000);
pub(super) const PUBLIC: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(192, 0, 2, 1), 20_004);
pub(super) const UPSTREAM: SocketAddrV4 =
    SocketAddrV4::new(Ipv4Addr::new(172, 17, 17, 254), 50_001);
pub(super) const SERVER: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(172, 17, 17, 4), 34_379);
pub(super) const NODE: u8 = 4;
/// The loopback interface, by which frames come in a test run.
pub(super) const LOOPBACK: u32 = 1;
/// To which hardware address datagrams leave, and from which.
pub(super) const HARDWARE: [u8; 12] = [2, 0, 0, 0, 0, 7, 2, 0, 0, 0, 0, 1];

/// A flow that both carry, the program and a core.
pub(super) struct Trial {
    pub(super) offload: Arc<Offload>,
    pub(super) counters: Arc<Counters>,
    pub(super) core: Core,
    pub(super) now: Instant,
    pub(super) via: UpstreamId,
    pub(super) shared: Lent<SharedFlow>,
    pub(super) entries: [Entry; 2],
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

impl Trial {
    pub(super) fn new() -> Result<Self, OffloadError> {
        let (table, now) = (table(), Instant::now());
        let offload = Arc::new(Offload::load(&table, 16, now)?);
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
        offload.flows.all()[shared.place() as usize].set_password(*PASSWORD);
        let [node, credential] = counters.places(MappingId(0), NetId(0), 0).unwrap();
        let (header, node_address, flow) = (Header::default().0, NODE, shared.place());
        let terms = Terms { header, node_address, flow, node, credential };
        let (client, public, upstream, server) = (CLIENT, PUBLIC, UPSTREAM, SERVER);
        let entries = Entry::both(&Ends { client, public, upstream, server }, terms);
        entries.iter().for_each(|entry| offload.enter(entry).unwrap());
        let both = Self { offload, counters, core, now, via: to.via, shared, entries };
        both.lend_way(u64::MAX, LOOPBACK);
        Ok(both)
    }

    /// The ways out of both directions.
    pub(super) fn lend_way(&self, lease: u64, interface: u32) {
        for way in &self.offload.flows.all()[self.shared.place() as usize].ways {
            way.lease.store(lease, Relaxed);
            way.interface.store(interface, Relaxed);
            for (word, octets) in way.hardware.iter().zip(HARDWARE.chunks(4)) {
                word.store(u32::from_ne_bytes(octets.try_into().unwrap()), Relaxed);
            }
        }
    }

    /// What the program does with a frame: the new frame, if it passes.
    pub(super) fn program(&self, frame: &[u8]) -> Option<Vec<u8>> {
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
    pub(super) fn core(&mut self, direction: Direction, payload: &[u8]) -> bool {
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

    pub(super) fn check_passed(&self, direction: Direction, before: &[u8], after: &[u8]) {
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

pub(super) fn datagram([destinations, rest]: [&[u8]; 2], data: &[u8], password: &[u8]) -> Vec<u8> {
    let control = [0x02, data.len() as u8];
    [&Header::default().0[..], destinations, rest, &control, data, password].concat()
}

pub(super) fn sum(octets: &[u8]) -> u16 {
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
pub(super) fn frame(
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
pub(super) fn coming(direction: Direction, payload: &[u8]) -> Vec<u8> {
    let [source, destination] = match direction {
        Direction::Request => [CLIENT, PUBLIC],
        Direction::Response => [SERVER, UPSTREAM],
    };
    frame([0; 12], source, destination, payload)
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

impl Trial {
    /// Gives a payload of this direction to both. Returns whether it has passed.
    pub(super) fn judge(&mut self, direction: Direction, payload: &[u8]) -> bool {
        let before = coming(direction, payload);
        let by_program = self.program(&before);
        let by_core = self.core(direction, payload);
        if let Some(after) = &by_program {
            assert!(by_core, "{direction:?}: {payload:02x?}");
            self.check_passed(direction, &before, after);
        } else if by_core {
            assert!(is_left_to_the_core(direction, payload), "{direction:?}: {payload:02x?}");
        }
        by_program.is_some()
    }
}

thread_local! {
    static TRIAL: RefCell<Trial> = RefCell::new(Trial::new().expect("programs may be loaded"));
}

/// Takes the first octet as a direction, and the others as the payload of a datagram.
pub fn holds(octets: &[u8]) {
    let Some((first, payload)) = octets.split_first() else { return };
    if payload.len() <= 2 * wire::MAX_DATAGRAM {
        let direction = Direction::ALL[usize::from(first % 2)];
        TRIAL.with_borrow_mut(|trial| trial.judge(direction, payload));
    }
}
