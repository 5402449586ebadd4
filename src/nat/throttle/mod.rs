//! Throttling: who sent too many wrong passwords lately is refused for a while.
//!
//! A sender has two token buckets: one for its address and port, and a larger one for its whole
//! address (an IPv4 address or an IPv6 /64). So an attacker behind a shared address does not shut
//! out its neighbours at once.
//!
//! The tables have a fixed size, so that a stranger with a million addresses cannot make them grow.
//! Only senders of wrong passwords are in them. A new one always gets a place, or a full table
//! would leave it unobserved; the one that owes least loses its place and is forgiven early.

#[cfg(test)]
mod tests;

use std::hash::{BuildHasher, Hasher};
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use foldhash::fast::SeedableRandomState;

use super::effects::Effects;
use super::gcra::Gcra;
use super::table::Limits;
use super::throttled::{ThrottleScope, Throttled};
use super::time::Nanos;

const SETS: usize = 512;
const WAYS: usize = 4;

/// The buckets of all that sent a wrong password.
#[derive(Debug)]
pub(super) struct Throttle {
    hash: SeedableRandomState,
    addresses: Buckets,
    senders: Buckets,
    /// Whether a sender may owe more than the limits allow, because they have changed since it
    /// owes.
    clamp_is_due: bool,
}

/// The buckets of one scope. With one table for both scopes, the two buckets of a sender could push
/// each other out.
#[derive(Debug)]
struct Buckets {
    scope: ThrottleScope,
    rate: Gcra,
    sets: Box<[[Offender; WAYS]]>,
    /// The throttled sender at each place of `sets`. They are apart because they are seldom needed.
    throttled: Box<[[Option<Record>; WAYS]]>,
    throttled_now: usize,
}

#[derive(Clone, Copy, Debug, Default)]
struct Offender {
    key: u64,
    /// The bucket: when all its wrong passwords will be forgiven. In the past, the place is free.
    forgiven_at: Nanos,
}

/// What becomes a [`Throttled`].
#[derive(Clone, Copy, Debug)]
struct Record {
    sender: SocketAddr,
    since: Nanos,
    refused: u64,
}

impl Throttle {
    pub(super) fn new(limits: &Limits, hash: SeedableRandomState) -> Self {
        Self {
            hash,
            addresses: Buckets::new(ThrottleScope::Address, limits),
            senders: Buckets::new(ThrottleScope::Sender, limits),
            clamp_is_due: false,
        }
    }

    /// Puts other limits in force. What senders owe stays, but no more than the new limits allow:
    /// otherwise an interval changed from "24h" to "1s" would not forgive them for days.
    pub(super) fn set_limits(&mut self, limits: &Limits) {
        for buckets in [&mut self.addresses, &mut self.senders] {
            buckets.rate = rate(buckets.scope, limits);
        }
        self.clamp_is_due = true;
    }

    /// Whether a password of this sender is compared. It always is for a known client. The error says
    /// whether this is the first refusal.
    #[inline]
    pub(super) fn admits(
        &mut self,
        now: Nanos,
        sender: SocketAddr,
        is_known: impl FnOnce() -> bool,
    ) -> Result<(), Option<Throttled>> {
        self.clamp_if_due(now);
        let address_key = self.address_key(sender);
        let (refusing, key) = if !self.addresses.has_room(now, address_key) {
            (&mut self.addresses, address_key)
        } else {
            let sender_key = self.sender_key(sender);
            if self.senders.has_room(now, sender_key) {
                return Ok(());
            }
            (&mut self.senders, sender_key)
        };
        if is_known() { Ok(()) } else { Err(refusing.note_refusal(now, key, sender)) }
    }

    /// Notes a wrong password of this sender.
    pub(super) fn wrong_password(
        &mut self,
        now: Nanos,
        sender: SocketAddr,
        effects: &mut impl Effects,
    ) {
        let keys = [self.address_key(sender), self.sender_key(sender)];
        for (buckets, key) in [&mut self.addresses, &mut self.senders].into_iter().zip(keys) {
            if let Some(pushed_out) = buckets.charge(now, key) {
                effects.throttling_ended(&pushed_out);
            }
        }
    }

    /// Reports the throttled whose wrong passwords are all forgiven. Not as soon as one is
    /// forgiven, or a sender that goes on guessing would be reported again and again. To be called
    /// about once a second.
    pub(super) fn expire(&mut self, now: Nanos, effects: &mut impl Effects) {
        self.clamp_if_due(now);
        self.addresses.expire(now, effects);
        self.senders.expire(now, effects);
    }

