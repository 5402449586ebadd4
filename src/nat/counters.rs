//! Counters of one worker. Only this worker's [`Writer`] changes them, so counting is a plain load and
//! store: no lock, no look-up, no read-modify-write. Others may read them at any time.
//!
//! The law of the counters: for every node and direction, received = forwarded + the sum of
//! dropped, when no datagram is under way.

use std::collections::HashMap;
use std::fmt;
use std::hash::Hash;
use std::mem::offset_of;
use std::net::IpAddr;
use std::sync::Arc;

use super::counter::{Counter, Writer};
use super::ids::{MappingId, NetId};
use super::last_sender::LastSender;
use super::net::Net;
use super::offload::{Held, Lent};
use super::reason::{CloseReason, Direction, DropReason};
use super::refusals::{Refusals, net_key};
use super::response_times::ResponseTimes;
use super::source_sketch::SourceSketch;
use super::table::Table;
use super::time::Nanos;

/// What is counted for one node and direction.
#[derive(Debug, Default)]
pub struct DirectionCounters {
    /// Datagrams received from the kernel.
    pub received: Counter,
    /// Datagrams that the kernel took for sending.
    pub forwarded: Counter,
    /// UDP payload octets of the forwarded datagrams.
    pub forwarded_bytes: Counter,
    dropped: [Counter; DropReason::COUNT],
}

impl DirectionCounters {
    /// Datagrams dropped for this reason.
    pub fn dropped(&self, reason: DropReason) -> &Counter {
        &self.dropped[reason as usize]
    }

    /// Counts a datagram that the kernel took.
    #[inline]
    pub(super) fn forwarded(&self, writer: &Writer, octets: usize) {
        self.forwarded.add(writer, 1);
        self.forwarded_bytes.add(writer, octets as u64);
    }

    /// Datagrams dropped for any reason.
    pub fn dropped_total(&self) -> u64 {
        self.dropped.iter().map(Counter::get).sum()
    }
}

/// What is counted for one server node.
#[derive(Debug, Default)]
pub struct NodeCounters {
    directions: [DirectionCounters; Direction::ALL.len()],
    /// How long the node's answers took.
    pub response_times: ResponseTimes,
    /// When the last response passed, in nanoseconds since the relay's start, plus one; 0: never.
    pub last_response: Counter,
    /// When the last request that wants an answer was sent, in the same unit.
    pub last_request: Counter,
    /// When the first such request after the last response was sent; 0: there was none.
    pub unanswered_since: Counter,
}

impl NodeCounters {
    /// Notes a request that wants an answer.
    #[inline]
    pub(super) fn asked(&self, writer: &Writer, now: u64) {
        self.last_request.set(writer, now);
        if self.unanswered_since.get() == 0 {
            self.unanswered_since.set(writer, now);
        }
    }

    /// Notes a response.
    #[inline]
    pub(super) fn answered(&self, writer: &Writer, now: u64) {
        self.last_response.set(writer, now);
        self.unanswered_since.set(writer, 0);
    }

    /// Sets everything to 0.
    pub(crate) fn clear(&self, writer: &Writer) {
        for direction in &self.directions {
            let DirectionCounters { received, forwarded, forwarded_bytes, dropped } = direction;
            let all = [received, forwarded, forwarded_bytes].into_iter().chain(dropped);
            all.for_each(|counter| counter.set(writer, 0));
        }
        self.response_times.clear(writer);
        let Self { last_response, last_request, unanswered_since, .. } = self;
        let times = [last_response, last_request, unanswered_since];
        times.iter().for_each(|time| time.set(writer, 0));
    }

    /// The counters of one direction.
    pub fn direction(&self, direction: Direction) -> &DirectionCounters {
        &self.directions[direction as usize]
    }
}

/// Where a program in the kernel finds the counters of one node.
pub(crate) struct NodeLayout {
    pub directions: [DirectionLayout; Direction::ALL.len()],
    pub last_response: usize,
    pub last_request: usize,
    pub unanswered_since: usize,
    pub response_times: usize,
}

