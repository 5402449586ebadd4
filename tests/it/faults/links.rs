//! Addresses that go away and come back, and lines that lose, repeat and reorder datagrams.

use std::net::IpAddr;
use std::time::Duration;

use super::Sections;
use crate::harness::{
    FIGURE_10, Network, PASSWORD, Peer, Settings, datagram, eventually, exchange, has_nft, request,
    response,
};

/// The router gets another address in the plant, as by DHCP: flows go on from there.
#[test]
fn an_address_towards_the_plant_that_changes() {
    Sections::scenario(|sections| {
        let port = sections.exchange_with_section_1();
        let edge = &sections.network.edge;
        edge.ip("address delete 172.17.17.254/24 dev eth1");
        let failed = sections.way_is_gone();
        sections.only_section_1_is_hurt(30);
        sections.relay.expect_drops(&[("request", "send_failed", failed + 30)]);

        edge.ip("address add 172.17.17.253/24 dev eth1");
        sections.client.send(sections.section_1(), &request(4));
        let from_relay = sections.node.expect(&request(4));
        assert_eq!(from_relay.to_string(), format!("172.17.17.253:{port}"));
        sections.node.send(from_relay, &response(4));
        sections.client.expect(&response(4));
        sections.all_is_well_again(port);
    });
}

/// Whether the relay listens on each address or on all: only who uses that one is hurt.
#[test]
fn a_public_address_that_goes_away_and_comes_back() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let each = r#"["198.51.100.1", "203.0.113.1", "2001:db8:1::1", "2001:db8:2::1"]"#;
        for listen in [each, r#"["0.0.0.0", "::"]"#] {
            let relay = network.place(listen).relay(&Settings::default());
            let node = network.node(4);
            let mut lost = 0;
            for (address, hurt, others) in [
                ("198.51.100.1/24 dev eth0", "198.51.100", "203.0.113"),
                ("2001:db8:1::1/64 dev eth0 nodad", "2001:db8:1:", "2001:db8:2:"),
            ] {
                let dot = if hurt.contains(':') { ":" } else { "." };
                let end = |net, last| {
                    (network.client(&format!("{net}{dot}7")), format!("{net}{dot}{last}"))
                };
                let ((client, public), (other, others)) = (end(hurt, 1), end(others, 1));
                let (public, others) = (network.public(&public, 4), network.public(&others, 4));
                let port = exchange(&client, public, &node, 4);
                exchange(&other, others, &node, 4);
                client.send(public, &request(4));
                let from_relay = node.expect(&request(4));

                network.edge.ip(&format!("address delete {address}"));
                for _ in 0..10 {
                    node.send(from_relay, &response(4));
                    exchange(&other, others, &node, 4);
                }
                lost += 10;
                relay.expect_drops(&[("response", "send_failed", lost)]);

                network.edge.ip(&format!("address add {address}"));
                reached_again(&network, client.address().ip(), public.ip());
                assert_eq!(exchange(&client, public, &node, 4), port);
                exchange(&other, others, &node, 4);
            }
            assert_eq!(relay.at_rest().sum("pnet_nat_flows_opened_total", &[]), 4);
            relay.finish();
        }
    });
}

/// Waits until both ends have found each other on the link: meanwhile the kernel may lose a datagram
/// of whoever is in a hurry, and on a busy machine it does.
fn reached_again(network: &Network, client: IpAddr, public: IpAddr) {
    let there = network.edge.peer((public, 0).into());
    let here = network.client(&client.to_string());
    let pause = Duration::from_millis(100);
    eventually("the address is reached", || {
        here.send(there.address(), b"?");
        let (_, from) = there.receive_within(pause)?;
        there.send(from, b"!");
        here.receive_within(pause)
    });
}

/// What the lines do to every so many-th datagram: rules of the kernel's packet filter, which count
/// where a random choice would only make it likely. Class 1:2 of each line is a slow lane.
#[derive(Clone, Copy)]
struct Lines<'a> {
    internet: &'a str,
    edge: &'a str,
    plant: &'a str,
}

/// The numbers of the requests that came to the node and of the responses that came to the client,
/// in the order they did.
struct Passed {
    to_node: Vec<u16>,
    to_client: Vec<u16>,
}

