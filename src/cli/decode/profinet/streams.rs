//! How regularly the frames of one stream come: cycle counters and times of arrival.
//!
//! Invariant: a stream has one size, however many frames it has, and whatever they hold.

use std::time::SystemTime;

use arrayvec::ArrayVec;

use crate::profinet::rt::ApduStatus;

/// Intervals that the usual one is taken from.
const FIRST: usize = 64;
/// Different steps of the cycle counter that are counted, each by itself.
const STEPS: usize = 8;

/// What is known of a stream.
#[derive(Debug, Default)]
pub(super) struct Stream {
    pub(super) frames: u64,
    /// How often the data status was another one than before.
    pub(super) status_changes: u64,
    steps: Steps,
    arrivals: Arrivals,
    last_status: Option<ApduStatus>,
    last_time: Option<SystemTime>,
}

impl Stream {
    /// Counts a frame. The status is none where there is none, or where it was not captured.
    pub(super) fn frame(&mut self, status: Option<ApduStatus>, time: Option<SystemTime>) {
        self.frames += 1;
        if let (Some(last), Some(now)) = (self.last_status, status) {
            self.steps.add(now.cycle_counter.wrapping_sub(last.cycle_counter));
            self.status_changes += u64::from(last.data_status != now.data_status);
        }
        if let (Some(last), Some(now)) = (self.last_time, time) {
            // A clock that was set back gives no interval.
            if let Ok(interval) = now.duration_since(last) {
                self.arrivals.add(interval.as_nanos().try_into().unwrap_or(u64::MAX));
            }
        }
        self.last_status = status;
        self.last_time = time;
    }

    /// The usual step of the cycle counter, and how often it was another one.
    pub(super) fn steps(&self) -> Option<(u16, u64)> {
        self.steps.usual()
    }

    /// The usual interval, and how far the others are from it.
    pub(super) fn jitter(&self) -> Option<Jitter> {
        self.arrivals.jitter()
    }
}

/// Times between frames, in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Jitter {
    /// The median of the first intervals.
    pub(super) usual_interval: f64,
    /// Of the differences from it, without their sign.
    pub(super) median: f64,
    pub(super) p99: f64,
}

/// How often the cycle counter went on by which step.
#[derive(Debug, Default)]
struct Steps {
    known: ArrayVec<(u16, u64), STEPS>,
    /// Steps beside those.
    others: u64,
}

impl Steps {
    fn add(&mut self, step: u16) {
        if let Some((_, count)) = self.known.iter_mut().find(|(known, _)| *known == step) {
            *count += 1;
        } else if self.known.try_push((step, 1)).is_err() {
            self.others += 1;
        }
    }

    fn usual(&self) -> Option<(u16, u64)> {
        let &(usual, count) = self.known.iter().max_by_key(|(_, count)| *count)?;
        let all: u64 = self.known.iter().map(|(_, count)| count).sum();
        Some((usual, all + self.others - count))
    }
}

/// Intervals, in nanoseconds.
#[derive(Debug, Default)]
struct Arrivals {
    first: ArrayVec<u64, FIRST>,
    /// The median of the first ones, and how far all are from it.
    after: Option<(u64, Box<Histogram>)>,
}

impl Arrivals {
    fn add(&mut self, interval: u64) {
        if let Some((usual, histogram)) = &mut self.after {
            histogram.add(interval.abs_diff(*usual));
            return;
        }
        self.first.push(interval);
        if self.first.is_full() {
            self.after = self.measured();
        }
    }

    fn measured(&self) -> Option<(u64, Box<Histogram>)> {
        let mut first = self.first.clone();
        first.sort_unstable();
        let usual = *first.get(first.len() / 2)?;
        let mut histogram = Box::<Histogram>::default();
        first.iter().for_each(|interval| histogram.add(interval.abs_diff(usual)));
        Some((usual, histogram))
    }

    fn jitter(&self) -> Option<Jitter> {
        let fresh = if self.after.is_none() { self.measured() } else { None };
        let (usual, histogram) = self.after.as_ref().or(fresh.as_ref())?;
        let seconds = |nanoseconds: u64| nanoseconds as f64 / 1e9;
        Some(Jitter {
            usual_interval: seconds(*usual),
            median: seconds(histogram.quantile(0.5)),
            p99: seconds(histogram.quantile(0.99)),
        })
    }
}

/// Buckets of a power of two.
const IN_OCTAVE: usize = 8;
/// Up to 2^41 ns, more than half an hour.
const BUCKETS: usize = 40 * IN_OCTAVE;

/// Nanoseconds, in buckets each an eighth wide.
#[derive(Debug)]
struct Histogram([u64; BUCKETS]);

