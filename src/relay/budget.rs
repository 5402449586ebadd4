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

use super::flow::Nanos;
use super::rate::RequestRate;
use super::table::{Limits, Net, NetId, Table};

/// Places for flows, one count for each net and one for the router (RFC 6888 REQ-11); and the
/// requests of each net.
#[derive(Debug)]
pub struct Budget {
    all: Places,
    nets: Box<[NetBudget]>,
}

#[derive(Clone, Debug)]
struct NetBudget {
    places: Places,
    requests: Requests,
}

#[derive(Clone, Debug)]
struct Requests {
    paid_until: Arc<AtomicU64>,
    rate: Option<RequestRate>,
}

#[derive(Clone, Debug)]
struct Places {
    taken: Arc<AtomicU32>,
    limit: u32,
}

impl Budget {
    /// All places free, and a second's requests for each net.
    pub fn new(table: &Table, limits: &Limits) -> Self {
        let nets = table.nets().iter().map(NetBudget::new).collect();
        Self { all: Places::new(limits.max_flows), nets }
    }

    /// Other limits for what is taken of this budget, whose table is `old`. Nets are known by name.
    pub(super) fn with_limits(&self, old: &Table, new: &Table, limits: &Limits) -> Self {
        let known: HashMap<_, _> = old.nets().iter().map(|net| &net.name).zip(&self.nets).collect();
        let next = |net: &Net| match known.get(&net.name) {
            Some(before) => before.with_limits(net),
            None => NetBudget::new(net),
        };
        let nets = new.nets().iter().map(next).collect();
        Self { all: Places { limit: limits.max_flows, ..self.all.clone() }, nets }
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
        let requests = Requests { paid_until: Arc::default(), rate: net.max_requests };
        Self { places: Places::new(net.max_flows), requests }
    }

    fn with_limits(&self, net: &Net) -> Self {
        Self {
            places: Places { limit: net.max_flows, ..self.places.clone() },
            requests: Requests { rate: net.max_requests, ..self.requests.clone() },
        }
    }
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
