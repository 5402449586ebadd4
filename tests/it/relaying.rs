//! Requests that may pass, and their answers: where they go, and that they stay what they are.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};

use serde_json::Value;

use crate::harness::{
    DEVICE, FIGURE_10, PASSWORD, Peer, SECOND, Settings, Site, close, datagram, exchange, pause,
    request, response,
};

#[test]
fn figure_10_reaches_its_node_and_the_answer_its_client() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let nodes = [1, 2, 3, 4, 33].map(|node_address| (node_address, site.node(node_address)));
    let client = site.client();

    let asked = datagram(&FIGURE_10, &[0x11, 0x22], PASSWORD);
    client.send(site.public(4), &asked);
    let from_relay = nodes[3].1.expect(&asked);
    nodes[3].1.send(from_relay, &response(4));
    assert_eq!(client.expect(&response(4)), site.public(4));

    for (node_address, node) in &nodes {
        assert_eq!(node.waiting(), None, "node {node_address} got nothing of it");
        exchange(&client, site.public(*node_address), node, *node_address);
    }
    relay.expect_drops(&[]);
    relay.finish();
}

/// from the smallest datagram over IP to the largest.
#[test]
fn the_smallest_and_the_largest_datagram_pass() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    let mut longest_route = [0x07; 30];
    (longest_route[1], longest_route[2]) = (4, 27);
    longest_route[28..].copy_from_slice(&[0x8B, 0x83]);
    let smallest = datagram(&[0x0B, 0x04, 0x8B, 0x83], &[], PASSWORD);
    let largest = datagram(&longest_route, &[0xA5; 63], PASSWORD);
    assert_eq!((smallest.len(), largest.len()), (18, 107));
    for octets in [smallest, largest] {
        client.send(site.public(4), &octets);
        let from_relay = node.expect(&octets);
        node.send(from_relay, &octets);
        client.expect(&octets);
    }
    relay.expect_drops(&[]);
    relay.finish();
}

/// N-1, RFC 4787 REQ-1 and REQ-3.
#[test]
fn two_clients_with_the_same_port_do_not_cross_talk() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let node = site.node(4);
    let first = site.client();
    let second = Peer::bind((site.address(253), first.address().port()).into());
    let clients = [first, second];

    let asked = |n| datagram(&FIGURE_10, &[n], PASSWORD);
    let ways_back: Vec<_> = (0..)
        .zip(&clients)
        .map(|(n, client)| {
            client.send(site.public(4), &asked(n));
            node.expect(&asked(n))
        })
        .collect();
    assert_ne!(ways_back[0], ways_back[1]);
    for n in [1, 0] {
        node.send(ways_back[usize::from(n)], &asked(n));
    }
    for (n, client) in (0..).zip(&clients) {
        assert_eq!(client.expect(&asked(n)), site.public(4));
        assert_eq!(client.waiting(), None);
    }
    relay.expect_drops(&[]);
    relay.finish();
}

/// a server's table of dynamic clients does not fill, whichever worker serves the client.
#[test]
fn a_client_that_polls_all_nodes_comes_from_one_port() {
    let site = Site::claim();
    let relay = site.relay(Settings { runtime: "workers = 2", ..Settings::default() });
    let nodes = [1, 2, 3, 4, 33].map(|node_address| (node_address, site.node(node_address)));
    let clients: Vec<_> = (0..12).map(|_| site.client()).collect();
    let poll = |client| {
        let mut ports: Vec<_> = nodes
            .iter()
            .map(|(node_address, node)| {
                exchange(client, site.public(*node_address), node, *node_address)
            })
            .collect();
        ports.dedup();
        assert_eq!(ports.len(), 1, "the relay's ports for one client");
        ports[0]
    };
    let first_round: Vec<_> = clients.iter().map(poll).collect();
    let second_round: Vec<_> = clients.iter().map(poll).collect();
    assert_eq!(first_round, second_round, "and they stay");
    let mut different = first_round;
    different.sort_unstable();
    different.dedup();
    assert_eq!(different.len(), clients.len(), "no two clients share one at a node");
    relay.finish();
}