impl Default for Histogram {
    fn default() -> Self {
        Self([0; BUCKETS])
    }
}

impl Histogram {
    fn add(&mut self, value: u64) {
        self.0[Self::bucket(value)] += 1;
    }

    fn bucket(value: u64) -> usize {
        if value < IN_OCTAVE as u64 {
            return value as usize;
        }
        let octave = value.ilog2() as usize;
        let eighth = (value >> (octave - 3)) as usize % IN_OCTAVE;
        ((octave - 2) * IN_OCTAVE + eighth).min(BUCKETS - 1)
    }

    /// The lowest value of a bucket.
    fn lowest(bucket: usize) -> u64 {
        let (octave, eighth) = (bucket / IN_OCTAVE, (bucket % IN_OCTAVE) as u64);
        match octave {
            0 => eighth,
            _ => (IN_OCTAVE as u64 + eighth) << (octave - 1),
        }
    }

    /// The middle of the bucket that so large a share of the values is in or below.
    fn quantile(&self, share: f64) -> u64 {
        let all: u64 = self.0.iter().sum();
        let rank = ((all as f64 * share).ceil() as u64).max(1);
        let mut below = 0;
        for (bucket, count) in self.0.iter().enumerate() {
            below += count;
            if below >= rank {
                return u64::midpoint(Self::lowest(bucket), Self::lowest(bucket + 1) - 1);
            }
        }
        0
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, UNIX_EPOCH};

    use super::*;
    use crate::profinet::rt::{DataStatus, TransferStatus};

    fn status(cycle_counter: u16, data_status: u8) -> Option<ApduStatus> {
        let (data_status, transfer_status) = (DataStatus(data_status), TransferStatus(0));
        Some(ApduStatus { cycle_counter, data_status, transfer_status })
    }

    #[test]
    fn gaps_are_steps_that_differ_from_the_usual_one() {
        let mut stream = Stream::default();
        // The counter wraps; frames 10 and 20 are missing, one comes twice.
        for cycle in (0..40_u16).filter(|cycle| ![10, 20].contains(cycle)).chain([39]) {
            stream.frame(status(65_000_u16.wrapping_add(cycle * 64), 0x35), None);
        }
        assert_eq!((stream.frames, stream.steps()), (39, Some((64, 3))));
        assert_eq!((stream.status_changes, stream.jitter()), (0, None));
        stream.frame(status(0, 0x25), None);
        stream.frame(status(64, 0x35), None);
        assert_eq!(stream.status_changes, 2);
        // A frame that was cut off has no status, and no step on either side of it.
        stream.frame(None, None);
        stream.frame(status(9, 0x00), None);
        assert_eq!((stream.frames, stream.status_changes, stream.steps()), (43, 2, Some((64, 4))));
    }

    #[test]
    fn steps_of_every_kind_need_no_more_room() {
        let mut stream = Stream::default();
        let mut counter = 0_u16;
        for step in 0..1000_u16 {
            counter = counter.wrapping_add(step);
            stream.frame(status(counter, 0), None);
        }
        assert_eq!(stream.steps().map(|(_, gaps)| gaps), Some(998));
    }

    #[test]
    fn jitter_is_the_distance_from_the_usual_interval() {
        for frames in [20, 2000] {
            let mut stream = Stream::default();
            let mut time = UNIX_EPOCH;
            for frame in 0..frames {
                // 2 ms, every tenth one 300 µs later than it should, and the one behind it early.
                let micros = match frame % 10 {
                    3 => 2300,
                    4 => 1700,
                    _ => 2000,
                };
                time += Duration::from_micros(micros);
                stream.frame(None, Some(time));
            }
            let jitter = stream.jitter().unwrap();
            assert_eq!((jitter.usual_interval, jitter.median), (0.002, 0.0));
            assert!((jitter.p99 / 0.0003 - 1.0).abs() < 0.07, "{jitter:?}");
        }
    }

    #[test]
    fn a_clock_that_is_set_back_is_no_interval() {
        let mut stream = Stream::default();
        for millis in [100, 50, 52, 54] {
            stream.frame(None, Some(UNIX_EPOCH + Duration::from_millis(millis)));
        }
        assert_eq!(stream.jitter().unwrap().usual_interval, 0.002);
    }

    #[test]
    fn buckets_follow_each_other_and_hold_their_values() {
        for bucket in 0..BUCKETS {
            assert_eq!(Histogram::bucket(Histogram::lowest(bucket)), bucket);
            assert_eq!(Histogram::bucket(Histogram::lowest(bucket + 1) - 1), bucket);
        }
        assert_eq!(Histogram::bucket(u64::MAX), BUCKETS - 1);
        assert_eq!(Histogram::default().quantile(0.5), Histogram::default().quantile(0.99));
    }
}
