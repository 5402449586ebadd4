//! Relays that die, are drained, and come back. Times are in milliseconds.

use std::collections::BTreeSet;

pub(crate) const SECOND: u64 = 1_000;
pub(crate) const MINUTE: u64 = 60 * SECOND;
pub(crate) const HOUR: u64 = 60 * MINUTE;

pub(crate) const RELAYS: usize = 1_000;
/// How long the simulation looks.
pub(crate) const TIME: u64 = 4 * HOUR;
/// Each relay dies once a week: far more often than hosts do, so that some die in this time.
const DIES_EVERY: u64 = 7 * 24 * HOUR;
/// A host starts again by itself, or somebody is called.
const DEAD_FOR: u64 = 10 * MINUTE;
/// An upgrade of all relays in a day, one after the other. Their order is not that of the router's list: where a
/// relay stands there decides how many clients a hash-threshold moves.
const DRAINED_EVERY: u64 = 24 * HOUR;
const DRAINED_STEP: u64 = 617;
/// A new kernel takes the host so long. A new program alone takes some 10 s.
const DRAINED_FOR: u64 = MINUTE;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Why {
    Died,
    Drained,
    Back,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Change {
    pub(crate) at: u64,
    pub(crate) relay: u16,
    pub(crate) why: Why,
}

/// All changes, in order.
pub(crate) fn changes(random: &mut Random) -> Vec<Change> {
    let mut changes = Vec::new();
    let mut away = BTreeSet::new(); // when it comes back, and who
    for now in 0..TIME {
        while let Some(&(at, relay)) = away.first().filter(|(at, _)| *at <= now) {
            away.pop_first();
            changes.push(Change { at, relay, why: Why::Back });
        }
        let mut goes = |relay: u16, why, time| {
            // A relay that is away already can neither die nor be drained.
            if !away.iter().any(|&(_, other)| other == relay) {
                away.insert((now + time, relay));
                changes.push(Change { at: now, relay, why });
            }
        };
        if random.below(DIES_EVERY / RELAYS as u64) == 0 {
            goes(random.below(RELAYS as u64) as u16, Why::Died, DEAD_FOR);
        }
        if now % (DRAINED_EVERY / RELAYS as u64) == 0 {
            let number = now / (DRAINED_EVERY / RELAYS as u64);
            let relay = (number * DRAINED_STEP % RELAYS as u64) as u16;
            goes(relay, Why::Drained, DRAINED_FOR);
        }
    }
    changes
}

/// splitmix64. It gives the same numbers at each run and on each machine.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.0)
    }

    /// A number below this one.
    pub(crate) fn below(&mut self, end: u64) -> u64 {
        ((u128::from(self.next()) * u128::from(end)) >> 64) as u64
    }
}

/// Spreads each bit over all: a good hash of 64 bits.
pub(crate) fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
