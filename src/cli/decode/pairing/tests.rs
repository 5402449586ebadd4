//! Requests and answers as they come, late, twice, or not at all.

use std::time::UNIX_EPOCH;

use proptest::prelude::*;

use super::*;
use crate::pnet::wire::Header;

const CLIENT: &str = "198.51.100.20:50000";
const SERVER: &str = "203.0.113.5:20004";

/// A datagram with this route and three data octets.
fn datagram(route: &[u8]) -> Vec<u8> {
    [&[2, 0, 0, 0][..], route, &[0, 3, 1, 2, 3]].concat()
}

/// From net 11 node 3, on to this endpoint, to node 4, on to 2.
fn request(endpoint: u8) -> Vec<u8> {
    datagram(&[0x0B, 0x04, 0x04, 0x02, 0x8B, 0x83, 0x80 | endpoint])
}

/// Its answer. The server has given the client another IPNetID and node address.
fn answer(endpoint: u8) -> Vec<u8> {
    datagram(&[0x7D, 0x01, 0x05, endpoint, 0x8C, 0x84, 0x82, 0x80])
}

/// Milliseconds of the capture.
fn at(millis: u64) -> Option<SystemTime> {
    Some(UNIX_EPOCH + Duration::from_millis(millis))
}

fn ends(from: &str, to: &str) -> [SocketAddr; 2] {
    [from, to].map(|text| text.parse().unwrap())
}

fn parsed(octets: &[u8]) -> Datagram<'_> {
    Datagram::parse(octets, Header::default()).unwrap()
}

/// The lists agree with each other.
fn check(pairing: &Pairing) {
    let mut at = pairing.ends.map(|[oldest, _]| oldest);
    let (mut count, mut latest, mut number) = (0, None, 0);
    while let Some(index) = at {
        let open = &pairing.requests[index];
        assert!(open.number > number && open.older == latest);
        (count, latest, number, at) = (count + 1, at, open.number, open.newer);
    }
    assert_eq!((count, latest), (pairing.requests.len(), pairing.ends.map(|[_, latest]| latest)));
    assert!(pairing.by_ends.iter().all(|&index| pairing.requests.contains(index)));
    assert!(pairing.by_ends.is_empty() == pairing.requests.is_empty());
}

fn ask(pairing: &mut Pairing, packet: u64, time: Option<SystemTime>, octets: &[u8]) {
    let request = Request::of(&parsed(octets), packet, time, ends(CLIENT, SERVER)).unwrap();
    assert!(pairing.ask(request).is_none());
    check(pairing);
}

/// The packet of the request and the milliseconds since then.
fn answered(pairing: &mut Pairing, time: Option<SystemTime>, octets: &[u8]) -> Option<(u64, u128)> {
    let asked = pairing.answer(&parsed(octets), 99, time, ends(SERVER, CLIENT));
    check(pairing);
    asked.map(|asked| {
        assert!(!asked.from_another_port);
        (asked.packet, asked.elapsed.unwrap().as_millis())
    })
}

#[test]
fn r27_r40_an_answer_has_the_route_of_its_request_the_other_way_round() {
    let mut pairing = Pairing::default();
    ask(&mut pairing, 1, at(0), &request(31));
    ask(&mut pairing, 2, at(1), &request(32));
    ask(&mut pairing, 3, at(2), &request(33));
    for (octets, found) in [
        (answer(32), Some((2, 4))),
        (answer(32), None),
        (answer(34), None),
        (answer(31), Some((1, 5))),
        // From another node, and from another element behind it.
        (datagram(&[0x7D, 0x01, 0x05, 33, 0x8C, 0x85, 0x82, 0x80]), None),
        (datagram(&[0x7D, 0x01, 0x05, 33, 0x8C, 0x84, 0x83, 0x80]), None),
        // Without the mark of a response.
        (datagram(&[0x7D, 0x01, 0x04, 33, 0x8C, 0x84, 0x82]), Some((3, 3))),
    ] {
        assert_eq!(answered(&mut pairing, at(5), &octets), found, "{octets:02X?}");
    }
    assert!(pairing.requests.is_empty());
}

#[test]
fn each_leg_is_a_pair_of_its_own() {
    let mut pairing = Pairing::default();
    let legs = [(CLIENT, SERVER), ("172.17.17.1:45000", "172.17.17.4:34379")];
    for ((client, server), packet) in legs.into_iter().zip([1, 2]) {
        let octets = request(31);
        let request = Request::of(&parsed(&octets), packet, at(packet), ends(client, server));
        assert!(pairing.ask(request.unwrap()).is_none());
    }
    for ((client, server), packet) in legs.into_iter().zip([1, 2]).rev() {
        let octets = answer(31);
        let asked = pairing.answer(&parsed(&octets), 9, at(9), ends(server, client)).unwrap();
        assert_eq!((asked.packet, asked.server), (packet, server.parse().unwrap()));
    }
}

