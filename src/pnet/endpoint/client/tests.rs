//! The client node of PAS 6 and 9, datagram by datagram. The octets are written by hand, so that the
//! codec does not test itself.

use std::net::SocketAddr;
use std::time::Duration;

use proptest::prelude::*;

use super::*;
use crate::pnet::endpoint::{Memory, Port, Server, Service};
use crate::pnet::ip_net_table::{Destination, Fields, IpNetTable, Nettype};
use crate::pnet::wire::{
    Elements, Header, IpNetId, MAX_DATAGRAM, NORMAL_PORT, NodeAddress, Password,
};

const PASSWORD: &[u8; 8] = b"PNETPASS";
const NODE_4: &str = "203.0.113.5:20004";
const FLAT: Option<FlatAddressing> = Some(FlatAddressing { read: Some(1), write: Some(2) });

fn millis(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

fn address(text: &str) -> SocketAddr {
    text.parse().unwrap()
}

/// To node 33 behind port 2 of a node, as in PAS Figure 10.
fn to_node(node: u8) -> Attributes {
    Attributes::new(DestinationRoute {
        way: Way {
            address: SocketAddr::from(([203, 0, 113, 5], 20000 + u16::from(node))),
            password: Some(Password::new(*PASSWORD)),
        },
        ip_net_id: IpNetId::new(11).unwrap(),
        node: Destination::try_from(node).unwrap(),
        beyond: Elements::from_iter([2, 33]),
    })
}

fn client(change: impl FnOnce(&mut Arep)) -> Client {
    let mut arep = Arep::new(Source::FIGURE_10);
    change(&mut arep);
    Client::new(arep)
}

/// A client that has many requests on the way.
fn wide(max_retries: u32) -> Client {
    client(|arep| (arep.max_outstanding_requests, arep.max_retries) = (8, max_retries))
}

/// Has a new endpoint send these data.
fn ask(client: &mut Client, attributes: Attributes, data_octets: &[u8]) -> EndpointId {
    let id = client.reserve(attributes).unwrap();
    client.request(id, &data(data_octets)).unwrap();
    id
}

fn data(data_octets: &[u8]) -> Request<'_> {
    Request::Data { control_status: 0x2A, data_octets }
}

/// All datagrams that may be sent now.
fn sent(client: &mut Client, now: Duration) -> Vec<Vec<u8>> {
    let mut octets = [0; MAX_DATAGRAM];
    let mut all = Vec::new();
    while let Some(transmit) = client.poll_transmit(now, &mut octets) {
        client.check_invariants();
        all.push(octets[..transmit.length].to_vec());
    }
    all
}

/// What a server that gives the client 125.7 sends back: the data of the request, with its password.
fn response_to(request: &[u8]) -> Vec<u8> {
    let endpoint = request[11] & 0x7F;
    let route = [0x7D, 7, 6, endpoint, 0x8B, 0x80 | request[5], 0x82, 0xA1, 0x80];
    [&request[..4], &route, &request[12..]].concat()
}

fn answered(client: &mut Client, id: EndpointId) -> Response {
    match client.take_outcome(id) {
        Some(Outcome::Answered(response)) => response,
        other => panic!("{other:?}"),
    }
}

fn lost(client: &mut Client, id: EndpointId) -> Loss {
    match client.take_outcome(id) {
        Some(Outcome::Lost(loss)) => loss,
        other => panic!("{other:?}"),
    }
}

#[test]
fn r27_pas_figure_10_a_request_octet_for_octet() {
    let mut client = client(|_| ());
    let id = client.reserve(to_node(4)).unwrap();
    client.request(id, &data(b"abc")).unwrap();
    let mut octets = [0; MAX_DATAGRAM];
    let transmit = client.poll_transmit(Duration::ZERO, &mut octets).unwrap();
    assert_eq!((transmit.to, transmit.endpoint, transmit.is_retry), (address(NODE_4), id, false));
    let route = [0x0B, 4, 5, 2, 33, 0x8B, 0x83, 0x80 | client.get(id).unwrap().address()];
    let expected = [&[2, 0, 0, 0], &route[..], &[0x2A, 3], b"abc", PASSWORD].concat();
    assert_eq!(octets[..transmit.length], expected);
}

