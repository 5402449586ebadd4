//! Queues and buffers of the kernel that are full.

use std::time::Duration;

use super::Sections;
use crate::harness::{
    FIGURE_10, PASSWORD, Settings, Site, datagram, eventually, exchange, request, response,
};

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

/// For a node that is switched off the kernel is told to hold back more than a send buffer has room for.
/// What finds no room (EAGAIN) is dropped and counted, also of who shares the socket; when the kernel
/// lets go, all go on.
#[test]
fn a_full_send_buffer() {
    Sections::scenario(|sections| {
        let port = sections.exchange_with_section_1();
        let (edge, plant) = (&sections.network.edge, &sections.network.plant);
        // As much as it likes, for as long as it takes.
        for setting in ["unres_qlen_bytes=100000000", "mcast_solicit=120"] {
            edge.output(&["sysctl", "-w", &format!("net.ipv4.neigh.eth1.{setting}")]);
        }
        plant.ip("address delete 172.17.17.4/24 dev eth0");
        edge.ip("neighbour flush dev eth1");
        let largest = datagram(&FIGURE_10, &[0; 63], PASSWORD);
        eventually("the send buffer is full", || {
            for _ in 0..4000 {
                sections.client.send(sections.section_1(), &largest);
            }
            (sections.failed("section-1") > 0).then_some(())
        });
        let complaint = eventually("it is told", || {
            sections.relay.process.logged("cannot send to a server").pop()
        });
        assert!(complaint["error"].as_str().unwrap().contains("os error 11"), "{complaint}");
        sections.client.send(sections.section_2(), &request(1));
        eventually("section 2 shares the socket", || {
            (sections.failed("section-2") == 1).then_some(())
        });
        sections.relay.at_rest();

        plant.ip("address add 172.17.17.4/24 dev eth0");
        let held_back = sections.node.receive().0;
        assert_eq!(held_back, largest);
        while sections.node.receive_within(Duration::from_millis(200)).is_some() {}
        let before = [sections.failed("section-1"), sections.failed("section-2")];
        sections.only_section_1_is_hurt(30);
        for _ in 0..30 {
            sections.node.expect(&request(4));
        }
        assert_eq!([sections.failed("section-1"), sections.failed("section-2")], before);
        sections.all_is_well_again(port);
    });
}

/// While the relay cannot keep up, the kernel drops what a port's buffer has no room for, and only
/// what is sent to that port.
#[test]
fn a_full_buffer_of_a_public_port() {
    let site = Site::claim();
    let sections = "[datapath]\nreceive_buffer = 4096";
    let relay = site.relay(Settings { sections, ..Settings::default() });
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
    let sections = "[datapath]\nreceive_buffer = 4096";
    let relay = site.relay(Settings { sections, ..Settings::default() });
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
