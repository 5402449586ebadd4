//! The checks come in the order in which [`DropReason`] lists their reasons. Each datagram here also
//! fails checks that come later.

use std::time::{Duration, Instant};

use super::fixture::*;
use crate::nat::*;

const WRONG: &[u8; 8] = b"guessed!";

/// There is one socket. Port 0 counts as an upstream port, so that a loop is unanswerable too.
#[derive(Default)]
struct OneSocket {
    is_open: bool,
}

impl Effects for OneSocket {
    fn open_upstream(&mut self, _: &Table, _: UpstreamId, _: NetId, _: SocketKind) -> Option<u16> {
        (!std::mem::replace(&mut self.is_open, true)).then_some(50_000)
    }

    fn close_upstream(&mut self, _: UpstreamId) {}

    fn has_upstream_port(&self, port: u16) -> bool {
        port == 0
    }
}

/// The net has room for one flow and one request a second.
fn rules(max_flows: u32) -> Rules {
    let net = Net {
        allow: vec!["198.51.100.0/24".parse().unwrap()],
        max_flows,
        max_requests: Some(RequestRate::new(1)),
        ..net()
    };
    let limits = Limits { wrong_password_burst: 1, ..LIMITS };
    Rules::new(table(vec![net], vec![node_4()]), limits)
}

/// The same rules for a net of another plant, which has no use for a password.
fn remote_rules() -> Rules {
    let Rules { table: section, limits, .. } = rules(1);
    let kind = NetKind::Remote { start_port: 20_000 };
    let net = Net { kind, ..section.nets()[0].clone() };
    Rules::new(table(vec![net], section.mappings().to_vec()), limits)
}

/// A worker with an open flow, and where its request went.
fn worker(now: Instant) -> (Worker<OneSocket>, ToServer) {
    let mut worker = Worker::new(&rules(1), now, 0, OneSocket::default());
    let arrival = arrival(CLIENT.parse().unwrap());
    let to = worker.request(now, &arrival, &mut request(PASSWORD)).unwrap();
    (worker, to)
}

/// Octets that do not follow the format, in the order of the checks.
fn malformed() -> [Vec<u8>; 5] {
    let no_route = [&[2, 0, 0, 0, 11, 4, 0], &[0; 20][..]].concat();
    [vec![0], vec![0; 108], vec![0; 20], no_route, simple_route(9)]
}

/// A datagram with a Simple route whose data-field-format announces eight octets. This many follow.
fn simple_route(data_octets: usize) -> Vec<u8> {
    [&[2, 0, 0, 0, 4, 0x83, 2, 8], &vec![0; data_octets][..]].concat()
}

/// A request to this node.
fn request_to(node_address: u8, password: &[u8]) -> Vec<u8> {
    datagram([&[11, node_address, 2], &[11, 3]], &[0; 8], password)
}

#[test]
fn of_a_request() {
    let now = Instant::now();
    let (mut worker, _) = worker(now);
    let mut ask = |now, client: &str, public: &str, mut octets: Vec<u8>| {
        let public_address = public.parse().unwrap();
        let arrival = Arrival { public_address, ..arrival(client.parse().unwrap()) };
        worker.request(now, &arrival, &mut octets).unwrap_err()
    };
    let (looping, client) = ("192.0.2.1:0", "198.51.100.8:1");
    let mut seen = vec![ask(now, looping, "0.0.0.0", vec![0])];
    seen.extend(malformed().map(|octets| ask(now, looping, PUBLIC, octets)));
    seen.push(ask(now, looping, PUBLIC, simple_route(8)));
    seen.push(ask(now, looping, PUBLIC, request_to(126, b"")));
    let mut remote = Worker::new(&remote_rules(), now, 0, OneSocket::default());
    let refused =
        remote.request(now, &arrival(looping.parse().unwrap()), &mut request_to(126, PASSWORD));
    seen.push(refused.unwrap_err());
    let guesser = "198.51.100.66:1";
    assert_eq!(ask(now, guesser, PUBLIC, request(WRONG)), DropReason::PasswordWrong);
    for sender in [looping, "203.0.113.66:0", "203.0.113.66:1", guesser, "198.51.100.67:1"] {
        seen.push(ask(now, sender, PUBLIC, request_to(126, WRONG)));
    }
    seen.push(ask(now, client, PUBLIC, request_to(126, PASSWORD)));
    seen.push(ask(now, client, PUBLIC, request_to(5, PASSWORD)));
    seen.push(ask(now, client, PUBLIC, request(PASSWORD)));
    let later = now + Duration::from_secs(1);
    seen.push(ask(later, client, PUBLIC, request(PASSWORD)));
    // With room for another flow, there is still no socket for it.
    let Rules { table, limits, .. } = rules(2);
    let next = worker.succession(&worker.rules.followed_by(table, limits), &Default::default());
    worker.reload(later, next);
    let arrival = arrival(client.parse().unwrap());
    seen.push(worker.request(later, &arrival, &mut request(PASSWORD)).unwrap_err());
    assert_eq!([&seen[..], &[DropReason::SendFailed]].concat(), DropReason::REQUEST);
}

#[test]
fn of_a_response() {
    let now = Instant::now();
    let (mut worker, to) = worker(now);
    let mut answer = |server, mut octets: Vec<u8>| {
        worker.response(now, to.via, server, &mut octets).unwrap_err()
    };
    let mut seen = vec![answer("172.17.17.9:34379".parse().unwrap(), vec![0])];
    seen.extend(malformed().map(|octets| answer(to.server, octets)));
    seen.push(answer(to.server, response(WRONG)));
    assert_eq!([&seen[..], &[DropReason::SendFailed]].concat(), DropReason::RESPONSE);
}
