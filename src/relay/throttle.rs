//! Who sent wrong passwords lately.
//!
//! Two token buckets judge a sender: one of its address and port, and a wider one of its address (an
//! IPv4 address or an IPv6 /64), so that one guesser behind a shared address does not shut out his
//! neighbours at once. The table has a fixed size: a stranger with a million addresses cannot make
//! it grow, and honest senders are not in it, so there is nothing of theirs to push out. To be
//! pushed out is to be forgiven early, and the lightest offender of its set goes first.

use std::hash::{BuildHasher, Hasher};
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use super::flow::Nanos;
use super::table::Limits;

const SETS: usize = 1024;
const WAYS: usize = 4;
/// An address may send as many wrong passwords as so many of its ports, in the same time.
const PORTS_OF_AN_ADDRESS: u64 = 512;

/// The buckets of those who sent a wrong password.
#[derive(Debug)]
pub(super) struct Throttle {
    sets: Box<[[Offender; WAYS]]>,
    hash: foldhash::fast::RandomState,
    port: Rate,
    address: Rate,
}

#[derive(Clone, Copy, Debug, Default)]
struct Offender {
    key: u64,
    /// When all its wrong passwords will be forgiven; in the past, the place is free.
    forgiven_at: Nanos,
}

/// How a bucket fills and drains, in nanoseconds.
#[derive(Clone, Copy, Debug)]
struct Rate {
    /// What a wrong password costs.
    interval: u64,
    /// What may be owed at most when one more wrong password is still bearable.
    bearable: u64,
}

impl Throttle {
    pub(super) fn new(limits: &Limits) -> Self {
        Self {
            sets: vec![[Offender::default(); WAYS]; SETS].into_boxed_slice(),
            hash: foldhash::fast::RandomState::default(),
            port: Rate::of(limits, 1),
            address: Rate::of(limits, PORTS_OF_AN_ADDRESS),
        }
    }

    /// Goes over to other limits; what senders owe stays.
    pub(super) fn set_limits(&mut self, limits: &Limits) {
        self.port = Rate::of(limits, 1);
        self.address = Rate::of(limits, PORTS_OF_AN_ADDRESS);
    }

    /// Whether a password from this sender is looked at.
    #[inline]
    pub(super) fn admits(&self, now: Nanos, sender: SocketAddr) -> bool {
        let bears = |key: u64, rate: Rate| {
            self.sets[set(key)].iter().all(|offender| {
                offender.key != key || offender.forgiven_at.saturating_sub(now) <= rate.bearable
            })
        };
        bears(self.address_key(sender), self.address) && bears(self.port_key(sender), self.port)
    }

    /// Notes a wrong password of this sender.
    pub(super) fn wrong_password(&mut self, now: Nanos, sender: SocketAddr) {
        self.charge(now, self.address_key(sender), self.address);
        self.charge(now, self.port_key(sender), self.port);
    }

    fn charge(&mut self, now: Nanos, key: u64, rate: Rate) {
        let ways = &mut self.sets[set(key)];
        let known = ways.iter().position(|offender| offender.key == key);
        let way = known.unwrap_or_else(|| lightest(ways));
        let owed = if known.is_some() { ways[way].forgiven_at.max(now) } else { now };
        ways[way] = Offender { key, forgiven_at: owed.saturating_add(rate.interval) };
    }

    fn address_key(&self, sender: SocketAddr) -> u64 {
        let mut hasher = self.hash.build_hasher();
        match sender.ip().to_canonical() {
            IpAddr::V4(address) => hasher.write_u32(address.to_bits()),
            // A subscriber owns a /64 at least.
            IpAddr::V6(address) => hasher.write_u64((address.to_bits() >> 64) as u64),
        }
        hasher.finish().max(1)
    }

    fn port_key(&self, sender: SocketAddr) -> u64 {
        self.hash.hash_one((sender.ip().to_canonical(), sender.port())).max(1)
    }
}

