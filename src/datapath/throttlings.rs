//! Tells the observer who is throttled. A worker never waits for it: there is room for a few, and the
//! others are only counted. So strangers can fill neither memory nor the list of events.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};

use crate::nat::{MappingId, Table, Throttled};

/// A sender that is throttled from now on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Throttling {
    pub throttled: Throttled,
    /// The net and node at which it was refused first.
    pub net: String,
    pub node: u8,
}

/// The senders that were throttled since the observer looked last.
#[derive(Debug)]
pub(crate) struct Throttlings {
    room: AtomicU32,
    more: AtomicU64,
    told: SyncSender<Throttling>,
    /// Only the observer locks it.
    untaken: Mutex<Receiver<Throttling>>,
}

impl Default for Throttlings {
    fn default() -> Self {
        let (told, untaken) = sync_channel(2 * Self::ROOM as usize);
        Self {
            room: AtomicU32::new(Self::ROOM),
            more: AtomicU64::new(0),
            told,
            untaken: Mutex::new(untaken),
        }
    }
}

impl Throttlings {
    /// How many are told of between two looks.
    pub(crate) const ROOM: u32 = 8;

    /// Notes a sender. It only counts it when there is no room.
    pub(crate) fn note(&self, table: &Table, throttled: &Throttled, id: MappingId) {
        let has_room = self.room.fetch_update(Relaxed, Relaxed, |room| room.checked_sub(1)).is_ok();
        let told = has_room && {
            let mapping = table.mapping(id);
            let net = table.net(mapping.net).name.clone();
            let throttled = throttled.clone();
            self.told.try_send(Throttling { throttled, net, node: mapping.node_address }).is_ok()
        };
        if !told {
            self.more.fetch_add(1, Relaxed);
        }
    }

    /// Those since the last call, and how many more there were.
    pub(crate) fn take(&self) -> (Vec<Throttling>, u64) {
        let untaken = self.untaken.lock().unwrap_or_else(PoisonError::into_inner);
        let taken = untaken.try_iter().take(2 * Self::ROOM as usize).collect();
        self.room.store(Self::ROOM, Relaxed);
        (taken, self.more.swap(0, Relaxed))
    }
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;
    use std::time::Duration;

    use super::*;
    use crate::config::fixture::{NODE_33, config};
    use crate::nat::ThrottleScope;

    /// A million forged sources take no more memory than eight, and are all counted.
    #[test]
    fn a_few_are_told_of_and_the_others_counted() {
        let (table, throttlings) = (config().table, Throttlings::default());
        for n in 0..1_000_000_u32 {
            let sender = SocketAddr::from((n.to_be_bytes(), 4000));
            let scope = ThrottleScope::Sender;
            let throttled = Throttled { scope, sender, age: Duration::ZERO, refused: 1 };
            throttlings.note(&table, &throttled, NODE_33);
        }
        let (told, more) = throttlings.take();
        assert_eq!((told.len(), more), (8, 999_992));
        assert_eq!((told[7].net.as_str(), told[7].node), ("section-1", 33));
        assert_eq!(told[7].throttled.sender.to_string(), "0.0.0.7:4000");
        assert_eq!(throttlings.take(), (Vec::new(), 0));
        throttlings.note(&table, &told[0].throttled, NODE_33);
        assert_eq!(throttlings.take().0.len(), 1, "there is room again");
    }
}
