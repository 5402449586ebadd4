//! The relay where it belongs: between two networks that only it connects.
//!
//! Needs root. The scenarios run at the edge; servers and clients are sockets in the plant and on
//! the Internet, or processes there.

use std::fs;
use std::net::SocketAddr;
use std::time::Duration;

use nix::sys::signal::Signal;

use crate::harness::{
    ANNOTATED, FIGURE_10, Network, PASSWORD, Packet, Peer, Process, Relay, Settings, WRONG, close,
    datagram, eventually, exchange, folder, pnet_nat, request, response,
};

fn start_annotated(network: &Network) -> Relay {
    Relay::start(ANNOTATED, network.place("").admin, None)
}

fn start(network: &Network, listen: &str) -> Relay {
    start_with(network, listen, "")
}

fn start_with(network: &Network, listen: &str, sections: &str) -> Relay {
    let runtime = "workers = 2\ndrain = \"100ms\"";
    network.place(listen).relay(&Settings { runtime, sections, ..Settings::default() })
}

/// Two uplinks: with the rule that docs/operations.md has, an answer leaves by the uplink whose address was
/// asked. The default route leads to a gateway that is not there, so nothing comes by that one.
#[test]
fn an_answer_leaves_by_the_uplink_of_its_request() {
    let Some(network) = Network::build() else { return };
    let (internet, edge) = (&network.internet, &network.edge);
    internet.ip(&format!("link add wan1 type veth peer name wan1 netns {}", edge.name()));
    internet.ip("link set wan1 up
         address add 192.0.2.1/24 dev wan1
         address add 100.64.0.7/32 dev lo");
    edge.ip("link set wan1 up
         address add 192.0.2.5/24 dev wan1
         route add default via 198.51.100.99 dev eth0");
    for listen in [r#"["198.51.100.1", "192.0.2.5"]"#, r#"["0.0.0.0"]"#] {
        network.at_the_edge(|| {
            for interface in ["all", "wan1"] {
                let switch = format!("/proc/sys/net/ipv4/conf/{interface}/rp_filter");
                fs::write(switch, "0").unwrap();
            }
            let relay = start(&network, listen);
            let (client, node) = (network.client("100.64.0.7"), network.node(4));
            let public = network.public("192.0.2.5", 4);
            client.send(public, &request(4));
            let from_relay = node.expect(&request(4));
            node.send(from_relay, &response(4));
            let lost = client.receive_within(Duration::from_millis(500));
            assert_eq!(lost, None, "it left by the default route");

            let commands = "route add default via 192.0.2.1 dev wan1 table 101
                rule add from 192.0.2.5 lookup 101";
            edge.ip(commands);
            exchange(&client, public, &node, 4);
            edge.ip("rule delete from 192.0.2.5 lookup 101\nroute flush table 101");
            relay.finish();
        });
    }
}

/// R-8, R-10, R-11, N-5, RFC 4787 REQ-10: both sides captured and compared.
#[test]
fn figure_10_crosses_the_edge_unchanged() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = start_annotated(&network);
        let node = network.node(4);
        let client = network.client("198.51.100.7");
        let (outside, inside) = (network.internet.capture(), network.plant.capture());

        let asked = datagram(&FIGURE_10, &[], PASSWORD);
        let public = network.public("198.51.100.1", 4);
        client.send(public, &asked);
        let from_relay = node.expect(&asked);
        node.send(from_relay, &response(4));
        assert_eq!(client.expect(&response(4)), public);

        let (outside, inside) = (outside.end(), inside.end());
        let udp = |from: SocketAddr, to: SocketAddr, octets: &[u8]| Packet::Udp {
            from,
            to,
            octets: octets.to_vec(),
        };
        let (client, node, answer) = (client.address(), node.address(), response(4));
        assert_eq!(outside, [udp(client, public, &asked), udp(public, client, &answer)]);
        assert_eq!(inside, [udp(from_relay, node, &asked), udp(node, from_relay, &answer)]);
        assert_eq!(from_relay.ip().to_string(), "172.17.17.254");

        relay.expect_drops(&[]);
        relay.finish();
    });
}