/// N-7, RFC 4787 REQ-12, RFC 5508: the kernel answers for the closed port, and nobody minds.
#[test]
fn a_node_that_comes_back_is_reached_over_the_same_flow() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    let port = exchange(&client, site.public(4), &node, 4);
    let other = site.node(3);
    assert_eq!(exchange(&client, site.public(3), &other, 3), port);
    close(node);
    // Held, the relay finds all of them at once, and sends them in one go on one socket.
    relay.process.hold();
    for _ in 0..3 {
        client.send(site.public(3), &request(3));
        client.send(site.public(4), &request(4));
    }
    relay.process.go_on();
    for _ in 0..3 {
        other.expect(&request(3));
    }
    let node = site.node(4);
    assert_eq!(exchange(&client, site.public(4), &node, 4), port);
    assert_eq!(relay.at_rest().sum("pnet_nat_flows_opened_total", &[]), 2);
    relay.expect_drops(&[]);
    let log = relay.finish();
    assert_eq!(log.logged("cannot receive from the servers"), [] as [Value; 0]);
}

/// N-8, RFC 6888 REQ-11.
#[test]
fn a_full_flow_table_refuses_the_new_and_serves_the_old() {
    let site = Site::claim();
    let relay = site.relay(Settings { net: "max_flows = 2", ..Settings::default() });
    let node = site.node(4);
    let known = [site.client(), site.client()];
    for client in &known {
        exchange(client, site.public(4), &node, 4);
    }
    let new = site.client();
    new.send(site.public(4), &request(4));
    for client in &known {
        exchange(client, site.public(4), &node, 4);
    }
    assert_eq!(new.waiting(), None);
    relay.expect_drops(&[("request", "flow_limit", 1)]);
    let metrics = relay.at_rest();
    assert_eq!(metrics.sum("pnet_nat_flows", &[("net", "section-1")]), 2);
    assert_eq!(metrics.sum("pnet_nat_flow_limit", &[("net", "section-1")]), 2);
    relay.finish();
}

/// N-11, RFC 8085: whether a node is slow or silent is for the client to find out.
#[test]
fn nothing_is_repeated_and_nothing_answered_by_the_relay_itself() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    client.send(site.public(4), &request(4));
    let from_relay = node.expect(&request(4));
    pause(std::time::Duration::from_millis(2500)); // more than two of its ticks
    assert_eq!((node.waiting(), client.waiting()), (None, None));
    node.send(from_relay, &response(4));
    client.expect(&response(4));
    assert_eq!((node.waiting(), client.waiting()), (None, None));
    relay.finish();
}

