//! The open connections of the admin server. Their number is limited, but a new one is always accepted.
//!
//! When there are too many, the oldest connection of the client with the most is cut. So a client that
//! opens many connections only cuts its own, and a probe does not wait.

use std::collections::{HashMap, VecDeque};
use std::net::{IpAddr, Ipv6Addr};
use std::time::Duration;

use tokio::task::{AbortHandle, JoinSet};
use tokio::time::timeout;

/// Connections at once. They use the file descriptors that the datapath leaves free.
pub(super) const MOST: usize = 96;

#[derive(Debug, Default)]
pub(super) struct Connections {
    tasks: JoinSet<()>,
    /// Oldest first.
    open: VecDeque<(Source, AbortHandle)>,
}

impl Connections {
    /// Serves a new connection, and cuts another one if there are too many.
    pub(super) fn add(&mut self, from: Source, serving: impl Future<Output = ()> + Send + 'static) {
        while self.tasks.try_join_next().is_some() {}
        self.open.retain(|(_, task)| !task.is_finished());
        if self.open.len() >= MOST
            && let Some((_, task)) = self.greediest().and_then(|index| self.open.remove(index))
        {
            task.abort();
        }
        self.open.push_back((from, self.tasks.spawn(serving)));
    }

    /// Waits until the open ones end, but no longer than `grace`.
    pub(super) async fn close(mut self, grace: Duration) {
        let _ = timeout(grace, async { while self.tasks.join_next().await.is_some() {} }).await;
    }

    /// The oldest connection of the source with the most.
    fn greediest(&self) -> Option<usize> {
        let mut count = HashMap::new();
        for (source, _) in &self.open {
            *count.entry(source).or_insert(0) += 1;
        }
        let most = count.values().max()?;
        self.open.iter().position(|(source, _)| count[source] == *most)
    }
}

/// Whom a connection is counted for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Source {
    /// An address, or the /64 of an IPv6 address: who has one address of a /64 has them all.
    Address(IpAddr),
    /// Everybody who may use the control socket.
    Control,
}

impl Source {
    pub(super) fn of(address: IpAddr) -> Self {
        Self::Address(match address.to_canonical() {
            IpAddr::V6(v6) => Ipv6Addr::from_bits(v6.to_bits() & !u128::from(u64::MAX)).into(),
            v4 => v4,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::future;

    use super::*;

    #[tokio::test]
    async fn the_oldest_of_the_greediest_is_cut() {
        let mut connections = Connections::default();
        let [greedy, new] = [2, 3].map(|host| Source::of([192, 0, 2, host].into()));
        let one = Source::Control;
        connections.add(one, future::pending());
        for _ in 1..MOST {
            connections.add(greedy, future::pending());
        }
        let open = |connections: &Connections, source| {
            connections.open.iter().filter(|(from, _)| *from == source).count()
        };
        for (taken, from) in [(1, new), (2, new), (2, greedy)] {
            connections.add(from, future::pending());
            assert_eq!(open(&connections, one), 1, "it has fewer than others");
            assert_eq!(open(&connections, greedy), MOST - 1 - taken);
        }
        tokio::task::yield_now().await;
        connections.add(new, future::ready(()));
        assert_eq!(connections.open.len(), MOST);
    }

    #[test]
    fn a_source_is_an_address_or_a_64() {
        for (address, expected) in [
            ("198.51.100.7", "198.51.100.7"),
            ("::ffff:198.51.100.7", "198.51.100.7"),
            ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::"),
        ] {
            let expected = Source::Address(expected.parse().unwrap());
            assert_eq!(Source::of(address.parse().unwrap()), expected);
        }
    }
}
