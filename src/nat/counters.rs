//! Counters of one worker. Only that worker writes them, so counting is a plain load and store:
//! no lock, no look-up, no read-modify-write. Others read them at any time.
//!
//! The law of the counters: at rest, for every net, node and direction,
//! received = forwarded + the sum of dropped.

use std::collections::HashMap;
use std::hash::Hash;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use super::ids::{MappingId, NetId};
use super::last_sender::LastSender;
use super::reason::{CloseReason, Direction, DropReason};
use super::response_times::ResponseTimes;
use super::source_sketch::SourceSketch;
use super::table::{Mapping, Net, Table};
use super::time::Nanos;

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

    /// Counts a datagram that was handed back.
    #[inline]
    pub(super) fn forwarded(&self, octets: usize) {
        self.forwarded.add(1);
        self.forwarded_bytes.add(octets as u64);
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
    /// When the last request that wants an answer was sent, likewise.
    pub last_request: Counter,
    /// When the first such request after the last response was sent; 0: none waits.
    pub unanswered_since: Counter,
}

impl NodeCounters {
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
#[derive(Debug, Default)]
pub struct NetCounters {
    /// Flows open now.
    pub flows: Counter,
    /// Flows opened so far.
    pub flows_opened: Counter,
    flows_closed: [Counter; CloseReason::ALL.len()],
    sources: [SourceSketch; DropReason::COUNT],
    last_senders: [LastSender; DropReason::COUNT],
    /// Who sent wrong passwords since the start: hashes as in [`sources`](Self::sources).
    pub wrong_password_sources: SourceSketch,
}

impl NetCounters {
    /// Notes who sent a datagram that was dropped, and the address as a hash. Called by the one
    /// writer only.
    pub fn note_source(&self, reason: DropReason, now: Nanos, sender: IpAddr, hash: u64) {
        self.sources(reason).note(hash);
        self.last_sender(reason).note(now, sender);
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

    /// Who sent the last datagram that was dropped for this reason.
    pub fn last_sender(&self, reason: DropReason) -> &LastSender {
        &self.last_senders[reason as usize]
    }
}

/// All counters of one worker, laid out like the [`Table`] they belong to.
#[derive(Debug)]
pub struct Counters {
    nodes: Box<[Arc<NodeCounters>]>,
    nets: Box<[Arc<NetCounters>]>,
    accepted: Box<[Box<[Arc<Counter>]>]>,
    /// Datagrams on an upstream socket from an address that is no server of the table.
    pub stray: Arc<NodeCounters>,
}

impl Counters {
    /// Counters at 0 for this table.
    pub fn new(table: &Table) -> Self {
        let accepted = |net: &Net| net.credentials.iter().map(|_| Arc::default()).collect();
        Self {
            nodes: table.mappings().iter().map(|_| Arc::default()).collect(),
            nets: table.nets().iter().map(|_| Arc::default()).collect(),
            accepted: table.nets().iter().map(accepted).collect(),
            stray: Arc::default(),
        }
    }

    /// Counters for the table `new` that go on from these, of the table `old`: nets by their name,
    /// nodes by net and node address, credentials by net and name. They are the same ones, so that
    /// nothing is lost of what is counted meanwhile.
    pub fn followed_by(&self, old: &Table, new: &Table) -> Self {
        let nets: HashMap<_, _> = old.nets().iter().map(|net| &net.name).zip(&self.nets).collect();
        let accepted: HashMap<_, _> = old
            .nets()
            .iter()
            .zip(&self.accepted)
            .flat_map(|(net, accepted)| credential_names(net).zip(accepted))
            .collect();
        let nodes: HashMap<_, _> =
            old.mappings().iter().map(|was| node_name(old, was)).zip(&self.nodes).collect();
        let of_net =
            |net: &Net| credential_names(net).map(|name| known(&accepted, &name)).collect();
        Self {
            nodes: new.mappings().iter().map(|is| known(&nodes, &node_name(new, is))).collect(),
            nets: new.nets().iter().map(|net| known(&nets, &&net.name)).collect(),
            accepted: new.nets().iter().map(of_net).collect(),
            stray: Arc::clone(&self.stray),
        }
    }

    /// The counters of the node behind a mapping.
    pub fn node(&self, mapping: MappingId) -> &NodeCounters {
        &self.nodes[mapping.0 as usize]
    }

    /// The counters of a net.
    pub fn net(&self, net: NetId) -> &NetCounters {
        &self.nets[usize::from(net.0)]
    }

    /// Requests that a net accepted, by its credentials in their order.
    pub fn accepted(&self, net: NetId) -> &[Arc<Counter>] {
        &self.accepted[usize::from(net.0)]
    }
}

/// What a net's credentials are known by.
fn credential_names(net: &Net) -> impl Iterator<Item = (&str, &str)> {
    net.credentials.iter().map(|credential| (&*net.name, &*credential.name))
}

/// What a node is known by.
fn node_name<'a>(table: &'a Table, mapping: &Mapping) -> (&'a str, u8) {
    (&table.net(mapping.net).name, mapping.node_address)
}

/// The counters of that name, or new ones.
fn known<K: Eq + Hash, T: Default>(counters: &HashMap<K, &Arc<T>>, name: &K) -> Arc<T> {
    counters.get(name).map_or_else(Arc::default, |counters| Arc::clone(counters))
}
