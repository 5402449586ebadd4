//! `docs/vectors.md`: datagrams for other implementers, octet for octet, as this code makes and takes
//! them.

use std::fmt::Write;
use std::net::SocketAddrV4;
use std::time::Duration;

use pnet_nat::nat::Payload;
use pnet_nat::pnet::endpoint::client::{
    Arep, Attributes, Client, DestinationRoute, FlatAddressing, Outcome, Request, Source, Way,
};
use pnet_nat::pnet::endpoint::{Memory, Port, Server, Service};
use pnet_nat::pnet::ip_net_table::{Destination, Fields, IpNetTable, Nettype};
use pnet_nat::pnet::wire::{
    BNA, Datagram, DatagramRepr, DlRoute, Elements, Header, IpNetId, MAX_DATAGRAM, NORMAL_PORT,
    NodeAddress, Password, RouteFormat,
};

use pnet_nat_rig::isolated_core::{Rig, Site, arrival, client_endpoint, server as server_of};

const PAGE: &str = include_str!("../../docs/vectors.md");
const PASSWORD: &[u8; 8] = b"PNETPASS";
/// What most of the datagrams carry.
const DATA: &[u8] = &[0x12, 0x34, 0x56];

/// A datagram from the sender's DL-route.
fn emit(route: &DlRoute, data: &[u8], password: Option<&[u8; 8]>) -> Vec<u8> {
    let route = route.to_route().unwrap();
    let repr = DatagramRepr {
        header: Header::default(),
        route: route.as_route(),
        control_status: 0,
        data_field_flags: 0,
        data_octets: data,
        password: password.map(|octets| Password::new(*octets)),
    };
    let mut buffer = [0; MAX_DATAGRAM];
    let length = repr.emit(&mut buffer).unwrap();
    buffer[..length].to_vec()
}

fn route(destination: &[u8], source: &[u8]) -> DlRoute {
    DlRoute::new(destination, source).unwrap()
}

fn hex(octets: &[u8]) -> String {
    octets.iter().map(|octet| format!("{octet:02X}")).collect::<Vec<_>>().join(" ")
}

fn line(table: &mut String, what: &str, octets: &[u8]) {
    writeln!(table, "| {what} | `{}` |", hex(octets)).unwrap();
}

const HEAD: &str = "| what | octets |\n|---|---|\n";

/// PAS 5.7.2: what each number of elements becomes.
fn formats() -> String {
    let mut table = HEAD.to_owned();
    for (what, format, destination, source) in [
        ("Simple: to node 4, from node 3", RouteFormat::Simple, &[4][..], &[3][..]),
        (
            "Extended: to node 4 of net 11, from node 3 of net 11",
            RouteFormat::Extended,
            &[11, 4],
            &[11, 3],
        ),
        ("Complex: to 4, 2, 33, 5, from node 3", RouteFormat::Complex, &[4, 2, 33, 5], &[3]),
        ("IP, PAS Figure 9: to 4, 2, 33, from 3, 31", RouteFormat::Ip, &[4, 2, 33], &[3, 31]),
        (
            "IP, PAS Figure 10: to node 33 behind port 2 of node 4 of net 11, from 31 at node 3 of net 11",
            RouteFormat::Ip,
            &[11, 4, 2, 33],
            &[11, 3, 31],
        ),
    ] {
        let octets = emit(&route(destination, source), DATA, None);
        let datagram = Datagram::parse(&octets, Header::default()).unwrap();
        assert_eq!(datagram.route().format(), format, "{what}");
        line(&mut table, what, &octets);
    }
    table
}

/// Node 4 of net 11 in 172.17.17.0, as [`exchanges`] has it.
fn server() -> Server {
    let own = Fields {
        nettype: Nettype::IpRange,
        ip_address: [172, 17, 17, 0].into(),
        udp_port: NORMAL_PORT,
        ..Fields::UNUSED
    };
    let rows = [(IpNetId::new(11).unwrap(), own)];
    let table = IpNetTable::new(NodeAddress::new(4).unwrap(), rows).unwrap();
    Server::new(table, Header::default(), vec![Password::new(*PASSWORD)])
}

