//! When which node is asked: in rounds, as often as the user says.

use std::num::NonZeroU32;
use std::time::Duration;

use tokio::time::Instant;

/// The requests that are still to be sent.
#[derive(Debug)]
pub(super) struct Schedule {
    nodes: usize,
    interval: Duration,
    rounds_left: u32,
    /// The node that is next in this round.
    next: usize,
    /// When the next round may begin. `None` for never.
    due: Option<Instant>,
}

impl Schedule {
    /// Some rounds to these nodes. The first begins now; the others begin this time after the one
    /// before, or as soon as that has been sent.
    pub(super) fn new(nodes: usize, rounds: NonZeroU32, interval: Duration, now: Instant) -> Self {
        Self { nodes, interval, rounds_left: rounds.get(), next: 0, due: Some(now) }
    }

    /// The node that is to be asked now.
    pub(super) fn next(&mut self, now: Instant) -> Option<usize> {
        if self.is_over() {
            return None;
        }
        if self.next == 0 {
            self.due.filter(|due| *due <= now)?;
            self.due = now.checked_add(self.interval);
        }
        let node = self.next;
        self.next += 1;
        if self.next == self.nodes {
            self.next = 0;
            self.rounds_left -= 1;
        }
        Some(node)
    }

    /// When the next round may begin. `None` for never.
    pub(super) fn due(&self) -> Option<Instant> {
        self.due.filter(|_| !self.is_over())
    }

    pub(super) fn is_over(&self) -> bool {
        self.rounds_left == 0 || self.nodes == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_keep_their_distance() {
        let second = Duration::from_secs(1);
        let start = Instant::now();
        let mut schedule = Schedule::new(2, NonZeroU32::new(3).unwrap(), second, start);
        let mut asked = |now| std::iter::from_fn(|| schedule.next(now)).collect::<Vec<_>>();
        assert_eq!(asked(start), [0, 1]);
        assert!(asked(start + second / 2).is_empty());
        // The second is late, so the third is as well.
        assert_eq!(asked(start + 2 * second), [0, 1]);
        assert!(asked(start + second * 5 / 2).is_empty());
        assert_eq!(asked(start + 3 * second), [0, 1]);
        assert!(asked(start + 100 * second).is_empty());
        assert!(schedule.is_over() && schedule.due().is_none());
    }
}
