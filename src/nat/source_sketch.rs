//! How many different sources sent dropped datagrams: an estimate in fixed memory, whatever
//! arrives.
//!
//! Linear counting (Whang, Vander-Zanden, Taylor, 1990): each source sets the one bit that its
//! hash names; the share of bits still clear tells how many there were. Sources are never stored.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

const BITS: u32 = 1024;
const WORDS: usize = (BITS / u64::BITS) as usize;

/// A bitmap of 1024 bits with one writer; a reader may clear it.
#[derive(Debug, Default)]
pub struct SourceSketch([AtomicU64; WORDS]);

impl SourceSketch {
    /// The largest estimate, reached with one bit still clear: 1024 · ln 1024. It stands for
    /// itself and everything above.
    pub const MOST: u32 = 7098;

    /// Notes a source. All sketches that are merged must be given hashes of the same function.
    pub fn note(&self, hash: u64) {
        let bit = mixed(hash) >> (u64::BITS - BITS.ilog2());
        let (word, mask) = (&self.0[(bit / 64) as usize], 1 << (bit % 64));
        // A source that goes on and on costs a load: the cache line stays shared.
        if word.load(Relaxed) & mask == 0 {
            word.fetch_or(mask, Relaxed);
        }
    }

    /// About how many different sources these sketches have seen together, 0 to
    /// [`MOST`](Self::MOST). A source that two of them saw counts once.
    pub fn estimate<'a>(sketches: impl Iterator<Item = &'a Self>) -> u32 {
        Self::merge(sketches, |word| word.load(Relaxed))
    }

    /// The same, and clears them.
    pub fn take_estimate<'a>(sketches: impl Iterator<Item = &'a Self>) -> u32 {
        Self::merge(sketches, |word| word.swap(0, Relaxed))
    }

    fn merge<'a>(
        sketches: impl Iterator<Item = &'a Self>,
        read: impl Fn(&AtomicU64) -> u64,
    ) -> u32 {
        let mut merged = [0; WORDS];
        for sketch in sketches {
            for (bits, word) in merged.iter_mut().zip(&sketch.0) {
                *bits |= read(word);
            }
        }
        let clear: u32 = merged.iter().map(|bits| bits.count_zeros()).sum();
        let share = f64::from(clear.max(1)) / f64::from(BITS);
        (-f64::from(BITS) * share.ln()).round() as u32
    }
}

/// Spreads the hash over the high bits (the finalizer of SplitMix64). A fast hash spreads
/// neighbouring addresses too evenly, and linear counting expects the collisions of chance.
fn mixed(hash: u64) -> u64 {
    let hash = (hash ^ (hash >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (hash ^ (hash >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb)
}

#[cfg(test)]
mod tests {
    use std::hash::BuildHasher;
    use std::net::Ipv4Addr;

    use super::*;

    /// Sketches of two workers that saw `count` sources between them; each saw every third.
    fn two_workers(count: u32) -> [SourceSketch; 2] {
        let sketches = [SourceSketch::default(), SourceSketch::default()];
        let state = foldhash::fast::FixedState::with_seed(7);
        for source in 0..count {
            let hash = state.hash_one(Ipv4Addr::from_bits(0x0a00_0000 + source));
            sketches[source as usize % 2].note(hash);
            if source % 3 == 0 {
                sketches.iter().for_each(|sketch| sketch.note(hash));
            }
        }
        sketches
    }

    #[test]
    fn few_sources_are_counted_exactly_and_many_nearly() {
        for (count, tolerance) in [(0, 0), (1, 0), (5, 0), (300, 15), (3000, 300)] {
            let estimate = SourceSketch::take_estimate(two_workers(count).iter());
            assert!(estimate.abs_diff(count) <= tolerance, "{estimate} of {count}");
        }
    }

    #[test]
    fn a_flood_of_sources_reads_as_the_most() {
        let estimate = SourceSketch::take_estimate(two_workers(100_000).iter());
        assert_eq!(estimate, SourceSketch::MOST);
    }

    #[test]
    fn taking_clears_and_looking_does_not() {
        let sketches = two_workers(300);
        let seen = SourceSketch::estimate(sketches.iter());
        assert_ne!(seen, 0);
        assert_eq!(SourceSketch::take_estimate(sketches.iter()), seen);
        assert_eq!(SourceSketch::take_estimate(sketches.iter()), 0);
    }
}
