//! How the last reload went. Metrics, the API and the status page ask for this later.

use std::time::Instant;

use crate::config::{Changes, NotInForce};
use crate::datapath::Reloaded;

/// How the last reload went. Before the first reload, it stands for the start.
#[derive(Clone, Debug)]
pub struct LastReload {
    /// Number of reloads that have begun since the start.
    pub begun: u64,
    /// Number of the reload that the other fields tell of. 0 stands for the start.
    pub number: u64,
    /// Why the reload changed nothing.
    pub error: Option<String>,
    /// The faults of the configuration, one per line, where they are the reason.
    pub faults: Vec<String>,
    /// What it changed; nothing when it failed.
    pub changes: Changes,
    /// Flows that it closed because the new configuration has no place for them.
    pub flows_closed: usize,
    /// Settings of the configuration in force that need a restart.
    pub(in crate::datapath) settled: Vec<NotInForce>,
    /// Public sockets of the configuration in force that could not be opened yet.
    pub(in crate::datapath) missing: Vec<NotInForce>,
    /// When the configuration in force came into force.
    pub success_at: Instant,
}

impl Default for LastReload {
    fn default() -> Self {
        Self {
            begun: 0,
            number: 0,
            error: None,
            faults: Vec::new(),
            changes: Changes::default(),
            flows_closed: 0,
            settled: Vec::new(),
            missing: Vec::new(),
            success_at: Instant::now(),
        }
    }
}

impl LastReload {
    /// Whether all of the configuration that was read last is in force.
    pub fn successful(&self) -> bool {
        self.error.is_none() && self.settled.is_empty() && self.missing.is_empty()
    }

    /// The parts of the last sound configuration that are not in force.
    pub fn not_in_force(&self) -> impl Iterator<Item = &NotInForce> {
        self.settled.iter().chain(&self.missing)
    }

    /// Notes that the reload that has begun changed nothing, and why.
    pub(in crate::datapath) fn failed(&mut self, error: String, faults: Vec<String>) {
        (self.number, self.error, self.faults) = (self.begun, Some(error), faults);
        (self.changes, self.flows_closed) = (Changes::default(), 0);
    }

    /// Notes that the configuration of the reload that has begun is in force.
    pub(in crate::datapath) fn succeeded(&mut self, reloaded: &Reloaded) {
        (self.number, self.error, self.faults) = (self.begun, None, Vec::new());
        (self.changes, self.flows_closed) = (reloaded.changes.clone(), reloaded.flows_closed);
        self.success_at = Instant::now();
    }
}
