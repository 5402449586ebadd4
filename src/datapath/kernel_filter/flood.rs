//! When there is a flood, and when it is over: whether a filter in the kernel pays.

use std::time::Duration;

/// Watches for a flood, to tell when a filter in the kernel pays.
#[derive(Debug, Default)]
pub(in crate::datapath) struct FloodWatch {
    /// Which tenth of a second it is, since the router's start.
    window: u64,
    /// Datagrams in this window that a filter would have refused the worker.
    refused: usize,
    /// The kernel's figure at the last look.
    dropped: u32,
    quiet_looks: u32,
}

impl FloodWatch {
    /// So many in a tenth of a second are a flood.
    pub(in crate::datapath) const FLOOD: usize = 100;
    /// And so many of one worker, where no net has that many.
    pub(in crate::datapath) const FLOOD_OF_WORKER: usize = 10 * Self::FLOOD;
    /// Fewer between two looks are quiet,
    const QUIET: u32 = 100;
    /// and so many quiet looks are peace. A worker looks about once a second.
    const QUIET_LOOKS: u32 = 10;

    /// Notes `refused` more datagrams, and tells whether a flood has begun.
    pub(in crate::datapath) fn flooded(
        &mut self,
        since_start: Duration,
        refused: usize,
        flood: usize,
    ) -> bool {
        let window = since_start.as_millis() as u64 / 100;
        if window != self.window {
            (self.window, self.refused) = (window, 0);
        }
        self.refused += refused;
        self.refused >= flood
    }

    /// Takes the kernel's figure, and tells whether the flood is over.
    pub(in crate::datapath) fn over(&mut self, dropped: u32) -> bool {
        let new = dropped.wrapping_sub(std::mem::replace(&mut self.dropped, dropped));
        self.quiet_looks = if new < Self::QUIET { self.quiet_looks + 1 } else { 0 };
        let over = self.quiet_looks >= Self::QUIET_LOOKS;
        if over {
            (self.quiet_looks, self.refused) = (0, 0);
        }
        over
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_begins_within_a_tenth_of_a_second_and_ends_after_ten_quiet_looks() {
        let mut watch = FloodWatch::default();
        let tenth = |n: u64| Duration::from_millis(100 * n);
        for n in 0..50 {
            assert!(!watch.flooded(tenth(n), 99, FloodWatch::FLOOD), "990 a second are none");
        }
        assert!(watch.flooded(tenth(49), 1, FloodWatch::FLOOD));
        let mut dropped = u32::MAX - 50;
        let mut look = |new| {
            dropped = dropped.wrapping_add(new);
            watch.over(dropped)
        };
        assert!(!look(0), "what the kernel dropped before counts once");
        assert!((0..9).all(|_| !look(99)) && !look(100) && (0..9).all(|_| !look(0)));
        assert!(look(0));
        assert!(!watch.flooded(tenth(49), 99, FloodWatch::FLOOD));
    }
}
