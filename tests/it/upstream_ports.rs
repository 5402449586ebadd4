//! Which ports the relay has towards the servers: those that the host lends, at random, but never
//! one of a block of the NAT table.
//!
//! Needs root: each scenario has a host of its own, which lends other ports than this one.

use std::collections::BTreeSet;
use std::fs;
use std::net::{Ipv4Addr, UdpSocket};

use serde_json::Value;

use crate::harness::{Network, Peer, Relay, Settings, exchange, request};

/// What the host of the calling thread lends: `net.ipv4.ip_local_port_range` and
/// `ip_local_reserved_ports`.
fn lend(range: &str, reserved: &str) {
    fs::write("/proc/sys/net/ipv4/ip_local_port_range", range).unwrap();
    fs::write("/proc/sys/net/ipv4/ip_local_reserved_ports", reserved).unwrap();
}

/// Single servers: on the Internet's side of the edge, for there is IPv6.
const SERVERS: &str = r#"
[[server]]
name = "press"
public_port = 20150
address = "[2001:db8:1::7]:34379"
node = 7
allow = ["0.0.0.0/0"]
[[server.password]]
name = "service"
file = "secrets/section-1"
"#;

fn start(network: &Network, settings: Settings<'_>) -> Relay {
    network.place(r#"["198.51.100.1"]"#).relay(&settings)
}

/// So many clients ask this node, each over a port of its own.
fn ports(network: &Network, clients: usize, node: &Peer) -> BTreeSet<u16> {
    let public = network.public("198.51.100.1", 4);
    let clients: Vec<_> = (0..clients).map(|_| network.client("198.51.100.7")).collect();
    clients.iter().map(|client| exchange(client, public, node, 4)).collect()
}

/// Also after a reload to nodes whose ports were nobody's before; what was open stays open.
#[test]
fn upstream_ports_are_of_those_that_the_host_lends_and_outside_all_blocks() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        lend("20000 20199", "20130-20139,20141");
        let settings = Settings { sections: SERVERS, ..Settings::default() };
        let relay = start(&network, settings.clone());
        let node = network.node(4);
        let ports = ports(&network, 40, &node);
        assert_eq!(ports.len(), 40);
        let may_have = |port: &u16| {
            (20128..=20199).contains(port)
                && ![20141, 20150].contains(port)
                && !(20130..=20139).contains(port)
        };
        assert!(ports.iter().all(may_have), "{ports:?}");

        let press = network.internet.peer("[2001:db8:1::7]:34379".parse().unwrap());
        for _ in 0..10 {
            let client = network.client("198.51.100.8");
            let port = exchange(&client, (Ipv4Addr::new(198, 51, 100, 1), 20150).into(), &press, 7);
            assert!(may_have(&port), "{port}");
        }

        let place = network.place(r#"["198.51.100.1"]"#);
        let all = place.configuration(&settings).replace(r#""1-4", 33"#, r#""1-125""#);
        let line = relay.reload_to(&all);
        assert_eq!(line["flows_closed"], 0, "{line}");
        let (_, flows) = relay.get("/api/v1/flows").unwrap();
        let flows: Value = serde_json::from_str(&flows).unwrap();
        assert_eq!(flows["flows"].as_array().unwrap().len(), 50);
        relay.expect_drops(&[]);
        relay.finish();
    });
}

/// The block takes up all that the host lends.
#[test]
fn where_the_host_lends_nothing_else_other_ports_are_taken() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        lend("20000 20127", "");
        let relay = start(&network, Settings::default());
        lend("32768 60999", ""); // for what asks the admin server
        let ports = ports(&network, 20, &network.node(4));
        let may_have = |port: &u16| *port > 1023 && !(20000..=20127).contains(port);
        assert!(ports.iter().all(may_have), "{ports:?}");
        relay.expect_drops(&[]);
        let log = relay.finish();
        let told = "every port that the host lends belongs to a block or is reserved";
        assert!(log.stderr().contains(told), "{}", log.stderr());
    });
}

/// All but one are other programs', on whichever address.
#[test]
fn what_other_programs_have_is_passed_over() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        lend("20100 20131", "");
        let relay = start(&network, Settings::default());
        lend("32768 60999", "");
        let _others = ["127.0.0.1:20128", "0.0.0.0:20129", "172.17.17.254:20131"]
            .map(|address| UdpSocket::bind(address).unwrap());
        let (first, second) = (network.client("198.51.100.7"), network.client("198.51.100.8"));
        let (public, node) = (network.public("198.51.100.1", 4), network.node(4));
        assert_eq!(exchange(&first, public, &node, 4), 20130);
        second.send(public, &request(4));
        assert_eq!(exchange(&first, public, &node, 4), 20130);
        relay.expect_drops(&[("request", "upstream_exhausted", 1)]);
        let log = relay.finish();
        assert_eq!(log.logged("cannot open an upstream socket").len(), 1, "{}", log.stderr());
    });
}
