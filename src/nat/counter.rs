//! The number that everything is counted in, and who may change it.

use std::cell::Cell;
use std::marker::PhantomData;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// A number with one writer and any number of readers.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

/// The right to change the counters of one worker. Its core holds it: there is no copy, and no other
/// thread can borrow it. So a change needs no read-modify-write.
#[derive(Debug)]
pub struct Writer(PhantomData<Cell<()>>);

impl Writer {
    /// The one for the counters of a worker.
    pub(crate) fn of_worker() -> Self {
        Self(PhantomData)
    }
}

impl Counter {
    /// A counter at 0.
    pub const fn new() -> Self {
        Self(AtomicU64::new(0))
    }

    /// Adds `n`.
    #[inline]
    pub fn add(&self, _: &Writer, n: u64) {
        self.0.store(self.0.load(Relaxed).wrapping_add(n), Relaxed);
    }

    /// Takes `n` away.
    #[inline]
    pub fn sub(&self, _: &Writer, n: u64) {
        self.0.store(self.0.load(Relaxed).wrapping_sub(n), Relaxed);
    }

    /// Sets the value.
    #[inline]
    pub fn set(&self, _: &Writer, value: u64) {
        self.0.store(value, Relaxed);
    }

    /// The value now.
    pub fn get(&self) -> u64 {
        self.0.load(Relaxed)
    }
}
