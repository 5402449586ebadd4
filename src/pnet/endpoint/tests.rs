//! The server node of PAS 5.4.1.2, 7 and 9, datagram by datagram. The octets are written by hand, so
//! that the codec does not test itself.

use std::net::SocketAddrV4;
use std::time::Duration;

use proptest::prelude::*;

use super::client::{ArepRole, RepRole};
use super::*;
use crate::pnet::ip_net_table::{Fields, IpNetTable, Nettype};
use crate::pnet::wire::{
    Header, IpNetId, MAX_DATA, MAX_DATAGRAM, NORMAL_PORT, NodeAddress, Password,
};

const PASSWORD: &[u8; 8] = b"PNETPASS";
const SECOND: &[u8; 8] = b"second-1";
const STRANGER: &str = "198.51.100.9:50000";
/// Node 3 of the server's own net.
const NEIGHBOUR: &str = "172.17.17.3:34378";
/// PAS Figure 10: net 11, node 4, to node 33 behind port 2, from node 3 of net 11.
const FIGURE_10: &[u8] = &[0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F];

/// Node 4 of net 11, 172.17.17.0, which reaches 172.17.18.0 through node 1 as net 12.
fn server() -> Server {
    let own = Fields {
        nettype: Nettype::IpRange,
        ip_address: [172, 17, 17, 0].into(),
        udp_port: NORMAL_PORT,
        ..Fields::UNUSED
    };
    let next = Fields { ip_address: [172, 17, 18, 0].into(), router: 1, ..own };
    let rows = [(11, own), (12, next)].map(|(id, row)| (IpNetId::new(id).unwrap(), row));
    let table = IpNetTable::new(NodeAddress::new(4).unwrap(), rows).unwrap();
    let passwords = [PASSWORD, SECOND].map(|octets| Password::new(*octets));
    Server::new(table, Header::default(), passwords.into())
}

fn datagram(route: &[u8], data: &[u8], password: &[u8]) -> Vec<u8> {
    [&[2, 0, 0, 0], route, &[0x2A, 0xC0 | data.len() as u8], data, password].concat()
}

struct Judged {
    to: SocketAddrV4,
    octets: Vec<u8>,
}

/// Has the server judge a datagram and answer it with its data, if it wants an answer.
fn judge_at(
    server: &mut Server,
    seconds: u64,
    port: Port,
    from: &str,
    octets: &[u8],
) -> Result<Option<Judged>, Ignored> {
    let now = Duration::from_secs(seconds);
    let indicated = server.receive(now, port, from.parse().unwrap(), octets)?;
    let mut buffer = [0; MAX_DATAGRAM];
    Ok(indicated.requester.map(|requester| {
        let length = requester.respond(indicated.data_octets, &mut buffer).unwrap();
        Judged { to: requester.address(), octets: buffer[..length].to_vec() }
    }))
}

fn judge(
    server: &mut Server,
    port: Port,
    from: &str,
    octets: &[u8],
) -> Result<Option<Judged>, Ignored> {
    judge_at(server, 0, port, from, octets)
}

#[track_caller]
fn answers(server: &mut Server, port: Port, from: &str, octets: &[u8], expected: &[u8]) {
    let answer = judge(server, port, from, octets).unwrap().expect("an answer");
    assert_eq!(answer.octets, expected);
    assert_eq!(answer.to, from.parse().unwrap());
}

#[test]
fn r36_pas_figure_10_a_known_client_is_answered_through_the_table() {
    let mut server = server();
    let back: &[u8] = &[0x0B, 0x03, 0x06, 0x1F, 0x8B, 0x84, 0x82, 0xA1, 0x80];
    for (from, client, route) in [
        (NEIGHBOUR, 0x0B, back.to_vec()),
        ("172.17.18.3:34378", 0x0C, [&[0x0C], &back[1..]].concat()),
    ] {
        let mut request = FIGURE_10.to_vec();
        request[5] = 0x80 | client;
        let request = datagram(&request, b"abc", b"");
        answers(&mut server, Port::Normal, from, &request, &datagram(&route, b"abc", b""));
    }
    assert!(server.dynamic_clients().is_empty());
}