#[test]
fn r44_the_states_of_an_endpoint() {
    let mut client = client(|_| ());
    let id = client.reserve(to_node(4)).unwrap();
    assert_eq!(client.state(id), RepState::IdleReserved);
    assert_eq!(client.get(id).unwrap().role(), RepRole::Proxy);
    assert_eq!(client.arep_role(), ArepRole::Client);
    client.request(id, &data(b"abc")).unwrap();
    assert_eq!(client.state(id), RepState::WaitingForResponse);
    assert_eq!(client.get(id).unwrap().progress().fraction(), 0.0);
    assert_eq!(client.request(id, &data(b"abc")), Err(RequestError::Busy));
    assert_eq!(client.set(id, to_node(5)), Err(NotIdle));
    assert_eq!(client.set_arep(client.arep().clone()), Err(NotIdle));
    assert_eq!(client.take_outcome(id), None);

    let request = sent(&mut client, millis(1));
    client.receive(millis(3), address(NODE_4), &response_to(&request[0])).unwrap();
    assert_eq!(client.state(id), RepState::ResponseReceived);
    assert_eq!(client.get(id).unwrap().progress().fraction(), 1.0);
    assert_eq!((client.poll_finished(), client.poll_finished()), (Some(id), None));
    client.set(id, to_node(5)).unwrap();
    let response = answered(&mut client, id);
    assert_eq!(response.destinations[..], [125, 7, 1]);
    assert_eq!(response.sources[..], [11, 4, 2, 33, 0]);
    assert_eq!((response.control_status, &response.data_octets[..]), (0x2A, &b"abc"[..]));
    assert_eq!(response.round_trip, millis(2));
    assert_eq!(client.state(id), RepState::IdleReserved);

    client.free(id);
    assert_eq!(client.state(id), RepState::NotInUse);
    assert_eq!(client.request(id, &data(b"abc")), Err(RequestError::NotInUse));
    assert_eq!(client.set(id, to_node(5)), Err(NotIdle));
    client.free(id);
}

#[test]
fn r44_endpoints_come_to_an_end() {
    let mut client = client(|_| ());
    let ids: Vec<_> = (0..MAX_ENDPOINTS).map(|_| client.reserve(to_node(4)).unwrap()).collect();
    assert_eq!(client.reserve(to_node(4)), Err(NoneFree));
    client.check_invariants();
    client.free(ids[3]);
    let again = client.reserve(to_node(4)).unwrap();
    assert!(!ids.contains(&again));
    assert_eq!(client.reserve(to_node(4)), Err(NoneFree));
}

#[test]
fn r44_the_window_lets_as_many_wait_as_it_says() {
    let mut client = client(|arep| arep.max_outstanding_requests = 3);
    let ids: Vec<_> = (1..=5).map(|node| ask(&mut client, to_node(node), b"abc")).collect();
    let first = sent(&mut client, millis(0));
    assert_eq!(first.iter().map(|octets| octets[5]).collect::<Vec<_>>(), [1, 2, 3]);
    assert!(sent(&mut client, millis(0)).is_empty());
    client.receive(millis(1), address("203.0.113.5:20002"), &response_to(&first[1])).unwrap();
    assert_eq!(client.poll_finished(), Some(ids[1]));
    assert_eq!(sent(&mut client, millis(1))[0][5], 4);
    client.free(ids[0]);
    assert_eq!(sent(&mut client, millis(1))[0][5], 5);
}

#[test]
fn r44_high_priority_goes_first() {
    let mut client = wide(0);
    for (node, priority) in [(1, Priority::Normal), (2, Priority::High), (3, Priority::Normal)] {
        ask(&mut client, Attributes { priority, ..to_node(node) }, b"abc");
    }
    ask(&mut client, Attributes { priority: Priority::High, ..to_node(4) }, b"abc");
    let order: Vec<_> = sent(&mut client, millis(0)).iter().map(|octets| octets[5]).collect();
    assert_eq!(order, [2, 4, 1, 3]);
}

