//! The systems under test, and what a check may ask of each: nothing that only one of them knows.

use std::fs;
use std::net::SocketAddr;
use std::time::Duration;

use crate::harness::{self, Network, PATIENCE, Peer, Relay, request, response};

/// What stands at the edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum System {
    Relay,
    /// nftables: port map and masquerade.
    Kernel,
}

/// What it is told beside where the nodes are.
#[derive(Default)]
pub(super) struct Settings {
    /// Seconds of silence that end a flow; none: as they are without being told.
    pub(super) idle: Option<u32>,
    /// Flows at once.
    pub(super) max_flows: Option<u32>,
}

/// A system at work at the edge of a network.
pub(super) struct Tested<'a> {
    pub(super) network: &'a Network,
    /// None: the kernel.
    relay: Option<Relay>,
    /// How long to wait for what may not come.
    patience: Duration,
}

impl<'a> Tested<'a> {
    /// Starts it, from the edge. Where a check is not expected to pass, there is less to wait for.
    pub(super) fn start(
        system: System,
        network: &'a Network,
        settings: &Settings,
        passes: bool,
    ) -> Self {
        let relay = match system {
            System::Relay => Some(start_relay(network, settings)),
            System::Kernel => {
                start_kernel(network, settings);
                None
            }
        };
        let patience = if passes { PATIENCE } else { Duration::from_secs(2) };
        Self { network, relay, patience }
    }

    pub(super) fn end(self) {
        self.relay.map(Relay::finish);
    }

    /// Where a node is reached from outside.
    pub(super) fn public(&self, node_address: u8) -> SocketAddr {
        self.network.public("198.51.100.1", node_address)
    }

    /// A client on the Internet.
    pub(super) fn client(&self, address: &str) -> Peer {
        self.network.internet.peer(address.parse().unwrap())
    }

    /// Whether this is what comes next; tells who sent it.
    pub(super) fn comes(&self, peer: &Peer, octets: &[u8]) -> Option<SocketAddr> {
        let (came, from) = peer.receive_within(self.patience)?;
        (came == octets).then_some(from)
    }

    /// A request and its answer, through where the node is reached; tells the port that the node
    /// saw, if both come where they should and from where they should.
    pub(super) fn exchange(&self, client: &Peer, node: &Peer) -> Option<u16> {
        let node_address = match node.address() {
            SocketAddr::V4(address) => address.ip().octets()[3],
            SocketAddr::V6(_) => unreachable!("nodes are IPv4"),
        };
        client.send(self.public(node_address), &request(node_address));
        let router = self.comes(node, &request(node_address))?;
        node.send(router, &response(node_address));
        let from = self.comes(client, &response(node_address))?;
        (from == self.public(node_address)).then_some(router.port())
    }

    /// Open flows.
    pub(super) fn flows(&self) -> usize {
        match &self.relay {
            Some(relay) => relay.metrics().sum("pnet_nat_flows", &[]) as usize,
            None => tracked().lines().filter(|line| line.contains(" udp ")).count(),
        }
    }

    /// Whether the flows end that are idle.
    pub(super) fn idle_flows_end(&self) -> bool {
        harness::eventually("no flow is open", || (self.flows() == 0).then_some(true))
    }

    /// What is written down of flows.
    pub(super) fn records(&self) -> String {
        self.relay.as_ref().map_or_else(tracked, |relay| relay.process.stderr())
    }
}

fn start_relay(network: &Network, settings: &Settings) -> Relay {
    let mut net = String::new();
    if let Some(seconds) = settings.idle {
        net += &format!("idle_timeout = \"{seconds}s\"\n");
    }
    if let Some(flows) = settings.max_flows {
        net += &format!("max_flows = {flows}\n");
    }
    let settings = harness::Settings { net: &net, ..harness::Settings::default() };
    network.place(r#"["198.51.100.1", "203.0.113.1"]"#).relay(&settings)
}

fn start_kernel(network: &Network, settings: &Settings) {
    let nodes = [1, 2, 3, 4, 33].map(|node_address: u16| {
        format!("{} : 172.17.17.{node_address} . 34379", 20000 + node_address)
    });
    let limit = settings.max_flows.map(|flows| {
        format!(
            "chain full {{ type filter hook forward priority filter;
                ct state new ct count over {flows} drop; }}"
        )
    });
    network.edge.nft(&format!(
        "table ip router {{
            map nodes {{
                type inet_service : ipv4_addr . inet_service
                elements = {{ {} }}
            }}
            chain in {{ type nat hook prerouting priority dstnat;
                ip daddr {{ 198.51.100.1, 203.0.113.1 }} dnat ip to udp dport map @nodes; }}
            chain out {{ type nat hook postrouting priority srcnat;
                oifname eth1 masquerade; }}
            {}
        }}",
        nodes.join(", "),
        limit.unwrap_or_default()
    ));
    fs::write("/proc/sys/net/ipv4/ip_forward", "1").unwrap();
    if let Some(seconds) = settings.idle {
        for state in ["timeout", "timeout_stream"] {
            let path = format!("/proc/sys/net/netfilter/nf_conntrack_udp_{state}");
            fs::write(path, seconds.to_string()).unwrap();
        }
    }
}

/// The kernel's flows, and all that it writes down of them.
fn tracked() -> String {
    fs::read_to_string("/proc/thread-self/net/nf_conntrack").unwrap()
}