#[test]
fn r35_each_of_the_four_conditions_counts() {
    let known = (FIGURE_10, NEIGHBOUR, &b""[..]);
    for (is_known, (route, from, password)) in [
        (true, known),
        (false, (&[0x0B, 0x04, 0x05, 0x02, 0x21, 0x8C, 0x83, 0x9F], known.1, known.2)), // another net
        (false, (&[0x0B, 0x04, 0x05, 0x02, 0x21, 0x8D, 0x83, 0x9F], known.1, known.2)), // an unused one
        (false, (&[0x0B, 0x04, 0x05, 0x02, 0x21, 0xFD, 0x83, 0x9F], known.1, known.2)), // 125
        (false, (&[0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x85, 0x9F], known.1, known.2)), // another node
        (false, (known.0, "172.17.17.3:34379", known.2)),
        (false, (known.0, "172.17.18.3:34378", known.2)),
        (false, (known.0, known.1, PASSWORD)),
    ] {
        let mut server = server();
        let request = datagram(route, b"abc", password);
        let answer = judge(&mut server, Port::Normal, from, &request).unwrap().unwrap();
        assert_eq!(server.dynamic_clients().is_empty(), is_known, "{route:02X?} {from}");
        assert_eq!(answer.octets[4] == 125, !is_known);
    }
}

#[test]
fn r37_r39_an_unknown_client_gets_a_place_and_its_own_password_back() {
    let mut server = server();
    let to = |node: u8| [0x7D, node, 0x06, 0x1F, 0x8B, 0x84, 0x82, 0xA1, 0x80];
    for (from, password, node) in [
        (STRANGER, PASSWORD, 1),
        ("198.51.100.9:50001", SECOND, 2),
        (STRANGER, SECOND, 1), // R-38, and the password in use is the last one
        ("203.0.113.9:50000", PASSWORD, 3),
    ] {
        let request = datagram(FIGURE_10, b"abc", password);
        let expected = datagram(&to(node), b"abc", password);
        answers(&mut server, Port::Secure, from, &request, &expected);
    }
    let first = server.dynamic_clients().get(NodeAddress::new(1).unwrap()).unwrap();
    assert_eq!(first.password.as_ref().unwrap().octets(), SECOND);

    // the client may use what it was given.
    let route = [0x0B, 0x04, 0x05, 0x02, 0x21, 0xFD, 0x82, 0x9F];
    let request = datagram(&route, b"abc", SECOND);
    let expected = datagram(&to(2), b"abc", SECOND);
    answers(&mut server, Port::Secure, "198.51.100.9:50001", &request, &expected);
    assert_eq!(server.dynamic_clients().len(), 3);
}

#[test]
fn a13_the_client_that_is_silent_for_longest_loses_its_place() {
    let mut server = server();
    let request = datagram(FIGURE_10, b"abc", PASSWORD);
    let place = |server: &mut Server, seconds, client: u16| {
        let from = format!("198.51.100.9:{client}");
        let answer = judge_at(server, seconds, Port::Secure, &from, &request).unwrap().unwrap();
        assert_eq!(answer.octets[4], 125);
        answer.octets[5]
    };
    for client in 1..=125 {
        assert_eq!(u16::from(place(&mut server, client.into(), client)), client);
    }
    assert_eq!(place(&mut server, 200, 1), 1, "it came back");
    assert_eq!(place(&mut server, 201, 1000), 2);
    assert_eq!(place(&mut server, 202, 2), 3);
    assert_eq!(server.dynamic_clients().len(), 125);
    for client in 2000..3000 {
        place(&mut server, 300, client);
    }
    assert_eq!(server.dynamic_clients().len(), 125);
}

#[test]
fn a13_nobody_takes_a_place_whose_datagram_is_ignored() {
    let mut server = server();
    for (port, route, password, why) in [
        (Port::Secure, FIGURE_10, &b""[..], Ignored::NoPassword),
        (Port::Secure, FIGURE_10, b"WRONGPAS", Ignored::WrongPassword),
        (
            Port::Secure,
            &[0x0B, 0x05, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F],
            PASSWORD,
            Ignored::OtherNode,
        ),
        (Port::Secure, &[0x04, 0x83], PASSWORD, Ignored::NotOnIp),
        (Port::Secure, &[0x83, 0x04], PASSWORD, Ignored::NotOnIp),
        (Port::Normal, &[0x04, 0x02, 0x03, 0x21, 0x05, 0x83], b"", Ignored::NotOnIp),
    ] {
        let refused = judge(&mut server, port, STRANGER, &datagram(route, b"abc", password));
        assert_eq!(refused.err(), Some(why), "{route:02X?}");
    }
    let cut = judge(&mut server, Port::Secure, STRANGER, &datagram(FIGURE_10, b"abc", b"1234567"));
    assert!(matches!(cut.err(), Some(Ignored::NotADatagram(_))));
    assert!(server.dynamic_clients().is_empty());
}

/// A route that is full on its way here has no room for the NCNA on its way back.
#[test]
fn a13_nobody_takes_a_place_without_a_way_back() {
    let mut server = server();
    let mut route = [&[0x0B, 0x04, 27], &[5; 24][..], &[0x8B, 0x83, 0x9F]].concat();
    let request = datagram(&route, b"abc", PASSWORD);
    let refused = judge(&mut server, Port::Secure, STRANGER, &request);
    assert!(matches!(refused.err(), Some(Ignored::NoWayBack(_))));
    assert!(server.dynamic_clients().is_empty());
    (route[2], _) = (26, route.remove(3));
    judge(&mut server, Port::Secure, STRANGER, &datagram(&route, b"abc", PASSWORD)).unwrap();
}

