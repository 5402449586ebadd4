//! How many flows may still be opened, and how many requests a net may still get, over all workers.
//!
//! The one thing that workers share. It is touched when a flow opens or closes; for a datagram only
//! where a net limits its requests. The kernel spreads clients over the workers by chance, so a
//! share for each worker would refuse one client while another's share lies idle.
//!
//! A new configuration brings other limits. What is taken goes on, so that the limits hold while one
//! worker after the other goes over to it.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

use super::gcra::Gcra;
use super::ids::NetId;
use super::table::{Limits, Net, Table};
use super::time::Nanos;

/// Places for flows, one count for each net and one for the router (RFC 6888 REQ-11); and the
/// requests of each net.
#[derive(Debug)]
pub struct Budget {
    all: Places,
    all_pairs: Places,
    nets: Box<[NetBudget]>,
}

#[derive(Clone, Debug)]
struct NetBudget {
    places: Places,
    /// For (socket, server) pairs, in use or resting.
    pairs: Places,
    requests: Requests,
}

#[derive(Clone, Debug)]
struct Requests {
    paid_until: Arc<AtomicU64>,
    rate: Option<Gcra>,
}

/// Places for one (socket, server) pair, in its net and in the router; given back when dropped.
#[derive(Debug)]
pub(super) struct PairPlace([Arc<AtomicU32>; 2]);

#[derive(Clone, Debug)]
struct Places {
    taken: Arc<AtomicU32>,
    limit: u32,
}

impl Budget {
    /// All places free, and a second's requests for each net.
    pub fn new(table: &Table, limits: &Limits) -> Self {
        let nets = table.nets().iter().map(NetBudget::new).collect();
        let all_pairs = Places::new(pairs(limits.max_flows));
        Self { all: Places::new(limits.max_flows), all_pairs, nets }
    }

    /// Other limits for what is taken of this budget, whose table is `old`. Nets are known by name.
    pub(super) fn with_limits(&self, old: &Table, new: &Table, limits: &Limits) -> Self {
        let known: HashMap<_, _> = old.nets().iter().map(|net| &net.name).zip(&self.nets).collect();
        let next = |net: &Net| match known.get(&net.name) {
            Some(before) => before.with_limits(net),
            None => NetBudget::new(net),
        };
        let nets = new.nets().iter().map(next).collect();
        let all_pairs = Places { limit: pairs(limits.max_flows), ..self.all_pairs.clone() };
        Self { all: Places { limit: limits.max_flows, ..self.all.clone() }, all_pairs, nets }
    }

    /// Takes a request of this net, if it has one left.
    #[inline]
    pub(super) fn take_request(&self, net: NetId, now: Nanos) -> bool {
        let Requests { rate: Some(rate), paid_until } = &self.net(net).requests else {
            return true;
        };
        paid_until.fetch_update(Relaxed, Relaxed, |paid_until| rate.take(paid_until, now)).is_ok()
    }

    /// Gives a request back that did not pass.
    pub(super) fn give_request(&self, net: NetId) {
        let Requests { rate: Some(rate), paid_until } = &self.net(net).requests else { return };
        let put_back = |paid_until| Some(rate.put_back(paid_until));
        // It always does something, so it cannot fail.
        let _ = paid_until.fetch_update(Relaxed, Relaxed, put_back);
    }

    /// Takes a place in this net, if both it and the router have one left.
    pub(super) fn take(&self, net: NetId) -> bool {
        let places = &self.net(net).places;
        if !places.take() {
            return false;
        }
        if !self.all.take() {
            places.give();
            return false;
        }
        true
    }

    /// Takes a place for a (socket, server) pair, which it has for as long as it rests too: as many
    /// pairs may rest as may be in use. So the sockets are bounded, however fast clients come and go.
    pub(super) fn take_pair(&self, net: NetId) -> Option<PairPlace> {
        let places = [&self.net(net).pairs, &self.all_pairs];
        if !places[0].take() {
            return None;
        }
        if !places[1].take() {
            places[0].give();
            return None;
        }
        Some(PairPlace(places.map(|places| Arc::clone(&places.taken))))
    }

    /// Whether a net has a place for another pair.
    #[cfg(test)]
    pub(super) fn has_room_for_pair(&self, net: NetId) -> bool {
        self.take_pair(net).is_some()
    }

    /// All pairs of all workers.
    #[cfg(test)]
    pub(super) fn pairs_taken(&self) -> usize {
        self.all_pairs.taken.load(Relaxed) as usize
    }

    /// Gives a place back.
    pub(super) fn give(&self, net: NetId) {
        self.net(net).places.give();
        self.all.give();
    }

    fn net(&self, net: NetId) -> &NetBudget {
        &self.nets[usize::from(net.0)]
    }
}

impl NetBudget {
    fn new(net: &Net) -> Self {
        let requests =
            Requests { paid_until: Arc::default(), rate: net.max_requests.map(|rate| rate.gcra) };
        let pairs = Places::new(pairs(net.max_flows));
        Self { places: Places::new(net.max_flows), pairs, requests }
    }

    fn with_limits(&self, net: &Net) -> Self {
        Self {
            places: Places { limit: net.max_flows, ..self.places.clone() },
            pairs: Places { limit: pairs(net.max_flows), ..self.pairs.clone() },
            requests: Requests {
                rate: net.max_requests.map(|rate| rate.gcra),
                ..self.requests.clone()
            },
        }
    }
}

impl Drop for PairPlace {
    fn drop(&mut self) {
        self.0.iter().for_each(|taken| _ = taken.fetch_sub(1, Relaxed));
    }
}

/// Pairs in use or resting, for so many flows.
fn pairs(max_flows: u32) -> u32 {
    max_flows.saturating_mul(2)
}

impl Places {
    fn new(limit: u32) -> Self {
        Self { taken: Arc::default(), limit }
    }

    /// A lower limit closes nothing; it is kept to when flows are opened.
    fn take(&self) -> bool {
        let one_more = |taken| (taken < self.limit).then_some(taken + 1);
        self.taken.fetch_update(Relaxed, Relaxed, one_more).is_ok()
    }

    fn give(&self) {
        self.taken.fetch_sub(1, Relaxed);
    }
}
