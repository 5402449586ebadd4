//! Servers whose addresses lead back to the relay's own public ports, in ways that `check` cannot
//! see: each request comes back once, and goes no further.
//!
//! Needs root: there are networks on both sides of the relay.

use std::net::SocketAddr;

use crate::harness::{Network, Relay, Settings, exchange, has_nft, request};

/// A single server behind public port 20200.
fn press(address: &str, more: &str) -> String {
    format!(
        "[[server]]\nname = \"press\"\npublic_port = 20200\naddress = \"{address}\"\nnode = 4\n\
         allow = [\"0.0.0.0/0\", \"::/0\"]\n[[server.password]]\nname = \"service\"\n\
         file = \"secrets/section-1\"\n{more}"
    )
}

fn start(network: &Network, sections: &str) -> Relay {
    let runtime = "workers = 2\ndrain = \"100ms\"";
    let listen = r#"["0.0.0.0", "::"]"#;
    network.place(listen).relay(&Settings { runtime, sections, ..Settings::default() })
}

/// Three requests of a client stay three: each is passed on once, and dropped when it comes back.
#[track_caller]
fn expect_no_more_than_three(network: &Network, relay: Relay, public: &str) {
    let public: SocketAddr = public.parse().unwrap();
    let client = network.client(if public.is_ipv4() { "198.51.100.7" } else { "2001:db8:1::7" });
    for _ in 0..3 {
        client.send(public, &request(4));
    }
    relay.expect_drops(&[("request", "loop", 3)]);
    let metrics = relay.at_rest();
    assert_eq!(metrics.sum("pnet_nat_flows_opened_total", &[]), 1);
    assert_eq!(metrics.sum("pnet_nat_forwarded_datagrams_total", &[]), 3);
    assert_eq!(client.waiting(), None);
    // Everybody else is served, also a client on the router itself.
    let node = network.node(4);
    let own = network.edge.peer("198.51.100.1:0".parse().unwrap());
    for client in [network.client("198.51.100.8"), own] {
        exchange(&client, network.public("198.51.100.1", 4), &node, 4);
    }
    relay.expect_drops(&[("request", "loop", 3)]);
    relay.finish();
}

/// The address becomes the router's own while the relay runs.
#[test]
fn a_server_whose_address_the_router_gets() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        for (address, server, public) in [
            ("203.0.113.99/32", "203.0.113.99:20200", "198.51.100.1:20200"),
            ("192.0.2.9/32", "192.0.2.9:20200", "198.51.100.1:20200"),
            ("2001:db8:1::99/128", "[2001:db8:1::99]:20200", "[2001:db8:1::1]:20200"),
        ] {
            let relay = start(&network, &press(server, ""));
            network.edge.ip(&format!("address add {address} dev lo"));
            expect_no_more_than_three(&network, relay, public);
            network.edge.ip(&format!("address del {address} dev lo"));
        }
    });
}

/// The router's packet filter sends what is for the server back to a public port. It comes from
/// another address than it was sent to.
#[test]
fn a_server_that_address_translation_leads_back_from() {
    let Some(network) = Network::build() else { return };
    if !has_nft() {
        return;
    }
    network.edge.nft(
        "table ip loops { chain output { type nat hook output priority -100;
         ip daddr 203.0.113.99 udp dport 34379 dnat to 198.51.100.1:20200; }; }",
    );
    network.at_the_edge(|| {
        let relay = start(&network, &press("203.0.113.99:34379", ""));
        expect_no_more_than_three(&network, relay, "198.51.100.1:20200");
    });
}

/// Two servers, each of which is the other's public port.
#[test]
fn two_servers_that_lead_to_each_other() {
    let Some(network) = Network::build() else { return };
    if !has_nft() {
        return;
    }
    network.edge.nft(
        "table ip loops { chain output { type nat hook output priority -100;
         ip daddr 203.0.113.99 udp dport 34379 dnat to 198.51.100.1:20201;
         ip daddr 203.0.113.98 udp dport 34379 dnat to 203.0.113.1:20200; }; }",
    );
    network.at_the_edge(|| {
        let other = press("203.0.113.98:34379", "");
        let other = other.replace("press", "other").replace("20200", "20201");
        let relay = start(&network, &press("203.0.113.99:34379", &other));
        expect_no_more_than_three(&network, relay, "198.51.100.1:20200");
    });
}