/// Requests to one server, in this order, and its responses.
fn exchanges() -> String {
    let mut server = server();
    let figure_10 = route(&[11, 4, 2, 33], &[11, 3, 31]);
    let kept = route(&[11, 4, 2, 33], &[125, 1, 31]);
    let mut table = "| what | request | response |\n|---|---|---|\n".to_owned();
    for (what, port, from, request) in [
        (
            "known client, Normal port, from 172.17.17.3:34378",
            Port::Normal,
            "172.17.17.3:34378",
            emit(&figure_10, DATA, None),
        ),
        (
            "unknown client, Secure port, from 198.51.100.9:50000: it becomes node 1 of net 125",
            Port::Secure,
            "198.51.100.9:50000",
            emit(&figure_10, DATA, Some(PASSWORD)),
        ),
        (
            "another unknown client, from 198.51.100.9:50001: node 2",
            Port::Secure,
            "198.51.100.9:50001",
            emit(&figure_10, DATA, Some(PASSWORD)),
        ),
        (
            "the first one again, with the address that it was given",
            Port::Secure,
            "198.51.100.9:50000",
            emit(&kept, DATA, Some(PASSWORD)),
        ),
        (
            "no data, from a known client",
            Port::Normal,
            "172.17.17.3:34378",
            emit(&figure_10, &[], None),
        ),
        (
            "broadcast to all nodes of net 11",
            Port::Normal,
            "172.17.17.3:34378",
            emit(&route(&[11, BNA], &[11, 3, 31]), DATA, None),
        ),
        (
            "the response of another server: it is unconfirmed",
            Port::Normal,
            "172.17.17.5:34378",
            emit(&route(&[11, 4, 31], &[11, 5, 0]), DATA, None),
        ),
        (
            "a wrong password at the Secure port",
            Port::Secure,
            "198.51.100.9:50000",
            emit(&figure_10, DATA, Some(b"WRONGPAS")),
        ),
    ] {
        let from: SocketAddrV4 = from.parse().unwrap();
        let indicated = server.receive(Duration::ZERO, port, from, &request);
        let requester = indicated.ok().and_then(|indicated| {
            let data = indicated.data_octets;
            indicated.requester.map(|requester| (requester, data))
        });
        let response = requester.map(|(requester, data)| {
            let mut buffer = [0; MAX_DATAGRAM];
            let length = requester.respond(data, &mut buffer).unwrap();
            format!("`{}`", hex(&buffer[..length]))
        });
        let response = response.as_deref().unwrap_or("none");
        writeln!(table, "| {what} | `{}` | {response} |", hex(&request)).unwrap();
    }
    table
}

/// A write of 70 octets into a memory, in pieces, and the answers of a server.
fn segments() -> String {
    let way = Way { address: "203.0.113.5:20004".parse().unwrap(), password: None };
    let mut attributes = Attributes::new(DestinationRoute {
        way,
        ip_net_id: IpNetId::new(11).unwrap(),
        node: Destination::Node(NodeAddress::new(4).unwrap()),
        beyond: Elements::new(),
    });
    attributes.flat_addressing = Some(FlatAddressing { read: Some(1), write: Some(2) });
    let mut client = Client::new(Arep::new(Source::FIGURE_10));
    let endpoint = client.reserve(attributes).unwrap();
    let data_octets: Vec<u8> = (0..70).collect();
    client.request(endpoint, &Request::Write { offset: 256, data_octets: &data_octets }).unwrap();

    let (mut server, mut memory) = (server(), Memory::new(512, Some(1), Some(2)));
    let mut table = "| request | response |\n|---|---|\n".to_owned();
    let mut buffer = [0; MAX_DATAGRAM];
    while let Some(sent) = client.poll_transmit(Duration::ZERO, &mut buffer) {
        let request = buffer[..sent.length].to_vec();
        let from = "198.51.100.9:50000".parse().unwrap();
        let indicated = server.receive(Duration::ZERO, Port::Normal, from, &request).unwrap();
        let data = memory.serve(&indicated).unwrap();
        let length = indicated.requester.unwrap().respond(&data, &mut buffer).unwrap();
        let response = buffer[..length].to_vec();
        client.receive(Duration::ZERO, sent.to, &response).unwrap();
        writeln!(table, "| `{}` | `{}` |", hex(&request), hex(&response)).unwrap();
    }
    assert_eq!(memory.octets()[256..326], data_octets);
    assert!(matches!(client.take_outcome(endpoint), Some(Outcome::Answered(_))));
    table
}

