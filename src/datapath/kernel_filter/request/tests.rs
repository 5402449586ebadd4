//! The kernel decides as the core does, or lets through.

use std::net::UdpSocket;
use std::sync::Arc;
use std::time::{Duration, Instant};

use proptest::prelude::*;
use socket2::SockRef;

use super::*;
use crate::nat::{
    Arrival, Chance, Core, Counters, Credential, Effects, Limits, ListenerId, Mapping, MappingId,
    Payload, Rules, SocketKind, ToServer, UpstreamId,
};

fn net(passwords: &[[u8; 8]], allow_without_password: bool) -> Net {
    let credential = |password: &[u8; 8]| Credential {
        name: "service".into(),
        password: Password::new(*password),
        device_password: None,
    };
    Net {
        allow: vec!["0.0.0.0/0".parse().unwrap()],
        credentials: passwords.iter().map(credential).collect(),
        allow_without_password,
        ..Net::new("section-1", NetKind::UdpRange { start_port: 20_000 })
    }
}

/// Asks the kernel whether a datagram gets through to a socket with the program.
struct Gate {
    inside: UdpSocket,
    outside: UdpSocket,
}

impl Gate {
    fn new(net: &Net) -> Self {
        let inside = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let outside = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        outside.connect(inside.local_addr().unwrap()).unwrap();
        inside.set_nonblocking(true).unwrap();
        let any = Ipv4Addr::UNSPECIFIED.into();
        program(Header::default(), net, any).attach(&SockRef::from(&inside)).unwrap();
        Self { inside, outside }
    }

    fn lets_through(&self, octets: &[u8]) -> bool {
        self.outside.send(octets).unwrap();
        let mut buffer = [0; 256];
        // On loopback, a datagram has either arrived or been refused when its send returns.
        self.inside.recv(&mut buffer).is_ok_and(|len| buffer[..len] == *octets)
    }
}

/// Asks the relay's own check in user space.
struct Judge {
    core: Core,
    arrival: Arrival,
}

struct NoSockets;

impl Effects for NoSockets {
    fn open_upstream(&mut self, _: &Table, _: UpstreamId, _: NetId, _: SocketKind) -> Option<u16> {
        Some(50_000)
    }
    fn close_upstream(&mut self, _: UpstreamId) {}
}

impl Judge {
    fn new(net: &Net) -> Self {
        let server = "172.17.17.4:34379".parse().unwrap();
        let (net_id, local_address) = (NetId(0), None);
        let mapping =
            Mapping { net: net_id, node_address: 4, local_address, public_port: 20_004, server };
        let table = Table::new(Header::default(), vec![net.clone()], vec![mapping]);
        let limits = Limits {
            max_flows: 1,
            wrong_password_burst: u16::MAX,
            wrong_password_address_burst: u32::MAX,
            wrong_password_interval: Duration::from_nanos(1),
        };
        let rules = Rules::new(Arc::new(table), limits);
        let counters = Arc::new(Counters::new(&rules.table));
        let core = Core::new(rules, counters, Instant::now(), Chance::from_seed(0));
        let arrival = Arrival {
            listener: ListenerId(0),
            mapping: MappingId(0),
            public_address: Ipv4Addr::LOCALHOST.into(),
            client: "127.0.0.1:1".parse().unwrap(),
        };
        Self { core, arrival }
    }

    fn judge(&mut self, octets: &[u8]) -> Result<ToServer, DropReason> {
        let mut room = [octets, &[0; Password::LEN]].concat();
        let mut payload = Payload::new(&mut room, octets.len());
        self.core.request(Instant::now(), &self.arrival, &mut payload, &mut NoSockets)
    }
}

/// A request with the route of figure 10, `len` data octets and a tail.
fn request(len: u8, tail: &[u8]) -> Vec<u8> {
    let mut octets = vec![2, 0, 0, 0, 0x0B, 4, 5, 2, 0x21, 0x8B, 0x83, 0x9F, 2, len];
    octets.extend((0..len).collect::<Vec<_>>());
    octets.extend(tail);
    octets
}