/// RFC 6864, 4.1: no datagram is cut, whatever is claimed about the length that a way takes.
#[test]
fn the_longest_datagrams_stay_whole() {
    let Some(network) = Network::build() else { return };
    network.edge.ip("
        route change 198.51.100.0/24 dev eth0 src 198.51.100.1 mtu 100
        route change 172.17.17.0/24 dev eth1 src 172.17.17.254 mtu 100");
    network.at_the_edge(|| {
        for listen in [r#"["0.0.0.0"]"#, r#"["198.51.100.1"]"#] {
            let relay = start(&network, listen);
            let (client, node) = (network.client("198.51.100.7"), network.node(4));
            let (outside, inside) = (network.internet.capture(), network.plant.capture());
            let asked = datagram(&FIGURE_10, &[7; 63], PASSWORD);
            for _ in 0..2 {
                client.send(network.public("198.51.100.1", 4), &asked);
                let from_relay = node.expect(&asked);
                node.send(from_relay, &asked);
                client.expect(&asked);
            }
            for packets in [outside.end(), inside.end()] {
                assert_eq!(packets.iter().map(Packet::octets).collect::<Vec<_>>(), [&asked[..]; 4]);
            }
            relay.expect_drops(&[]);
            relay.finish();
        }
    });
}

/// N-1, N-5: `pnet-nat request` on the Internet, `pnet-nat run` at the edge, `pnet-nat node` in the
/// plant.
#[test]
fn three_processes_in_three_networks() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = start_annotated(&network);
        let folder = folder("");
        let password = folder.path().join("secrets/section-1");
        let password = password.to_str().unwrap();
        let (outside, inside) = (network.internet.capture(), network.plant.capture());

        let mut nodes = network.plant.enter(|| {
            let listen = "172.17.17.1-4,172.17.17.33";
            Process::start(pnet_nat(&["node", "--listen", listen, "--password-file", password]))
        });
        eventually("the nodes are there", || (nodes.stdout().lines().count() == 5).then_some(()));
        let ask = || {
            let arguments = [
                &["request", "--to", "198.51.100.1", "--start-port", "20000"][..],
                &["--node", "1-4,33", "--count", "20", "--interval", "1ms", "--timeout", "20s"],
                &["--password-file", password],
            ];
            network.internet.enter(|| Process::start(pnet_nat(&arguments.concat())))
        };
        for mut client in [ask(), ask()] {
            assert_eq!(client.end(), Some(0), "{}", client.stdout());
            assert!(client.stdout().contains("sent 100, answered 100, lost 0"));
        }
        nodes.signal(Signal::SIGTERM);
        assert_eq!(nodes.end(), Some(0));

        let octets = |capture: Vec<Packet>| {
            let mut all: Vec<_> = capture.iter().map(|packet| packet.octets().to_vec()).collect();
            all.sort_unstable(); // two clients at once: the order is theirs
            all
        };
        let (outside, inside) = (octets(outside.end()), octets(inside.end()));
        assert_eq!(outside.len(), 400);
        assert_eq!(outside, inside);
        relay.expect_drops(&[]);
        relay.finish();
    });
}

/// N-1, R-41 and the reply address: IPv4 and IPv6, the same client port again and again.
#[test]
fn an_answer_leaves_from_the_address_that_was_asked() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let each = r#"["198.51.100.1", "203.0.113.1", "2001:db8:1::1", "2001:db8:2::1"]"#;
        for listen in [r#"["0.0.0.0", "::"]"#, each] {
            let relay = start(&network, listen);
            let nodes = [1, 4, 33].map(|node_address| (node_address, network.node(node_address)));
            let ways = [
                ("198.51.100.7:50000", "198.51.100.1"),
                ("198.51.100.8:50000", "198.51.100.1"),
                ("203.0.113.7:50000", "203.0.113.1"),
                ("198.51.100.7:50000", "203.0.113.1"), // routing would pick another address
                ("[2001:db8:1::7]:50000", "2001:db8:1::1"),
                ("[2001:db8:2::7]:50000", "2001:db8:2::1"),
                ("[2001:db8:1::7]:50000", "2001:db8:2::1"),
            ];
            let mut ports = Vec::new();
            for (from, to) in ways {
                let client = network.internet.peer(from.parse().unwrap());
                for _ in 0..2 {
                    for (node_address, node) in &nodes {
                        let port = exchange(
                            &client,
                            network.public(to, *node_address),
                            node,
                            *node_address,
                        );
                        ports.push(((from, to), port));
                    }
                }
            }
            ports.sort_unstable();
            ports.dedup();
            assert_eq!(ports.len(), ways.len(), "R-41: one port a client and public address");
            relay.expect_drops(&[]);
            relay.finish();
        }
    });
}

