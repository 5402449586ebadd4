//! Who sent wrong passwords lately.
//!
//! A table of fixed size: a stranger with a million addresses cannot make it grow, and honest
//! sources are not in it, so there is nothing of theirs to push out. To be pushed out is to be
//! forgiven early, and the lightest offender of its set goes first.

use std::hash::{BuildHasher, Hasher};
use std::net::IpAddr;
use std::time::{Duration, Instant};

use super::table::Limits;

const SETS: usize = 1024;
const WAYS: usize = 4;

/// A token bucket for each source (an IPv4 address or an IPv6 /64) that sent a wrong password.
#[derive(Debug)]
pub(super) struct Throttle {
    sets: Box<[[Offender; WAYS]]>,
    hash: foldhash::fast::RandomState,
    start: Instant,
    interval: u64,
    /// What may be owed at most when one more wrong password is still bearable.
    bearable: u64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Offender {
    source: u64,
    /// When all its wrong passwords will be forgiven, in nanoseconds since `start`; in the past,
    /// the place is free.
    forgiven_at: u64,
}

impl Throttle {
    pub(super) fn new(limits: &Limits, start: Instant) -> Self {
        let mut throttle = Self {
            sets: vec![[Offender::default(); WAYS]; SETS].into_boxed_slice(),
            hash: foldhash::fast::RandomState::default(),
            start,
            interval: 0,
            bearable: 0,
        };
        throttle.set_limits(limits);
        throttle
    }

    /// Goes over to other limits; what sources owe stays.
    pub(super) fn set_limits(&mut self, limits: &Limits) {
        self.interval = nanos(limits.wrong_password_interval);
        let others = u64::from(limits.wrong_password_burst).saturating_sub(1);
        self.bearable = self.interval.saturating_mul(others);
    }

    /// Whether a password from this source is looked at.
    #[inline]
    pub(super) fn admits(&self, now: Instant, source: IpAddr) -> bool {
        let (source, now) = (self.source(source), self.since_start(now));
        self.sets[set(source)].iter().all(|offender| {
            offender.source != source || offender.forgiven_at.saturating_sub(now) <= self.bearable
        })
    }

    /// Notes a wrong password from this source.
    pub(super) fn wrong_password(&mut self, now: Instant, source: IpAddr) {
        let (source, now) = (self.source(source), self.since_start(now));
        let ways = &mut self.sets[set(source)];
        let known = ways.iter().position(|offender| offender.source == source);
        let way = known.unwrap_or_else(|| lightest(ways));
        let owed = if known.is_some() { ways[way].forgiven_at.max(now) } else { now };
        ways[way] = Offender { source, forgiven_at: owed.saturating_add(self.interval) };
    }

    fn source(&self, source: IpAddr) -> u64 {
        let mut hasher = self.hash.build_hasher();
        match source.to_canonical() {
            IpAddr::V4(address) => hasher.write_u32(address.to_bits()),
            // A subscriber owns a /64 at least.
            IpAddr::V6(address) => hasher.write_u64((address.to_bits() >> 64) as u64),
        }
        hasher.finish().max(1)
    }

    fn since_start(&self, now: Instant) -> u64 {
        nanos(now.saturating_duration_since(self.start))
    }
}

fn set(source: u64) -> usize {
    (source >> 32) as usize % SETS
}

fn lightest(ways: &[Offender; WAYS]) -> usize {
    (1..WAYS).fold(
        0,
        |best, way| {
            if ways[way].forgiven_at < ways[best].forgiven_at { way } else { best }
        },
    )
}

fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{Ipv4Addr, Ipv6Addr};

    const SECOND: Duration = Duration::from_secs(1);

    fn throttle(start: Instant) -> Throttle {
        let limits =
            Limits { max_flows: 1, wrong_password_burst: 3, wrong_password_interval: 6 * SECOND };
        Throttle::new(&limits, start)
    }

    fn v4(last: u32) -> IpAddr {
        Ipv4Addr::from_bits(0xc633_6400 + last).into()
    }

    #[test]
    fn a_burst_is_allowed_and_one_is_forgiven_each_interval() {
        let start = Instant::now();
        let mut throttle = throttle(start);
        for _ in 0..3 {
            assert!(throttle.admits(start, v4(1)));
            throttle.wrong_password(start, v4(1));
        }
        assert!(!throttle.admits(start, v4(1)));
        assert!(throttle.admits(start, v4(2)), "another source is not concerned");
        assert!(!throttle.admits(start, v4(1).to_canonical()));
        let mapped = Ipv4Addr::from_bits(0xc633_6401).to_ipv6_mapped();
        assert!(!throttle.admits(start, mapped.into()), "the same source over an IPv6 socket");
        let later = start + 6 * SECOND;
        assert!(!throttle.admits(later - Duration::from_nanos(1), v4(1)));
        assert!(throttle.admits(later, v4(1)));
        throttle.wrong_password(later, v4(1));
        assert!(!throttle.admits(later, v4(1)));
        assert!(throttle.admits(later + 60 * SECOND, v4(1)));
    }

    #[test]
    fn an_ipv6_source_is_its_64_bit_prefix() {
        let start = Instant::now();
        let mut throttle = throttle(start);
        let host =
            |prefix, host| IpAddr::from(Ipv6Addr::new(0x2001, 0xdb8, 0, prefix, 0, 0, 0, host));
        (1..=3).for_each(|n| throttle.wrong_password(start, host(7, n)));
        assert!(!throttle.admits(start, host(7, 99)));
        assert!(throttle.admits(start, host(8, 1)));
    }

    #[test]
    fn a_million_sources_do_not_push_out_a_heavy_offender() {
        let start = Instant::now();
        let mut throttle = throttle(start);
        (0..3).for_each(|_| throttle.wrong_password(start, v4(1)));
        for n in 0..1_000_000 {
            throttle.wrong_password(start, Ipv4Addr::from_bits(0x0a00_0000 + n).into());
        }
        assert!(!throttle.admits(start, v4(1)));
    }
}
