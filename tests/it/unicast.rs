//! What was sent to a broadcast or multicast address: others may have it too, so nobody carries it
//! out.
//!
//! Needs root, for network namespaces.

use std::net::{IpAddr, Ipv6Addr, SocketAddr, SocketAddrV6};

use nix::net::if_::if_nametoindex;

use crate::harness::{Network, Peer, Relay, Settings, exchange, request};

const KERNEL: &str = "pnet_nat_kernel_dropped_datagrams_total";

fn start(network: &Network, listen: &str, prefilter: &str) -> Relay {
    let runtime = "workers = 2\ndrain = \"100ms\"";
    let sections = &format!("[datapath]\nprefilter = \"{prefilter}\"");
    network.place(listen).relay(&Settings { runtime, sections, ..Settings::default() })
}

/// A sender and where to, with whether the address alone tells that it is nobody's.
fn ways(network: &Network) -> [(Peer, SocketAddr, bool); 5] {
    let v4 = |to| network.public(to, 4);
    let index = network.internet.enter(|| if_nametoindex("eth0")).unwrap();
    let all_nodes: Ipv6Addr = "ff02::1".parse().unwrap();
    let all_nodes = SocketAddrV6::new(all_nodes, v4("0.0.0.0").port(), 0, index);
    let inside = network.edge.peer("127.0.0.1:0".parse().unwrap());
    [
        (network.client("203.0.113.7"), v4("203.0.113.255"), false),
        (network.client("203.0.113.7"), v4("255.255.255.255"), true),
        (network.client("198.51.100.7"), v4("224.0.0.1"), true),
        (network.client("2001:db8:1::7"), all_nodes.into(), true),
        (inside, v4("127.255.255.255"), false),
    ]
}

#[test]
fn a_broadcast_reaches_no_node() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        for prefilter in ["auto", "always"] {
            let relay = start(&network, r#"["0.0.0.0", "::"]"#, prefilter);
            let node = network.node(4);
            let inside = network.plant.capture();
            let (mut worker, mut kernel) = (0, 0);
            for (client, to, by_address) in ways(&network) {
                client.send(to, &request(4));
                // Each worker's socket gets its own.
                let by =
                    if by_address && prefilter == "always" { &mut kernel } else { &mut worker };
                *by += 2;
                relay.expect_drops(&[("request", "not_unicast", worker)]);
                assert_eq!(relay.metrics().sum(KERNEL, &[("cause", "prefilter")]), kernel);
            }
            assert_eq!(inside.end(), []);
            for address in ["203.0.113.1", "127.0.0.1", "2001:db8:1::1"] {
                let from = if address == "127.0.0.1" { &network.edge } else { &network.internet };
                let client = from.peer(match address {
                    "2001:db8:1::1" => "[2001:db8:1::7]:0".parse().unwrap(),
                    "127.0.0.1" => "127.0.0.1:0".parse().unwrap(),
                    _ => "203.0.113.7:0".parse().unwrap(),
                });
                exchange(&client, network.public(address, 4), &node, 4);
            }
            relay.finish();
        }
    });
}

/// A socket of one address gets what was sent to that one.
#[test]
fn a_broadcast_does_not_arrive_at_a_named_address() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = start(&network, r#"["203.0.113.1", "2001:db8:1::1"]"#, "off");
        let node = network.node(4);
        for (client, to, _) in ways(&network) {
            client.send(to, &request(4));
        }
        for (from, to) in [("203.0.113.7", "203.0.113.1"), ("2001:db8:1::7", "2001:db8:1::1")] {
            exchange(&network.client(from), network.public(to, 4), &node, 4);
        }
        let received = [("direction", "request")];
        assert_eq!(relay.at_rest().sum("pnet_nat_received_datagrams_total", &received), 2);
        relay.expect_drops(&[]);
        relay.finish();
    });
}

/// Towards the plant: a broadcast is no answer, and what goes to a group does not even arrive.
#[test]
fn a_broadcast_in_the_plant_is_a_stray() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = start(&network, r#"["0.0.0.0"]"#, "auto");
        let (client, node) = (network.client("203.0.113.7"), network.node(4));
        let port = exchange(&client, network.public("203.0.113.1", 4), &node, 4);
        let other = network.plant.peer("172.17.17.100:34379".parse().unwrap());
        for group in ["224.0.0.1", "172.17.17.255"] {
            other.send((group.parse::<IpAddr>().unwrap(), port).into(), &request(4));
        }
        relay.expect_drops(&[("response", "unknown_flow", 1)]);
        assert_eq!(client.waiting(), None);
        relay.finish();
    });
}
