//! How the last reload went. Metrics, the API and the status page ask for this later.

use std::time::Instant;

use crate::config::NotInForce;

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

    /// Notes how the reload that has begun ended. `failed` tells why it changed nothing; without
    /// it, the configuration is in force.
    pub(in crate::datapath) fn ended(&mut self, failed: Option<(String, Vec<String>)>) {
        self.number = self.begun;
        match failed {
            Some((error, faults)) => (self.error, self.faults) = (Some(error), faults),
            None => {
                (self.error, self.faults) = (None, Vec::new());
                self.success_at = Instant::now();
            }
        }
    }
}