/// Sends numbered requests to node 4 and has it answer each that comes. So many have to come to the
/// relay, to the node, to the relay again, and to the client. Meanwhile somebody else talks to node 3
/// over the same lines, which do nothing to him: he has each answer at once.
fn pass(lines: Lines<'_>, requests: u16, expected: [usize; 4]) -> Option<Passed> {
    let [to_relay, to_node, from_node, to_client] = expected;
    let network = Network::build().filter(|_| has_nft())?;
    let mut passed = Passed { to_node: Vec::new(), to_client: Vec::new() };
    network.at_the_edge(|| {
        // Flows in the kernel do not meet the edge's packet filter, which stands for the lines here.
        let sections = "[datapath]\nkernel = \"off\"";
        let place = network.place(r#"["0.0.0.0"]"#);
        let relay = place.relay(&Settings { sections, ..Settings::default() });
        let (client, node) = (network.client("198.51.100.7"), network.node(4));
        let public = network.public("198.51.100.1", 4);
        let (bystander, node_3) = (network.client("198.51.100.8"), network.node(3));
        let public_3 = network.public("198.51.100.1", 3);
        let from_relay = exchange(&client, public, &node, 4);
        network.internet.nft(lines.internet);
        network.edge.nft(lines.edge);
        network.plant.nft(lines.plant);
        let ends = [(&network.internet, "eth0"), (&network.plant, "eth0")];
        for (namespace, device) in
            ends.into_iter().chain(["eth0", "eth1"].map(|d| (&network.edge, d)))
        {
            namespace.tc(&format!(
                "qdisc add dev {device} root handle 1: htb default 1
                 class add dev {device} parent 1: classid 1:1 htb rate 1gbit quantum 1500
                 class add dev {device} parent 1: classid 1:2 htb rate 100kbit quantum 1500 \
                 burst 100 cburst 100"
            ));
        }

        let numbered = |n: u16| datagram(&FIGURE_10, &n.to_be_bytes(), PASSWORD);
        let number = |octets: &[u8]| u16::from_be_bytes(*octets[14..].first_chunk().unwrap());
        let take = |peer: &Peer, list: &mut Vec<u16>| {
            let (octets, from) = peer.receive();
            let n = number(&octets);
            assert_eq!(octets, numbered(n), "octet for octet");
            list.push(n);
            from
        };
        for n in 0..requests {
            client.send(public, &numbered(n));
            exchange(&bystander, public_3, &node_3, 3);
        }
        for _ in 0..to_node {
            let relay = take(&node, &mut passed.to_node);
            assert_eq!(relay.port(), from_relay);
            node.send(relay, &numbered(*passed.to_node.last().unwrap()));
        }
        for _ in 0..to_client {
            assert_eq!(take(&client, &mut passed.to_client), public);
        }
        relay.expect_drops(&[]);
        let metrics = relay.at_rest();
        for (direction, datagrams) in [("request", to_relay), ("response", from_node)] {
            let labels = [("node", "4"), ("direction", direction)];
            let received = metrics.sum("pnet_nat_received_datagrams_total", &labels);
            assert_eq!(received as usize, datagrams + 1, "{direction}s, and the first exchange");
            let of_bystander = [("node", "3"), ("direction", direction)];
            let received = metrics.sum("pnet_nat_received_datagrams_total", &of_bystander);
            assert_eq!(received, u64::from(requests), "{direction}s of the bystander");
        }
        assert_eq!((node.waiting(), client.waiting()), (None, None));
        relay.finish();
    });
    Some(passed)
}

/// Of 100 requests every fifth is lost before the edge, then every fourth in the plant, and the same
/// of the responses. The relay passes on what comes, and makes up for nothing.
#[test]
fn lines_that_lose() {
    let lines = Lines {
        internet: "table inet line { chain in { type filter hook prerouting priority raw;
            udp sport 20004 numgen inc mod 4 0 drop; }; }",
        edge: "table inet line { chain in { type filter hook prerouting priority raw;
            udp dport 20004 numgen inc mod 5 0 drop;
            ip saddr 172.17.17.4 udp sport 34379 numgen inc mod 5 0 drop; }; }",
        plant: "table inet line { chain in { type filter hook prerouting priority raw;
            ip daddr 172.17.17.4 udp dport 34379 numgen inc mod 4 0 drop; }; }",
    };
    let Some(passed) = pass(lines, 100, [80, 60, 48, 36]) else { return };
    assert!(passed.to_node.is_sorted() && passed.to_client.is_sorted());
}

/// Each line carries every datagram twice: the relay passes on each copy once.
#[test]
fn lines_that_repeat() {
    let twice = |what: &str, to: &str| {
        format!(
            "table ip line {{ chain twice {{ type filter hook postrouting priority 0;
                {what} dup to {to}; }}; }}\n"
        )
    };
    let to_node = "ip daddr 172.17.17.4 udp dport 34379";
    let from_node = "ip saddr 172.17.17.4 udp sport 34379";
    let edge = twice(to_node, "172.17.17.4") + &twice("udp sport 20004", "198.51.100.7");
    let lines = Lines {
        internet: &twice("udp dport 20004", "198.51.100.1"),
        edge: &edge,
        plant: &twice(from_node, "172.17.17.254"),
    };
    let Some(passed) = pass(lines, 15, [30, 60, 120, 240]) else { return };
    for (list, copies) in [(&passed.to_node, 4), (&passed.to_client, 16)] {
        let count = |n| list.iter().filter(|&&came| came == n).count();
        assert!((0..15).all(|n| count(n) == copies), "{list:?}");
    }
}

/// On each line every third datagram takes a slow lane, and the others overtake it.
#[test]
fn lines_that_reorder() {
    let slow = |what: &str| {
        format!(
            "table inet line {{ chain slow {{ type filter hook postrouting priority 0;
                {what} numgen inc mod 3 0 meta priority set \"1:2\"; }}; }}"
        )
    };
    let to_node = slow("ip daddr 172.17.17.4 udp dport 34379");
    let from_node = slow("ip saddr 172.17.17.4 udp sport 34379");
    let edge = to_node + "\n" + &slow("udp sport 20004");
    let lines = Lines { internet: &slow("udp dport 20004"), edge: &edge, plant: &from_node };
    let Some(mut passed) = pass(lines, 100, [100; 4]) else { return };
    for list in [&mut passed.to_node, &mut passed.to_client] {
        assert!(!list.is_sorted(), "nothing was overtaken: {list:?}");
        list.sort_unstable();
        assert!(list.iter().copied().eq(0..100));
    }
}
