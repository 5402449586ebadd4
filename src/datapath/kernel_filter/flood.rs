//! Tells when a flood begins and when it is over. Only during a flood does a filter in the kernel
//! pay.

use std::time::Duration;

/// Watches for a flood, to tell when a filter in the kernel pays.
#[derive(Debug, Default)]
pub(in crate::datapath) struct FloodWatch {
    /// The number of the current tenth of a second, counted from the start of the relay.
    window: u64,
    /// Datagrams in this window that a filter would have kept from the worker.
    refused: usize,
    /// The kernel's figure at the last look.
    dropped: u32,
    quiet_looks: u32,
}

impl FloodWatch {
    /// This many datagrams in a tenth of a second are a flood.
    pub(in crate::datapath) const FLOOD: usize = 100;
    /// This many datagrams of one worker are a flood too, where no net has a flood of its own.
    pub(in crate::datapath) const FLOOD_OF_WORKER: usize = 10 * Self::FLOOD;
    /// Fewer dropped datagrams than this between two looks are quiet.
    const QUIET: u32 = 100;
    /// After this many quiet looks the flood is over. A worker looks about once a second.
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

    /// Notes the kernel's figure of dropped datagrams, and tells whether the flood is over.
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
