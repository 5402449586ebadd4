//! An estimate of how many different sources sent dropped datagrams, in memory of fixed size.
//!
//! Linear counting (Whang, Vander-Zanden, Taylor, 1990): the hash of each source chooses one bit to
//! set, and the share of bits still clear tells how many sources there were. Sources are not
//! stored.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

const BITS: u32 = 1024;
const WORDS: usize = (BITS / u64::BITS) as usize;

/// A bitmap of 1024 bits with one writer; a reader may clear it.
#[derive(Debug, Default)]
pub struct SourceSketch([AtomicU64; WORDS]);

impl SourceSketch {
    /// The largest estimate, when one bit is still clear: 1024 · ln 1024. It also stands for every
    /// larger number.
    pub const MOST: u32 = 7098;

    /// Notes a source by its hash. Sketches that are merged need hashes of the same function.
    pub fn note(&self, hash: u64) {
        let bit = mixed(hash) >> (u64::BITS - BITS.ilog2());
        let (word, mask) = (&self.0[(bit / 64) as usize], 1 << (bit % 64));
        // A source that sends on and on costs only a load: the cache line stays shared.
        if word.load(Relaxed) & mask == 0 {
            word.fetch_or(mask, Relaxed);
        }
    }

    /// About how many different sources these sketches have noted together, 0 to
    /// [`MOST`](Self::MOST). A source that two sketches noted counts once.
    pub fn estimate<'a>(sketches: impl Iterator<Item = &'a Self>) -> u32 {
        Self::merge(sketches, |word| word.load(Relaxed))
    }

    /// As [`estimate`](Self::estimate), and clears the sketches.
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

/// Mixes the hash again (the finalizer of SplitMix64). A fast hash spreads neighbouring addresses
/// too evenly, but linear counting expects as many collisions as chance makes.
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
