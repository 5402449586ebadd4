//! What the kernel remembers of its own address translation when its rules have gone or come anew, as
//! docs/operations.md and docs/container.md tell it.
//!
//! Needs root, nft and conntrack.

use std::fs;
use std::process::Command;

use crate::harness::{
    Network, Peer, Relay, Settings, exchange, has_nft, left_out, request, response,
};

/// Rules of something else, which stay.
const OTHERS: &str = "table ip others { chain in { type nat hook prerouting priority dstnat;
    udp dport 9 dnat to 172.17.17.9:9; }; }";

/// The map of one node.
const RULES: &str = "table ip plant_nat {
    chain in { type nat hook prerouting priority dstnat; udp dport 20004 dnat to 172.17.17.4:34379; }
    chain out { type nat hook postrouting priority srcnat; oifname eth1 masquerade; }
}";

const REMOVE: [&str; 5] = ["nft", "delete", "table", "ip", "plant_nat"];
const FORGET: [&str; 6] = ["conntrack", "-D", "-p", "udp", "--orig-port-dst", "20004"];

fn network() -> Option<Network> {
    let network = Network::build().filter(|_| has_nft())?;
    if Command::new("conntrack").arg("--version").output().is_err() {
        left_out("conntrack");
        return None;
    }
    network.edge.nft(OTHERS);
    Some(network)
}

/// Datagrams that came to the relay.
fn received(relay: &Relay) -> u64 {
    let labels = [("direction", "request")];
    relay.metrics().sum("pnet_nat_received_datagrams_total", &labels)
}

/// From the kernel's rules to the relay: a client that polls comes to the relay when its entry has gone.
#[test]
fn a_polling_client_stays_with_rules_that_are_gone() {
    let Some(network) = network() else { return };
    network.edge.nft(RULES);
    network.at_the_edge(|| {
        fs::write("/proc/sys/net/ipv4/ip_forward", "1").unwrap();
        let relay = network.place(r#"["198.51.100.1"]"#).relay(&Settings::default());
        let (client, node) = (network.client("198.51.100.7"), network.node(4));
        let public = network.public("198.51.100.1", 4);
        exchange(&client, public, &node, 4);
        assert_eq!(received(&relay), 0, "the rules come first");
        network.edge.output(&REMOVE);
        exchange(&client, public, &node, 4);
        assert_eq!(received(&relay), 0, "the entry stays");
        network.edge.output(&FORGET);
        exchange(&client, public, &node, 4);
        assert_eq!(received(&relay), 1);
        relay.finish();
    });
}

/// The moment without a rule that a container with published ports has when it is started anew.
#[test]
fn a_client_that_polls_while_there_is_no_rule_is_shut_out() {
    let Some(network) = network() else { return };
    network.at_the_edge(|| {
        fs::write("/proc/sys/net/ipv4/ip_forward", "1").unwrap();
        let node = network.node(4);
        let public = network.public("198.51.100.1", 4);
        let reaches = |client: &Peer| {
            client.send(public, &request(4));
            let patience = std::time::Duration::from_millis(500);
            let Some((_, router)) = node.receive_within(patience) else { return false };
            node.send(router, &response(4));
            client.receive_within(patience).is_some()
        };
        let polling = network.client("198.51.100.7");
        assert!(!reaches(&polling));
        network.edge.nft(RULES);
        assert!(!reaches(&polling) && !reaches(&polling), "the rule is not asked any more");
        assert!(reaches(&network.client("198.51.100.8")), "it works for others");
        network.edge.output(&FORGET);
        assert!(reaches(&polling));
    });
}
