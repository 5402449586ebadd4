//! How the last reload went, for who asks later: metrics, the API, the status page.

use std::time::Instant;

use crate::config::NotInForce;

/// How the last reload went; at first, the start.
#[derive(Clone, Debug)]
pub struct LastReload {
    /// Reloads that have begun since the start.
    pub begun: u64,
    /// Which of them the rest tells of; 0: the start.
    pub number: u64,
    /// Why it changed nothing.
    pub error: Option<String>,
    /// The faults of its configuration, one a line, as far as they are the reason.
    pub faults: Vec<String>,
    /// Settings of the active configuration that need a restart.
    pub(in crate::datapath) settled: Vec<NotInForce>,
    /// Its public sockets that could not be opened yet.
    pub(in crate::datapath) missing: Vec<NotInForce>,
    /// When the active configuration came into force.
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
    /// Whether all of the configuration that was last read is in force.
    pub fn successful(&self) -> bool {
        self.error.is_none() && self.settled.is_empty() && self.missing.is_empty()
    }

    /// What the last sound configuration has and what is not in force all the same.
    pub fn not_in_force(&self) -> impl Iterator<Item = &NotInForce> {
        self.settled.iter().chain(&self.missing)
    }

    /// Notes how the reload that has begun ended: why it changed nothing, or that it is in force.
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
