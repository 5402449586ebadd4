//! Who was refused of late: sender, net, node and reason, how often, and when first and last.
//!
//! The table has a fixed size and one writer. Each reason has places of its own, and few are for
//! reasons that scanners cause, so that noise takes none from clients. The places of a reason
//! stand in small sets. A hash that strangers cannot foresee chooses the set.
//!
//! What matters is in the table also during a flood of forged senders:
//!
//! - A sender takes the place of another only when it was [seen before](SeenBefore), so that
//!   senders that come once change nothing. Places of senders that are over are free for all.
//! - The longer half of the entries of a set is not replaced while their senders go on. Of the
//!   others, the one that was refused least often goes first, and one goes in a [`tick`] at most.
//!
//! So whoever is in the table and goes on stays, with the right count since `first`, and whoever
//! comes in a flood gets in after some datagrams. Each refused datagram counts for an entry or as
//! `not_listed`, once.
//!
//! There is no lock: whoever reads an entry while it is given to another sender leaves it out.
//!
//! The table takes 0.9 MB of address space, and as much memory as there were senders: the kernel
//! gives a page to whoever writes to it first, and most relays refuse few.

mod seen_before;
#[cfg(test)]
mod tests;

use std::array;
use std::hash::BuildHasher;
use std::net::IpAddr;
use std::ops::Range;
use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::Relaxed;

use foldhash::fast::FixedState;
use strum::VariantArray;
use zerocopy::FromZeros;

use super::counter::{Counter, Writer};
use super::reason::{Direction, DropReason};
use super::sequence_lock::{SequenceLock, address_of, words_of};
use super::time::Nanos;
use seen_before::SeenBefore;

/// Entries of one set.
const WAYS: usize = 14;
/// An entry whose sender was not refused for so long may be replaced by anybody.
const OVER: Nanos = 600_000_000_000;
/// The number of [`tick`]s between two searches of a set for such entries: a second.
const SEARCH: u32 = 15;

/// The refusals that one worker remembers.
#[derive(Debug)]
pub struct Refusals {
    /// Those of one reason behind those of another.
    sets: Box<[Set]>,
    /// Where the sets of each reason are: as many as a power of two.
    of_reason: [Range<usize>; DropReason::COUNT],
    /// For what may come from a client, and for noise.
    seen_before: [SeenBefore; 2],
    /// Refused datagrams that no entry counts: their senders found no place, or have lost it.
    pub not_listed: Counter,
}

/// Whose datagrams are refused, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Refused {
    /// The address that they come from, without the port.
    pub sender: IpAddr,
    /// The [key](net_key) of the net that they are for.
    pub net: u64,
    /// The node that they are for, or come from.
    pub node: u8,
    /// Which way they go.
    pub direction: Direction,
    /// Why they are refused.
    pub reason: DropReason,
}

/// How often and when somebody was refused for one reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Who and why.
    pub refused: Refused,
    /// Datagrams since `first`.
    pub count: u64,
    /// When the first of them came, in nanoseconds since the relay's start, plus one.
    pub first: Nanos,
    /// When the last of them came, in the same unit.
    pub last: Nanos,
}

/// What names a net in [`Refused`]: a hash of its name, which a reload does not change.
pub fn net_key(name: &str) -> u64 {
    FixedState::with_seed(0).hash_one(name)
}

/// Entries of one reason that share a part of the hash. A look at a set costs a cache line or two, and
/// as many for the entry.
//
// With an alignment of its own, a usual allocator would write zeros to all memory at the start. That of the program
// has the sets begin with a cache line anyway.
#[derive(Debug, FromZeros)]
struct Set {
    /// A part of the hash of each entry; 0: free. The free ones are the last ones.
    tags: [AtomicU32; WAYS],
    /// When an entry was replaced last, in ticks.
    replaced: AtomicU32,
    /// When the set was searched last for entries that are over, in ticks.
    searched: AtomicU32,
    entries: [Entry; WAYS],
}

/// The [`Refused`] in four words, then count, first and last.
#[derive(Debug, FromZeros)]
struct Entry(SequenceLock<7>);

impl Default for Refusals {
    fn default() -> Self {
        let mut end = 0;
        let of_reason = array::from_fn(|index| {
            let count = if DropReason::VARIANTS[index].is_malformed() { 4 } else { 32 };
            let start = end;
            end += count;
            start..end
        });
        Self {
            sets: FromZeros::new_box_zeroed_with_elems(end).expect("memory for a start"),
            of_reason,
            seen_before: [SeenBefore::new(16 * 1024), SeenBefore::new(1024)],
            not_listed: Counter::default(),
        }
    }
}

impl Refusals {
    /// Those of a datapath that refuses nothing.
    pub(super) fn none() -> Self {
        let seen_before = [SeenBefore::new(1), SeenBefore::new(1)];
        let of_reason = array::from_fn(|_| 0..0);
        Self { sets: Box::default(), of_reason, seen_before, not_listed: Counter::default() }
    }

