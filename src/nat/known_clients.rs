//! Known clients: those that sent a request with a right password to a net within the last day.
//! Wrong passwords under the address of a known client do not shut it out of that net.
//!
//! The table has a fixed size. All workers share it, and it stays in a reload. A sender without a
//! password never gets into it, so strangers push nobody out. A new client takes the place of the
//! one whose password was right longest ago.

use std::hash::BuildHasher;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use foldhash::fast::FixedState;

use super::ids::NetId;
use super::net::Net;
use super::table::Table;
use super::time::Nanos;

const SETS: usize = 1024;
const WAYS: usize = 8;

const MINUTE: Nanos = 60_000_000_000;
/// A day.
const MINUTES: u64 = 24 * 60;
/// The lower bits of an entry are a minute, enough for years. The upper bits are the client's hash.
const MINUTE_BITS: u32 = 22;
const MINUTE_MASK: u64 = (1 << MINUTE_BITS) - 1;

/// It need not be secret: only clients with the password get into a set.
const HASH: FixedState = FixedState::with_seed(0);

/// The known clients, for one table.
#[derive(Clone, Debug)]
pub(super) struct Known {
    /// Client and minute of each entry; 0 is a free place.
    sets: Arc<[[AtomicU64; WAYS]]>,
    /// For each net, a value that is part of its clients' hashes. With another value, the net knows
    /// nobody.
    nets: Box<[u64]>,
    era: u64,
}

impl Known {
    /// A table in which nobody is known.
    pub(super) fn new(table: &Table) -> Self {
        let sets = (0..SETS).map(|_| Default::default()).collect();
        Self { sets, nets: table.nets().iter().map(|net| fresh(net, 0)).collect(), era: 0 }
    }

    /// The same clients, for the next table. A net forgets its clients when one of its passwords is
    /// withdrawn or changed.
    pub(super) fn followed_by(&self, old: &Table, new: &Table) -> Self {
        let era = self.era + 1;
        let of_net = |is: &Net| {
            let stays = |was: &Net| {
                was.credentials.iter().all(|credential| is.same_credential(credential).is_some())
            };
            let mut known = old.nets().iter().zip(&self.nets);
            let same = known.find(|(was, _)| was.name == is.name);
            same.filter(|(was, _)| stays(was)).map_or_else(|| fresh(is, era), |(_, &key)| key)
        };
        Self { sets: Arc::clone(&self.sets), nets: new.nets().iter().map(of_net).collect(), era }
    }

    /// Notes that a client sent a right password to this net.
    pub(super) fn note(&self, net: NetId, client: IpAddr, now: Nanos) {
        let (set, who) = self.place(net, client);
        // If two workers write the same entry at once, one client is lost until it is noted again.
        let same = set.iter().find(|entry| entry.load(Relaxed) & !MINUTE_MASK == who);
        let oldest = || set.iter().min_by_key(|entry| entry.load(Relaxed) & MINUTE_MASK);
        if let Some(entry) = same.or_else(oldest) {
            entry.store(who | minute(now), Relaxed);
        }
    }

    /// Whether a client sent a right password to this net within the last day.
    pub(super) fn includes(&self, net: NetId, client: IpAddr, now: Nanos) -> bool {
        let (set, who) = self.place(net, client);
        set.iter().map(|entry| entry.load(Relaxed)).any(|entry| {
            entry & !MINUTE_MASK == who
                && minute(now).saturating_sub(entry & MINUTE_MASK) <= MINUTES
        })
    }

    /// The set of a client, and the client's part of its entry. An IPv6 client is its /64.
    fn place(&self, net: NetId, client: IpAddr) -> (&[AtomicU64; WAYS], u64) {
        let address = match client.to_canonical() {
            IpAddr::V4(address) => (4, u64::from(address.to_bits())),
            IpAddr::V6(address) => (6, (address.to_bits() >> 64) as u64),
        };
        let hash = HASH.hash_one((self.nets[usize::from(net.0)], address));
        // The set is chosen by other bits than the entry has. An entry must not look like a free
        // place.
        let who = (hash & !MINUTE_MASK).max(MINUTE_MASK + 1);
        (&self.sets[hash as usize % SETS], who)
    }
}

fn fresh(net: &Net, era: u64) -> u64 {
    HASH.hash_one((&net.name, era))
}

fn minute(now: Nanos) -> u64 {
    (now / MINUTE + 1) & MINUTE_MASK
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::fixture::config;

    fn client(number: u32) -> IpAddr {
        std::net::Ipv4Addr::from_bits(0x0a00_0000 + number).into()
    }

    #[test]
    fn a_client_is_known_for_a_day_in_its_net() {
        let known = Known::new(&config().table);
        known.note(NetId(0), client(1), MINUTE);
        assert!(known.includes(NetId(0), client(1), MINUTE * MINUTES));
        assert!(!known.includes(NetId(0), client(1), MINUTE * (MINUTES + 3)));
        assert!(!known.includes(NetId(1), client(1), MINUTE), "another net");
        assert!(!known.includes(NetId(0), client(2), MINUTE), "another client");
    }

    #[test]
    fn who_was_right_longest_ago_goes_first() {
        let known = Known::new(&config().table);
        let most = (SETS * WAYS) as u32;
        (0..3 * most).for_each(|n| known.note(NetId(0), client(n), u64::from(n) * MINUTE / 100));
        let now = u64::from(3 * most) * MINUTE / 100;
        let found = |from: u32| {
            (from..from + most / 4).filter(|&n| known.includes(NetId(0), client(n), now))
        };
        assert_eq!(found(3 * most - most / 4).count() as u32, most / 4, "the latest are all there");
        // Sets do not fill evenly, so a few are kept longer.
        assert!(found(0).count() < 50);
    }
}
