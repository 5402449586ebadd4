//! Decides how many datagrams a worker asks a socket for in its turn.
//!
//! When the worker asks for more than there are, the kernel looks once in vain before the received
//! datagrams can be sent on. When the worker asks for fewer, the socket needs another turn. So the
//! worker first asks a socket for one datagram. It asks for more when the socket used its whole
//! quota in the wake-up right before.

use crate::datapath::socket::event_key::EventKey;
use crate::datapath::socket::sys::batch::AT_ONCE;

/// The quota of each socket of a worker.
#[derive(Debug, Default)]
pub(in crate::datapath) struct ReceiveQuota {
    /// Number of the worker's wake-ups.
    turn: u64,
    public: Vec<Helping>,
    upstream: Vec<Helping>,
}

#[derive(Clone, Copy, Debug)]
struct Helping {
    most: usize,
    /// The last turn that used the whole quota.
    used_up: u64,
}

impl Helping {
    const FIRST: Self = Self { most: 1, used_up: u64::MAX };
}

impl ReceiveQuota {
    /// Begins another wake-up, in which each socket has its turn.
    pub(in crate::datapath) fn next_turn(&mut self) {
        self.turn += 1;
    }

    /// How many datagrams to ask for now, at most [`AT_ONCE`].
    #[inline]
    pub(in crate::datapath) fn most(&mut self, place: EventKey) -> usize {
        let turn = self.turn;
        let helping = self.of(place);
        if helping.used_up.wrapping_add(1) == turn {
            helping.most = (helping.most * 4).min(AT_ONCE);
        }
        helping.most
    }

    /// Notes how many datagrams came.
    #[inline]
    pub(in crate::datapath) fn note(&mut self, place: EventKey, received: usize) {
        let turn = self.turn;
        let helping = self.of(place);
        if received < helping.most {
            helping.most = received.max(1);
        } else {
            helping.used_up = turn;
        }
    }

    #[inline]
    fn of(&mut self, place: EventKey) -> &mut Helping {
        let (quota, index) = match place {
            EventKey::Public(id) => (&mut self.public, id.0 as usize),
            EventKey::Upstream(id) => (&mut self.upstream, id.0 as usize),
            EventKey::Wake | EventKey::Tick => (&mut self.public, 0), // nothing is received there
        };
        if index >= quota.len() {
            quota.resize(index + 1, Helping::FIRST);
        }
        &mut quota[index]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nat::{ListenerId, UpstreamId};

    #[test]
    fn a_helping_grows_while_some_is_left_and_shrinks_to_what_came() {
        let (quiet, busy) = (EventKey::Upstream(UpstreamId(0)), EventKey::Public(ListenerId(7)));
        let mut quota = ReceiveQuota::default();
        let mut asked = Vec::new();
        for _ in 0..4 {
            quota.next_turn();
            let most = quota.most(busy);
            asked.push(most);
            quota.note(busy, most);
        }
        assert_eq!(asked, [1, 4, 16, AT_ONCE]);
        for came in [5, 0] {
            quota.next_turn();
            quota.most(busy);
            quota.note(busy, came);
            quota.next_turn();
            assert_eq!(quota.most(busy), came.max(1));
        }

        // A socket that gets one datagram now and then.
        for _ in 0..3 {
            quota.next_turn();
            assert_eq!(quota.most(quiet), 1);
            quota.note(quiet, 1);
            quota.next_turn();
        }
    }
}