#[test]
fn r33_own_address_bna_and_sna_are_taken() {
    let mut server = server();
    for number in 0..128 {
        let route = [0x0B, number, 0x8B, 0x83];
        let judged = judge(&mut server, Port::Normal, NEIGHBOUR, &datagram(&route, b"abc", b""));
        match number {
            4 | 127 => {
                assert_eq!(judged.unwrap().unwrap().octets[4..10], [0x0B, 3, 3, 0x8B, 0x84, 0x80])
            }
            126 => assert!(judged.unwrap().is_none(), "R-28: nobody waits for it"),
            _ => assert_eq!(judged.err(), Some(Ignored::OtherNode), "{number}"),
        }
    }
}

#[test]
fn r28_r34_nothing_unconfirmed_is_answered() {
    let mut server = server();
    for route in [
        &[0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x80][..], // a response of another server
        &[0x0B, 0x04, 0x8B, 0x80],
        &[0x0B, 0x04, 0x05, 0x02, 0x7E, 0x8B, 0x83, 0x9F], // a broadcast behind this node
    ] {
        for (port, password) in [(Port::Normal, &b""[..]), (Port::Secure, PASSWORD)] {
            let octets = datagram(route, b"abc", password);
            assert!(judge(&mut server, port, STRANGER, &octets).unwrap().is_none());
        }
    }
    assert!(server.dynamic_clients().is_empty());
}

#[test]
fn r3_any_password_opens_the_secure_port_and_none_opens_nothing() {
    let request = |password: &[u8]| datagram(FIGURE_10, b"", password);
    let mut open = server();
    for password in [PASSWORD, SECOND] {
        assert!(judge(&mut open, Port::Secure, STRANGER, &request(password)).is_ok());
    }
    let table = IpNetTable::of_device([172, 17, 17, 4].into(), 0, &[Fields::UNUSED; 124]).unwrap();
    let mut closed = Server::new(table, Header::default(), Vec::new());
    let refused = judge(&mut closed, Port::Secure, STRANGER, &request(PASSWORD)).err();
    assert_eq!(refused, Some(Ignored::WrongPassword));
}

#[test]
fn r44_a_server_holds_the_real_objects() {
    let server = server();
    assert_eq!((server.role(), server.arep_role()), (RepRole::RealContainer, ArepRole::Server));
}

#[test]
fn no_password_is_shown() {
    let mut server = server();
    let request = datagram(FIGURE_10, b"abc", PASSWORD);
    let from = STRANGER.parse().unwrap();
    let indicated = server.receive(Duration::ZERO, Port::Secure, from, &request).unwrap();
    let shown = format!("{indicated:?} {server:?}");
    assert!(!shown.contains("PNETPASS") && !shown.contains("80, 78, 69, 84"), "{shown}");
}

proptest! {
    /// Whatever comes, the server answers to the sender alone, and at the Secure port only whoever
    /// has shown a password, with the same one.
    #[test]
    fn any_octets_are_judged(
        front in proptest::option::of(Just(vec![2, 0, 0, 0, 0x0B, 0x04])),
        rest in prop::collection::vec(any::<u8>(), 0..120),
        secure in any::<bool>(),
        password in prop::sample::select(vec![&b""[..], PASSWORD, SECOND, b"WRONGPAS"]),
    ) {
        let octets = [front.unwrap_or_default(), rest, password.to_vec()].concat();
        let mut server = server();
        let port = if secure { Port::Secure } else { Port::Normal };
        if let Ok(Some(answer)) = judge(&mut server, port, STRANGER, &octets) {
            prop_assert_eq!(answer.to, STRANGER.parse().unwrap());
            let secret = octets.last_chunk::<8>().filter(|secret| [PASSWORD, SECOND].contains(secret));
            prop_assert!(!secure || answer.octets.last_chunk::<8>() == secret && secret.is_some());
            prop_assert!(answer.octets.len() <= MAX_DATAGRAM && answer.octets.len() >= 8);
        }
        prop_assert!(server.dynamic_clients().len() <= 1);
    }

    /// Data of any length come back, up to 63 octets.
    #[test]
    fn any_data_are_answered(data in prop::collection::vec(any::<u8>(), 0..=MAX_DATA)) {
        let mut server = server();
        let request = datagram(FIGURE_10, &data, PASSWORD);
        let answer = judge(&mut server, Port::Secure, STRANGER, &request).unwrap().unwrap();
        prop_assert_eq!(&answer.octets[15..15 + data.len()], &data[..]);
    }
}
