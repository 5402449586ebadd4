//! How many datagrams a worker asks a socket for in its turn.
//!
//! To ask for more than there are costs a look in vain, before what did come can be sent on; to ask
//! for fewer costs another turn. So a socket is asked for one, and for more as soon as one turn after
//! another leaves some.

use super::batch::AT_ONCE;
use super::place::Place;

/// What each socket of a worker is asked for.
#[derive(Debug, Default)]
pub(super) struct Helpings {
    /// The worker's wake-ups, counted.
    turn: u64,
    public: Vec<Helping>,
    upstream: Vec<Helping>,
}

#[derive(Clone, Copy, Debug)]
struct Helping {
    most: usize,
    /// The last turn in which it was all used.
    used_up: u64,
}

impl Helping {
    const FIRST: Self = Self { most: 1, used_up: u64::MAX };
}

impl Helpings {
    /// Another wake-up, in which each socket has its turn.
    pub(super) fn next_turn(&mut self) {
        self.turn += 1;
    }

    /// How many datagrams to ask for now, at most [`AT_ONCE`].
    #[inline]
    pub(super) fn most(&mut self, place: Place) -> usize {
        let turn = self.turn;
        let helping = self.of(place);
        if helping.used_up.wrapping_add(1) == turn {
            helping.most = (helping.most * 4).min(AT_ONCE);
        }
        helping.most
    }

    /// Notes how many came of it.
    #[inline]
    pub(super) fn note(&mut self, place: Place, received: usize) {
        let turn = self.turn;
        let helping = self.of(place);
        if received < helping.most {
            helping.most = received.max(1);
        } else {
            helping.used_up = turn;
        }
    }

    #[inline]
    fn of(&mut self, place: Place) -> &mut Helping {
        let (helpings, index) = match place {
            Place::Public(id) => (&mut self.public, id.0 as usize),
            Place::Upstream(id) => (&mut self.upstream, id.0 as usize),
            Place::Wake | Place::Tick => (&mut self.public, 0), // nothing is received there
        };
        if index >= helpings.len() {
            helpings.resize(index + 1, Helping::FIRST);
        }
        &mut helpings[index]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::relay::{ListenerId, UpstreamId};

    #[test]
    fn a_helping_grows_while_some_is_left_and_shrinks_to_what_came() {
        let (quiet, busy) = (Place::Upstream(UpstreamId(0)), Place::Public(ListenerId(7)));
        let mut helpings = Helpings::default();
        let mut asked = Vec::new();
        for _ in 0..4 {
            helpings.next_turn();
            let most = helpings.most(busy);
            asked.push(most);
            helpings.note(busy, most);
        }
        assert_eq!(asked, [1, 4, 16, AT_ONCE]);
        for came in [5, 0] {
            helpings.next_turn();
            helpings.most(busy);
            helpings.note(busy, came);
            helpings.next_turn();
            assert_eq!(helpings.most(busy), came.max(1));
        }

        // One datagram now and then.
        for _ in 0..3 {
            helpings.next_turn();
            assert_eq!(helpings.most(quiet), 1);
            helpings.note(quiet, 1);
            helpings.next_turn();
        }
    }
}
