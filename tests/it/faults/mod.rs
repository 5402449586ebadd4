//! Faults of what surrounds the relay, each with who is hurt by it: only whom it concerns. Each
//! scenario ends with the law of the counters.

mod clock;
mod kernel;
mod links;
mod log;
mod manager;
mod process;
mod servers;
mod threads;

use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use crate::harness::{Network, Peer, Relay, Settings, eventually, exchange, request, response};

/// A second plant section, on a cable of its own.
const SECTION_2: &str = r#"
[[udp_range_net]]
name = "section-2"
start_port = 41000
subnet = "172.17.18.0"
nodes = [1]
allow = ["0.0.0.0/0", "::/0"]

[[udp_range_net.password]]
name = "service"
file = "secrets/section-1"
"#;

/// A relay between the Internet and two plant sections. The fault will be one of section 1, and the
/// client has business in both: over the same upstream socket, in the same batches.
struct Sections<'a> {
    network: &'a Network,
    relay: Relay,
    client: Peer,
    node: Peer,
    other: Peer,
}

impl Sections<'_> {
    /// Runs a scenario at the edge, after a first exchange with either section.
    fn scenario(scenario: impl FnOnce(Sections<'_>) + Send) {
        let Some(network) = Network::build() else { return };
        let edge = &network.edge;
        network.plant.ip("link add eth1 type veth peer name eth2");
        network.plant.ip(&format!("link set eth2 netns {}", edge.name()));
        network.plant.ip("link set eth1 up\naddress add 172.17.18.1/24 dev eth1");
        edge.ip("link set eth2 up\naddress add 172.17.18.254/24 dev eth2");
        network.at_the_edge(|| {
            let settings = Settings { sections: SECTION_2, ..Settings::default() };
            let relay = network.place(r#"["0.0.0.0"]"#).relay(&settings);
            let other = network.plant.peer("172.17.18.1:34379".parse().unwrap());
            let (client, node) = (network.client("198.51.100.7"), network.node(4));
            let sections = Sections { network: &network, relay, client, node, other };
            sections.exchange_with_section_1();
            sections.exchange_with_section_2();
            scenario(sections);
        });
    }

    fn section_1(&self) -> SocketAddr {
        self.network.public("198.51.100.1", 4)
    }

    fn section_2(&self) -> SocketAddr {
        (Ipv4Addr::new(198, 51, 100, 1), 41001).into()
    }

    /// Tells the relay's port towards the node.
    #[track_caller]
    fn exchange_with_section_1(&self) -> u16 {
        exchange(&self.client, self.section_1(), &self.node, 4)
    }

    #[track_caller]
    fn exchange_with_section_2(&self) -> u16 {
        exchange(&self.client, self.section_2(), &self.other, 1)
    }

    /// Sends requests to both sections by turns, which the relay finds all at once. Whatever becomes
    /// of section 1's: those to section 2 arrive, and the client has all of their answers.
    #[track_caller]
    fn only_section_1_is_hurt(&self, requests: usize) {
        self.relay.process.hold();
        for _ in 0..requests {
            self.client.send(self.section_1(), &request(4));
            self.client.send(self.section_2(), &request(1));
        }
        self.relay.process.go_on();
        for _ in 0..requests {
            let from_relay = self.other.expect(&request(1));
            self.other.send(from_relay, &response(1));
            assert_eq!(self.client.expect(&response(1)), self.section_2());
        }
        self.relay.at_rest();
    }

    /// How many requests to a section could not be sent.
    fn failed(&self, net: &str) -> u64 {
        let labels = [("net", net), ("direction", "request"), ("reason", "send_failed")];
        self.relay.metrics().sum("pnet_nat_dropped_datagrams_total", &labels)
    }

    /// Waits until the relay has heard that the way to section 1 is gone: until then, the kernel sends what it
    /// carries where it did before. Returns how many requests could not be sent.
    #[track_caller]
    fn way_is_gone(&self) -> u64 {
        let section_1 = [("net", "section-1"), ("direction", "request")];
        let received = || self.relay.metrics().sum("pnet_nat_received_datagrams_total", &section_1);
        let failed = eventually("a request cannot be sent", || {
            let before = received();
            self.client.send(self.section_1(), &request(4));
            eventually("it is counted", || (received() > before).then_some(()));
            self.relay.at_rest();
            let failed = self.failed("section-1");
            (failed > 0).then_some(failed)
        });
        while self.node.receive_within(Duration::from_millis(50)).is_some() {}
        failed
    }

    /// The fault is over: section 1 is reached, and over the same flow.
    #[track_caller]
    fn all_is_well_again(self, port: u16) {
        assert_eq!(self.exchange_with_section_1(), port);
        self.exchange_with_section_2();
        assert_eq!(self.relay.at_rest().sum("pnet_nat_flows_opened_total", &[]), 2);
        self.relay.finish();
    }
}