#[test]
fn refuses_what_cannot_pass_and_lets_requests_through() {
    let gate = Gate::new(&net(&[*b"PNETPASS", *b"password"], false));
    for len in [0, 1, 2, 3, 16, 63] {
        assert!(gate.lets_through(&request(len, b"PNETPASS")));
        assert!(gate.lets_through(&request(len, b"password")));
        for tail in [&b""[..], b"PNETPASX", b"XNETPASS", b"PNETword", b"PNETPASS ", b"PNETPAS"] {
            assert!(!gate.lets_through(&request(len, tail)), "{tail:?}");
        }
    }
    let extended = [&[2, 0, 0, 0, 1, 4, 0x81, 0x83, 2, 0][..], b"PNETPASS"].concat();
    assert!(gate.lets_through(&extended));
    let simple = [&[2, 0, 0, 0, 4, 0x83, 2, 0][..], b"PNETPASS"].concat();
    assert!(!gate.lets_through(&simple));
    assert!(!gate.lets_through(&[]));
    assert!(!gate.lets_through(&[0xff; 128]));
    assert!(!gate.lets_through(&[[3].as_slice(), &request(3, b"PNETPASS")[1..]].concat()));
}

#[test]
fn without_a_password_where_the_net_allows_it() {
    let gate = Gate::new(&net(&[*b"PNETPASS"], true));
    assert!(gate.lets_through(&request(3, b"")));
    assert!(gate.lets_through(&request(3, b"PNETPASS")));
    assert!(!gate.lets_through(&request(3, b"password")));
}

#[test]
fn more_passwords_than_a_program_holds_are_left_to_the_worker() {
    let passwords: Vec<_> = (0..=MOST_PASSWORDS as u64).map(u64::to_be_bytes).collect();
    let gate = Gate::new(&net(&passwords, false));
    assert!(gate.lets_through(&request(3, &passwords[MOST_PASSWORDS])));
    assert!(gate.lets_through(&request(3, b"whatever")));
    assert!(!gate.lets_through(&request(3, b"")));
    let gate = Gate::new(&net(&passwords[1..], false));
    assert!(gate.lets_through(&request(3, &passwords[MOST_PASSWORDS])));
    assert!(!gate.lets_through(&request(3, b"whatever")));
}

/// Octets that are nearly a request. Many of them are one.
fn nearly_a_request() -> impl Strategy<Value = Vec<u8>> {
    let routes = prop_oneof![
        Just(vec![0x0B, 4, 5, 2, 0x21, 0x8B, 0x83, 0x9F]),
        Just(vec![0x0B, 4, 0x8B, 0x83]),
        Just(vec![0x0B, 4, 2, 0x8B, 0x83]),
        prop::collection::vec(any::<u8>(), 2..31),
    ];
    let tails = prop_oneof![Just(b"PNETPASS".to_vec()), prop::collection::vec(any::<u8>(), 0..10)];
    let data = prop::collection::vec(any::<u8>(), 0..64);
    let slip = prop::option::of((0..8_usize, any::<u8>()));
    (routes, data, any::<u8>(), tails, slip).prop_map(|(route, data, flags, tail, slip)| {
        let format = (flags & 0xc0) | data.len() as u8;
        let mut octets = [&[2, 0, 0, 0][..], &route, &[flags, format], &data, &tail].concat();
        if let Some((place, octet)) = slip {
            octets[place] = octet;
        }
        octets
    })
}

proptest! {
    #[test]
    fn never_refuses_what_the_relay_accepts(
        octets in prop_oneof![4 => nearly_a_request(), 1 => prop::collection::vec(any::<u8>(), 0..130)],
        allow_without_password in any::<bool>(),
    ) {
        let net = net(&[*b"PNETPASS", *b"password"], allow_without_password);
        let verdict = Judge::new(&net).judge(&octets);
        let through = Gate::new(&net).lets_through(&octets);
        match verdict {
            Ok(_) => prop_assert!(through, "accepted by the relay, refused by the kernel"),
            // The filter does not decide these. In all other cases it decides as the relay
            // does.
            Err(DropReason::BadRoute | DropReason::RouteFormat | DropReason::BadLength
                | DropReason::Broadcast | DropReason::NodeMismatch) => {}
            Err(reason) => prop_assert!(!through, "{reason:?} let through"),
        }
    }
}
