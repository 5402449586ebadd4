//! The sender of the last datagram of a kind: one writer, any number of readers, no lock.

use std::net::IpAddr;

use super::counter::Writer;
use super::sequence_lock::{SequenceLock, address_of, words_of};
use super::time::Nanos;

/// The time when a sender sent, 0 if nobody has sent yet; and its address.
#[derive(Debug, Default)]
pub struct LastSender(SequenceLock<3>);

impl LastSender {
    /// Notes a sender.
    pub fn note(&self, writer: &Writer, at: Nanos, sender: IpAddr) {
        let [upper, lower] = words_of(sender);
        self.0.set(writer, [at, upper, lower]);
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
        let [at, upper, lower] = self.0.get()?;
        Some((at, address_of([upper, lower])))
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv6Addr;
    use std::sync::atomic::Ordering::Relaxed;
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
        sender.0.version.store(3, Relaxed);
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
