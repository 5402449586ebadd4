//! The demo's figures at one moment, from client, stranger, nodes and relay, and the check that they are
//! right. `table` shows them.

use std::net::SocketAddr;
use std::time::Duration;

use crate::datapath::{ActiveConfig, Router};
use crate::nat::{Direction, DropReason, MappingId};
use crate::observe::totals::{DirectionTotals, NodeTotals};

use super::plant::Plant;
use super::traffic::{Intrusions, Polled, Traffic};

/// All figures.
#[derive(Clone, Debug)]
pub(super) struct Figures {
    /// Time since the start.
    pub(super) elapsed: Duration,
    /// One entry for each node.
    pub(super) nodes: Vec<NodeFigures>,
    /// What the stranger has done.
    pub(super) intrusions: Intrusions,
    /// Dropped datagrams by reason, for the reasons that occurred.
    pub(super) dropped: Vec<(DropReason, u64)>,
}

/// One node's figures.
#[derive(Clone, Debug)]
pub(super) struct NodeFigures {
    /// Its node address.
    pub(super) node_address: u8,
    /// The relay's address and port for it.
    pub(super) public: SocketAddr,
    /// Its own address and Secure port.
    pub(super) server: SocketAddr,
    /// What the client has seen of it.
    pub(super) polled: Polled,
    /// What the relay has done, by direction.
    pub(super) relayed: [Relayed; Direction::ALL.len()],
    /// Datagrams that have reached the node.
    pub(super) reached: u64,
}

/// What the relay has done in one direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Relayed {
    received: u64,
    forwarded: u64,
    pub(super) dropped: u64,
}

impl Figures {
    /// The figures now.
    pub(super) fn take(
        elapsed: Duration,
        plant: &Plant,
        router: &Router,
        traffic: &Traffic,
    ) -> Self {
        let router = &*router.active_config();
        let nodes = plant.nodes().iter().zip(traffic.polled()).zip(mappings(router));
        let nodes = nodes.map(|((node, polled), mapping)| NodeFigures {
            node_address: node.node_address,
            public: node.public,
            server: node.server,
            polled,
            relayed: Direction::ALL.map(|direction| relayed(router, mapping, direction)),
            reached: node.counts.received(),
        });
        Self {
            elapsed,
            nodes: nodes.collect(),
            intrusions: traffic.intrusions(),
            dropped: dropped(router),
        }
    }

    /// What is wrong, once everything has stopped; empty when all went well.
    pub(super) fn faults(&self) -> Vec<String> {
        let mut faults: Vec<String> = self.nodes.iter().flat_map(NodeFigures::faults).collect();
        let Intrusions { wrong_passwords, garbage, answered } = self.intrusions;
        if answered > 0 {
            faults.push(format!("the stranger was answered {answered} times"));
        }
        let intrusions = wrong_passwords + garbage;
        let dropped: u64 = self.dropped.iter().map(|(_, dropped)| dropped).sum();
        if dropped < intrusions {
            faults.push(format!(
                "of {intrusions} datagrams of the stranger only {dropped} were counted"
            ));
        }
        faults
    }
}

impl NodeFigures {
    fn faults(&self) -> Vec<String> {
        let mut faults = Vec::new();
        let mut fault = |text: String| faults.push(format!("node {}: {text}", self.node_address));
        let Polled { requests, right, wrong, .. } = self.polled;
        if requests == 0 {
            fault("was not asked".into());
        }
        if right != requests {
            let lost = requests - right - wrong;
            fault(format!("of {requests} requests {lost} got no answer and {wrong} a wrong one"));
        }
        if self.reached != requests {
            fault(format!("{} datagrams reached it, the client sent {requests}", self.reached));
        }
        for (direction, Relayed { received, forwarded, dropped }) in
            Direction::ALL.into_iter().zip(self.relayed)
        {
            if received != forwarded + dropped {
                let direction = direction.label();
                fault(format!(
                    "{direction}s: received {received} ≠ forwarded {forwarded} + dropped {dropped}"
                ));
            }
        }
        faults
    }
}

fn mappings(router: &ActiveConfig) -> impl Iterator<Item = MappingId> {
    router.config.table.mapping_ids()
}

fn relayed(router: &ActiveConfig, mapping: MappingId, direction: Direction) -> Relayed {
    let node = NodeTotals::of_node(&router.counters, mapping);
    let totals = node.direction(direction);
    let &DirectionTotals { received, forwarded, .. } = totals;
    Relayed { received, forwarded, dropped: totals.dropped_total() }
}

fn dropped(router: &ActiveConfig) -> Vec<(DropReason, u64)> {
    let table = &router.config.table;
    let of_net = |net| NodeTotals::of_net(&router.counters, table, net);
    let nets: Vec<_> = table.net_ids().map(of_net).collect();
    let mut dropped = Vec::new();
    for reason in Direction::ALL.iter().flat_map(|direction| direction.drop_reasons()) {
        let of = |net: &NodeTotals| -> u64 {
            Direction::ALL.map(|direction| net.direction(direction).dropped(reason)).iter().sum()
        };
        let count = nets.iter().map(of).sum();
        if count > 0 && !dropped.iter().any(|&(listed, _)| listed == reason) {
            dropped.push((reason, count));
        }
    }
    dropped
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// The figures of a demo in which all went well, as large as they may be shown.
    pub(in super::super) fn sound() -> Figures {
        let requests = 1_000_000;
        let polled = Polled { requests, right: requests, ..Polled::default() };
        let relayed =
            |dropped| Relayed { received: requests + dropped, forwarded: requests, dropped };
        let node = |node_address: u8| NodeFigures {
            node_address,
            public: SocketAddr::from(([127, 0, 0, 1], 20_000 + u16::from(node_address))),
            server: SocketAddr::from(([127, 17, 17, node_address], 34_379)),
            polled,
            relayed: [relayed(400_000), relayed(0)],
            reached: requests,
        };
        Figures {
            elapsed: Duration::from_secs(3600),
            nodes: vec![node(1), node(2)],
            intrusions: Intrusions { wrong_passwords: 400_000, garbage: 400_000, answered: 0 },
            dropped: DropReason::REQUEST.map(|reason| (reason, 100_000)).to_vec(),
        }
    }

    #[test]
    fn each_fault_is_found_and_a_sound_demo_has_none() {
        assert_eq!(sound().faults(), [""; 0]);
        type Break = fn(&mut Figures);
        let faults: [(Break, &str); 7] = [
            (|f| f.nodes[0].polled = Polled::default(), "node 1: was not asked"),
            (
                |f| f.nodes[0].polled.right -= 3,
                "node 1: of 1000000 requests 3 got no answer and 0 a wrong one",
            ),
            (
                |f| (f.nodes[1].polled.right, f.nodes[1].polled.wrong) = (999_998, 1),
                "node 2: of 1000000 requests 1 got no answer and 1 a wrong one",
            ),
            (
                |f| f.nodes[0].reached += 1,
                "node 1: 1000001 datagrams reached it, the client sent 1000000",
            ),
            (
                |f| f.nodes[1].relayed[1].received += 1,
                "node 2: responses: received 1000001 ≠ forwarded 1000000 + dropped 0",
            ),
            (|f| f.intrusions.answered = 1, "the stranger was answered 1 times"),
            (
                |f| f.dropped.truncate(7),
                "of 800000 datagrams of the stranger only 700000 were counted",
            ),
        ];
        for (break_it, expected) in faults {
            let mut figures = sound();
            break_it(&mut figures);
            assert_eq!(figures.faults()[0], expected);
        }
    }
}
