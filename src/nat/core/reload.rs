//! A new configuration for a core at work.
//!
//! New rules hold for the next datagram, however many flows there are. A flow goes over to them
//! when a datagram touches it, and otherwise when its turn comes, some flows at a time. It lives on
//! with its upstream port if its mapping, its password and its client's address are still good.
//! Otherwise it is closed in its turn, and until then nothing passes through it.

use std::mem;
use std::sync::Arc;
use std::time::Instant;

use super::offload::kept_terms;
use super::{AT_ONCE, Core};
use crate::nat::counters::Counters;
use crate::nat::effects::Effects;
use crate::nat::flow::{Flow, FlowRecord, Offload};
use crate::nat::ids::FlowId;
use crate::nat::reason::CloseReason;
use crate::nat::rules::Rules;
use crate::nat::time::Nanos;
use crate::nat::transition::{FlowTarget, Transition};

/// What a core goes over to.
#[derive(Debug)]
pub struct Succession {
    /// The new rules.
    pub rules: Rules,
    /// The counters that belong to their table.
    pub counters: Arc<Counters>,
    /// Which indices of the old table are which of the new one.
    pub transition: Arc<Transition>,
}

/// What is left to do of going over to new rules.
#[derive(Debug)]
pub(in crate::nat) struct GoingOver {
    /// The old rules, under which flows stand that have not gone over.
    rules: Rules,
    /// The counters of those flows.
    counters: Arc<Counters>,
    transition: Arc<Transition>,
    /// The flow whose turn it is.
    next: FlowId,
    /// Flows that have not gone over.
    left: usize,
    /// Flows that were closed because they could not, or because their port is wanted.
    closed: usize,
    /// Flows that have gone over, on sockets that are about to be closed.
    leaving: Vec<FlowId>,
    /// Flows that have gone over, and that a faster datapath may not carry as it does.
    recalled: Vec<FlowId>,
}

impl Core {
    /// Puts new rules in force. They hold at once; [`go_over`](Self::go_over) does the rest.
    pub fn reload(&mut self, now: Instant, succession: Succession, effects: &mut impl Effects) {
        while self.going_over.is_some() {
            self.go_over(now, effects);
        }
        let Succession { rules, counters, transition } = succession;
        self.throttle.set_limits(&rules.limits);
        self.era += 1;
        self.going_over = Some(GoingOver {
            rules: mem::replace(&mut self.rules, rules),
            counters: mem::replace(&mut self.counters, counters),
            transition,
            next: FlowId(0),
            left: self.flows.len(),
            closed: 0,
            leaving: Vec::new(),
            recalled: Vec::new(),
        });
        // A public port is given; an upstream socket can be on any other port.
        let mut wanted = vec![false; 1 << 16];
        for mapping in self.rules.table.mappings() {
            wanted[usize::from(mapping.public_port)] = true;
        }
        self.upstreams.leave(|port| wanted[usize::from(port)]);
    }

    /// Lets some more flows go over to the rules of the last [`reload`](Self::reload). Once all
    /// have, returns how many flows the reload closed; none before that, and none without a reload.
    pub fn go_over(&mut self, now: Instant, effects: &mut impl Effects) -> Option<usize> {
        let now = self.nanos(now);
        for _ in 0..AT_ONCE {
            let going_over = self.going_over.as_mut()?;
            if going_over.left == 0 {
                if let Some(id) = going_over.recalled.pop() {
                    if self.flows.contains(id) {
                        self.recall(id, effects);
                    }
                    continue;
                }
                if let Some(id) = going_over.leaving.pop() {
                    let flow = self.flows.find(id);
                    if flow.is_some_and(|flow| self.upstreams.is_leaving(flow.upstream)) {
                        going_over.closed += 1;
                        self.leave(id, now, effects);
                    }
                    continue;
                }
                let closed = going_over.closed;
                self.going_over = None;
                return Some(closed);
            }
            let id = going_over.next;
            going_over.next = FlowId(id.0 + 1);
            if self.flows.contains(id) {
                self.settle(id, now, effects);
            }
        }
        None
    }

    /// Brings a flow under the rules in force, or closes it. True if it is still there.
    #[inline]
    pub(super) fn settle(&mut self, id: FlowId, now: Nanos, effects: &mut impl Effects) -> bool {
        match self.take_along(id) {
            Ok(()) => true,
            Err(reason) => {
                self.close(id, reason, now, effects);
                false
            }
        }
    }

    /// Brings a flow under the rules in force, or returns why it has to be closed.
    #[inline]
    pub(super) fn take_along(&mut self, id: FlowId) -> Result<(), CloseReason> {
        if self.flows.get(id).era == self.era { Ok(()) } else { self.take_over(id) }
    }

    #[cold]
    fn take_over(&mut self, id: FlowId) -> Result<(), CloseReason> {
        let Some(going_over) = &mut self.going_over else { return Ok(()) };
        let (old, new) = (&*going_over.rules.table, &*self.rules.table);
        let flow = self.flows.get_mut(id);
        let place = going_over.transition.place(flow, old, new)?;
        if flow.left == 0 && self.upstreams.is_leaving(flow.upstream) {
            going_over.leaving.push(id);
        }
        let terms = kept_terms(flow, old);
        let was = old.net(old.mapping(flow.mapping).net).idle_timeout;
        let is = new.net(new.mapping(place.mapping).net).idle_timeout;
        let net = old.mapping(flow.mapping).net;
        let earlier = flow.earlier_credentials.iter();
        let earlier = earlier.filter_map(|&index| going_over.transition.credential(net, index));
        flow.earlier_credentials = earlier.collect();
        flow.mapping = place.mapping;
        flow.credential = place.credential;
        flow.era = self.era;
        going_over.left -= 1;
        match flow.offload {
            Offload::Carried(_) if terms.is_none() || kept_terms(flow, new) != terms => {
                going_over.recalled.push(id);
            }
            Offload::Declined => flow.offload = Offload::Open,
            Offload::Carried(_) | Offload::Open => {}
        }
        if is < was {
            let idle_at = self.idle_at(id);
            self.wheel.file(id, idle_at);
        }
        Ok(())
    }

    /// The rules that a flow stands under, and its counters.
    pub(super) fn rules_of(&self, flow: &Flow) -> (&Rules, &Counters) {
        match &self.going_over {
            Some(before) if flow.era != self.era => (&before.rules, &before.counters),
            _ => (&self.rules, &self.counters),
        }
    }

    /// Notes that a flow was closed, if it had not gone over.
    pub(super) fn note_withdrawn(&mut self, flow: &Flow) {
        if let Some(going_over) = self.going_over.as_mut().filter(|_| flow.era != self.era) {
            going_over.left -= 1;
            going_over.closed += usize::from(flow.left == 0);
        }
    }

    /// The mapping and credential of a flow under the rules in force, if they have a place for it.
    pub(super) fn place(&self, flow: &Flow) -> Option<FlowTarget> {
        match &self.going_over {
            Some(before) if flow.era != self.era => {
                let (old, new) = (&before.rules.table, &self.rules.table);
                before.transition.place(flow, old, new).ok()
            }
            _ => Some(FlowTarget { mapping: flow.mapping, credential: flow.credential }),
        }
    }

    /// The record of a flow; none when the rules in force have no place for it, nor when it is open
    /// for its last answers only.
    pub(super) fn record(&self, flow: &Flow, now: Nanos) -> Option<FlowRecord> {
        let FlowTarget { mapping, credential } = self.place(flow).filter(|_| flow.left == 0)?;
        let credential = credential.map(usize::from);
        Some(FlowRecord { mapping, credential, ..flow.record(now) })
    }
}
