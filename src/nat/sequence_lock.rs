//! Words that belong together: one writer, any number of readers, and nobody waits.
//!
//! The writer counts a version up before and after each change, so that a reader notices when it
//! read while a change was under way.

use std::array;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};
use std::sync::atomic::{AtomicU64, fence};

use zerocopy::FromZeros;

use super::counter::Writer;

#[derive(Debug, FromZeros)]
pub(super) struct SequenceLock<const N: usize> {
    /// Odd while the words are being changed.
    pub(super) version: AtomicU64,
    /// The writer may change a single word without a new version, where readers can do with it.
    pub(super) words: [AtomicU64; N],
}

impl<const N: usize> Default for SequenceLock<N> {
    fn default() -> Self {
        Self { version: AtomicU64::new(0), words: array::from_fn(|_| AtomicU64::new(0)) }
    }
}

impl<const N: usize> SequenceLock<N> {
    /// Changes all words.
    pub(super) fn set(&self, _: &Writer, values: [u64; N]) {
        let version = self.version.load(Relaxed);
        self.version.store(version.wrapping_add(1), Relaxed);
        fence(Release);
        for (word, value) in self.words.iter().zip(values) {
            word.store(value, Relaxed);
        }
        self.version.store(version.wrapping_add(2), Release);
    }

    /// All words; none while they are being changed.
    pub(super) fn get(&self) -> Option<[u64; N]> {
        let version = self.version.load(Acquire);
        let words = self.words.each_ref().map(|word| word.load(Relaxed));
        fence(Acquire);
        let is_whole = version.is_multiple_of(2) && self.version.load(Relaxed) == version;
        is_whole.then_some(words)
    }
}

/// An address as two words: the upper and lower half of an IPv6 address, into which an IPv4 address
/// is mapped.
pub(super) fn words_of(address: IpAddr) -> [u64; 2] {
    let octets = match address {
        IpAddr::V4(address) => address.to_ipv6_mapped().to_bits(),
        IpAddr::V6(address) => address.to_bits(),
    };
    [(octets >> 64) as u64, octets as u64]
}

/// The address of two words.
pub(super) fn address_of([upper, lower]: [u64; 2]) -> IpAddr {
    Ipv6Addr::from_bits(u128::from(upper) << 64 | u128::from(lower)).to_canonical()
}
