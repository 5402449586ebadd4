//! What the workers work from.

use std::sync::Arc;

use super::budget::FlowBudget;
use super::table::{Limits, Table};

/// What every worker works from; replaced whole by a new configuration.
#[derive(Clone, Debug)]
pub struct Rules {
    /// The NAT table.
    pub table: Arc<Table>,
    /// Bounds of the router as a whole.
    pub limits: Limits,
    /// Places for flows, shared by all workers.
    pub budget: Arc<FlowBudget>,
}

impl Rules {
    /// Rules with all places for flows free.
    pub fn new(table: Arc<Table>, limits: Limits) -> Self {
        let budget = Arc::new(FlowBudget::new(&table, &limits));
        Self { table, limits, budget }
    }
}
