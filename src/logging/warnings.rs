//! Warnings that appear in the log only from time to time.

use std::collections::HashMap;
use std::io;
use std::time::{Duration, Instant};

use crate::nat::{NetId, Table};

/// How long the same warning is not written again.
const INTERVAL: Duration = Duration::from_secs(10);

/// What a warning is about: the sentence, the system's error code, and the net that it concerns.
/// Each combination is a fact of its own.
type Fact = (&'static str, Option<i32>, Option<NetId>);

/// Warnings about errors of the system. The same warning is written once in ten seconds at most: a
/// broken network is one fact, and should not fill the log with a thousand lines. The net IDs
/// belong to one table. With another table, a new value of this type is necessary.
#[derive(Debug, Default)]
pub(crate) struct RateLimitedWarnings {
    /// When each warning was written last. The map stays small: only a few errors occur with each
    /// sentence.
    last: HashMap<Fact, Instant>,
}

impl RateLimitedWarnings {
    /// Warns of an error that concerns no particular net, unless the same warning was just written.
    pub(crate) fn note(&mut self, error: &io::Error, what: &'static str) {
        if self.is_due(Instant::now(), (what, error.raw_os_error(), None)) {
            tracing::warn!(%error, "{what}");
        }
    }

    /// Warns of an error that concerns a net of this table, unless the same warning was just
    /// written.
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

    /// Whether a warning with this sentence may be written now.
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
