//! Server nodes that are not there, and subnets that cannot be reached.

use super::Sections;
use crate::harness::{Packet, close, eventually, request};

/// The node's host says so by ICMP, as often as it likes.
#[test]
fn a_dead_node() {
    Sections::scenario(|mut sections| {
        let port = sections.exchange_with_section_1();
        let address = sections.node.address();
        let spare = sections.network.client("198.51.100.8");
        let node = std::mem::replace(&mut sections.node, spare);
        sections.network.plant.enter(|| close(node));
        let (outside, inside) =
            (sections.network.internet.capture(), sections.network.plant.capture());
        sections.only_section_1_is_hurt(30);
        let refusal = |packet: &Packet| matches!(packet, Packet::PortUnreachable { .. });
        eventually("ICMP is seen", || inside.so_far().iter().any(refusal).then_some(()));
        assert!(!outside.end().iter().any(refusal), "nothing of it reaches the client");
        sections.relay.expect_drops(&[]);

        sections.node = sections.network.plant.peer(address);
        sections.all_is_well_again(port);
    });
}

/// ENETUNREACH, EHOSTUNREACH: the kernel refuses each datagram, and only these.
#[test]
fn an_unreachable_subnet() {
    let route = "172.17.17.0/24 dev eth1 src 172.17.17.254";
    let faults = [
        (format!("route delete {route}"), format!("route add {route}"), 101),
        (
            "route add unreachable 172.17.17.4".to_owned(),
            "route delete unreachable 172.17.17.4".to_owned(),
            113,
        ),
    ];
    for (breaks, mends, errno) in faults {
        Sections::scenario(|sections| {
            let port = sections.exchange_with_section_1();
            sections.network.edge.ip(&breaks);
            let failed = sections.way_is_gone();
            sections.only_section_1_is_hurt(30);
            sections.relay.expect_drops(&[("request", "send_failed", failed + 30)]);
            let complaint = eventually("it is told", || {
                sections.relay.process.logged("cannot send to a server").into_iter().next()
            });
            let error = complaint["error"].as_str().unwrap();
            assert!(error.contains(&format!("os error {errno}")), "{error}");

            sections.network.edge.ip(&mends);
            sections.all_is_well_again(port);
        });
    }
}

/// Nobody answers to ARP: the kernel keeps what it was given for three seconds, then loses it in
/// silence. What it keeps must not fill the send buffer that all nodes share.
#[test]
fn a_host_that_is_switched_off() {
    Sections::scenario(|sections| {
        let port = sections.exchange_with_section_1();
        let plant = &sections.network.plant;
        plant.ip("address delete 172.17.17.4/24 dev eth0");
        sections.network.edge.ip("neighbour flush dev eth1");
        for _ in 0..400 {
            sections.client.send(sections.section_1(), &request(4));
        }
        sections.only_section_1_is_hurt(30);
        eventually("the kernel gives up", || {
            sections.client.send(sections.section_1(), &request(4)); // not all of them ask for the address
            let neighbours = sections.network.edge.output(&["ip", "neighbour"]);
            let gone = |line: &str| line.starts_with("172.17.17.4 ") && line.ends_with("FAILED ");
            neighbours.lines().any(gone).then_some(())
        });
        sections.only_section_1_is_hurt(30);
        sections.relay.expect_drops(&[]);

        plant.ip("address add 172.17.17.4/24 dev eth0");
        sections.all_is_well_again(port);
    });
}
