//! A histogram of one node's response times, written by one worker.
//!
//! The buckets are fine enough to show a median. Each also keeps the sum of its times, so that the
//! average is exact where all answers take about the same time. Every bound of
//! [`RESPONSE_BUCKETS`], the buckets for Prometheus, is a bound here too.

use std::time::Duration;

use super::counter::{Counter, Writer};

/// Upper bounds of the histogram for Prometheus, in seconds; one more bucket takes the rest.
pub const RESPONSE_BUCKETS: [f64; 10] =
    [0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.05, 0.2, 1.0, 5.0];

/// Renard's series R20: 20 bounds for each power of ten, each about an eighth above the one before.
const SERIES: [u64; 20] = [
    100, 112, 125, 140, 160, 180, 200, 224, 250, 280, 315, 355, 400, 450, 500, 560, 630, 710, 800,
    900,
];

/// Upper bounds of the buckets in nanoseconds, 100 µs to 10 s; one more bucket takes the rest.
pub const FINE_BOUNDS: [u64; 5 * SERIES.len() + 1] = {
    let mut bounds = [0; 5 * SERIES.len() + 1];
    let mut index = 0;
    while index < bounds.len() {
        let decade = 10_u64.pow((index / SERIES.len()) as u32);
        bounds[index] = 1_000 * decade * SERIES[index % SERIES.len()];
        index += 1;
    }
    bounds
};

/// Buckets of one node.
pub const FINE_BUCKETS: usize = FINE_BOUNDS.len() + 1;

/// Response times of one node.
#[derive(Debug)]
pub struct ResponseTimes([Bucket; FINE_BUCKETS]);

/// The answers of one bucket.
#[derive(Debug, Default)]
struct Bucket {
    answers: Counter,
    sum_nanos: Counter,
}

impl Default for ResponseTimes {
    fn default() -> Self {
        Self(std::array::from_fn(|_| Bucket::default()))
    }
}

impl ResponseTimes {
    /// Counts one response that took `elapsed`.
    pub fn observe(&self, writer: &Writer, elapsed: Duration) {
        let nanos = u64::try_from(elapsed.as_nanos()).unwrap_or(u64::MAX);
        let bucket = &self.0[FINE_BOUNDS.partition_point(|&bound| bound < nanos)];
        bucket.answers.add(writer, 1);
        bucket.sum_nanos.add(writer, nanos);
    }

    /// For each bucket, its number of answers (not cumulative) and the sum of their times in
    /// nanoseconds.
    pub fn buckets(&self) -> impl Iterator<Item = (u64, u64)> {
        self.0.iter().map(|bucket| (bucket.answers.get(), bucket.sum_nanos.get()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_rise_by_an_eighth_and_hold_those_of_prometheus() {
        assert_eq!((FINE_BOUNDS[0], FINE_BOUNDS[100]), (100_000, 10_000_000_000));
        for pair in FINE_BOUNDS.windows(2) {
            let step = pair[1] as f64 / pair[0] as f64;
            assert!((1.1..1.145).contains(&step), "{pair:?}");
        }
        for bound in RESPONSE_BUCKETS.map(Duration::from_secs_f64) {
            assert!(FINE_BOUNDS.contains(&(bound.as_nanos() as u64)), "{bound:?}");
        }
    }

    #[test]
    fn a_time_on_a_bound_belongs_to_the_bucket_below() {
        let (times, writer) = (ResponseTimes::default(), Writer::of_worker());
        for nanos in [200_000, 200_001, 100_000, 60_000_000_000] {
            times.observe(&writer, Duration::from_nanos(nanos));
        }
        let filled: Vec<_> = times.buckets().enumerate().filter(|(_, (n, _))| *n > 0).collect();
        let expected = [
            (0, (1, 100_000)),
            (6, (1, 200_000)),
            (7, (1, 200_001)),
            (FINE_BUCKETS - 1, (1, 60_000_000_000)),
        ];
        assert_eq!(filled, expected);
    }
}
