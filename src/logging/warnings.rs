//! Lines that the log gets now and then at most.

use std::collections::HashMap;
use std::io;
use std::time::{Duration, Instant};

use crate::nat::{NetId, Table};

/// How long nothing more is told.
const INTERVAL: Duration = Duration::from_secs(10);

/// What is told of: each sentence is a fact of its own with each error of the system, and in each net
/// that it concerns.
type Fact = (&'static str, Option<i32>, Option<NetId>);

/// Errors of the system, each told at most every ten seconds: a broken network is one fact, not a
/// thousand lines. Nets are those of one table: with another, there have to be new ones.
#[derive(Debug, Default)]
pub(crate) struct RateLimitedWarnings {
    /// When each was told last. A sentence has few errors.
    last: HashMap<Fact, Instant>,
}

impl RateLimitedWarnings {
    /// Tells of an error that is no net's, if it was not told of lately.
    pub(crate) fn note(&mut self, error: &io::Error, what: &'static str) {
        if self.is_due(Instant::now(), (what, error.raw_os_error(), None)) {
            tracing::warn!(%error, "{what}");
        }
    }

    /// Tells of an error that concerns a net of this table, likewise.
    pub(crate) fn note_of(
        &mut self,
        net: NetId,
        table: &Table,
        error: &io::Error,
        what: &'static str,
    ) {
        if self.is_due(Instant::now(), (what, error.raw_os_error(), Some(net))) {
            tracing::warn!(net = table.net(net).name, %error, "{what}");
        }
    }

    /// Whether this may be told now.
    pub(crate) fn due(&mut self, now: Instant, what: &'static str) -> bool {
        self.is_due(now, (what, None, None))
    }

    fn is_due(&mut self, now: Instant, fact: Fact) -> bool {
        let is_due = self.last.get(&fact).is_none_or(|&last| now - last >= INTERVAL);
        if is_due {
            self.last.insert(fact, now);
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fact_has_its_own_turn() {
        let mut warnings = RateLimitedWarnings::default();
        let now = Instant::now();
        let fact = |error, net| ("send", Some(error), Some(NetId(net)));
        assert!(warnings.is_due(now, fact(libc::ENETUNREACH, 0)));
        assert!(!warnings.is_due(now, fact(libc::ENETUNREACH, 0)));
        assert!(warnings.is_due(now, fact(libc::EPERM, 0)), "another error");
        assert!(warnings.is_due(now, fact(libc::ENETUNREACH, 1)), "another net");
        assert!(!warnings.is_due(now, fact(libc::ENETUNREACH, 1)));
        assert!(warnings.due(now, "flood"));
        assert!(warnings.is_due(now + INTERVAL, fact(libc::ENETUNREACH, 0)));
    }
}
