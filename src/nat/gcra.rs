//! Limits of a rate by the generic cell rate algorithm (GCRA): a token bucket that is one number.
//!
//! A bucket is the time until which everything taken from it is paid for; in the past, it is full.
//! Each token costs the time in which a new one comes.

use super::time::Nanos;

const SECOND: Nanos = 1_000_000_000;

/// How fast tokens come, and how many a bucket holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Gcra {
    /// The time in which one token comes.
    interval: Nanos,
    /// The time in which all come but one.
    tolerance: Nanos,
}

impl Gcra {
    /// One token each `interval`; a full bucket holds `burst` of them, at least one.
    pub(super) fn new(interval: Nanos, burst: u64) -> Self {
        Self { interval, tolerance: interval.saturating_mul(burst.saturating_sub(1)) }
    }

    /// Whether there is a token in the bucket.
    #[inline]
    pub(super) fn has_token(self, paid_until: Nanos, now: Nanos) -> bool {
        paid_until.saturating_sub(now) <= self.tolerance
    }

    /// Takes a token; none when there is no token in the bucket.
    #[inline]
    pub(super) fn take(self, paid_until: Nanos, now: Nanos) -> Option<Nanos> {
        self.has_token(paid_until, now).then(|| self.charge(paid_until, now))
    }

    /// Takes a token, if there is one. An empty bucket begins to fill anew.
    #[inline]
    pub(super) fn charge(self, paid_until: Nanos, now: Nanos) -> Nanos {
        self.clamp(paid_until.max(now).saturating_add(self.interval), now)
    }

    /// The bucket under this rate if it was one under another rate: no bucket is more than empty.
    pub(super) fn clamp(self, paid_until: Nanos, now: Nanos) -> Nanos {
        paid_until.min(now.saturating_add(self.tolerance).saturating_add(self.interval))
    }

    /// Puts a token back that was taken for nothing.
    pub(super) fn put_back(self, paid_until: Nanos) -> Nanos {
        paid_until.saturating_sub(self.interval)
    }
}

/// A limit of requests a second, 1 to 1000000. After a second without any, as many may come at
/// once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RequestRate {
    per_second: u32,
    pub(super) gcra: Gcra,
}

impl RequestRate {
    /// The most that a rate can be.
    pub const MOST: u32 = 1_000_000;

    /// So many requests a second; 0 counts as 1, and more than [`MOST`](Self::MOST) as that.
    pub fn new(per_second: u32) -> Self {
        let per_second = per_second.clamp(1, Self::MOST);
        let gcra = Gcra::new(SECOND / Nanos::from(per_second), per_second.into());
        Self { per_second, gcra }
    }

    /// Requests a second.
    pub fn per_second(self) -> u32 {
        self.per_second
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many of `requests`, one every `gap`, pass a bucket that is full at the beginning.
    fn passed(per_second: u32, requests: u64, gap: Nanos) -> u64 {
        let rate = RequestRate::new(per_second).gcra;
        let mut paid_until = 0;
        let passes = |n| {
            let taken = rate.take(paid_until, SECOND + n * gap);
            paid_until = taken.unwrap_or(paid_until);
            taken.is_some()
        };
        (0..requests).map(passes).filter(|&passes| passes).count() as u64
    }

    #[test]
    fn a_seconds_requests_may_come_at_once_and_no_more() {
        for per_second in [1, 2, 3, 7, 100, 31_623, 700_000, RequestRate::MOST] {
            assert_eq!(passed(per_second, 2_000_000, 0), u64::from(per_second));
        }
    }

    #[test]
    fn the_rate_is_kept_to_in_the_long_run() {
        // 1000 a second for 100 s, of which 10 a second pass, and 10 at once.
        assert_eq!(passed(10, 100_000, SECOND / 1000), 1000 + 9);
        assert_eq!(passed(1000, 100_000, SECOND / 1000), 100_000, "just so many");
    }

    #[test]
    fn what_did_not_pass_is_put_back() {
        let rate = Gcra::new(SECOND, 1);
        let taken = rate.take(0, 5).unwrap();
        assert_eq!(rate.take(taken, 5), None);
        assert_eq!(rate.take(rate.put_back(taken), 5), Some(taken));
    }
}
