//! How many more flows may be opened, and how many more requests a net may send, over all workers.
//!
//! The workers share this. They touch it when a flow opens or closes, and for each request only
//! where a net limits its requests. A share for each worker would not do: the kernel spreads
//! clients over the workers by chance, so one share would be used up while another has room.
//!
//! A new configuration brings other limits, but what is taken stays taken. So the limits hold while
//! one worker after the other goes over to the new configuration.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

use super::gcra::Gcra;
use super::ids::NetId;
use super::net::Net;
use super::table::{Limits, Table};
use super::time::Nanos;

/// Places for flows, in each net and in the router as a whole (RFC 6888 REQ-11), and the requests
/// of each net.
#[derive(Debug)]
pub struct Budget {
    all: Places,
    all_leases: Places,
    nets: Box<[NetBudget]>,
}

#[derive(Clone, Debug)]
struct NetBudget {
    places: Places,
    /// Places for leases, in use or resting.
    leases: Places,
    requests: Requests,
}

#[derive(Clone, Debug)]
struct Requests {
    paid_until: Arc<AtomicU64>,
    rate: Option<Gcra>,
}

/// The places of one lease of an upstream socket, in its net and in the router. Dropping gives them back.
#[derive(Debug)]
pub(super) struct LeasePlace([Arc<AtomicU32>; 2]);

#[derive(Clone, Debug)]
struct Places {
    taken: Arc<AtomicU32>,
    limit: u32,
}

impl Budget {
    /// All places free, and a second's requests for each net.
    pub fn new(table: &Table, limits: &Limits) -> Self {
        let nets = table.nets().iter().map(NetBudget::new).collect();
        let all_leases = Places::new(leases(limits.max_flows));
        Self { all: Places::new(limits.max_flows), all_leases, nets }
    }

    /// The budget for the table `new` with these limits. What is taken of this one, whose table is
    /// `old`, stays taken. A net is the same if it has the same name.
    pub(super) fn with_limits(&self, old: &Table, new: &Table, limits: &Limits) -> Self {
        let known: HashMap<_, _> = old.nets().iter().map(|net| &net.name).zip(&self.nets).collect();
        let next = |net: &Net| match known.get(&net.name) {
            Some(before) => before.with_limits(net),
            None => NetBudget::new(net),
        };
        let nets = new.nets().iter().map(next).collect();
        let all_leases = Places { limit: leases(limits.max_flows), ..self.all_leases.clone() };
        Self { all: Places { limit: limits.max_flows, ..self.all.clone() }, all_leases, nets }
    }

    /// Takes one of this net's requests, if there is one left. True if so, and without a limit.
    #[inline]
    pub(super) fn take_request(&self, net: NetId, now: Nanos) -> bool {
        let Requests { rate: Some(rate), paid_until } = &self.net(net).requests else {
            return true;
        };
        paid_until.fetch_update(Relaxed, Relaxed, |paid_until| rate.take(paid_until, now)).is_ok()
    }

    /// Gives back a request that did not pass.
    pub(super) fn give_request(&self, net: NetId) {
        let Requests { rate: Some(rate), paid_until } = &self.net(net).requests else { return };
        let put_back = |paid_until| Some(rate.put_back(paid_until));
        // `put_back` never returns None, so this cannot fail.
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

    /// Takes the places of a lease, which it keeps while it rests. As many leases
    /// may rest as may be in use, so the number of sockets has a bound however fast clients come
    /// and go.
    pub(super) fn take_lease(&self, net: NetId) -> Option<LeasePlace> {
        let places = [&self.net(net).leases, &self.all_leases];
        if !places[0].take() {
            return None;
        }
        if !places[1].take() {
            places[0].give();
            return None;
        }
        Some(LeasePlace(places.map(|places| Arc::clone(&places.taken))))
    }

    /// Whether there is a place for another lease in this net.
    #[cfg(test)]
    pub(super) fn has_room_for_lease(&self, net: NetId) -> bool {
        self.take_lease(net).is_some()
    }

    /// Leases in use or resting, of all workers.
    #[cfg(test)]
    pub(super) fn leases_taken(&self) -> usize {
        self.all_leases.taken.load(Relaxed) as usize
    }

    /// Gives back a place in this net.
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
        let leases = Places::new(leases(net.max_flows));
        Self { places: Places::new(net.max_flows), leases, requests }
    }

    fn with_limits(&self, net: &Net) -> Self {
        Self {
            places: Places { limit: net.max_flows, ..self.places.clone() },
            leases: Places { limit: leases(net.max_flows), ..self.leases.clone() },
            requests: Requests {
                rate: net.max_requests.map(|rate| rate.gcra),
                ..self.requests.clone()
            },
        }
    }
}

impl Drop for LeasePlace {
    fn drop(&mut self) {
        self.0.iter().for_each(|taken| _ = taken.fetch_sub(1, Relaxed));
    }
}

/// Places for leases, in use or resting, where so many flows may be open.
fn leases(max_flows: u32) -> u32 {
    max_flows.saturating_mul(2)
}

impl Places {
    fn new(limit: u32) -> Self {
        Self { taken: Arc::default(), limit }
    }

    /// More may be taken than a new, lower limit allows. Then this fails until enough are given
    /// back.
    fn take(&self) -> bool {
        let one_more = |taken| (taken < self.limit).then_some(taken + 1);
        self.taken.fetch_update(Relaxed, Relaxed, one_more).is_ok()
    }

    fn give(&self) {
        self.taken.fetch_sub(1, Relaxed);
    }
}
