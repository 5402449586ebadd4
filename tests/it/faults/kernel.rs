//! Queues and buffers of the kernel that are full.

use super::Sections;
use crate::harness::{Settings, Site, eventually, exchange, request, response};

/// The queue of section 1's interface takes next to nothing. Of what it refuses, the kernel tells
/// nobody but its own figures: to the relay it is forwarded.
#[test]
fn a_full_queue_of_an_interface() {
    Sections::scenario(|sections| {
        let port = sections.exchange_with_section_1();
        let edge = &sections.network.edge;
        edge.tc("qdisc add dev eth1 root tbf rate 8kbit burst 200 limit 200");
        sections.only_section_1_is_hurt(100);
        sections.relay.expect_drops(&[]);
        let figures = edge.output(&["tc", "-s", "qdisc", "show", "dev", "eth1"]);
        let (_, dropped) = figures.split_once("(dropped ").unwrap();
        let dropped: u64 = dropped.split_once(',').unwrap().0.parse().unwrap();
        assert!(dropped > 90, "{figures}");

        edge.tc("qdisc delete dev eth1 root");
        let mut arrived = 0;
        while sections.node.waiting().is_some() {
            arrived += 1;
        }
        assert!(arrived < 10, "{arrived}");
        sections.all_is_well_again(port);
    });
}

/// While the relay cannot keep up, the kernel drops what a port's buffer has no room for, and only
/// what is sent to that port.
#[test]
fn a_full_buffer_of_a_public_port() {
    let site = Site::claim();
    let runtime = "workers = 1\nreceive_buffer = 4096\ndrain = \"100ms\"";
    let relay = site.relay(Settings { runtime, ..Settings::default() });
    let (client, node, other) = (site.client(), site.node(4), site.node(3));
    let port = exchange(&client, site.public(4), &node, 4);
    relay.process.hold();
    for _ in 0..200 {
        client.send(site.public(4), &request(4));
    }
    for _ in 0..5 {
        client.send(site.public(3), &request(3));
    }
    relay.process.go_on();
    for _ in 0..5 {
        let from_relay = other.expect(&request(3));
        other.send(from_relay, &response(3));
        assert_eq!(client.expect(&response(3)), site.public(3));
    }
    let overflow = [("net", "section-1"), ("cause", "overflow")];
    let lost = relay.metrics().sum("pnet_nat_kernel_dropped_datagrams_total", &overflow);
    assert!((100..200).contains(&lost), "{lost}");
    for _ in 0..200 - lost {
        node.expect(&request(4));
    }
    assert_eq!(exchange(&client, site.public(4), &node, 4), port);
    relay.expect_drops(&[]);
    relay.finish();
}

/// Answers come faster than the relay takes them: those that find no room are lost, and counted.
#[test]
fn a_full_buffer_of_an_upstream_socket() {
    let site = Site::claim();
    let runtime = "workers = 1\nreceive_buffer = 4096\ndrain = \"100ms\"";
    let relay = site.relay(Settings { runtime, ..Settings::default() });
    let (client, node, other) = (site.client(), site.node(4), site.client());
    let port = exchange(&client, site.public(4), &node, 4);
    relay.process.hold();
    for _ in 0..200 {
        node.send((site.public_address(), port).into(), &response(4));
    }
    relay.process.go_on();
    let overflow = [("net", "none"), ("cause", "overflow")];
    let lost = || relay.metrics().sum("pnet_nat_kernel_dropped_datagrams_total", &overflow);
    let lost = eventually("the kernel's drops are counted", || Some(lost()).filter(|&n| n > 0));
    assert!((100..200).contains(&lost), "{lost}");
    for _ in 0..200 - lost {
        client.expect(&response(4));
    }
    assert_eq!(exchange(&client, site.public(4), &node, 4), port);
    exchange(&other, site.public(4), &node, 4);
    relay.expect_drops(&[]);
    relay.finish();
}