#[test]
fn r44_r28_a_broadcast_is_never_confirmed() {
    let mut client = client(|_| ());
    let mut broadcast = to_node(126);
    broadcast.destination.beyond.clear();
    let mut behind = to_node(4);
    behind.destination.beyond[1] = 126;
    let unconfirmed = Attributes { confirmation: false, ..to_node(4) };
    for (attributes, destinations) in [
        (broadcast, &[0x0B, 126, 3][..]),
        (behind, &[0x0B, 4, 5, 2, 126]),
        (unconfirmed, &[0x0B, 4, 5, 2, 33]),
    ] {
        let id = ask(&mut client, attributes, b"abc");
        assert!(!client.get(id).unwrap().confirmation());
        let octets = &sent(&mut client, millis(0))[0];
        let route = [destinations, &[0x8B, 0x83, 0x80]].concat();
        assert_eq!(octets[4..4 + route.len()], route, "NCNA comes last");
        assert_eq!(client.poll_finished(), Some(id));
        assert_eq!(client.state(id), RepState::IdleReserved);
        assert_eq!(client.take_outcome(id), Some(Outcome::Sent));
        assert_eq!(client.next_timeout(), None);
    }
    let flat = Attributes { confirmation: false, flat_addressing: FLAT, ..to_node(4) };
    let id = client.reserve(flat).unwrap();
    let read = Request::Read { offset: 0, size: 1 };
    assert_eq!(client.request(id, &read), Err(RequestError::UnconfirmedRead));
    client.request(id, &Request::Write { offset: 0, data_octets: &[0; 100] }).unwrap();
    assert_eq!(sent(&mut client, millis(0)).len(), 2, "each segment, one after the other");
    assert_eq!(client.take_outcome(id), Some(Outcome::Sent));
}

#[test]
fn r44_a_request_is_sent_again_until_max_retries() {
    let mut client = client(|arep| arep.max_retries = 2);
    let id = ask(&mut client, to_node(4), b"abc");
    let first = sent(&mut client, millis(0));
    for retry in 1..=2 {
        let now = client.next_timeout().unwrap();
        assert_eq!(now, millis(1000 * retry));
        client.handle_timeout(now - millis(1));
        assert!(sent(&mut client, now).is_empty());
        client.handle_timeout(now);
        assert_eq!(sent(&mut client, now), first, "the same octets");
    }
    client.handle_timeout(millis(3000));
    assert_eq!(client.get(id).unwrap().retries(), 2);
    assert_eq!(client.poll_finished(), Some(id));
    let loss = lost(&mut client, id);
    assert_eq!(loss, Loss::NoAnswer { waited: millis(3000), sent: 3 });
    assert_eq!(loss.to_string(), "no answer within 3s, sent 3 times");
    assert_eq!((client.state(id), client.next_timeout()), (RepState::IdleReserved, None));
    let late = client.receive(millis(3001), address(NODE_4), &response_to(&first[0]));
    assert_eq!(late, Err(Ignored::Late));
}

#[test]
fn r44_no_retry_begins_after_max_retry_time() {
    let mut client =
        client(|arep| (arep.max_retries, arep.max_retry_time) = (u32::MAX, millis(1500)));
    let id = ask(&mut client, to_node(4), b"abc");
    sent(&mut client, millis(0));
    client.handle_timeout(millis(1000));
    assert_eq!(sent(&mut client, millis(1000)).len(), 1);
    client.handle_timeout(millis(2000));
    assert_eq!(lost(&mut client, id), Loss::NoAnswer { waited: millis(2000), sent: 2 });
}

#[test]
fn an_answer_to_any_sending_counts_and_only_once() {
    let mut client = wide(1);
    let id = ask(&mut client, to_node(4), b"abc");
    let request = sent(&mut client, millis(0));
    client.handle_timeout(millis(1000));
    // Between the time-out and the second sending.
    let response = response_to(&request[0]);
    client.receive(millis(1001), address(NODE_4), &response).unwrap();
    assert!(sent(&mut client, millis(1001)).is_empty());
    assert_eq!(answered(&mut client, id).round_trip, millis(1001));
    for now in [1002, 5000] {
        let again = client.receive(millis(now), address(NODE_4), &response);
        assert_eq!(again, Err(Ignored::Duplicate));
    }
    // The next request of the same endpoint has another address.
    client.request(id, &data(b"xyz")).unwrap();
    let next = sent(&mut client, millis(1003));
    assert_eq!(client.receive(millis(1004), address(NODE_4), &response), Err(Ignored::Duplicate));
    client.receive(millis(1005), address(NODE_4), &response_to(&next[0])).unwrap();
    assert_eq!(answered(&mut client, id).data_octets, b"xyz");
}

