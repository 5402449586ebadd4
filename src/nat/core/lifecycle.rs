//! How a flow begins and ends.
//!
//! A flow has a place in the budget from `open` until `note_closed`. The two ends are counted and
//! recorded once each (N-10).

use std::collections::BTreeSet;
use std::time::Instant;

use super::{AT_ONCE, Arrival, Core};
use crate::nat::effects::Effects;
use crate::nat::flow::{Answers, Flow, FlowTraffic, Offload};
use crate::nat::ids::FlowId;
use crate::nat::protocol::Conversation;
use crate::nat::reason::{CloseReason, DropReason};
use crate::nat::time::Nanos;
use crate::nat::upstream_ports::Owner;

/// How long to wait for the last answers on a socket whose port is wanted for something else.
const LAST_ANSWERS: Nanos = 2_000_000_000;

impl Core {
    /// Opens the flow of a request that passed all checks, if there is room for it and a way back
    /// to the client.
    pub(super) fn open(
        &mut self,
        now: Nanos,
        arrival: &Arrival,
        credential: Option<u16>,
        effects: &mut impl Effects,
    ) -> Result<FlowId, DropReason> {
        let mapping = self.rules.table.mapping(arrival.mapping);
        let Arrival { listener, public_address, client, .. } = *arrival;
        if !effects.can_answer(listener, public_address, client) {
            self.rules.budget.give_request(mapping.net);
            return Err(DropReason::Unanswerable);
        }
        if !self.rules.budget.take(mapping.net) {
            self.rules.budget.give_request(mapping.net);
            return Err(DropReason::FlowLimit); // N-8
        }
        let owner = Owner {
            client: arrival.client,
            public_address: arrival.public_address,
            public_port: mapping.public_port,
            has_local_address: mapping.local_address.is_some(),
        };
        let budget = &self.rules.budget;
        let (upstream, upstream_port) =
            self.upstreams.assign(owner, &mapping, &self.rules, effects).inspect_err(|_| {
                budget.give(mapping.net);
                budget.give_request(mapping.net);
            })?;
        let flow = Flow {
            endpoints: arrival.endpoints(),
            server: self.rules.table.answers_from(&mapping),
            mapping: arrival.mapping,
            upstream,
            upstream_port,
            credential,
            earlier_credentials: Box::default(),
            noted: 0,
            opened: now,
            used: now,
            answers: Answers::default(),
            traffic: FlowTraffic::default(),
            offload: Offload::Open,
            conversation: Conversation::of(self.rules.table.net(mapping.net).kind),
            era: self.era,
            paid_until: 0,
            left: 0,
        };
        effects.flow_opened(&self.rules.table, &flow.record(now));
        let net = self.counters.net(mapping.net);
        net.flows.add(&self.writer, 1);
        net.flows_opened.add(&self.writer, 1);
        let id = self.flows.insert(flow);
        self.wheel.file(id, self.idle_at(id));
        Ok(id)
    }

    /// Closes flows that have been idle for their net's time-out and sockets that nothing needs any
    /// more, and reports senders whose throttling is over. To be called about once a second. Each
    /// call does a part of the work; true means that it should be called again at once.
    pub fn expire(&mut self, now: Instant, effects: &mut impl Effects) -> bool {
        let now = self.nanos(now);
        let more = self.end_left(now, effects);
        self.close_sockets_left(effects);
        if self.upstreams.expire(now, effects) || more {
            return true;
        }
        for _ in 0..AT_ONCE {
            let Some(id) = self.wheel.next(now) else {
                self.throttle.expire(now, effects);
                return false;
            };
            if self.settle(id, now, effects) {
                match self.idle_at(id) {
                    at if at <= now => self.close(id, CloseReason::Idle, now, effects),
                    at => self.wheel.put_back(id, at),
                }
            }
        }
        true
    }

    /// When a flow will have been idle for too long.
    pub(super) fn idle_at(&self, id: FlowId) -> Nanos {
        let (flow, table) = (self.flows.get(id), &self.rules.table);
        let time_out = table.net(table.mapping(flow.mapping).net).idle_timeout.as_nanos();
        flow.last_used().saturating_add(Nanos::try_from(time_out).unwrap_or(Nanos::MAX))
    }

    pub(super) fn close(
        &mut self,
        id: FlowId,
        reason: CloseReason,
        now: Nanos,
        effects: &mut impl Effects,
    ) {
        self.recall(id, effects);
        self.wheel.remove(id);
        let flow = self.flows.remove(id);
        self.upstreams.release(flow.upstream, flow.server, now);
        match flow.left {
            0 => self.note_closed(&flow, reason, now, effects),
            _ => _ = self.leaving.remove(&id), // another flow may get its number
        }
        self.note_withdrawn(&flow);
    }

    /// Closes a flow for its client, whose next request opens another one. Answers to earlier
    /// requests still pass.
    pub(super) fn leave(&mut self, id: FlowId, now: Nanos, effects: &mut impl Effects) {
        self.recall(id, effects);
        self.flows.leave(id);
        self.note_closed(self.flows.get(id), CloseReason::PortWanted, now, effects);
        self.flows.get_mut(id).left = now;
        self.leaving.insert(id);
    }

    /// Closes the sockets whose ports are wanted for something else and that wait for no answer any
    /// more. True while others still wait.
    pub fn close_left(&mut self, now: Instant, effects: &mut impl Effects) -> bool {
        self.end_left(self.nanos(now), effects);
        self.close_sockets_left(effects)
    }

    /// Closes those of them that no flow is on. True while there are others.
    fn close_sockets_left(&mut self, effects: &mut impl Effects) -> bool {
        if self.going_over.is_some() {
            return true; // any number of flows may come to them
        }
        let used: BTreeSet<_> =
            self.leaving.iter().map(|&id| self.flows.get(id).upstream).collect();
        self.upstreams.close_left(|id| used.contains(&id), effects)
    }

    /// Closes some of the flows that wait for no last answer any more. True if there may be others.
    fn end_left(&mut self, now: Nanos, effects: &mut impl Effects) -> bool {
        if self.going_over.is_some() {
            return false;
        }
        let ends = |id: &FlowId| {
            let flow = self.flows.get(*id);
            !flow.awaits_answers(now) || now - flow.left >= LAST_ANSWERS
        };
        let ended: Vec<_> = self.leaving.iter().copied().filter(ends).take(AT_ONCE).collect();
        let more = ended.len() == AT_ONCE;
        ended.into_iter().for_each(|id| self.close(id, CloseReason::PortWanted, now, effects));
        more
    }

    fn note_closed(
        &self,
        flow: &Flow,
        reason: CloseReason,
        now: Nanos,
        effects: &mut impl Effects,
    ) {
        let (rules, counters) = self.rules_of(flow);
        let net = rules.table.mapping(flow.mapping).net;
        rules.budget.give(net);
        let net = counters.net(net);
        net.flows.sub(&self.writer, 1);
        net.flows_closed(reason).add(&self.writer, 1);
        effects.flow_closed(&rules.table, &flow.record(now), reason);
    }
}
