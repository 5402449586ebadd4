//! Counters of one worker. Only that worker writes them, so counting is a plain load and store:
//! no lock, no look-up, no read-modify-write. Others read them at any time.
//!
//! The law of the counters: at rest, for every net, node and direction,
//! received = forwarded + the sum of dropped.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use super::reason::{CloseReason, Direction, DropReason};
use super::sketch::SourceSketch;
use super::table::{Credential, Mapping, MappingId, NetId, Table};

/// A number with one writer and any number of readers.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// Adds `n`. Called by the one writer only.
    pub fn add(&self, n: u64) {
        self.0.store(self.0.load(Relaxed).wrapping_add(n), Relaxed);
    }

    /// Takes `n` away. Called by the one writer only.
    pub fn sub(&self, n: u64) {
        self.0.store(self.0.load(Relaxed).wrapping_sub(n), Relaxed);
    }

    /// Sets the value. Called by the one writer only.
    pub fn set(&self, value: u64) {
        self.0.store(value, Relaxed);
    }

    /// Takes over the value of another.
    fn copy(&self, other: &Self) {
        self.set(other.get());
    }

    /// The value now.
    pub fn get(&self) -> u64 {
        self.0.load(Relaxed)
    }
}

/// Upper bounds of the response time histogram, in seconds; one more bucket takes the rest.
pub const RESPONSE_BUCKETS: [f64; 10] =
    [0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.05, 0.2, 1.0, 5.0];

const RESPONSE_BUCKET_NANOS: [u64; RESPONSE_BUCKETS.len()] = [
    200_000,
    500_000,
    1_000_000,
    2_000_000,
    5_000_000,
    10_000_000,
    50_000_000,
    200_000_000,
    1_000_000_000,
    5_000_000_000,
];

/// What is counted for one node and direction.
#[derive(Debug, Default)]
pub struct DirectionCounters {
    /// Datagrams taken from the kernel.
    pub received: Counter,
    /// Datagrams handed back to the kernel.
    pub forwarded: Counter,
    /// UDP payload octets of the forwarded ones.
    pub forwarded_bytes: Counter,
    dropped: [Counter; DropReason::COUNT],
}

impl DirectionCounters {
    /// The counter of one reason.
    pub fn dropped(&self, reason: DropReason) -> &Counter {
        &self.dropped[reason as usize]
    }

    fn copy(&self, other: &Self) {
        self.received.copy(&other.received);
        self.forwarded.copy(&other.forwarded);
        self.forwarded_bytes.copy(&other.forwarded_bytes);
        copy_all(&self.dropped, &other.dropped);
    }

    /// All that was dropped, whatever the reason.
    pub fn dropped_total(&self) -> u64 {
        self.dropped.iter().map(Counter::get).sum()
    }
}

/// Response times of one node.
#[derive(Debug, Default)]
pub struct ResponseTimes {
    buckets: [Counter; RESPONSE_BUCKETS.len() + 1],
    sum_nanos: Counter,
}

impl ResponseTimes {
    /// Counts one response that took `elapsed`.
    pub fn observe(&self, elapsed: Duration) {
        let nanos = u64::try_from(elapsed.as_nanos()).unwrap_or(u64::MAX);
        let bucket = RESPONSE_BUCKET_NANOS.partition_point(|&bound| bound < nanos);
        self.buckets[bucket].add(1);
        self.sum_nanos.add(nanos);
    }

    /// How many fell into each bucket alone (not cumulated); the last is beyond all bounds.
    pub fn buckets(&self) -> [u64; RESPONSE_BUCKETS.len() + 1] {
        std::array::from_fn(|bucket| self.buckets[bucket].get())
    }

    /// The sum of all times.
    pub fn sum(&self) -> Duration {
        Duration::from_nanos(self.sum_nanos.get())
    }
}

/// What is counted for one server node.
#[derive(Debug, Default)]
pub struct NodeCounters {
    directions: [DirectionCounters; Direction::ALL.len()],
    /// Response times.
    pub response_times: ResponseTimes,
    /// When the last response was forwarded, as nanoseconds since the router's start; 0: never.
    pub last_response: Counter,
    /// When the last request that wants an answer was accepted, likewise.
    pub last_request: Counter,
    /// When the first such request after the last response was accepted; 0: none waits.
    pub unanswered_since: Counter,
}

impl NodeCounters {
    fn copy(&self, other: &Self) {
        for direction in Direction::ALL {
            self.direction(direction).copy(other.direction(direction));
        }
        copy_all(&self.response_times.buckets, &other.response_times.buckets);
        self.response_times.sum_nanos.copy(&other.response_times.sum_nanos);
        self.last_response.copy(&other.last_response);
        self.last_request.copy(&other.last_request);
        self.unanswered_since.copy(&other.unanswered_since);
    }

    /// Notes a request that wants an answer.
    #[inline]
    pub(super) fn asked(&self, now: u64) {
        self.last_request.set(now);
        if self.unanswered_since.get() == 0 {
            self.unanswered_since.set(now);
        }
    }

    /// Notes a response.
    #[inline]
    pub(super) fn answered(&self, now: u64) {
        self.last_response.set(now);
        self.unanswered_since.set(0);
    }