#[test]
fn a_device_password_is_put_in_and_taken_out_again() {
    let site = Site::claim();
    let passwords = "[[udp_range_net.password]]\nname = \"service\"\nfile = \"secrets/section-1\"\n\
                     device_file = \"secrets/section-1-device\"";
    let relay = site.relay(Settings { passwords, ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    let asked = |password: &[u8]| datagram(&FIGURE_10, &[1, 2, 3], password);
    client.send(site.public(4), &asked(PASSWORD));
    let from_relay = node.expect(&asked(DEVICE));
    node.send(from_relay, &asked(DEVICE));
    client.expect(&asked(PASSWORD));

    // The clients' password is none of the server's, and the server's none of the clients'.
    node.send(from_relay, &asked(PASSWORD));
    client.send(site.public(4), &asked(DEVICE));
    client.send(site.public(4), &asked(PASSWORD));
    node.expect(&asked(DEVICE));
    node.send(from_relay, &asked(b""));
    client.expect(&asked(b"")); // A16
    relay.expect_drops(&[("request", "password_wrong", 1), ("response", "password_mismatch", 1)]);
    relay.finish();
}

/// Old and new password side by side, and a metric that tells when the old one can go.
#[test]
fn two_passwords_are_valid_and_counted_apart() {
    let site = Site::claim();
    let passwords = "[[udp_range_net.password]]\nname = \"old\"\nfile = \"secrets/section-1\"\n\
                     [[udp_range_net.password]]\nname = \"new\"\nfile = \"secrets/press\"";
    let relay = site.relay(Settings { passwords, ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    for password in [PASSWORD, SECOND, SECOND] {
        let octets = datagram(&FIGURE_10, &[], password);
        client.send(site.public(4), &octets);
        let from_relay = node.expect(&octets);
        node.send(from_relay, &octets);
        client.expect(&octets); // with the password of the latest request
    }
    let metrics = relay.at_rest();
    for (credential, count) in [("old", 1), ("new", 2)] {
        let labels = [("net", "section-1"), ("credential", credential)];
        assert_eq!(metrics.sum("pnet_nat_accepted_requests_total", &labels), count);
    }
    assert_eq!(metrics.sum("pnet_nat_flows", &[]), 1);
    relay.expect_drops(&[]);
    relay.finish();
}

/// A4: said by name in the configuration, and only then.
#[test]
fn a_net_may_take_requests_without_a_password() {
    let site = Site::claim();
    let net = "allow_without_password = true";
    let relay = site.relay(Settings { net, ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    let bare = datagram(&FIGURE_10, &[7], b"");
    client.send(site.public(4), &bare);
    let from_relay = node.expect(&bare);
    node.send(from_relay, &response(4)); // carries a password that nobody asked with
    node.send(from_relay, &bare);
    client.expect(&bare);
    exchange(&client, site.public(4), &node, 4);
    client.send(site.public(4), &datagram(&FIGURE_10, &[7], crate::harness::WRONG));
    exchange(&client, site.public(4), &node, 4);
    relay.expect_drops(&[("request", "password_wrong", 1), ("response", "password_mismatch", 1)]);
    relay.finish();
}

#[test]
fn a_single_server_is_reached_on_its_one_port() {
    let site = Site::claim();
    let server = format!(
        "[[server]]\nname = \"press\"\npublic_port = 20200\naddress = \"{}:34379\"\nnode = 7\n\
         allow = [\"{}/24\"]\n\
         [[server.password]]\nname = \"service\"\nfile = \"secrets/press\"",
        site.address(7),
        site.address(0)
    );
    let relay = site.relay(Settings { sections: &server, ..Settings::default() });
    let (client, press) = (site.client(), site.node(7));
    let mut route = FIGURE_10;
    route[1] = 7;
    let octets = datagram(&route, &[], SECOND);
    let public = SocketAddr::from((site.public_address(), 20200));
    client.send(public, &octets);
    let from_relay = press.expect(&octets);
    press.send(from_relay, &octets);
    assert_eq!(client.expect(&octets), public);

    client.send(public, &request(7));
    client.send(public, &datagram(&FIGURE_10, &[], SECOND));
    relay.expect_drops(&[("request", "password_wrong", 1), ("request", "node_mismatch", 1)]);
    assert_eq!(relay.at_rest().sum("pnet_nat_forwarded_datagrams_total", &[("net", "press")]), 2);
    relay.finish();
}

/// An answer leaves from the address that was asked, also where one socket has them all.
#[test]
fn a_relay_on_every_address_answers_from_the_one_that_was_asked() {
    let site = Site::claim();
    let start_port = free_start_port();
    let configuration = site.configuration(&Settings::default());
    let configuration = configuration
        .replace(&format!("listen = [\"{}\"]", site.public_address()), "listen = [\"0.0.0.0\"]")
        .replace(&format!("= {}", site.start_port()), &format!("= {start_port}"));
    let relay = crate::harness::Relay::start(&configuration, site.admin(), None);
    let (client, node) = (site.client(), site.node(4));
    let mut ports = Vec::new();
    for last in [200, 199, 198, 200] {
        let public = SocketAddr::from((site.address(last), start_port + 4));
        ports.push(exchange(&client, public, &node, 4));
    }
    assert_eq!(ports[0], ports[3]);
    assert_eq!(relay.at_rest().sum("pnet_nat_flows", &[]), 3, "one for each address");
    relay.finish();
}

/// Ports that are free on every address: other scenarios have theirs on some from 20000 on.
fn free_start_port() -> u16 {
    let free = |port: u16| UdpSocket::bind((Ipv4Addr::UNSPECIFIED, port)).map(close).is_ok();
    let mut blocks = (10_000..19_000).step_by(130);
    blocks.find(|start| [1, 2, 3, 4, 33].iter().all(|node| free(start + node))).unwrap()
}