/// Through a relay with a remote net: what a local program and the other plant's router send, and what
/// becomes of it.
fn adapter() -> String {
    let mut rig = Rig::new(&Site { is_remote: true, ..Site::default() });
    let program = arrival(client_endpoint(0), 4);
    let (to_33, extended) = (route(&[11, 4, 2, 33], &[11, 3, 31]), route(&[11, 4], &[11, 3]));
    let (back, back_extended) =
        (route(&[125, 1, 31], &[11, 4, 2, 33, 0]), route(&[125, 1], &[11, 4, 0]));
    let mut table = "| what | sent | passed on |\n|---|---|---|\n".to_owned();
    let mut via = None;
    for (what, request, password, is_request) in [
        ("request, PAS Figure 10, to 127.17.2.4:34378", &to_33, None, true),
        ("its answer, from the router's port", &back, Some(PASSWORD), false),
        ("request, Extended", &extended, None, true),
        (
            "an answer without a password, with `require_response_password`",
            &back_extended,
            None,
            false,
        ),
        ("a request with a password, even the right one", &to_33, Some(PASSWORD), true),
        ("an answer with another password", &back, Some(b"WRONGPAS"), false),
    ] {
        let sent = emit(request, DATA, password);
        let mut room = [&sent[..], &[0; Password::LEN]].concat();
        let mut payload = Payload::new(&mut room, sent.len());
        let Rig { core, effects, now, .. } = &mut rig;
        let passed = match is_request {
            true => {
                let to = core.request(*now, &program, &mut payload, effects);
                via = to.ok().map(|to| to.via).or(via);
                to.is_ok()
            }
            false => core.response(*now, via.unwrap(), server_of(4), &mut payload).is_ok(),
        };
        let passed = if passed { format!("`{}`", hex(&payload)) } else { "none".to_owned() };
        writeln!(table, "| {what} | `{}` | {passed} |", hex(&sent)).unwrap();
    }
    table
}

/// PAS 8, by the table of the page.
fn translations() -> String {
    let ip_range = |router| Fields {
        nettype: Nettype::IpRange,
        ip_address: [172, 17, if router == 0 { 17 } else { 18 }, 0].into(),
        udp_port: NORMAL_PORT,
        router,
        ..Fields::UNUSED
    };
    let udp_range = Fields {
        nettype: Nettype::UdpRange,
        ip_address: [203, 0, 113, 5].into(),
        udp_port: 20000,
        use_password: true,
        router: 1,
        ..Fields::UNUSED
    };
    let rows = [(1, ip_range(0)), (2, ip_range(1)), (3, udp_range)];
    let rows = rows.map(|(id, row)| (IpNetId::new(id).unwrap(), row));
    let table = IpNetTable::new(NodeAddress::new(3).unwrap(), rows).unwrap();
    let mut text =
        "| net | node | method | sent to | next hop | password |\n|---|---|---|---|---|---|\n"
            .to_owned();
    for (net, node) in [(1, 4), (2, 4), (3, 4), (3, 125), (1, BNA), (2, BNA), (3, BNA), (4, 4)] {
        let to = Destination::try_from(node).unwrap();
        let way = table.translate(IpNetId::new(net).unwrap(), to);
        let told = match way {
            Ok(way) => format!(
                "{} | {}:{} | {} | {}",
                way.method.letter(),
                way.address,
                way.port,
                way.next_hop.map_or("–".to_owned(), |node| format!("node {node}")),
                if way.use_password { "yes" } else { "no" },
            ),
            Err(error) => format!("– | {error} | – | –"),
        };
        writeln!(text, "| {net} | {node} | {told} |").unwrap();
    }
    text
}

#[test]
fn the_vectors_are_those_of_the_code() {
    for (heading, right) in [
        ("Route formats", formats()),
        ("A server and its clients", exchanges()),
        ("A request in pieces", segments()),
        ("An adapter", adapter()),
        ("Translation", translations()),
    ] {
        let (_, section) = PAGE.split_once(&format!("## {heading}\n")).unwrap();
        let section = section.split("\n## ").next().unwrap();
        assert!(section.contains(&right), "the table under \"{heading}\" has to be:\n\n{right}");
    }
}