    /// The counters of one direction.
    pub fn direction(&self, direction: Direction) -> &DirectionCounters {
        &self.directions[direction as usize]
    }
}

/// What is counted for one net.
#[derive(Debug)]
pub struct NetCounters {
    /// Flows open now.
    pub flows: Counter,
    /// Flows opened so far.
    pub flows_opened: Counter,
    flows_closed: [Counter; CloseReason::ALL.len()],
    /// Requests accepted, by the net's credentials in their order.
    pub accepted: Box<[Counter]>,
    sources: [SourceSketch; DropReason::COUNT],
    /// Who sent wrong passwords since the start: hashes as in [`sources`](Self::sources).
    pub wrong_password_sources: SourceSketch,
}

impl NetCounters {
    pub(super) fn note_source(&self, reason: DropReason, hash: u64) {
        self.sources(reason).note(hash);
        if reason == DropReason::PasswordWrong {
            self.wrong_password_sources.note(hash);
        }
    }

    /// The counter of flows that ended for this reason.
    pub fn flows_closed(&self, reason: CloseReason) -> &Counter {
        &self.flows_closed[reason as usize]
    }

    /// Who sent the datagrams that were dropped for this reason since the log last looked: the
    /// hash of the sender's address without its port.
    pub fn sources(&self, reason: DropReason) -> &SourceSketch {
        &self.sources[reason as usize]
    }
}

/// All counters of one worker, laid out like the [`Table`] they belong to.
#[derive(Debug)]
pub struct Counters {
    nodes: Box<[NodeCounters]>,
    nets: Box<[NetCounters]>,
    /// Datagrams on an upstream socket from an address that is no server of the table.
    pub stray: NodeCounters,
}

impl Counters {
    /// Counters at 0 for this table.
    pub fn new(table: &Table) -> Self {
        let net = |credentials: usize| NetCounters {
            flows: Counter::default(),
            flows_opened: Counter::default(),
            flows_closed: Default::default(),
            accepted: (0..credentials).map(|_| Counter::default()).collect(),
            sources: Default::default(),
            wrong_password_sources: SourceSketch::default(),
        };
        Self {
            nodes: table.mappings().iter().map(|_| NodeCounters::default()).collect(),
            nets: table.nets().iter().map(|n| net(n.credentials.len())).collect(),
            stray: NodeCounters::default(),
        }
    }

    /// Counters for the table `new` that go on from these, of the table `old`: nets by their name,
    /// nodes by net and node address, credentials by net and name.
    pub(super) fn carried_over(&self, old: &Table, new: &Table) -> Self {
        let next = Self::new(new);
        next.stray.copy(&self.stray);
        let old_nets: HashMap<_, _> = old
            .nets()
            .iter()
            .zip(&self.nets)
            .map(|(net, counters)| (&net.name, (net, counters)))
            .collect();
        for (net, next) in new.nets().iter().zip(&next.nets) {
            let Some((old, counters)) = old_nets.get(&net.name) else { continue };
            next.flows.copy(&counters.flows);
            next.flows_opened.copy(&counters.flows_opened);
            copy_all(&next.flows_closed, &counters.flows_closed);
            next.wrong_password_sources.copy(&counters.wrong_password_sources);
            for (credential, next) in net.credentials.iter().zip(&next.accepted) {
                let same = |old: &Credential| old.name == credential.name;
                if let Some(index) = old.credentials.iter().position(same) {
                    next.copy(&counters.accepted[index]);
                }
            }
        }
        let key = |table: &'_ Table, mapping: &Mapping| {
            (table.net(mapping.net).name.clone(), mapping.node_address)
        };
        let old_nodes: HashMap<_, _> =
            old.mappings().iter().map(|mapping| key(old, mapping)).zip(&self.nodes).collect();
        for (mapping, next) in new.mappings().iter().zip(&next.nodes) {
            if let Some(counters) = old_nodes.get(&key(new, mapping)) {
                next.copy(counters);
            }
        }
        next
    }

    /// The counters of the node behind a mapping.
    pub fn node(&self, mapping: MappingId) -> &NodeCounters {
        &self.nodes[mapping.0 as usize]
    }

    /// The counters of a net.
    pub fn net(&self, net: NetId) -> &NetCounters {
        &self.nets[usize::from(net.0)]
    }
}

fn copy_all(counters: &[Counter], others: &[Counter]) {
    counters.iter().zip(others).for_each(|(counter, other)| counter.copy(other));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bucket_bounds_are_the_same_in_both_units() {
        for (seconds, nanos) in RESPONSE_BUCKETS.iter().zip(RESPONSE_BUCKET_NANOS) {
            assert_eq!(Duration::from_secs_f64(*seconds), Duration::from_nanos(nanos));
        }
    }

    #[test]
    fn a_time_on_a_bound_belongs_to_the_bucket_below() {
        let times = ResponseTimes::default();
        times.observe(Duration::from_micros(200));
        times.observe(Duration::from_nanos(200_001));
        times.observe(Duration::from_secs(60));
        let mut expected = [0; RESPONSE_BUCKETS.len() + 1];
        (expected[0], expected[1], expected[RESPONSE_BUCKETS.len()]) = (1, 1, 1);
        assert_eq!(times.buckets(), expected);
        assert_eq!(times.sum(), Duration::from_nanos(60_000_400_001));
    }
}