/// N-4, RFC 4787 REQ-9: a client inside the plant uses the public address all the same.
#[test]
fn a_client_in_the_plant_reaches_the_public_address() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = start(&network, r#"["0.0.0.0"]"#);
        let node = network.node(4);
        let client = network.plant.peer("172.17.17.100:0".parse().unwrap());
        for address in ["198.51.100.1", "203.0.113.1"] {
            exchange(&client, network.public(address, 4), &node, 4);
        }
        relay.expect_drops(&[]);
        relay.finish();
    });
}

/// N-7, RFC 4787 REQ-12, RFC 5508: ICMP neither closes a flow nor fails the next send.
#[test]
fn a_node_that_was_down_is_reached_again() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = start(&network, r#"["0.0.0.0"]"#);
        let (client, node) = (network.client("198.51.100.7"), network.node(4));
        let public = network.public("198.51.100.1", 4);
        let port = exchange(&client, public, &node, 4);
        let server = node.address();
        network.plant.enter(|| close(node));
        let (outside, inside) = (network.internet.capture(), network.plant.capture());
        client.send(public, &request(4));
        let refusal =
            Packet::PortUnreachable { from: server.ip(), to: "172.17.17.254".parse().unwrap() };
        eventually("ICMP is seen", || inside.so_far().contains(&refusal).then_some(()));

        let node = network.plant.peer(server);
        assert_eq!(exchange(&client, public, &node, 4), port);
        assert_eq!(outside.end().len(), 3, "nothing but three datagrams on the Internet side");
        let metrics = relay.at_rest();
        assert_eq!(metrics.sum("pnet_nat_flows_opened_total", &[]), 1);
        assert_eq!(metrics.sum("pnet_nat_forwarded_datagrams_total", &[]), 5);
        relay.expect_drops(&[]);
        relay.finish();
    });
}

/// N-11, RFC 8085: captured on both sides, a flood from strangers causes nothing at all, whether
/// the kernel or the worker refuses it.
#[test]
fn a_flood_causes_no_packet_on_either_side() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        for prefilter in ["off", "auto", "always"] {
            let limits = format!("[datapath]\nprefilter = \"{prefilter}\"");
            let relay = start_with(&network, r#"["0.0.0.0", "::"]"#, &limits);
            let (client, node) = (network.client("198.51.100.7"), network.node(4));
            let (outside, inside) = (network.internet.capture(), network.plant.capture());
            let sent = flood(&network, &relay);
            let from_relay = exchange(&client, network.public("198.51.100.1", 4), &node, 4);

            let (outside, inside) = (outside.end(), inside.end());
            assert_eq!(outside.len() as u64, sent + 2, "what strangers sent, and one exchange");
            let octets = |packets: &[Packet]| -> Vec<_> {
                packets.iter().map(|packet| packet.octets().to_vec()).collect()
            };
            assert_eq!(octets(&outside[sent as usize..]), [request(4), response(4)]);
            assert_eq!(octets(&inside), [request(4), response(4)]);
            assert!(matches!(&inside[0], Packet::Udp { from, .. } if from.port() == from_relay));

            let metrics = relay.at_rest();
            let refused = metrics.sum("pnet_nat_kernel_dropped_datagrams_total", &[]);
            assert_eq!(metrics.drops().values().sum::<u64>() + refused, sent);
            assert_eq!(refused > 0, prefilter != "off");
            assert_eq!(metrics.sum("pnet_nat_flows_opened_total", &[]), 1);
            relay.finish();
        }
    });
}