    /// Notes a refused datagram. `hash` makes a hash that strangers cannot foresee.
    #[inline]
    pub fn note(&self, writer: &Writer, now: Nanos, refused: &Refused, hash: &impl BuildHasher) {
        let words = refused.to_words();
        let hash = hash.hash_one(words);
        let sets = &self.sets[self.of_reason[refused.reason as usize].clone()];
        let set = &sets[hash as usize & (sets.len() - 1)]; // a power of two
        let tag = (hash >> 32) as u32 | 1; // 0 is free
        let is_its =
            |&way: &usize| set.tags[way].load(Relaxed) == tag && set.entries[way].words() == words;
        if let Some(way) = (0..WAYS).find(is_its) {
            return set.entries[way].again(now);
        }
        let seen_before = &self.seen_before[usize::from(refused.reason.is_malformed())];
        match set.place(now, || seen_before.note(now, hash)) {
            Some(way) => {
                // 0 of a free entry.
                self.not_listed.add(writer, set.entries[way].count());
                set.tags[way].store(tag, Relaxed);
                set.entries[way].give_to(writer, words, now);
            }
            None => self.not_listed.add(writer, 1),
        }
    }

    /// What is remembered now.
    pub fn list(&self) -> impl Iterator<Item = Refusal> {
        // Most sets are empty.
        let used = self.sets.iter().filter(|set| set.tags[0].load(Relaxed) != 0);
        used.flat_map(|set| &set.entries).filter_map(Entry::get)
    }
}

impl Set {
    /// Where a newcomer may stand, if anywhere.
    fn place(&self, now: Nanos, is_seen_before: impl FnOnce() -> bool) -> Option<usize> {
        if let Some(free) = (0..WAYS).find(|&way| self.tags[way].load(Relaxed) == 0) {
            return Some(free);
        }
        let tick = tick(now);
        if tick.wrapping_sub(self.searched.load(Relaxed)) >= SEARCH {
            self.searched.store(tick, Relaxed);
            let oldest = (0..WAYS).min_by_key(|&way| self.entries[way].last());
            if oldest.is_some_and(|way| self.entries[way].is_over(now)) {
                return oldest;
            }
        }
        if !is_seen_before() || self.replaced.load(Relaxed) == tick {
            return None;
        }
        self.replaced.store(tick, Relaxed);
        self.weakest(now)
    }

    /// The entry that gives way to a newcomer.
    fn weakest(&self, now: Nanos) -> Option<usize> {
        let mut firsts = [0; WAYS];
        for (first, entry) in firsts.iter_mut().zip(&self.entries) {
            *first = entry.first();
        }
        firsts.sort_unstable();
        let median = firsts[WAYS / 2];
        (0..WAYS).min_by_key(|&way| {
            let entry = &self.entries[way];
            let count = entry.count();
            let goes_on = count > 1 && entry.first() < median;
            (!entry.is_over(now), goes_on, count, entry.last())
        })
    }
}

impl Entry {
    fn words(&self) -> [u64; 4] {
        array::from_fn(|index| self.0.words[index].load(Relaxed))
    }

    fn count(&self) -> u64 {
        self.0.words[4].load(Relaxed)
    }

    fn first(&self) -> Nanos {
        self.0.words[5].load(Relaxed)
    }

    fn last(&self) -> Nanos {
        self.0.words[6].load(Relaxed)
    }

    fn is_over(&self, now: Nanos) -> bool {
        now.saturating_sub(self.last()) >= OVER
    }

    #[inline]
    fn again(&self, now: Nanos) {
        self.0.words[4].store(self.count() + 1, Relaxed);
        self.0.words[6].store(now, Relaxed);
    }

    fn give_to(&self, writer: &Writer, [upper, lower, net, place]: [u64; 4], now: Nanos) {
        self.0.set(writer, [upper, lower, net, place, 1, now, now]);
    }

    /// What it says; none while it is free or being given to another sender.
    fn get(&self) -> Option<Refusal> {
        let [upper, lower, net, place, count, first, last] = self.0.get()?;
        let refused = Refused::from_words([upper, lower, net, place]).filter(|_| count > 0)?;
        Some(Refusal { refused, count, first, last })
    }
}

impl Refused {
    fn to_words(self) -> [u64; 4] {
        let Self { sender, net, node, direction, reason } = self;
        let [upper, lower] = words_of(sender);
        let place = u64::from(node) | (direction as u64) << 8 | (reason as u64) << 16;
        [upper, lower, net, place]
    }

    fn from_words([upper, lower, net, place]: [u64; 4]) -> Option<Self> {
        Some(Self {
            sender: address_of([upper, lower]),
            net,
            node: place as u8,
            direction: *Direction::VARIANTS.get((place >> 8) as usize & 0xFF)?,
            reason: *DropReason::VARIANTS.get((place >> 16) as usize)?,
        })
    }
}

/// A time in units of 67 ms, as the sets keep it.
fn tick(now: Nanos) -> u32 {
    (now >> 26) as u32
}