/// A client that asks again has given the first request up, or a router shows each packet twice.
#[test]
fn of_two_requests_on_one_route_the_latest_is_answered_first() {
    let mut pairing = Pairing::default();
    ask(&mut pairing, 1, at(0), &request(31));
    ask(&mut pairing, 2, at(1000), &request(31));
    ask(&mut pairing, 3, at(1001), &request(31));
    assert_eq!(answered(&mut pairing, at(1002), &answer(31)), Some((3, 1)));
    assert_eq!(answered(&mut pairing, at(1003), &answer(31)), Some((2, 3)));
    ask(&mut pairing, 5, at(9000), &request(31));
    // The one in front of it goes, and it stays.
    assert_eq!(pairing.overdue(at(10_001)).map(|request| request.packet), Some(1));
    check(&pairing);
    assert_eq!(answered(&mut pairing, at(10_002), &answer(31)), Some((5, 1002)));
    assert_eq!(answered(&mut pairing, at(10_003), &answer(31)), None);
}

#[test]
fn a_request_waits_for_ten_seconds_of_the_capture() {
    let mut pairing = Pairing::default();
    ask(&mut pairing, 1, at(5000), &request(31));
    ask(&mut pairing, 2, at(6000), &request(32));
    assert!(pairing.overdue(at(15_000)).is_none());
    assert!(pairing.overdue(at(1000)).is_none() && pairing.overdue(None).is_none());
    assert_eq!(pairing.overdue(at(15_001)).map(|request| request.packet), Some(1));
    assert!(pairing.overdue(at(15_001)).is_none());
    assert_eq!(pairing.next().map(|request| request.packet), Some(2));
    assert!(pairing.next().is_none());
    check(&pairing);
}

#[test]
fn an_answer_from_another_port_is_told_and_its_request_stays_open() {
    let mut pairing = Pairing::default();
    ask(&mut pairing, 1, at(0), &request(31));
    let octets = answer(31);
    let mut from = |server| {
        let asked = pairing.answer(&parsed(&octets), 9, at(2), ends(server, CLIENT));
        asked.map(|asked| (asked.packet, asked.server.port(), asked.from_another_port))
    };
    assert_eq!(from("203.0.113.5:20005"), Some((1, 20004, true)));
    assert_eq!(from("203.0.113.6:20004"), None);
    assert_eq!(from("203.0.113.5:20004"), Some((1, 20004, false)));
    assert_eq!(from("203.0.113.5:20005"), None);
}

#[test]
fn what_asks_for_no_answer_is_no_request() {
    let is_request = |route: &[u8]| {
        let octets = datagram(route);
        Request::of(&parsed(&octets), 1, None, ends(CLIENT, SERVER)).is_some()
    };
    assert!(is_request(&[0x0B, 0x04, 0x8B, 0x83]) && is_request(&[0x04, 0x83]));
    // To every node; from nobody; the Immediate format.
    assert!(!is_request(&[0x0B, 0x7E, 0x8B, 0x83]));
    assert!(!is_request(&[0x0B, 0x04, 0x8B, 0x80]));
    assert!(!is_request(&[0x83, 0x04]));
}

#[test]
fn more_requests_than_there_is_room_for_push_the_oldest_out() {
    let mut pairing = Pairing::default();
    let octets = request(31);
    for packet in 0..MOST as u64 + 10 {
        let client = SocketAddr::from(([10, 0, (packet >> 16) as u8, 1], packet as u16));
        let ends = [client, SERVER.parse().unwrap()];
        let evicted = pairing.ask(Request::of(&parsed(&octets), packet, at(packet), ends).unwrap());
        assert_eq!(evicted.map(|request| request.packet), packet.checked_sub(MOST as u64));
    }
    assert_eq!(pairing.requests.len(), MOST);
    check(&pairing);
}

proptest! {
    #[test]
    fn the_lists_agree_whatever_comes(steps in prop::collection::vec((0_u8..4, 1_u8..5), 0..200)) {
        let mut pairing = Pairing::default();
        for ((step, endpoint), now) in steps.into_iter().zip(0..) {
            let now = at(now * 900);
            match step {
                0 | 1 => ask(&mut pairing, 1, now, &request(endpoint)),
                2 => drop(answered(&mut pairing, now, &answer(endpoint))),
                _ => drop(pairing.overdue(now)),
            }
            check(&pairing);
        }
    }
}