impl Rate {
    fn of(limits: &Limits, share: u64) -> Self {
        let burst = u64::from(limits.wrong_password_burst) * share;
        let interval = nanos(limits.wrong_password_interval) / share;
        Self { interval, bearable: interval.saturating_mul(burst.saturating_sub(1)) }
    }
}

fn set(key: u64) -> usize {
    (key >> 32) as usize % SETS
}

fn lightest(ways: &[Offender; WAYS]) -> usize {
    (1..WAYS).fold(
        0,
        |best, way| {
            if ways[way].forgiven_at < ways[best].forgiven_at { way } else { best }
        },
    )
}

fn nanos(duration: Duration) -> Nanos {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{Ipv4Addr, Ipv6Addr};

    const START: Nanos = 1;
    const SECOND: Nanos = 1_000_000_000;

    fn throttle() -> Throttle {
        let wrong_password_interval = Duration::from_secs(6);
        Throttle::new(&Limits { max_flows: 1, wrong_password_burst: 3, wrong_password_interval })
    }

    fn v4(last: u32, port: u16) -> SocketAddr {
        (Ipv4Addr::from_bits(0xc633_6400 + last), port).into()
    }

    #[test]
    fn a_burst_is_allowed_and_one_is_forgiven_each_interval() {
        let mut throttle = throttle();
        for _ in 0..3 {
            assert!(throttle.admits(START, v4(1, 7)));
            throttle.wrong_password(START, v4(1, 7));
        }
        assert!(!throttle.admits(START, v4(1, 7)));
        assert!(throttle.admits(START, v4(1, 8)), "another port is not concerned yet");
        assert!(throttle.admits(START, v4(2, 7)), "another address is not concerned");
        let mapped = Ipv4Addr::from_bits(0xc633_6401).to_ipv6_mapped();
        assert!(!throttle.admits(START, (mapped, 7).into()), "the same sender over IPv6");
        let later = START + 6 * SECOND;
        assert!(!throttle.admits(later - 1, v4(1, 7)));
        assert!(throttle.admits(later, v4(1, 7)));
        throttle.wrong_password(later, v4(1, 7));
        assert!(!throttle.admits(later, v4(1, 7)));
        assert!(throttle.admits(later + 60 * SECOND, v4(1, 7)));
    }

    #[test]
    fn an_address_is_throttled_whatever_port_it_takes() {
        let mut throttle = throttle();
        let wrong = (1000..).take_while(|&port| {
            let admitted = throttle.admits(START, v4(1, port));
            throttle.wrong_password(START, v4(1, port));
            admitted
        });
        assert_eq!(wrong.count(), 3 * 512);
        assert!(!throttle.admits(START, v4(1, 7)));
        assert!(throttle.admits(START, v4(2, 7)), "another address is not concerned");
        assert!(throttle.admits(START + SECOND, v4(1, 7)), "forgiven 512 times as fast");
    }

    #[test]
    fn an_ipv6_address_is_its_64_bit_prefix() {
        let mut throttle = throttle();
        let host = |prefix, host| {
            SocketAddr::from((Ipv6Addr::new(0x2001, 0xdb8, 0, prefix, 0, 0, 0, host), 1))
        };
        (0..3 * 512).for_each(|n| throttle.wrong_password(START, host(7, n)));
        assert!(!throttle.admits(START, host(7, 9999)));
        assert!(throttle.admits(START, host(8, 1)));
    }

    #[test]
    fn a_million_senders_do_not_push_out_a_heavy_offender() {
        let mut throttle = throttle();
        (0..3).for_each(|_| throttle.wrong_password(START, v4(1, 7)));
        for n in 0..1_000_000 {
            throttle.wrong_password(START, (Ipv4Addr::from_bits(0x0a00_0000 + n), 7).into());
        }
        assert!(!throttle.admits(START, v4(1, 7)));
    }
}
