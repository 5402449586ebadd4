//! Whose passwords are compared, what is reported, and what many strangers together can do and
//! cannot.

use super::*;
use crate::nat::{NetId, SocketKind, Table, UpstreamId};
use std::net::{Ipv4Addr, Ipv6Addr};

const START: Nanos = 1;
const SECOND: Nanos = 1_000_000_000;

/// The throttle, and what it reported.
struct Rig {
    throttle: Throttle,
    told: Told,
}

#[derive(Default)]
struct Told {
    begun: usize,
    ended: usize,
    first_begun: Option<Throttled>,
    last_ended: Option<Throttled>,
}

impl Effects for Told {
    fn open_upstream(&mut self, _: &Table, _: UpstreamId, _: NetId, _: SocketKind) -> Option<u16> {
        None
    }
    fn close_upstream(&mut self, _: UpstreamId) {}
    fn throttling_ended(&mut self, throttled: &Throttled) {
        self.ended += 1;
        self.last_ended = Some(throttled.clone());
    }
}

fn hash() -> SeedableRandomState {
    SeedableRandomState::fixed()
}

impl Rig {
    fn new() -> Self {
        Self { throttle: Throttle::new(&limits(3), hash()), told: Told::default() }
    }

    fn admits(&mut self, now: Nanos, sender: SocketAddr) -> bool {
        match self.throttle.admits(now, sender, || false) {
            Ok(()) => true,
            Err(begun) => {
                if let Some(begun) = begun {
                    self.told.begun += 1;
                    self.told.first_begun.get_or_insert(begun);
                }
                false
            }
        }
    }

    /// A request with a wrong password. True if the password was compared.
    fn guess(&mut self, now: Nanos, sender: SocketAddr) -> bool {
        let admitted = self.admits(now, sender);
        if admitted {
            self.throttle.wrong_password(now, sender, &mut self.told);
        }
        let throttled = [&self.throttle.addresses, &self.throttle.senders];
        let throttled: usize = throttled.iter().map(|buckets| buckets.throttled_now).sum();
        assert_eq!(throttled, self.told.begun - self.told.ended);
        admitted
    }
}

fn limits(wrong_password_burst: u16) -> Limits {
    limits_each(wrong_password_burst, Duration::from_secs(6))
}

fn limits_each(wrong_password_burst: u16, wrong_password_interval: Duration) -> Limits {
    Limits {
        max_flows: 1,
        wrong_password_burst,
        wrong_password_address_burst: 512 * u32::from(wrong_password_burst),
        wrong_password_interval,
    }
}

fn v4(last: u32, port: u16) -> SocketAddr {
    (Ipv4Addr::from_bits(0xc633_6400 + last), port).into()
}

/// One of many strangers.
fn stranger(number: u32) -> SocketAddr {
    (Ipv4Addr::from_bits(0x0a00_0000 + number), 7).into()
}

#[test]
fn a_burst_is_allowed_and_one_is_forgiven_each_interval() {
    let mut rig = Rig::new();
    assert!((0..3).all(|_| rig.guess(START, v4(1, 7))));
    assert!(!rig.admits(START, v4(1, 7)));
    assert!(rig.admits(START, v4(1, 8)), "another port is not concerned yet");
    assert!(rig.admits(START, v4(2, 7)), "another address is not concerned");
    let mapped = Ipv4Addr::from_bits(0xc633_6401).to_ipv6_mapped();
    assert!(!rig.admits(START, (mapped, 7).into()), "the same sender over IPv6");
    let later = START + 6 * SECOND;
    assert!(!rig.admits(later - 1, v4(1, 7)));
    assert!(rig.guess(later, v4(1, 7)));
    assert!(!rig.admits(later, v4(1, 7)));
    assert!(rig.admits(later + 60 * SECOND, v4(1, 7)));
}

#[test]
fn an_address_is_throttled_whatever_port_it_takes() {
    let mut rig = Rig::new();
    let wrong = (1000..).take_while(|&port| rig.guess(START, v4(1, port)));
    assert_eq!(wrong.count(), 3 * 512);
    assert!(!rig.admits(START, v4(1, 7)));
    assert!(rig.admits(START, v4(2, 7)), "another address is not concerned");
    assert!(rig.admits(START + SECOND, v4(1, 7)), "forgiven 512 times as fast");
}

/// All is forgiven to an address in the same time as to a sender.
#[test]
fn how_much_an_address_may_send_is_a_setting() {
    let limits = Limits { wrong_password_address_burst: 36, ..limits(3) };
    let mut rig = Rig { throttle: Throttle::new(&limits, hash()), told: Told::default() };
    let wrong = (1000..).take_while(|&port| rig.guess(START, v4(1, port)));
    assert_eq!(wrong.count(), 36);
    let half_a_second = START + SECOND / 2;
    assert!(!rig.admits(half_a_second - 1, v4(1, 7)));
    assert!(rig.guess(half_a_second, v4(1, 7)));
    assert!(!rig.admits(half_a_second, v4(1, 8)));
}

#[test]
fn an_ipv6_address_is_its_64_bit_prefix() {
    let mut rig = Rig::new();
    let host = |prefix, host| {
        SocketAddr::from((Ipv6Addr::new(0x2001, 0xdb8, 0, prefix, 0, 0, 0, host), 1))
    };
    assert!((0..3 * 512).all(|n| rig.guess(START, host(7, n))));
    assert!(!rig.admits(START, host(7, 9999)));
    assert!(rig.admits(START, host(8, 1)));
    assert_eq!(rig.told.first_begun.unwrap().address().to_string(), "2001:db8:0:7::/64");
}