/// Wrong passwords and garbage for node 4, over IPv4 and IPv6; tells how many were sent.
fn flood(network: &Network, relay: &Relay) -> u64 {
    let kinds = [
        datagram(&FIGURE_10, &[1, 2, 3], WRONG),
        datagram(&FIGURE_10, &[1, 2, 3], b""),
        request(3), // a good password in a request for another node
        datagram(&[0x04, 0x9F], &[], &[0; 40]),
        vec![0xFF; 1400],
        vec![],
    ];
    let mut sent = 0;
    for (from, to) in [("198.51.100.8", "198.51.100.1"), ("2001:db8:1::7", "2001:db8:1::1")] {
        let stranger = network.client(from);
        for octets in kinds.iter().cycle().take(1500) {
            stranger.send(network.public(to, 4), octets);
            sent += 1;
            if sent % 100 == 0 {
                // Not faster than they are taken: no buffer is to overflow.
                eventually("they are taken or refused", || {
                    let metrics = relay.metrics();
                    let labels = [("node", "4"), ("direction", "request")];
                    let taken = metrics.sum("pnet_nat_received_datagrams_total", &labels);
                    let refused = metrics.sum("pnet_nat_kernel_dropped_datagrams_total", &[]);
                    (taken + refused == sent).then_some(())
                });
            }
        }
        assert_eq!(stranger.waiting(), None);
    }
    sent
}

/// R-11: nobody listens where the broadcast addresses would be; the host itself says so.
#[test]
fn nothing_listens_at_the_broadcast_addresses() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = start_annotated(&network);
        let client = network.client("198.51.100.7");
        let (outside, inside) = (network.internet.capture(), network.plant.capture());
        for node_address in [126, 127] {
            client.send(network.public("198.51.100.1", node_address), &request(node_address));
        }
        eventually("the host refuses both", || {
            let refused = |packet: &&Packet| matches!(packet, Packet::PortUnreachable { .. });
            (outside.so_far().iter().filter(refused).count() == 2).then_some(())
        });
        assert_eq!(inside.end(), []);
        relay.expect_drops(&[]);
        relay.finish();
    });
}

/// A cable that is out is counted, and in again forgotten: on the plant's side, then on the other.
#[test]
fn a_network_that_was_gone_is_used_again() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = start(&network, r#"["0.0.0.0"]"#);
        let (client, node) = (network.client("198.51.100.7"), network.node(4));
        let public = network.public("198.51.100.1", 4);
        exchange(&client, public, &node, 4);

        network.edge.ip("link set eth1 down");
        client.send(public, &request(4));
        client.send(public, &request(4));
        relay.expect_drops(&[("request", "send_failed", 2)]);
        network.edge.ip("link set eth1 up");
        exchange(&client, public, &node, 4);

        client.send(public, &request(4));
        let from_relay = node.expect(&request(4));
        network.edge.ip("link set eth0 down");
        node.send(from_relay, &response(4));
        relay.expect_drops(&[("request", "send_failed", 2), ("response", "send_failed", 1)]);
        network.edge.ip("link set eth0 up");
        exchange(&client, public, &node, 4);

        assert_eq!(relay.at_rest().sum("pnet_nat_flows_opened_total", &[]), 1);
        let log = relay.finish();
        let complaints =
            log.log().filter(|line| line["message"].as_str().unwrap().contains("cannot send"));
        assert_eq!(complaints.count(), 2, "one line for each direction: {}", log.stderr());
    });
}

/// A source that is not allowed comes no further than the edge, whatever it knows.
#[test]
fn only_allowed_networks_come_in() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = start_annotated(&network);
        let (allowed, stranger) = (network.client("198.51.100.7"), network.client("203.0.113.7"));
        let node = network.node(4);
        let inside = network.plant.capture();
        send_and_expect_silence(&stranger, network.public("203.0.113.1", 4), &relay);
        exchange(&allowed, network.public("203.0.113.1", 4), &node, 4);
        assert_eq!(inside.end().len(), 2);
        assert_eq!(stranger.waiting(), None);
        relay.finish();
    });
}

fn send_and_expect_silence(stranger: &Peer, public: SocketAddr, relay: &Relay) {
    stranger.send(public, &request(4));
    relay.expect_drops(&[("request", "source_not_allowed", 1)]);
    assert_eq!(stranger.waiting(), None);
}
