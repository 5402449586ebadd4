//! Lines that the log gets now and then at most.

use std::io;
use std::time::{Duration, Instant};

/// How long nothing more is told.
const INTERVAL: Duration = Duration::from_secs(10);

/// Errors of the system, each kind told at most every ten seconds: a broken network is one fact, not
/// a thousand lines.
#[derive(Debug, Default)]
pub(super) struct Complaints {
    /// When each was told last. There are as many as there are sentences in the code.
    last: Vec<(&'static str, Instant)>,
}

impl Complaints {
    /// Tells of an error, if none was told of lately.
    pub(super) fn note(&mut self, error: &io::Error, what: &'static str) {
        if self.due(Instant::now(), what) {
            tracing::warn!(%error, "{what}");
        }
    }

    /// Whether this may be told now.
    pub(super) fn due(&mut self, now: Instant, what: &'static str) -> bool {
        match self.last.iter_mut().find(|(told, _)| *told == what) {
            Some((_, last)) if now - *last < INTERVAL => return false,
            Some((_, last)) => *last = now,
            None => self.last.push((what, now)),
        }
        true
    }
}