#[test]
fn responses_may_come_in_any_order() {
    let mut client = wide(0);
    let ids: Vec<_> = (1..=8).map(|node| ask(&mut client, to_node(node), &[node; 3])).collect();
    let requests = sent(&mut client, millis(0));
    for (request, node) in requests.iter().zip(1..=8_u16).rev() {
        let from = SocketAddr::from(([203, 0, 113, 5], 20000 + node));
        client.receive(millis(1), from, &response_to(request)).unwrap();
    }
    for (id, node) in ids.into_iter().zip(1..) {
        assert_eq!(answered(&mut client, id).data_octets, [node; 3]);
    }
}

#[test]
fn what_does_not_answer_a_request_is_ignored_with_a_reason() {
    let mut client = client(|_| ());
    let id = ask(&mut client, to_node(4), b"abc");
    let idle = client.reserve(to_node(4)).unwrap();
    let idle = client.get(idle).unwrap().address();
    let request = sent(&mut client, millis(0)).remove(0);
    let right = response_to(&request);
    let changed = |at: usize, to: u8| {
        let mut octets = right.clone();
        octets[at] = to;
        octets
    };
    let without_password = right[..right.len() - 8].to_vec();
    let confirmed = changed(12, 0x81);
    let longer = [&right[..6], &[7, 1], &right[7..]].concat();
    for octets in [vec![], changed(0, 3), right[..20].to_vec()] {
        let refused = client.receive(millis(1), address(NODE_4), &octets);
        assert!(matches!(refused, Err(Ignored::Garbage(_))), "{refused:?}");
    }
    for (octets, why) in [
        (confirmed, Ignored::NotAResponse),
        (changed(7, 0), Ignored::NotForUs),
        (changed(7, 99), Ignored::NotForUs),
        (changed(7, 126), Ignored::NotForUs),
        (changed(7, idle), Ignored::NotForUs),
        (longer, Ignored::NotForUs),
        (changed(9, 0x85), Ignored::NotForUs),
        (changed(right.len() - 1, b'Z'), Ignored::WrongPassword),
        (without_password, Ignored::WrongPassword),
    ] {
        let refused = client.receive(millis(1), address(NODE_4), &octets);
        assert_eq!(refused, Err(why), "{octets:02X?}");
    }
    for from in ["203.0.113.5:20005", "203.0.113.6:20004", "[::1]:20004"] {
        let refused = client.receive(millis(1), address(from), &right);
        assert_eq!(refused, Err(Ignored::OtherPort(address(from))));
    }
    assert_eq!(client.state(id), RepState::WaitingForResponse);
    client.receive(millis(1), address(NODE_4), &right).unwrap();
}

#[test]
fn a_loss_says_what_was_seen() {
    let mut client = wide(0);
    let elsewhere = ask(&mut client, to_node(4), b"abc");
    let wrong = ask(&mut client, to_node(4), b"abc");
    let requests = sent(&mut client, millis(0));
    let from = address("203.0.113.5:51234");
    client.receive(millis(1), from, &response_to(&requests[0])).unwrap_err();
    let mut octets = response_to(&requests[1]);
    *octets.last_mut().unwrap() ^= 1;
    client.receive(millis(1), address(NODE_4), &octets).unwrap_err();
    client.handle_timeout(millis(1000));
    let loss = lost(&mut client, elsewhere);
    assert_eq!(loss, Loss::OtherPort(from));
    assert_eq!(loss.to_string(), "answers came from another port, 203.0.113.5:51234");
    assert_eq!(lost(&mut client, wrong).to_string(), "answers with a wrong password");
}

