//! The one place that adds up the workers' counters: for a node, for the nodes of a net, for a
//! net. Metrics, admin API, log and demo all read these sums.
//!
//! The workers go on counting while they are read, so figures that belong together may be some
//! datagrams apart; each alone never runs backwards (`flows` apart).

use std::sync::Arc;
use std::time::Duration;

use crate::relay::{
    CloseReason, Counter, Counters, Direction, DirectionCounters, DropReason, MappingId, NetId,
    NodeCounters, RESPONSE_BUCKETS, Table,
};

/// Datagrams of one direction.
#[derive(Clone, Debug, Default)]
pub struct DirectionTotals {
    /// Datagrams taken from the kernel.
    pub received: u64,
    /// Datagrams handed back to the kernel.
    pub forwarded: u64,
    /// UDP payload octets of the forwarded ones.
    pub forwarded_bytes: u64,
    dropped: [u64; DropReason::COUNT],
}

impl DirectionTotals {
    /// Datagrams dropped for this reason.
    pub fn dropped(&self, reason: DropReason) -> u64 {
        self.dropped[reason as usize]
    }

    /// Datagrams dropped, whatever the reason.
    pub fn dropped_total(&self) -> u64 {
        self.dropped.iter().sum()
    }

    fn add(&mut self, counters: &DirectionCounters, reasons: &[DropReason]) {
        self.received += counters.received.get();
        self.forwarded += counters.forwarded.get();
        self.forwarded_bytes += counters.forwarded_bytes.get();
        for &reason in reasons {
            self.dropped[reason as usize] += counters.dropped(reason).get();
        }
    }
}

/// Response times: from a forwarded request to its forwarded response.
#[derive(Clone, Debug, Default)]
pub struct ResponseTotals {
    /// How many fell into each bucket alone (not cumulated); the last is beyond all bounds.
    pub buckets: [u64; RESPONSE_BUCKETS.len() + 1],
    /// The sum of all times.
    pub sum: Duration,
}

impl ResponseTotals {
    /// How many times were measured.
    pub fn count(&self) -> u64 {
        self.buckets.iter().sum()
    }

    /// The mean time; none before the first.
    pub fn mean(&self) -> Option<Duration> {
        let seconds = self.sum.as_secs_f64() / self.count() as f64;
        Duration::try_from_secs_f64(seconds).ok()
    }
}

/// What is counted for one server node, or for several together.
#[derive(Clone, Debug, Default)]
pub struct NodeTotals {
    directions: [DirectionTotals; 2],
    /// Response times.
    pub response_times: ResponseTotals,
    /// When the last response was forwarded, from the router's start; none: never.
    pub last_response: Option<Duration>,
}

impl NodeTotals {
    /// The sum over `workers` for the node behind a mapping.
    pub fn of_node(workers: &[Arc<Counters>], mapping: MappingId) -> Self {
        Self::sum(workers.iter().map(|worker| worker.node(mapping)))
    }

    /// The sum over `workers` for all nodes of a net.
    pub fn of_net(workers: &[Arc<Counters>], table: &Table, net: NetId) -> Self {
        Self::sum(
            table
                .mappings_of(net)
                .flat_map(|mapping| workers.iter().map(move |worker| worker.node(mapping))),
        )
    }

    /// The sum over `workers` for the datagrams on upstream sockets that come from no server of
    /// the table.
    pub fn of_strays(workers: &[Arc<Counters>]) -> Self {
        Self::sum(workers.iter().map(|worker| &worker.stray))
    }

    /// Datagrams of one direction.
    pub fn direction(&self, direction: Direction) -> &DirectionTotals {
        &self.directions[direction as usize]
    }

    fn sum<'a>(nodes: impl Iterator<Item = &'a NodeCounters>) -> Self {
        let mut totals = Self::default();
        for node in nodes {
            for (direction, sum) in Direction::ALL.into_iter().zip(&mut totals.directions) {
                sum.add(node.direction(direction), direction.drop_reasons());
            }
            let times = &mut totals.response_times;
            for (sum, bucket) in times.buckets.iter_mut().zip(node.response_times.buckets()) {
                *sum += bucket;
            }
            times.sum += node.response_times.sum();
            let last = Some(node.last_response.get()).filter(|&nanos| nanos != 0);
            totals.last_response = totals.last_response.max(last.map(Duration::from_nanos));
        }
        totals
    }
}

/// What is counted for a net beside its nodes.
#[derive(Clone, Debug)]
pub struct NetTotals {
    /// Flows open now.
    pub flows: u64,
    /// Flows opened so far.
    pub flows_opened: u64,
    flows_closed: [u64; CloseReason::ALL.len()],
    /// Requests accepted, by the net's credentials in their order.
    pub accepted: Vec<u64>,
}

impl NetTotals {
    /// The sum over `workers` for a net.
    pub fn of_net(workers: &[Arc<Counters>], table: &Table, net: NetId) -> Self {
        let sum = |counter: &dyn Fn(&Counters) -> &Counter| {
            workers.iter().map(|worker| counter(worker).get()).sum()
        };
        let credentials = 0..table.net(net).credentials.len();
        Self {
            flows: sum(&|worker| &worker.net(net).flows),
            flows_opened: sum(&|worker| &worker.net(net).flows_opened),
            flows_closed: CloseReason::ALL
                .map(|reason| sum(&|worker| worker.net(net).flows_closed(reason))),
            accepted: credentials.map(|i| sum(&|worker| &worker.net(net).accepted[i])).collect(),
        }
    }

    /// Flows that ended for this reason.
    pub fn flows_closed(&self, reason: CloseReason) -> u64 {
        self.flows_closed[reason as usize]
    }
}
