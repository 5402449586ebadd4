//! Which senders were refused a moment ago, without their names: a table of fingerprints.
//!
//! A fingerprint keeps its place for two seconds before another may have it. So a flood cannot
//! wash a sender out before it comes again, however fast it is, and a sender that comes only once
//! is not taken for another one but once in 16 million times.

use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::Relaxed;

use crate::nat::time::Nanos;

/// How long a fingerprint keeps its place, in units of 0.27 s.
const KEPT: u8 = 8;

/// A power of two of places with one writer.
#[derive(Debug)]
pub(super) struct SeenBefore(
    /// The upper 24 bits of a hash, and the time; 0: nobody.
    Box<[AtomicU32]>,
);

impl SeenBefore {
    pub(super) fn new(places: usize) -> Self {
        Self((0..places).map(|_| AtomicU32::new(0)).collect())
    }

    /// Notes a hash, if there is room for it, and tells whether it was noted before.
    pub(super) fn note(&self, now: Nanos, hash: u64) -> bool {
        // It wraps after 68 s. Then an old fingerprint may keep its place for two seconds more.
        let time = (now >> 28) as u8;
        let place = &self.0[hash as usize & (self.0.len() - 1)];
        let there = place.load(Relaxed);
        let fingerprint = (hash >> 40) as u32;
        let is_it = there >> 8 == fingerprint && there != 0;
        if is_it || there == 0 || time.wrapping_sub(there as u8) >= KEPT {
            place.store(fingerprint << 8 | u32::from(time), Relaxed);
        }
        is_it
    }
}
