//! The report of dropped datagrams. It stands in place of one log line for each datagram.
//!
//! `senders` finds out who sent what, `group` decides what is told of it and when, `line` writes it.

mod group;
mod line;
mod senders;
#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::datapath::{ActiveConfig, Router};
use crate::nat::{DropReason, MappingId, Table};
use crate::observe::totals::NodeTotals;
use strum::VariantArray;

use group::{Group, Window};
use senders::Senders;

/// Reports dropped datagrams. For each net and drop reason, a few senders have lines of their own,
/// and all others have one together: at the end of the first window with drops, and then every ten
/// minutes, while the drops go on, with the sum since the line before. The audit log uses the same
/// windows.
#[derive(Debug)]
pub struct DropReport {
    router: Arc<Router>,
    /// Datagrams dropped up to the end of the last window, by mapping and reason.
    reported: Vec<[u64; DropReason::COUNT]>,
    /// The table that these mappings belong to.
    table: Arc<Table>,
    senders: Senders,
    window_began: Instant,
    /// The drops that go on, by net and reason.
    going_on: HashMap<(String, DropReason), Group>,
}

impl DropReport {
    /// The length of a window.
    pub const WINDOW: Duration = Duration::from_secs(10);

    /// How often drops that go on get a line. After a pause of this length, they count as new.
    pub const INTERVAL: Duration = Duration::from_secs(600);

    /// How many senders have lines of their own at once, in all. So strangers cannot fill the log.
    const NAMED_IN_ALL: usize = 256;

    /// Makes the report and starts its first window.
    pub fn new(router: Arc<Router>) -> Self {
        let active = router.active_config();
        let table = Arc::clone(&active.config.table);
        let reported = table.mapping_ids().map(|mapping| dropped(&active, mapping)).collect();
        let mut senders = Senders::default();
        senders.since_last(&active);
        let (window_began, going_on) = (Instant::now(), HashMap::new());
        Self { router, reported, table, senders, window_began, going_on }
    }

    /// Reports, if the window is over. Returns whether all is reported and no drops go on.
    pub(super) fn look(&mut self) -> bool {
        // A look may come a little early.
        let is_over = self.window_began.elapsed() + Self::WINDOW / 4 >= Self::WINDOW;
        if is_over {
            self.report(Self::WINDOW, false);
        }
        is_over && self.going_on.is_empty()
    }

    /// Begins a window after a time without drops.
    pub(super) fn begin_window(&mut self) {
        self.window_began = Instant::now();
    }

    /// Reports the window that has begun. It is the last one.
    pub fn report_rest(&mut self) {
        self.report(self.window_began.elapsed(), true);
    }

    /// Ends the window and writes the lines that are due. For the `last` window, it writes all
    /// lines.
    fn report(&mut self, window: Duration, last: bool) {
        self.window_began = Instant::now();
        let active = self.router.active_config();
        self.router.audit().end_window(active.config.log.audit_lines, window);
        let counts = self.counts(&active);
        // After the counts, so that these have no drop that the sender's own count does not have.
        let mut senders = self.senders.since_last(&active);
        let named: usize = self.going_on.values().map(Group::named).sum();
        let places = Self::NAMED_IN_ALL.saturating_sub(named);
        let mut window = Window { time: window, is_last: last, places };
        let table = &active.config.table;
        for (net, counts) in table.net_ids().zip(counts) {
            for &reason in DropReason::VARIANTS {
                let name = &table.net(net).name;
                let senders = senders.remove(&(net, reason)).unwrap_or_default();
                let count = counts[reason as usize];
                let key = (name.clone(), reason);
                if count == 0 && senders.is_empty() && !self.going_on.contains_key(&key) {
                    continue;
                }
                let group = self.going_on.entry(key).or_default();
                for line in group.end_window(count, &senders, &mut window) {
                    line.write(&active, net, reason);
                }
                if !group.has_others() {
                    line::forget_sources(&active, net, reason);
                }
            }
        }
        let table = &self.table;
        self.going_on.retain(|(net, _), group| {
            !group.is_over() && table.nets().iter().any(|it| it.name == *net)
        });
    }

    /// The datagrams dropped in this window, by net and reason.
    fn counts(&mut self, active: &ActiveConfig) -> Vec<[u64; DropReason::COUNT]> {
        let table = &active.config.table;
        if !Arc::ptr_eq(table, &self.table) {
            self.reported = carried_over(&self.reported, &self.table, table);
            self.table = Arc::clone(table);
        }
        let mut counts = vec![[0; DropReason::COUNT]; table.nets().len()];
        for (mapping, reported) in table.mapping_ids().zip(&mut self.reported) {
            let dropped = dropped(active, mapping);
            let before = std::mem::replace(reported, dropped);
            let counts = &mut counts[usize::from(table.mapping(mapping).net.0)];
            for ((count, now), before) in counts.iter_mut().zip(dropped).zip(before) {
                // A smaller count means that the node was away and its counters began again.
                *count += now.checked_sub(before).unwrap_or(now);
            }
        }
        counts
    }
}

/// The datagrams dropped so far on the way to and from a node, by reason.
fn dropped(active: &ActiveConfig, mapping: MappingId) -> [u64; DropReason::COUNT] {
    let totals = NodeTotals::of_node(&active.counters, mapping);
    std::array::from_fn(|reason| totals.dropped(DropReason::VARIANTS[reason]))
}

/// Carries figures from the mappings of one table over to those of another. A node is found by its
/// net and node address.
fn carried_over<T: Copy + Default>(figures: &[T], old: &Table, new: &Table) -> Vec<T> {
    let figures: HashMap<_, _> = old.node_names().zip(figures).collect();
    new.node_names().map(|node| figures.get(&node).copied().copied().unwrap_or_default()).collect()
}