    /// Whether nobody is throttled. Then there is nothing to expire.
    pub(super) fn is_quiet(&self) -> bool {
        self.addresses.throttled_now == 0 && self.senders.throttled_now == 0
    }

    fn clamp_if_due(&mut self, now: Nanos) {
        if std::mem::take(&mut self.clamp_is_due) {
            self.addresses.clamp(now);
            self.senders.clamp(now);
        }
    }

    fn address_key(&self, sender: SocketAddr) -> u64 {
        let mut hasher = self.hash.build_hasher();
        match sender.ip().to_canonical() {
            IpAddr::V4(address) => hasher.write_u32(address.to_bits()),
            // A subscriber has a /64 or more.
            IpAddr::V6(address) => hasher.write_u64((address.to_bits() >> 64) as u64),
        }
        hasher.finish().max(1)
    }

    fn sender_key(&self, sender: SocketAddr) -> u64 {
        self.hash.hash_one((sender.ip().to_canonical(), sender.port())).max(1)
    }
}

impl Buckets {
    fn new(scope: ThrottleScope, limits: &Limits) -> Self {
        Self {
            scope,
            rate: rate(scope, limits),
            sets: vec![[Offender::default(); WAYS]; SETS].into_boxed_slice(),
            throttled: vec![[None; WAYS]; SETS].into_boxed_slice(),
            throttled_now: 0,
        }
    }

    /// Whether this bucket has room for one more wrong password.
    #[inline]
    fn has_room(&self, now: Nanos, key: u64) -> bool {
        self.sets[set(key)]
            .iter()
            .all(|offender| offender.key != key || self.rate.has_token(offender.forgiven_at, now))
    }

    /// Counts a refused request. Returns who is throttled if it is the first one.
    fn note_refusal(&mut self, now: Nanos, key: u64, sender: SocketAddr) -> Option<Throttled> {
        let way = self.sets[set(key)].iter().position(|offender| offender.key == key)?;
        let record = &mut self.throttled[set(key)][way];
        if let Some(record) = record {
            record.refused += 1;
            return None;
        }
        self.throttled_now += 1;
        let begun = record.insert(Record { sender, since: now, refused: 1 });
        Some(begun.report(self.scope, now))
    }

    /// Counts a wrong password. Returns whose throttling ends because its place is needed.
    fn charge(&mut self, now: Nanos, key: u64) -> Option<Throttled> {
        let ways = &mut self.sets[set(key)];
        let known = ways.iter().position(|offender| offender.key == key);
        let way = known.unwrap_or_else(|| lightest(ways));
        let forgiven_at = if known.is_some() { ways[way].forgiven_at } else { now };
        // The bucket of a known client may be empty already: the client is not refused.
        ways[way] = Offender { key, forgiven_at: self.rate.charge(forgiven_at, now) };
        let pushed_out = self.throttled[set(key)][way].take_if(|_| known.is_none())?;
        self.throttled_now -= 1;
        Some(pushed_out.report(self.scope, now))
    }

    fn clamp(&mut self, now: Nanos) {
        for offender in self.sets.as_flattened_mut() {
            offender.forgiven_at = self.rate.clamp(offender.forgiven_at, now);
        }
    }

    fn expire(&mut self, now: Nanos, effects: &mut impl Effects) {
        if self.throttled_now == 0 {
            return;
        }
        let offenders = self.sets.as_flattened().iter();
        for (offender, record) in offenders.zip(self.throttled.as_flattened_mut()) {
            if let Some(ended) = record.take_if(|_| offender.forgiven_at <= now) {
                self.throttled_now -= 1;
                effects.throttling_ended(&ended.report(self.scope, now));
            }
        }
    }
}

impl Record {
    fn report(&self, scope: ThrottleScope, now: Nanos) -> Throttled {
        let Self { sender, since, refused } = *self;
        Throttled { scope, sender, age: Duration::from_nanos(now - since), refused }
    }
}

/// One token is one wrong password. In either scope, an empty bucket is full again after the same
/// time.
fn rate(scope: ThrottleScope, limits: &Limits) -> Gcra {
    let senders_burst = u64::from(limits.wrong_password_burst);
    let burst = match scope {
        ThrottleScope::Sender => senders_burst,
        ThrottleScope::Address => u64::from(limits.wrong_password_address_burst),
    };
    let all = nanos(limits.wrong_password_interval).saturating_mul(senders_burst);
    Gcra::new(all / burst.max(1), burst)
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