/// The same for one direction.
#[derive(Clone, Copy)]
pub(crate) struct DirectionLayout {
    pub received: usize,
    pub forwarded: usize,
    pub forwarded_bytes: usize,
}

pub(crate) const NODE_LAYOUT: NodeLayout = {
    let mut directions =
        [DirectionLayout { received: 0, forwarded: 0, forwarded_bytes: 0 }; Direction::ALL.len()];
    let mut index = 0;
    while index < directions.len() {
        let begin = offset_of!(NodeCounters, directions) + index * size_of::<DirectionCounters>();
        directions[index] = DirectionLayout {
            received: begin + offset_of!(DirectionCounters, received),
            forwarded: begin + offset_of!(DirectionCounters, forwarded),
            forwarded_bytes: begin + offset_of!(DirectionCounters, forwarded_bytes),
        };
        index += 1;
    }
    NodeLayout {
        directions,
        last_response: offset_of!(NodeCounters, last_response),
        last_request: offset_of!(NodeCounters, last_request),
        unanswered_since: offset_of!(NodeCounters, unanswered_since),
        response_times: offset_of!(NodeCounters, response_times),
    }
};

/// Who lends the counters that a faster datapath writes to.
pub trait SharedCounters: fmt::Debug + Send + Sync {
    /// Counters of a node, all 0; none when no place is left.
    fn node(&self) -> Option<Lent<NodeCounters>>;
    /// A counter of a credential, at 0; none when no place is left.
    fn credential(&self) -> Option<Lent<Counter>>;
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
    /// The sources of wrong passwords since the start, hashed as in [`sources`](Self::sources).
    pub wrong_password_sources: SourceSketch,
}

impl NetCounters {
    /// Notes the sender of a dropped datagram, and the hash of its address.
    pub fn note_source(
        &self,
        writer: &Writer,
        reason: DropReason,
        now: Nanos,
        sender: IpAddr,
        hash: u64,
    ) {
        self.sources(reason).note(hash);
        self.last_sender(reason).note(writer, now, sender);
        if reason == DropReason::PasswordWrong {
            self.wrong_password_sources.note(hash);
        }
    }

    /// Flows that ended for this reason.
    pub fn flows_closed(&self, reason: CloseReason) -> &Counter {
        &self.flows_closed[reason as usize]
    }

    /// The sources of datagrams dropped for this reason since the log last reported them. A source
    /// is the hash of an address without its port.
    pub fn sources(&self, reason: DropReason) -> &SourceSketch {
        &self.sources[reason as usize]
    }

    /// The sender of the last datagram dropped for this reason.
    pub fn last_sender(&self, reason: DropReason) -> &LastSender {
        &self.last_senders[reason as usize]
    }
}

/// All counters of one worker, laid out like the [`Table`] they belong to.
#[derive(Debug)]
pub struct Counters {
    nodes: Box<[Held<NodeCounters>]>,
    nets: Box<[Arc<NetCounters>]>,
    accepted: Box<[Box<[Held<Counter>]>]>,
    /// Where counters for new nodes and credentials come from, in those of a faster datapath.
    shared: Option<Arc<dyn SharedCounters>>,
    /// What names each net in `refusals`.
    net_keys: Box<[u64]>,
    /// Who was refused of late.
    pub refusals: Arc<Refusals>,
    /// Datagrams that arrived at an upstream socket from an address that is no server of the table.
    pub stray: Arc<NodeCounters>,
}

impl Counters {
    /// Counters for this table, all 0.
    pub fn new(table: &Table) -> Self {
        Self::with(table, None)
    }

    /// Counters of a faster datapath for this table, all 0.
    pub fn of_offload(table: &Table, shared: Arc<dyn SharedCounters>) -> Self {
        Self::with(table, Some(shared))
    }

