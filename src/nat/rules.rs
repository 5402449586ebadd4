//! The rules of a configuration: its table and limits, and what the workers share under them.

use std::sync::Arc;

use super::budget::Budget;
use super::known_clients::Known;
use super::table::{Limits, Table};

/// What every worker works by. A new configuration replaces it as a whole.
#[derive(Clone, Debug)]
pub struct Rules {
    /// The NAT table.
    pub table: Arc<Table>,
    /// Bounds of the router as a whole.
    pub limits: Limits,
    /// Places for flows, and requests of the nets, shared by all workers.
    pub budget: Arc<Budget>,
    /// Clients of all workers whose password was right lately.
    pub(super) known: Known,
}

impl Rules {
    /// Rules under which no flow is open and no request was sent yet.
    pub fn new(table: Arc<Table>, limits: Limits) -> Self {
        let budget = Arc::new(Budget::new(&table, &limits));
        let known = Known::new(&table);
        Self { table, limits, budget, known }
    }

    /// Flows that may be open at once.
    pub(crate) fn most_flows(&self) -> usize {
        let of_nets = self.table.nets().iter().map(|net| net.max_flows as usize).sum();
        (self.limits.max_flows as usize).min(of_nets)
    }

    /// The rules that replace these. Open flows and sent requests still count, and known clients
    /// stay known.
    pub fn followed_by(&self, table: Arc<Table>, limits: Limits) -> Self {
        let budget = Arc::new(self.budget.with_limits(&self.table, &table, &limits));
        let known = self.known.followed_by(&self.table, &table);
        Self { table, limits, budget, known }
    }
}
