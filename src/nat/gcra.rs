//! How many requests a second may pass: a token bucket that is one number.
//!
//! Each request costs the time that it takes to earn one more; a bucket is the moment until which
//! everything is paid for. A full one holds a second's requests.

use super::time::Nanos;

const SECOND: Nanos = 1_000_000_000;

/// A limit of requests a second, 1 to 1000000. After a pause as many may come at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RequestRate {
    per_second: u32,
    /// What one request costs.
    interval: Nanos,
}

impl RequestRate {
    /// The most that a rate can be.
    pub const MOST: u32 = 1_000_000;

    /// So many requests a second; 0 counts as 1, and more than [`MOST`](Self::MOST) as that.
    pub fn new(per_second: u32) -> Self {
        let per_second = per_second.clamp(1, Self::MOST);
        Self { per_second, interval: SECOND / Nanos::from(per_second) }
    }

    /// Requests a second.
    pub fn per_second(self) -> u32 {
        self.per_second
    }

    /// Takes one request out of a bucket that is paid for until then; none when it is empty.
    #[inline]
    pub(super) fn take(self, paid_until: Nanos, now: Nanos) -> Option<Nanos> {
        let paid_until = paid_until.max(now) + self.interval;
        let full = Nanos::from(self.per_second) * self.interval;
        (paid_until - now <= full).then_some(paid_until)
    }

    /// Puts a request back that was taken out and did not pass.
    pub(super) fn put_back(self, paid_until: Nanos) -> Nanos {
        paid_until.saturating_sub(self.interval)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many of `requests`, one every `gap`, pass a bucket that is full at the beginning.
    fn passed(per_second: u32, requests: u64, gap: Nanos) -> u64 {
        let rate = RequestRate::new(per_second);
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
        let rate = RequestRate::new(1);
        let taken = rate.take(0, 5).unwrap();
        assert_eq!(rate.take(taken, 5), None);
        assert_eq!(rate.take(rate.put_back(taken), 5), Some(taken));
    }
}
