//! Asks many devices: which datagram is sent when, and which conversation an answer belongs to.
//!
//! No I/O; the time is told. Invariants: no more datagrams a second than the rate says, acknowledgements
//! of fragments apart; no more conversations at once than [`WINDOW`].

use std::collections::{BTreeSet, VecDeque, btree_set};
use std::net::SocketAddrV4;
use std::time::{Duration, Instant};

use super::assembly::{FACK, fack};
use super::conversation::{Came, Conversation};
use super::device::Device;
use crate::profinet::Uuid;
use crate::profinet::rpc::Rpc;

/// Devices that are asked at the same time.
const WINDOW: usize = 64;
/// Acknowledgements that wait to be sent.
const MOST_FACKS: usize = 64;
/// How often a device may say that it is still at work, or send one fragment of an answer.
const PATIENCE: u32 = 200;

/// When datagrams are sent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    /// The shortest time between two requests.
    pub(super) interval: Duration,
    pub(super) timeout: Duration,
    /// How often a request is sent again.
    pub(super) retries: u32,
}

/// The conversations, and what is still to begin.
pub(super) struct Scan<R> {
    pace: Pace,
    targets: btree_set::IntoIter<SocketAddrV4>,
    total: usize,
    open: Vec<Open>,
    /// Where the search for a request to send begins, so that each conversation gets its turn.
    turn: usize,
    facks: VecDeque<(SocketAddrV4, [u8; FACK])>,
    /// When the next request may be sent.
    may_send: Instant,
    devices: Vec<Device>,
    random: R,
}

struct Open {
    conversation: Conversation,
    /// Requests that were sent for the present question.
    sent: u32,
    /// Until when the answer may come; none: the request is to be sent.
    deadline: Option<Instant>,
    patience: u32,
}

impl<R: FnMut() -> Uuid> Scan<R> {
    /// Asks these addresses. `random` makes up the activities.
    pub(super) fn new(
        targets: BTreeSet<SocketAddrV4>,
        pace: Pace,
        now: Instant,
        random: R,
    ) -> Self {
        Self {
            pace,
            total: targets.len(),
            targets: targets.into_iter(),
            open: Vec::new(),
            turn: 0,
            facks: VecDeque::new(),
            may_send: now,
            devices: Vec::new(),
            random,
        }
    }

    /// The next datagram that may be sent now, and where to.
    pub(super) fn transmit(
        &mut self,
        now: Instant,
        buffer: &mut [u8],
    ) -> Option<(SocketAddrV4, usize)> {
        if let Some((to, octets)) = self.facks.pop_front() {
            buffer[..FACK].copy_from_slice(&octets);
            return Some((to, FACK));
        }
        if now < self.may_send {
            return None;
        }
        let index = self.next_to_send()?;
        self.turn = index + 1;
        let open = &mut self.open[index];
        open.deadline = Some(now + self.pace.timeout);
        open.sent += 1;
        // What was late is not made up for.
        self.may_send = self.may_send.max(now) + self.pace.interval;
        Some((open.conversation.to(), open.conversation.emit(buffer)))
    }

    /// A conversation whose request is to be sent. A new one begins where none is.
    fn next_to_send(&mut self) -> Option<usize> {
        let count = self.open.len();
        let in_turn = (0..count).map(|index| (self.turn + index) % count);
        if let Some(index) = in_turn.into_iter().find(|&index| self.open[index].deadline.is_none())
        {
            return Some(index);
        }
        if count == WINDOW {
            return None;
        }
        let target = self.targets.next()?;
        let activities = std::array::from_fn(|_| (self.random)());
        let conversation = Conversation::new(target, activities);
        self.open.push(Open { conversation, sent: 0, deadline: None, patience: PATIENCE });
        Some(count)
    }

    /// Takes a datagram. What is no answer is ignored.
    pub(super) fn receive(&mut self, now: Instant, from: SocketAddrV4, octets: &[u8]) {
        let Ok(rpc) = Rpc::parse(octets) else { return };
        for index in 0..self.open.len() {
            let open = &mut self.open[index];
            // Without a deadline, nothing was asked.
            if open.deadline.is_none() {
                continue;
            }
            let came = open.conversation.receive(from, &rpc);
            if let Came::MoreToCome { wants_fack: true } | Came::Answered { wants_fack: true } =
                came
                && self.facks.len() < MOST_FACKS
            {
                let mut octets = [0; FACK];
                fack(rpc.header(), &mut octets);
                self.facks.push_back((from, octets));
            }
            match came {
                Came::Nothing => continue,
                Came::MoreToCome { .. } if open.patience > 0 => {
                    open.patience -= 1;
                    open.deadline = Some(now + self.pace.timeout);
                }
                Came::MoreToCome { .. } => {}
                Came::Answered { .. } => {
                    self.next_question(index);
                }
            }
            return;
        }
    }

    /// Ends what has waited too long.
    pub(super) fn handle_timeout(&mut self, now: Instant) {
        let mut index = 0;
        while let Some(open) = self.open.get_mut(index) {
            if open.deadline.is_some_and(|deadline| deadline <= now) {
                if open.sent <= self.pace.retries {
                    open.deadline = None;
                } else {
                    open.conversation.silent();
                    if self.next_question(index) {
                        continue; // another one has this index now
                    }
                }
            }
            index += 1;
        }
    }

    /// Goes on to the next question of a conversation. Returns whether that was the end of it.
    fn next_question(&mut self, index: usize) -> bool {
        let open = &mut self.open[index];
        (open.sent, open.deadline, open.patience) = (0, None, PATIENCE);
        if !open.conversation.is_over() {
            return false;
        }
        let ended = self.open.swap_remove(index);
        self.devices.extend(ended.conversation.into_device());
        true
    }

    /// When there is something to do that no datagram causes.
    pub(super) fn next_timeout(&self) -> Option<Instant> {
        let has_to_send = self.open.iter().any(|open| open.deadline.is_none())
            || self.open.len() < WINDOW && self.targets.len() > 0;
        let deadlines = self.open.iter().filter_map(|open| open.deadline);
        deadlines.chain(has_to_send.then_some(self.may_send)).min()
    }

    pub(super) fn is_over(&self) -> bool {
        self.open.is_empty() && self.targets.len() == 0 && self.facks.is_empty()
    }

    /// Addresses that are done, all addresses, and devices that answered.
    pub(super) fn progress(&self) -> (usize, usize, usize) {
        (self.total - self.targets.len() - self.open.len(), self.total, self.devices.len())
    }

    /// What was found so far.
    pub(super) fn into_devices(self) -> Vec<Device> {
        let open = self.open.into_iter().filter_map(|open| open.conversation.into_device());
        self.devices.into_iter().chain(open).collect()
    }
}
