//! Lines that the log gets now and then at most.

use std::io;
use std::time::{Duration, Instant};

/// How long nothing more is told.
const INTERVAL: Duration = Duration::from_secs(10);

/// Errors of the system, told at most every ten seconds: a broken network is one fact, not a
/// thousand lines.
#[derive(Debug, Default)]
pub(super) struct Complaints {
    last: Option<Instant>,
}

impl Complaints {
    /// Tells of an error, if none was told of lately.
    pub(super) fn note(&mut self, error: &io::Error, what: &'static str) {
        if self.due(Instant::now()) {
            tracing::warn!(%error, "{what}");
        }
    }

    /// Whether one may be told now.
    pub(super) fn due(&mut self, now: Instant) -> bool {
        let due = self.last.is_none_or(|last| now - last >= INTERVAL);
        if due {
            self.last = Some(now);
        }
        due
    }
}
