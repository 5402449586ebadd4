//! The sender of the last datagram of a kind: one writer, any number of readers, no lock.
//!
//! A sequence lock: the writer counts a version up before and after each change, so that a reader
//! notices when it read while a change was under way.

use std::net::{IpAddr, Ipv6Addr};
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};
use std::sync::atomic::{AtomicU64, fence};

use super::counter::Writer;
use super::time::Nanos;

/// The address of a sender, and the time when it sent.
#[derive(Debug, Default)]
pub struct LastSender {
    /// Odd while the other fields are being changed.
    version: AtomicU64,
    /// 0: nobody has sent yet.
    at: AtomicU64,
    /// An IPv6 address, or an IPv4 address mapped into IPv6: its upper and lower half.
    address: [AtomicU64; 2],
}

impl LastSender {
    /// Notes a sender.
    pub fn note(&self, _: &Writer, at: Nanos, sender: IpAddr) {
        let octets = match sender {
            IpAddr::V4(sender) => sender.to_ipv6_mapped().to_bits(),
            IpAddr::V6(sender) => sender.to_bits(),
        };
        let version = self.version.load(Relaxed);
        self.version.store(version.wrapping_add(1), Relaxed);
        fence(Release);
        self.at.store(at, Relaxed);
        self.address[0].store((octets >> 64) as u64, Relaxed);
        self.address[1].store(octets as u64, Relaxed);
        self.version.store(version.wrapping_add(2), Release);
    }

    /// The latest of these senders; none when nobody has sent yet, or when one of them is being
    /// changed.
    pub fn latest<'a>(senders: impl Iterator<Item = &'a Self>) -> Option<IpAddr> {
        let senders: Option<Vec<_>> = senders.map(Self::get).collect();
        let last = senders?.into_iter().filter(|&(at, _)| at > 0).max_by_key(|&(at, _)| at)?;
        Some(last.1)
    }

    /// Time and address; none while they are being changed.
    fn get(&self) -> Option<(Nanos, IpAddr)> {
        let version = self.version.load(Acquire);
        let at = self.at.load(Relaxed);
        let [upper, lower] = [0, 1].map(|half| u128::from(self.address[half].load(Relaxed)));
        fence(Acquire);
        let is_whole = version.is_multiple_of(2) && self.version.load(Relaxed) == version;
        let address = Ipv6Addr::from_bits(upper << 64 | lower).to_canonical();
        is_whole.then_some((at, address))
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    fn address(text: &str) -> IpAddr {
        text.parse().unwrap()
    }

    #[test]
    fn the_last_of_all() {
        let writer = Writer::of_worker();
        let [one, other] = [LastSender::default(), LastSender::default()];
        let latest = || LastSender::latest([&one, &other].into_iter());
        assert_eq!(latest(), None);
        other.note(&writer, 5, address("2001:db8::7"));
        assert_eq!(latest(), Some(address("2001:db8::7")));
        one.note(&writer, 7, address("198.51.100.9"));
        assert_eq!(latest(), Some(address("198.51.100.9")));
        other.note(&writer, 8, address("::ffff:203.0.113.7"));
        assert_eq!(latest(), Some(address("203.0.113.7")));
    }

    #[test]
    fn one_that_is_being_changed_is_left_out() {
        let sender = LastSender::default();
        sender.note(&Writer::of_worker(), 5, address("198.51.100.9"));
        sender.version.store(3, Relaxed);
        assert_eq!(LastSender::latest(std::iter::once(&sender)), None);
    }

    /// Time and address always belong to the same datagram.
    #[test]
    fn nothing_is_read_of_two() {
        let sender = LastSender::default();
        let written = |n: u64| Ipv6Addr::from_bits(u128::from(n) << 64 | u128::from(n));
        thread::scope(|scope| {
            let writer = scope.spawn(|| {
                let own = Writer::of_worker();
                for n in 1..=300_000 {
                    sender.note(&own, n, written(n).into());
                }
            });
            while !writer.is_finished() {
                if let Some((at, address)) = sender.get().filter(|&(at, _)| at > 0) {
                    assert_eq!(address, written(at));
                }
            }
        });
        assert_eq!(sender.get(), Some((300_000, written(300_000).into())));
    }
}