#[test]
fn a_million_senders_do_not_push_out_a_heavy_offender() {
    let mut rig = Rig::new();
    (0..3).for_each(|_| assert!(rig.guess(START, v4(1, 7))));
    for n in 0..1_000_000 {
        rig.guess(START, stranger(n));
    }
    assert!(!rig.admits(START, v4(1, 7)));
}

/// Attackers who guess up to their limits push an earlier one out. That takes hundreds of wrong
/// passwords for one more guess of the earlier one, and each of those is a guess already.
#[test]
fn pushing_an_offender_out_costs_more_guesses_than_it_gains() {
    let mut rig = Rig::new();
    let (mut won, mut spent) = (0, 0);
    for n in 0..100_000 {
        let now = START + u64::from(n) * SECOND / 1000;
        won += u32::from(rig.guess(now, v4(1, 7)));
        while rig.guess(now, stranger(n)) {
            spent += 1;
        }
    }
    assert!(won > 3 + 100 / 6, "{won}: nobody was pushed out");
    assert!(spent > 500 * won, "{spent} for {won}");
}

/// Even in a table full of senders that owe more.
#[test]
fn a_newcomer_is_observed_however_full_the_table_is() {
    let mut rig = Rig::new();
    for n in 0..100_000 {
        assert_eq!((0..1000).take_while(|_| rig.guess(START, stranger(n))).count(), 3);
    }
    for n in 1..=1000 {
        let guesses = (0..1000).take_while(|_| rig.guess(START, v4(n, 7))).count();
        assert_eq!(guesses, 3);
    }
}

/// A sender that goes on guessing is reported once, and once more after it has stopped.
#[test]
fn throttling_is_told_when_it_begins_and_when_all_is_forgiven() {
    let mut rig = Rig::new();
    for second in 0..120 {
        for _ in 0..10 {
            rig.guess(START + second * SECOND, v4(1, 7));
        }
        rig.throttle.expire(START + second * SECOND, &mut rig.told);
    }
    let throttled = |age, refused| Throttled {
        scope: ThrottleScope::Sender,
        sender: v4(1, 7),
        age: Duration::from_secs(age),
        refused,
    };
    assert_eq!((rig.told.begun, rig.told.ended), (1, 0));
    assert_eq!(rig.told.first_begun, Some(throttled(0, 1)));
    // 3 at once, and then one each 6 s, the last at 114 s. It owes 18 s then.
    let end = START + 132 * SECOND;
    rig.throttle.expire(end - 1, &mut rig.told);
    assert!(!rig.throttle.is_quiet());
    rig.throttle.expire(end, &mut rig.told);
    assert!(rig.throttle.is_quiet());
    assert_eq!((rig.told.begun, rig.told.ended), (1, 1));
    assert_eq!(rig.told.last_ended, Some(throttled(132, 1200 - 22)));
}

#[test]
fn new_limits_hold_at_once_for_what_is_owed() {
    let mut rig = Rig::new();
    (0..2).for_each(|_| assert!(rig.guess(START, v4(1, 7))));
    rig.throttle.set_limits(&limits(2));
    assert!(!rig.guess(START, v4(1, 7)));
    rig.throttle.set_limits(&limits(3));
    assert!(rig.guess(START, v4(1, 7)));
}

/// What a sender owes was counted by the old interval. It owes no more than it could under the new
/// one.
#[test]
fn shorter_limits_let_go_of_who_was_throttled_by_longer_ones() {
    const DAY: Duration = Duration::from_secs(24 * 60 * 60);
    let mut rig = Rig::new();
    rig.throttle.set_limits(&limits_each(3, DAY));
    while (1000..2000).any(|port| rig.guess(START, v4(1, port))) {}
    assert_eq!(rig.throttle.addresses.throttled_now, 1);
    assert!(!rig.admits(START + 3 * SECOND, v4(1, 1000)));

    rig.throttle.set_limits(&limits_each(3, Duration::from_secs(1)));
    let reloaded = START + 4 * SECOND;
    assert!(!rig.throttle.is_quiet());
    rig.throttle.expire(reloaded, &mut rig.told);
    for now in [reloaded, reloaded + SECOND / 512 - 1] {
        assert!(!rig.admits(now, v4(1, 1000)), "it owes the most that anybody can");
    }
    let of_address = reloaded + SECOND.div_ceil(512);
    assert!(rig.admits(of_address, v4(1, 7)));
    assert!(!rig.admits(of_address, v4(1, 1000)));
    assert!(rig.admits(reloaded + SECOND, v4(1, 1000)));
    rig.throttle.expire(reloaded + 3 * SECOND, &mut rig.told);
    assert!(rig.throttle.is_quiet());
    assert_eq!(rig.told.begun, rig.told.ended);
}

/// Also what a sender owes that was not refused, and so was not reported, is clamped.
#[test]
fn who_was_not_refused_yet_is_let_go_of_as_well() {
    let mut rig = Rig::new();
    rig.throttle.set_limits(&limits_each(3, Duration::from_secs(24 * 60 * 60)));
    (0..3).for_each(|_| assert!(rig.guess(START, v4(1, 7))));
    rig.throttle.set_limits(&limits_each(3, Duration::from_secs(1)));
    assert!(!rig.admits(START, v4(1, 7)));
    assert!(rig.admits(START + SECOND, v4(1, 7)));
}
