//! Addresses that go away and come back, and lines that lose, repeat and reorder datagrams.

use std::collections::BTreeSet;

use super::Sections;
use crate::harness::{
    FIGURE_10, Network, PASSWORD, Peer, Relay, Settings, datagram, exchange, request, response,
};

/// The router gets another address in the plant, as by DHCP: flows go on from there.
#[test]
fn an_address_towards_the_plant_that_changes() {
    Sections::scenario(|sections| {
        let port = sections.exchange_with_section_1();
        let edge = &sections.network.edge;
        edge.ip("address delete 172.17.17.254/24 dev eth1");
        sections.only_section_1_is_hurt(30);
        sections.relay.expect_drops(&[("request", "send_failed", 30)]);

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
                assert_eq!(exchange(&client, public, &node, 4), port);
                exchange(&other, others, &node, 4);
            }
            assert_eq!(relay.metrics().sum("pnet_nat_flows_opened_total", &[]), 4);
            relay.finish();
        }
    });
}
