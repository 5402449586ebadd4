//! Decides when a worker polls for the next datagram instead of sleeping.
//!
//! A wake-up costs more than many polls. But polling pays only while datagrams come close together.
//! So a worker sleeps when it has polled in vain, or when datagrams come seldom.

use std::time::{Duration, Instant};

/// The state of one worker's polling.
#[derive(Debug)]
pub(in crate::datapath) struct BusyPoll {
    /// How long polling may last. With zero, the worker does not poll.
    limit: Duration,
    last: Option<Instant>,
    looking: bool,
}

impl BusyPoll {
    pub(in crate::datapath) fn new(limit: Duration) -> Self {
        Self { limit, last: None, looking: false }
    }

    /// Notes how many sockets were ready.
    pub(in crate::datapath) fn note(&mut self, now: Instant, ready: usize) {
        if self.limit.is_zero() {
            return;
        }
        let close = self.last.is_some_and(|last| now - last <= self.limit);
        self.looking = close;
        if ready > 0 {
            self.last = Some(now);
        }
    }

    /// Whether the worker should poll again instead of sleeping.
    pub(in crate::datapath) fn goes_on(&self) -> bool {
        self.looking
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Duration = Duration::from_micros(50);

    #[test]
    fn looks_while_datagrams_come_close_together_and_no_longer() {
        let mut busy = BusyPoll::new(LIMIT);
        let mut now = Instant::now();
        busy.note(now, 1);
        assert!(!busy.goes_on(), "one alone says nothing");
        now += LIMIT;
        busy.note(now, 1);
        assert!(busy.goes_on());
        busy.note(now + LIMIT, 0);
        assert!(busy.goes_on());
        busy.note(now + 2 * LIMIT, 0);
        assert!(!busy.goes_on(), "in vain");
        busy.note(now + 1000 * LIMIT, 1);
        assert!(!busy.goes_on(), "seldom");
    }

    #[test]
    fn never_looks_without_a_limit() {
        let mut busy = BusyPoll::new(Duration::ZERO);
        let now = Instant::now();
        busy.note(now, 1);
        busy.note(now, 1);
        assert!(!busy.goes_on());
    }
}