#[test]
fn what_the_network_reports_ends_the_request_that_it_quotes() {
    let mut client = wide(0);
    let ids = [4, 4, 5, 4].map(|node| ask(&mut client, to_node(node), b"abc"));
    let requests = sent(&mut client, millis(0));
    let why = Undelivered::from(std::io::ErrorKind::ConnectionRefused);
    // Of another destination, of an endpoint that does not wait, and of none at all.
    client.undelivered(address(NODE_4), &requests[2], why);
    client.undelivered(address("203.0.113.9:20004"), &[], why);
    assert_eq!(client.poll_finished(), None);
    client.undelivered(address(NODE_4), &requests[1], why);
    assert_eq!((client.poll_finished(), client.poll_finished()), (Some(ids[1]), None));
    assert_eq!(lost(&mut client, ids[1]).to_string(), "nothing listens there");
    // A quotation that was cut: all to that port.
    client.undelivered(address(NODE_4), &requests[0][..8], why);
    assert_eq!([client.poll_finished(), client.poll_finished()], [Some(ids[0]), Some(ids[3])]);
    assert_eq!(client.state(ids[2]), RepState::WaitingForResponse);
}

#[test]
fn what_the_network_reports_is_tried_again_if_it_may_be() {
    let mut client = wide(1);
    let id = ask(&mut client, to_node(4), b"abc");
    let request = sent(&mut client, millis(0)).remove(0);
    client.undelivered(address(NODE_4), &request, Undelivered::NetworkUnreachable);
    assert_eq!(client.poll_finished(), None);
    client.handle_timeout(millis(1000));
    assert_eq!(sent(&mut client, millis(1000)).len(), 1);
    client.undelivered(address(NODE_4), &request, Undelivered::NetworkUnreachable);
    assert_eq!(client.poll_finished(), Some(id));
    assert_eq!(lost(&mut client, id).to_string(), "network unreachable");
}

#[test]
fn r40_a_client_keeps_the_address_that_a_server_gives_it() {
    let mut client = client(|_| ());
    for (node, source, given) in [
        (4, [0x8B, 0x83], [125, 7]),
        (4, [0xFD, 0x87], [125, 9]),
        (4, [0xFD, 0x89], [0, 9]), // no IPNetID: taken, and not kept
        (4, [0xFD, 0x89], [125, 9]),
        (5, [0x8B, 0x83], [125, 1]), // each server has its own table
        (4, [0xFD, 0x89], [125, 9]),
        (5, [0xFD, 0x81], [125, 1]),
    ] {
        let id = ask(&mut client, to_node(node), b"abc");
        let request = sent(&mut client, millis(0)).remove(0);
        assert_eq!(request[9..11], source);
        let mut response = response_to(&request);
        response[4..6].copy_from_slice(&given);
        let from = SocketAddr::from(([203, 0, 113, 5], 20000 + u16::from(node)));
        client.receive(millis(1), from, &response).unwrap();
        assert_eq!(answered(&mut client, id).destinations[..2], given);
        client.free(id);
    }
}

#[test]
fn nothing_is_sent_that_does_not_fit() {
    let mut client = client(|arep| (arep.max_pdu_size, arep.max_data_size) = (20, 8));
    let id = client.reserve(to_node(4)).unwrap();
    // The route has eight octets, and two are of the control-status and the data-field-format.
    client.request(id, &data(&[0; 8])).unwrap();
    assert_eq!(sent(&mut client, millis(0))[0].len(), 4 + 8 + 2 + 8 + 8);
    client.free(id);
    let id = client.reserve(to_node(4)).unwrap();
    let refused = client.request(id, &data(&[0; 9]));
    assert_eq!(refused, Err(RequestError::TooMuchData { octets: 9, most: 8 }));
    let mut far = to_node(4);
    far.destination.beyond = Elements::from_iter([2; 12]);
    client.set(id, far.clone()).unwrap();
    let refused = client.request(id, &data(&[0; 1]));
    assert_eq!(refused, Err(RequestError::TooMuchData { octets: 1, most: 0 }));
    far.destination.beyond.push(2);
    client.set(id, far.clone()).unwrap();
    let refused = client.request(id, &data(&[]));
    assert_eq!(refused, Err(RequestError::PackageTooLong { octets: 21, most: 20 }));
    far.destination.beyond = Elements::from_iter([2; 25]);
    client.set(id, far.clone()).unwrap();
    assert!(matches!(client.request(id, &data(&[])), Err(RequestError::Route(_))));
    far.destination.beyond = Elements::from_iter([128]);
    client.set(id, far).unwrap();
    assert!(matches!(client.request(id, &data(&[])), Err(RequestError::Route(_))));
    assert_eq!(client.state(id), RepState::IdleReserved);
}