    fn with(table: &Table, shared: Option<Arc<dyn SharedCounters>>) -> Self {
        let lender = shared.as_deref();
        let accepted = |net: &Net| net.credentials.iter().map(|_| new_credential(lender)).collect();
        Self {
            nodes: table.mappings().iter().map(|_| new_node(lender)).collect(),
            nets: table.nets().iter().map(|_| Arc::default()).collect(),
            accepted: table.nets().iter().map(accepted).collect(),
            shared: shared.clone(),
            net_keys: net_keys(table),
            refusals: Arc::new(if shared.is_some() {
                Refusals::none()
            } else {
                Refusals::default()
            }),
            stray: Arc::default(),
        }
    }

    /// The counters for the table `new` that continue these, which belong to the table `old`. A net
    /// is the same if its name is, a node if its net and node address are, a credential if its net
    /// and name are. Those have the very same counters, so that nothing counted meanwhile is lost.
    pub fn followed_by(&self, old: &Table, new: &Table) -> Self {
        let nets: HashMap<_, _> = old.nets().iter().map(|net| &net.name).zip(&self.nets).collect();
        let accepted: HashMap<_, _> = old
            .nets()
            .iter()
            .zip(&self.accepted)
            .flat_map(|(net, accepted)| credential_names(net).zip(accepted))
            .collect();
        let nodes: HashMap<_, _> = old.node_names().zip(&self.nodes).collect();
        let lender = self.shared.as_deref();
        let of_net = |net: &Net| {
            let credential = |name| known(&accepted, &name, || new_credential(lender));
            credential_names(net).map(credential).collect()
        };
        let node = |name| known(&nodes, &name, || new_node(lender));
        let net = |net: &Net| known(&nets, &&net.name, Arc::default);
        Self {
            nodes: new.node_names().map(node).collect(),
            nets: new.nets().iter().map(net).collect(),
            accepted: new.nets().iter().map(of_net).collect(),
            shared: self.shared.clone(),
            net_keys: net_keys(new),
            refusals: Arc::clone(&self.refusals),
            stray: Arc::clone(&self.stray),
        }
    }

    /// The counters of a mapping's node.
    pub fn node(&self, mapping: MappingId) -> &NodeCounters {
        &self.nodes[mapping.0 as usize]
    }

    /// The counters of a net.
    pub fn net(&self, net: NetId) -> &NetCounters {
        &self.nets[usize::from(net.0)]
    }

    /// What names a net in [`refusals`](Self::refusals).
    #[inline]
    pub(super) fn net_key(&self, net: NetId) -> u64 {
        self.net_keys[usize::from(net.0)]
    }

    /// Where a faster datapath counts a mapping's node and a credential of its net; none where it cannot.
    pub fn places(&self, mapping: MappingId, net: NetId, credential: u16) -> Option<[u32; 2]> {
        let node = self.nodes[mapping.0 as usize].place()?;
        Some([node, self.accepted(net)[usize::from(credential)].place()?])
    }

    /// Requests that a net accepted, for each of its credentials in their order.
    pub fn accepted(&self, net: NetId) -> &[Held<Counter>] {
        &self.accepted[usize::from(net.0)]
    }
}

fn net_keys(table: &Table) -> Box<[u64]> {
    table.nets().iter().map(|net| net_key(&net.name)).collect()
}

/// What identifies a net's credentials.
fn credential_names(net: &Net) -> impl Iterator<Item = (&str, &str)> {
    net.credentials.iter().map(|credential| (&*net.name, &*credential.name))
}

/// The counters with this name, or new ones.
fn known<K: Eq + Hash, T: Clone>(counters: &HashMap<K, &T>, name: &K, new: impl Fn() -> T) -> T {
    counters.get(name).map_or_else(new, |counters| T::clone(counters))
}

fn new_node(lender: Option<&dyn SharedCounters>) -> Held<NodeCounters> {
    held(lender.and_then(SharedCounters::node))
}

fn new_credential(lender: Option<&dyn SharedCounters>) -> Held<Counter> {
    held(lender.and_then(SharedCounters::credential))
}

fn held<T: Default>(lent: Option<Lent<T>>) -> Held<T> {
    lent.map_or_else(Held::default, |lent| Held::Lent(Arc::new(lent)))
}
