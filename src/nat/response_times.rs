//! A histogram of one node's response times, written by one worker.
//!
//! The buckets are log-linear: each holds the times that are the same when they are rounded to two
//! digits. So a median or a 99th percentile read from them has two true digits, an error under 5 %,
//! also when the buckets of many nodes are added up. Every bound of [`RESPONSE_BUCKETS`], the
//! buckets for Prometheus, is a bound here too. A node takes 3.9 KB for each worker.

use std::mem::offset_of;
use std::time::Duration;

use super::counter::{Counter, Writer};

/// Upper bounds of the histogram for Prometheus, in seconds; one more bucket takes the rest.
pub const RESPONSE_BUCKETS: [f64; 10] =
    [0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.05, 0.2, 1.0, 5.0];

/// Below this time, all buckets have the same width.
const LINEAR_UP_TO: u64 = 100_000;
const LINEAR_STEP: u64 = 5_000;
/// 1.05, 1.15 and so on to 9.95, and 2, 5 and 10.
const BOUNDS_OF_DECADE: usize = 93;

/// Upper bounds of the buckets in nanoseconds, up to 10 s; one more bucket takes the rest.
pub const FINE_BOUNDS: [u64; 20 + 5 * BOUNDS_OF_DECADE] = {
    let mut bounds = [LINEAR_STEP; 20 + 5 * BOUNDS_OF_DECADE];
    let mut index = 1;
    while index < bounds.len() {
        bounds[index] = bound_after(bounds[index - 1]);
        index += 1;
    }
    bounds
};

const fn bound_after(bound: u64) -> u64 {
    if bound < LINEAR_UP_TO {
        return bound + LINEAR_STEP;
    }
    let decade = 10_u64.pow(bound.ilog10());
    let (digit, half) = (decade / 10, decade / 20);
    let next = (bound + half) / digit * digit + half;
    let bounds_of_prometheus = [2 * decade, 5 * decade, 10 * decade];
    let mut index = 0;
    while index < bounds_of_prometheus.len() {
        let between = bounds_of_prometheus[index];
        if bound < between && between < next {
            return between;
        }
        index += 1;
    }
    next
}

/// Where a program in the kernel finds the parts of [`ResponseTimes`], and how it finds the bucket of a time:
/// those up to 0.1 ms have the same width, and after them each decade has so many.
pub(crate) struct ResponseLayout {
    pub answers: usize,
    pub sum_nanos: usize,
    pub linear: i32,
    pub of_decade: i32,
    pub last: i32,
}

pub(crate) const RESPONSE_LAYOUT: ResponseLayout = ResponseLayout {
    answers: offset_of!(ResponseTimes, answers),
    sum_nanos: offset_of!(ResponseTimes, sum_nanos),
    linear: (LINEAR_UP_TO / LINEAR_STEP) as i32,
    of_decade: BOUNDS_OF_DECADE as i32,
    last: FINE_BUCKETS as i32 - 1,
};

/// Buckets of one node.
pub const FINE_BUCKETS: usize = FINE_BOUNDS.len() + 1;

/// Response times of one node.
#[derive(Debug)]
pub struct ResponseTimes {
    answers: [Counter; FINE_BUCKETS],
    sum_nanos: Counter,
}

impl Default for ResponseTimes {
    fn default() -> Self {
        Self { answers: [const { Counter::new() }; FINE_BUCKETS], sum_nanos: Counter::new() }
    }
}

impl ResponseTimes {
    /// Counts one response that took `elapsed`.
    pub fn observe(&self, writer: &Writer, elapsed: Duration) {
        // At least 1, so that a sum of 0 tells that there was no answer.
        let nanos = u64::try_from(elapsed.as_nanos()).unwrap_or(u64::MAX).max(1);
        self.answers[Self::bucket(nanos)].add(writer, 1);
        self.sum_nanos.add(writer, nanos);
    }

    /// Sets everything to 0.
    pub(super) fn clear(&self, writer: &Writer) {
        let all = self.answers.iter().chain([&self.sum_nanos]);
        all.for_each(|counter| counter.set(writer, 0));
    }

    /// The bucket of a time in nanoseconds.
    pub fn bucket(nanos: u64) -> usize {
        FINE_BOUNDS.partition_point(|&bound| bound < nanos)
    }

    /// The number of answers in each bucket, not cumulative.
    pub fn buckets(&self) -> impl Iterator<Item = u64> {
        self.answers.iter().map(Counter::get)
    }

    /// The sum of all times, in nanoseconds. It is 0 only before the first answer.
    pub fn sum_nanos(&self) -> u64 {
        self.sum_nanos.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_log_linear_and_hold_those_of_prometheus() {
        assert_eq!(FINE_BOUNDS[19..23], [100_000, 105_000, 115_000, 125_000]);
        assert_eq!(FINE_BOUNDS.last(), Some(&10_000_000_000));
        for pair in FINE_BOUNDS.windows(2) {
            let step = pair[1] as f64 / pair[0] as f64;
            assert!(step > 1.0 && (pair[0] < LINEAR_UP_TO || step < 1.1), "{pair:?}");
        }
        for bound in RESPONSE_BUCKETS.map(Duration::from_secs_f64) {
            assert!(FINE_BOUNDS.contains(&(bound.as_nanos() as u64)), "{bound:?}");
        }
    }

    #[test]
    fn a_time_on_a_bound_belongs_to_the_bucket_below() {
        let (times, writer) = (ResponseTimes::default(), Writer::of_worker());
        for nanos in [5_000, 5_001, 100_000, 60_000_000_000] {
            times.observe(&writer, Duration::from_nanos(nanos));
        }
        let filled: Vec<_> = times.buckets().enumerate().filter(|(_, n)| *n > 0).collect();
        assert_eq!(filled, [(0, 1), (1, 1), (19, 1), (FINE_BUCKETS - 1, 1)]);
        assert_eq!(times.sum_nanos(), 60_000_110_001);
    }

    /// 31 MB for each worker at 8,000 nodes (`docs/performance.md`).
    #[test]
    fn a_node_takes_little_memory() {
        assert_eq!(size_of::<ResponseTimes>(), 3896);
    }
}