/// Each response comes twice, and now and then an older one comes late. None passes for another.
#[test]
fn r44_a_memory_is_written_and_read_in_segments() {
    let table = IpNetTable::of_device([172, 17, 17, 4].into(), 0, &[Fields::UNUSED; 124]).unwrap();
    let mut server = Server::new(table, Header::default(), vec![Password::new(*PASSWORD)]);
    let mut memory = Memory::new(1000, Some(1), Some(2));
    let mut client = client(|arep| arep.max_data_size = 32);
    let id = client.reserve(Attributes { flat_addressing: FLAT, ..to_node(4) }).unwrap();
    let octets: Vec<u8> = (0..=255).chain(0..200).collect();
    let mut old: Vec<Vec<u8>> = Vec::new();
    let mut run = |client: &mut Client, total: u32| {
        let mut fractions = vec![client.get(id).unwrap().progress().fraction()];
        while client.state(id) == RepState::WaitingForResponse {
            let request = sent(client, millis(0)).remove(0);
            for late in &old {
                client.receive(millis(1), address(NODE_4), late).unwrap_err();
            }
            let from = "198.51.100.9:50000".parse().unwrap();
            let taken = server.receive(millis(1), Port::Secure, from, &request).unwrap();
            let answer = memory.serve(&taken).unwrap();
            let mut response = [0; MAX_DATAGRAM];
            let length = taken.requester.unwrap().respond(&answer, &mut response).unwrap();
            client.receive(millis(1), address(NODE_4), &response[..length]).unwrap();
            client.receive(millis(1), address(NODE_4), &response[..length]).unwrap_err();
            fractions.push(client.get(id).unwrap().progress().fraction());
            old.push(response[..length].to_vec());
            old.drain(..old.len().saturating_sub(20));
        }
        assert_eq!(fractions.len() as u32, total + 1);
        assert!(fractions.is_sorted() && fractions[0] == 0.0 && fractions.ends_with(&[1.0]));
    };
    client.request(id, &Request::Write { offset: 100, data_octets: &octets }).unwrap();
    run(&mut client, 456_u32.div_ceil(30));
    assert_eq!(answered(&mut client, id).data_octets, b"");
    client.request(id, &Request::Read { offset: 99, size: 458 }).unwrap();
    run(&mut client, 458_u32.div_ceil(32));
    let read = answered(&mut client, id).data_octets;
    assert_eq!(read, [&[0], &octets[..], &[0]].concat());
}

#[test]
fn a_route_by_the_table() {
    let row = |nettype, ip_address: [u8; 4], udp_port, use_password, router| Fields {
        nettype,
        ip_address: ip_address.into(),
        udp_port,
        use_password,
        router,
        allow_without_password: false,
    };
    let own = row(Nettype::IpRange, [172, 17, 18, 0], NORMAL_PORT, false, 0);
    let plant = row(Nettype::UdpRange, [203, 0, 113, 5], 20000, true, 1);
    let [one, two, three] = [1, 2, 3].map(|number| IpNetId::new(number).unwrap());
    let table = IpNetTable::new(NodeAddress::new(4).unwrap(), [(one, own), (two, plant)]).unwrap();
    let password = Password::new(*PASSWORD);
    let node = Destination::try_from(33).unwrap();
    let way = |net, password| DestinationRoute::by_table(&table, net, node, password);
    let local = way(one, Some(&password)).unwrap().way;
    assert_eq!((local.address, local.password.is_some()), (address("172.17.18.33:34378"), false));
    let remote = way(two, Some(&password)).unwrap().way;
    assert_eq!((remote.address, remote.password.is_some()), (address("203.0.113.5:20033"), true));
    assert_eq!(way(two, None).unwrap_err(), NoWay::NoPassword(two));
    assert!(matches!(way(three, None), Err(NoWay::Translate(_))));
}

#[test]
fn no_password_is_shown() {
    let mut client = client(|_| ());
    ask(&mut client, to_node(4), b"abc");
    let shown = format!("{client:?}");
    assert!(!shown.contains("PNETPASS") && !shown.contains("80, 78, 69, 84"), "{shown}");
}

