//! The NAT of one worker: takes a datagram, and says where it goes or why it is dropped.
//!
//! The caller does the sending and reports it: every datagram is counted once as received, and once
//! as forwarded or dropped. Before a sender's password was right, only tables of fixed size know of
//! it: those of the [throttle](super::throttle), of each drop reason the sketch of its sources and
//! its last sender, and the table of [who was refused](super::refusals). So strangers cannot make
//! memory grow.

mod arrival;
#[cfg(test)]
mod invariants;
mod lifecycle;
mod offload;
mod reload;
mod request;
mod response;

use std::collections::BTreeSet;
use std::hash::BuildHasher;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Instant;

use foldhash::fast::{FixedState, SeedableRandomState};

use super::chance::Chance;
use super::counter::Writer;
use super::counters::Counters;
use super::effects::Effects;
use super::flow::{Flow, FlowRecord};
use super::flow_table::Flows;
use super::idle_wheel::Wheel;
use super::ids::{FlowId, MappingId};
use super::reason::{CloseReason, Direction, DropReason};
use super::refusals::Refused;
use super::rules::Rules;
use super::table::Table;
use super::throttle::Throttle;
use super::time::Nanos;
use super::upstream_ports::Upstreams;

pub use arrival::Arrival;
pub use reload::Succession;
pub use request::ToServer;
pub use response::ToClient;

use reload::GoingOver;

/// The same for all workers, because their sketches are merged. A stranger who makes the hashes of
/// addresses collide only makes the estimate of their number smaller.
const SOURCE_HASH: FixedState = FixedState::with_seed(0);

/// How many flows one call looks at when there is something to do about all of them, so that
/// datagrams are handled in between. So few in tests that a handful of flows takes several calls.
const AT_ONCE: usize = if cfg!(test) { 2 } else { 256 };

/// The flows of one worker and all that decides about them.
#[derive(Debug)]
pub struct Core {
    rules: Rules,
    counters: Arc<Counters>,
    writer: Writer,
    flows: Flows,
    /// When each flow has to be looked at because it may have been idle for too long.
    wheel: Wheel,
    /// The number of the last reload.
    era: u32,
    /// What is left to do of the last reload.
    pub(super) going_over: Option<GoingOver>,
    pub(super) upstreams: Upstreams,
    /// Flows that wait for last answers on sockets that are about to be closed.
    pub(super) leaving: BTreeSet<FlowId>,
    pub(super) throttle: Throttle,
    /// Chooses where a sender stands in the list of who was refused.
    hash: SeedableRandomState,
    start: Instant,
}

impl Core {
    /// A core without flows. `counters` belong to the table of `rules`; `start` is when the relay
    /// started.
    pub fn new(rules: Rules, counters: Arc<Counters>, start: Instant, chance: Chance) -> Self {
        let Chance { hash, choice } = chance;
        let throttle = Throttle::new(&rules.limits, hash.clone());
        let capacity = rules.most_flows();
        Self {
            rules,
            counters,
            writer: Writer::of_worker(),
            flows: Flows::new(hash.clone(), capacity),
            wheel: Wheel::new(capacity),
            era: 0,
            going_over: None,
            upstreams: Upstreams::new(hash.clone(), choice, capacity),
            leaving: BTreeSet::new(),
            throttle,
            hash,
            start,
        }
    }

    /// Counts a request that the system took. If it `asks` for an answer, the answer is due from
    /// now on: a node that was asked and does not answer is silent. To be called before the next
    /// datagram is judged.
    #[inline]
    pub fn request_sent(
        &mut self,
        now: Instant,
        mapping: MappingId,
        asks: Option<FlowId>,
        octets: usize,
    ) {
        let now = self.nanos(now);
        let node = self.counters.node(mapping);
        node.direction(Direction::Request).forwarded(&self.writer, octets);
        if let Some(id) = asks {
            node.asked(&self.writer, now);
            if let Some(flow) = self.flows.find_mut(id) {
                flow.note_request(now);
            }
        }
    }

    /// Counts a response that the system took.
    #[inline]
    pub fn response_sent(&self, mapping: MappingId, octets: usize) {
        self.counters.node(mapping).direction(Direction::Response).forwarded(&self.writer, octets);
    }

    /// Counts a datagram that the system refused to send.
    pub fn send_failed(&self, mapping: MappingId, direction: Direction) {
        let counters = self.counters.node(mapping).direction(direction);
        counters.dropped(DropReason::SendFailed).add(&self.writer, 1);
    }

    /// Closes every flow.
    pub fn shut_down(&mut self, now: Instant, effects: &mut impl Effects) {
        let now = self.nanos(now);
        let ids: Vec<_> = self.flows.iter().map(|(id, _)| id).collect();
        for id in ids {
            if self.settle(id, now, effects) {
                self.close(id, CloseReason::Shutdown, now, effects);
            }
        }
    }

    /// Whether the answer to some request may still come.
    pub fn awaits_answers(&self, now: Instant) -> bool {
        let now = self.nanos(now);
        let awaits = |flow: &Flow| flow.awaits_answers(now) && self.place(flow).is_some();
        self.flows.iter().any(|(_, flow)| awaits(flow))
    }

    /// Whether no flow is open, no socket is still needed and nobody is throttled. Then there is
    /// nothing to [expire](Self::expire).
    pub fn is_idle(&self) -> bool {
        self.flows.len() == 0 && self.upstreams.is_empty() && self.throttle.is_quiet()
    }

    /// The table in force.
    pub fn table(&self) -> &Arc<Table> {
        &self.rules.table
    }

    /// The open flows.
    pub fn flows(&self, now: Instant) -> impl Iterator<Item = FlowRecord> {
        let now = self.nanos(now);
        self.flows.iter().filter_map(move |(_, flow)| self.record(flow, now))
    }

    /// Notes who sent a datagram that was dropped, and why.
    #[inline]
    fn note_source(
        &self,
        reason: DropReason,
        now: Nanos,
        mapping: MappingId,
        direction: Direction,
        sender: IpAddr,
    ) {
        let mapping = self.rules.table.mapping(mapping);
        let (net, node) = (mapping.net, mapping.node_address);
        let hash = SOURCE_HASH.hash_one(sender);
        self.counters.net(net).note_source(&self.writer, reason, now, sender, hash);
        let net = self.counters.net_key(net);
        let refused = Refused { sender, net, node, direction, reason };
        self.counters.refusals.note(&self.writer, now, &refused, &self.hash);
    }

    /// A time as flows keep it.
    #[inline]
    fn nanos(&self, now: Instant) -> Nanos {
        let nanos = now.saturating_duration_since(self.start).as_nanos();
        u64::try_from(nanos).unwrap_or(u64::MAX).saturating_add(1)
    }
}
