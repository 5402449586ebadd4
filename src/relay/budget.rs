//! How many flows may still be opened, and how many requests a net may still get, over all workers.
//!
//! The one thing that workers share. It is touched when a flow opens or closes; for a datagram only
//! where a net limits its requests. The kernel spreads clients over the workers by chance, so a
//! share for each worker would refuse one client while another's share lies idle.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

use super::flow::Nanos;
use super::rate::RequestRate;
use super::table::{Limits, NetId, Table};

/// Places for flows, one count for each net and one for the router (RFC 6888 REQ-11); and the
/// requests of each net.
#[derive(Debug)]
pub struct Budget {
    all: Places,
    nets: Box<[NetBudget]>,
}

#[derive(Debug)]
struct NetBudget {
    places: Places,
    requests: Option<Requests>,
}

#[derive(Debug)]
struct Requests {
    rate: RequestRate,
    paid_until: AtomicU64,
}

#[derive(Debug)]
struct Places {
    taken: AtomicU32,
    limit: u32,
}

impl Budget {
    /// All places free, and a second's requests for each net.
    pub fn new(table: &Table, limits: &Limits) -> Self {
        let places = |limit| Places { taken: AtomicU32::new(0), limit };
        let requests = |rate| Requests { rate, paid_until: AtomicU64::new(0) };
        let nets = table.nets().iter().map(|net| NetBudget {
            places: places(net.max_flows),
            requests: net.max_requests.map(requests),
        });
        Self { all: places(limits.max_flows), nets: nets.collect() }
    }

    /// Takes a request of this net, if it has one left.
    #[inline]
    pub(super) fn take_request(&self, net: NetId, now: Nanos) -> bool {
        let Some(Requests { rate, paid_until }) = &self.net(net).requests else { return true };
        paid_until.fetch_update(Relaxed, Relaxed, |paid_until| rate.take(paid_until, now)).is_ok()
    }

    /// Gives a request back that did not pass.
    pub(super) fn give_request(&self, net: NetId) {
        let Some(Requests { rate, paid_until }) = &self.net(net).requests else { return };
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

    /// Takes a place that the flow had under earlier limits, whatever the new ones say.
    pub(super) fn take_regardless(&self, net: NetId) {
        self.net(net).places.taken.fetch_add(1, Relaxed);
        self.all.taken.fetch_add(1, Relaxed);
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

impl Places {
    fn take(&self) -> bool {
        let one_more = |taken| (taken < self.limit).then_some(taken + 1);
        self.taken.fetch_update(Relaxed, Relaxed, one_more).is_ok()
    }

    fn give(&self) {
        self.taken.fetch_sub(1, Relaxed);
    }
}
