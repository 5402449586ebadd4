//! How many flows may still be opened, over all workers.
//!
//! The one thing that workers share. It is touched when a flow opens or closes, never for a
//! datagram.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use super::table::{Limits, NetId, Table};

/// Places for flows: one count for each net and one for the router (RFC 6888 REQ-11).
#[derive(Debug)]
pub struct FlowBudget {
    all: Places,
    nets: Box<[Places]>,
}

#[derive(Debug)]
struct Places {
    taken: AtomicU32,
    limit: u32,
}

impl FlowBudget {
    /// All places free.
    pub fn new(table: &Table, limits: &Limits) -> Self {
        let places = |limit| Places { taken: AtomicU32::new(0), limit };
        let nets = table.nets().iter().map(|net| places(net.max_flows)).collect();
        Self { all: places(limits.max_flows), nets }
    }

    /// Takes a place in this net, if both it and the router have one left.
    pub(super) fn take(&self, net: NetId) -> bool {
        let places = &self.nets[usize::from(net.0)];
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
        self.nets[usize::from(net.0)].taken.fetch_add(1, Relaxed);
        self.all.taken.fetch_add(1, Relaxed);
    }

    /// Gives a place back.
    pub(super) fn give(&self, net: NetId) {
        self.nets[usize::from(net.0)].give();
        self.all.give();
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
