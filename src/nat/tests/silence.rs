//! How long a silent flow lives, second by second, in time that the test makes (N-2, N-3).

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::pnet::wire::{DlRoute, Header, Password};

use crate::nat::*;

const PASSWORD: &[u8; 8] = b"service!";
const IDLE_TIMEOUT: Duration = Duration::from_secs(300);
/// RFC 4787 REQ-5 forbids to forget a flow before 120 s.
const SILENCE: Duration = Duration::from_secs(119);

/// Opens whatever is asked for.
struct OneSocket;

impl Effects for OneSocket {
    fn open_upstream(&mut self, id: UpstreamId, _: NetId, _: bool) -> Option<u16> {
        assert_eq!(id, UpstreamId(0));
        Some(50_000)
    }

    fn close_upstream(&mut self, _: UpstreamId) {}

    fn flow_opened(&mut self, _: &Table, _: &FlowRecord) {}

    fn flow_closed(&mut self, _: &Table, _: &FlowRecord, reason: CloseReason) {
        assert_eq!(reason, CloseReason::Idle);
    }
}

/// One client, one node, and the clock.
struct World {
    core: Core,
    now: Instant,
    octets: Vec<u8>,
    /// Where the one request went.
    asked: ToServer,
}

impl World {
    /// A request has just passed.
    fn new() -> Self {
        let credential = Credential {
            name: "service".into(),
            password: Password::new(*PASSWORD),
            device_password: None,
        };
        let net = Net {
            name: "section-1".into(),
            kind: NetKind::UdpRange { start_port: 40_000 },
            allow: vec!["0.0.0.0/0".parse().unwrap()],
            credentials: vec![credential],
            allow_without_password: false,
            require_response_password: false,
            idle_timeout: IDLE_TIMEOUT,
            max_flows: 1,
            max_requests: None,
            max_flow_requests: None,
        };
        let mapping = Mapping {
            net: NetId(0),
            node_address: 4,
            public_port: 40_004,
            server: "172.17.17.4:34379".parse().unwrap(),
        };
        let limits = Limits {
            max_flows: 1,
            wrong_password_burst: 1,
            wrong_password_address_burst: 512,
            wrong_password_interval: Duration::from_secs(1),
        };
        let table = Arc::new(Table::new(Header::default(), vec![net], vec![mapping]));
        let counters = Arc::new(Counters::new(&table));
        let now = Instant::now();
        let mut core = Core::new(Rules::new(table, limits), counters, now, Chance::from_seed(0));

        let route = DlRoute::new(&[11, 4, 2], &[11, 3]).unwrap().to_route().unwrap();
        let mut octets = Header::default().0.to_vec();
        octets.extend(route.as_route().as_bytes());
        octets.extend([0x02, 0]);
        octets.extend(PASSWORD);
        let arrival = Arrival {
            listener: ListenerId(0),
            mapping: MappingId(0),
            public_address: "192.0.2.1".parse().unwrap(),
            client: "198.51.100.7:50000".parse().unwrap(),
        };
        let asked = core.request(now, &arrival, &mut octets, &mut OneSocket).unwrap();
        Self { core, now, octets, asked }
    }

    /// Lets time pass, as the worker does: looking for idle flows about once a second.
    fn pass(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.now = end.min(self.now + Duration::from_secs(1));
            while self.core.expire(self.now, &mut OneSocket) {}
        }
    }

    fn answer(&mut self) -> Result<ToClient, DropReason> {
        let ToServer { via, server, .. } = self.asked;
        self.core.response(self.now, via, server, &mut self.octets)
    }
}

#[test]
fn an_answer_comes_through_after_119_seconds_of_silence() {
    let mut world = World::new();
    world.pass(SILENCE);
    assert!(world.answer().is_ok());
    world.pass(SILENCE);
    assert!(world.answer().is_ok(), "and once more: N-3");
}

#[test]
fn a_flow_ends_with_its_time_out_and_not_before() {
    let mut world = World::new();
    let moment = Duration::from_millis(1);
    world.pass(IDLE_TIMEOUT - moment);
    assert!(world.answer().is_ok(), "N-2");
    world.pass(IDLE_TIMEOUT - moment);
    assert_eq!(world.core.flows(world.now).count(), 1, "N-3: since the answer");
    world.pass(moment);
    assert_eq!(world.core.flows(world.now).count(), 0);
    assert_eq!(world.answer(), Err(DropReason::UnknownFlow));
}