/// What happens to a client.
#[derive(Clone, Debug)]
enum Event {
    Ask {
        node: u8,
        high: bool,
    },
    /// The response to a datagram that was sent, by its number from the end, with an octet changed.
    Answer {
        back: usize,
        change: Option<(usize, u8)>,
        other_port: bool,
    },
    Octets(Vec<u8>),
    Wait(u64),
    Free(usize),
    Undelivered {
        back: usize,
        cut: usize,
    },
}

fn event() -> impl Strategy<Value = Event> {
    let change = proptest::option::weighted(0.3, (0..40_usize, any::<u8>()));
    prop_oneof![
        (1..4_u8, any::<bool>()).prop_map(|(node, high)| Event::Ask { node, high }),
        (0..12_usize, change, prop::bool::weighted(0.1))
            .prop_map(|(back, change, other_port)| Event::Answer { back, change, other_port }),
        prop::collection::vec(any::<u8>(), 0..120).prop_map(Event::Octets),
        (0..1500_u64).prop_map(Event::Wait),
        (0..8_usize).prop_map(Event::Free),
        (0..12_usize, 0..120_usize).prop_map(|(back, cut)| Event::Undelivered { back, cut }),
    ]
}

proptest! {
    /// Every request has its number as data. Whatever comes, in whatever order, a response that is handed
    /// out has the number of its request.
    #[test]
    fn no_answer_is_that_of_another_request(events in prop::collection::vec(event(), 0..200)) {
        let mut client = client(|arep| {
            (arep.max_outstanding_requests, arep.max_retries) = (4, 1);
        });
        let mut now = Duration::ZERO;
        let mut asked: Vec<(EndpointId, u32)> = Vec::new();
        let mut datagrams: Vec<Vec<u8>> = Vec::new();
        let back = |datagrams: &Vec<Vec<u8>>, back: usize| datagrams.iter().rev().nth(back).cloned();
        for (number, event) in (0_u32..).zip(events) {
            match event {
                Event::Ask { node, high } => {
                    let priority = if high { Priority::High } else { Priority::Normal };
                    let attributes = Attributes { priority, ..to_node(node) };
                    if let Ok(id) = client.reserve(attributes) {
                        client.request(id, &data(&number.to_be_bytes())).unwrap();
                        asked.push((id, number));
                    }
                }
                Event::Answer { back: number, change, other_port } => {
                    let Some(request) = back(&datagrams, number) else { continue };
                    let port = 20000 + u16::from(request[5]) + u16::from(other_port);
                    let mut response = response_to(&request);
                    // Endpoint address and data stay as they are: they tell what is answered.
                    if let Some((at, to)) = change.filter(|(at, _)| *at != 7 && !(15..19).contains(at))
                        && let Some(octet) = response.get_mut(at)
                    {
                        *octet = to;
                    }
                    let _ = client.receive(now, ([203, 0, 113, 5], port).into(), &response);
                }
                Event::Octets(octets) => {
                    let refused = client.receive(now, address(NODE_4), &octets);
                    prop_assert!(refused.is_err());
                }
                Event::Wait(time) => {
                    now += millis(time);
                    client.handle_timeout(now);
                    prop_assert!(client.next_timeout().is_none_or(|next| next > now));
                }
                Event::Free(index) => {
                    if index < asked.len() {
                        client.free(asked.remove(index).0);
                    }
                }
                Event::Undelivered { back: number, cut } => {
                    let Some(request) = back(&datagrams, number) else { continue };
                    let to = ([203, 0, 113, 5], 20000 + u16::from(request[5])).into();
                    let quoted = &request[..cut.min(request.len())];
                    client.undelivered(to, quoted, Undelivered::NothingListens);
                }
            }
            datagrams.extend(sent(&mut client, now));
            while let Some(id) = client.poll_finished() {
                let index = asked.iter().position(|(other, _)| *other == id).unwrap();
                let (_, number) = asked.remove(index);
                let outcome = client.take_outcome(id);
                prop_assert!(outcome.is_some());
                if let Some(Outcome::Answered(response)) = outcome {
                    prop_assert_eq!(response.data_octets, number.to_be_bytes());
                }
                client.free(id);
            }
            client.check_invariants();
        }
    }
}
