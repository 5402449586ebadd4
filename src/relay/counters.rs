//! Counters of one worker. Only that worker writes them, so counting is a plain load and store:
//! no lock, no look-up, no read-modify-write. Others read them at any time.
//!
//! The law of the counters: at rest, for every net, node and direction,
//! received = forwarded + the sum of dropped.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use super::reason::{CloseReason, Direction, DropReason};
use super::response_times::ResponseTimes;
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
        self.response_times.copy(&other.response_times);
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
