//! Who forges where his datagram comes from, with the right password: nothing reaches a node, and
//! nothing is used up.
//!
//! Needs root. The edge trusts every source here (`rp_filter` is off), as many routers do.

use std::fs;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, SocketAddrV6};

use serde_json::Value;

use crate::harness::{
    FIGURE_10, Network, Place, Relay, Settings, WRONG, datagram, eventually, exchange, request,
};

fn start(network: &Network, allow: &str) -> Relay {
    for interface in ["all", "eth0"] {
        fs::write(format!("/proc/sys/net/ipv4/conf/{interface}/rp_filter"), "0").unwrap();
    }
    let place = Place { allow, ..network.place(r#"["0.0.0.0", "::"]"#) };
    // One flow has room, and its client alone.
    let net = "max_flows = 1";
    place.relay(&Settings { net, runtime: "workers = 2", ..Settings::default() })
}

const UNANSWERABLE: [(&str, &str); 1] = [("reason", "unanswerable")];

/// The edge's own address on the link to the Internet, as seen from there.
fn of_the_link(network: &Network, port: u16) -> SocketAddr {
    let of_the_link = eventually("the edge has an address of the link", || {
        let addresses = fs::read_to_string("/proc/thread-self/net/if_inet6").unwrap();
        let mut lines = addresses.lines().filter(|line| line.ends_with(" eth0"));
        let line = lines.find(|line| line.starts_with("fe80"))?.to_owned();
        let tentative = line.split_whitespace().nth(4) == Some("40");
        (!tentative).then(|| u128::from_str_radix(&line[..32], 16).unwrap())
    });
    let scope = network.internet.enter(|| nix::net::if_::if_nametoindex("eth0").unwrap());
    SocketAddrV6::new(of_the_link.into(), port, 0, scope).into()
}

fn v4(address: SocketAddr) -> SocketAddrV4 {
    match address {
        SocketAddr::V4(address) => address,
        SocketAddr::V6(_) => unreachable!("{address}"),
    }
}

#[test]
fn sources_that_are_no_clients() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = start(&network, r#"["0.0.0.0/0", "::/0"]"#);
        let node = network.node(4);
        let public = network.public("198.51.100.1", 4);
        let forged = [
            "172.17.17.44:34379",   // a node that is not listed
            "172.17.17.3:34379",    // one that is
            "198.51.100.7:0",       // nothing can listen there
            "198.51.100.255:50000", // everybody on the Internet side
            "192.0.2.9:50000",      // no route leads there
        ];
        for from in forged {
            network.internet.forge(from.parse().unwrap(), v4(public), &request(4));
        }
        relay.expect_drops(&[("request", "source_not_allowed", 2), ("request", "unanswerable", 3)]);
        exchange(&network.client("198.51.100.7"), public, &node, 4);
        assert_eq!(node.waiting(), None);
        assert_eq!(relay.at_rest().sum("pnet_nat_flows_opened_total", &[]), 1);
        relay.finish();
    });
}

/// N-4: a client in the plant is let in by its subnet's name, or by a part of it.
#[test]
fn clients_in_a_plant_that_is_named() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = start(&network, r#"["0.0.0.0/0", "172.17.17.96/28"]"#);
        let node = network.node(4);
        let public = network.public("198.51.100.1", 4);
        network.node(3).send(public, &request(4));
        let client = network.plant.peer("172.17.17.100:0".parse().unwrap());
        exchange(&client, public, &node, 4);
        relay.expect_drops(&[("request", "source_not_allowed", 1)]);
        relay.finish();
    });
}

#[test]
fn clients_over_ipv6_that_no_answer_reaches() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        network.internet.ip("address add 2001:db8:9::7/64 dev eth0 nodad");
        let relay = start(&network, r#"["0.0.0.0/0", "::/0"]"#);
        let node = network.node(4);
        let public = network.public("2001:db8:1::1", 4);
        network.client("2001:db8:9::7").send(public, &request(4));
        let (client, of_the_link) =
            (network.client("2001:db8:1::7"), of_the_link(&network, public.port()));
        // Neighbours take a moment to find each other.
        eventually("both are refused", || {
            client.send(of_the_link, &request(4));
            let refused = relay.metrics().sum("pnet_nat_dropped_datagrams_total", &UNANSWERABLE);
            (refused >= 2).then_some(())
        });
        exchange(&client, public, &node, 4);
        assert_eq!(node.waiting(), None);
        assert_eq!(relay.at_rest().sum("pnet_nat_flows_opened_total", &[]), 1);
        relay.finish();
    });
}

/// A million senders, each with one wrong password. None of them is kept out by the kernel, so that the
/// relay sees all that its buffers have room for.
#[test]
fn a_million_senders_take_no_more_memory_than_the_first_ones() {
    const SENDERS: u32 = 1_000_000;
    const FIRST: u32 = SENDERS / 10;
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        for interface in ["all", "eth0"] {
            fs::write(format!("/proc/sys/net/ipv4/conf/{interface}/rp_filter"), "0").unwrap();
        }
        let place = Place { allow: r#"["0.0.0.0/0"]"#, ..network.place(r#"["198.51.100.1"]"#) };
        let sections = "[datapath]\nprefilter = \"off\"";
        let relay = place.relay(&Settings { sections, ..Settings::default() });
        let (client, node) = (network.client("198.51.100.7"), network.node(4));
        let public = network.public("198.51.100.1", 4);
        exchange(&client, public, &node, 4);

        let wrong = datagram(&FIGURE_10, &[], WRONG);
        let flood = |numbers: std::ops::Range<u32>| {
            let sender = |n: u32| SocketAddrV4::new(Ipv4Addr::from(0x0A00_0000 + n), 50_000);
            let sent = u64::from(numbers.end);
            network.internet.forge_all(numbers.map(sender), v4(public), &wrong);
            let metrics = eventually("all are judged, or did not fit into the buffer", || {
                let metrics = relay.metrics();
                let full = metrics.sum("pnet_nat_kernel_dropped_datagrams_total", &[]);
                (metrics.drops().values().sum::<u64>() + full == sent).then_some(metrics)
            });
            exchange(&client, public, &node, 4);
            (relay.process.resident(), metrics.drops().values().sum::<u64>())
        };
        let (early, _) = flood(0..FIRST);
        let (late, judged) = flood(FIRST..SENDERS);
        println!("{early} octets, and {late} after all");
        assert!(late <= early + (256 << 10), "it grows: {early}, {late}");
        assert!(judged > u64::from(FIRST), "most were lost on the way: {judged}");
        let count = |path: &str, list: &str| {
            let answer: Value = serde_json::from_str(&relay.get(path).unwrap().1).unwrap();
            (answer[list].as_array().unwrap().len(), answer["not_listed"].as_u64())
        };
        let (listed, not_listed) = count("/api/v1/refused", "refused");
        assert!(listed < 1000 && not_listed > Some(judged - 10_000), "{listed} {not_listed:?}");
        assert!(count("/api/v1/events", "events").0 < 300);
        relay.finish();
    });
}
