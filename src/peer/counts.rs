//! What a node has done with the datagrams that came to it.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::pnet::endpoint::Ignored;

/// The datagrams of a node so far. At rest, and without duplicates, received = answered +
/// unconfirmed + unserved + lost + the sum of those that were refused.
#[derive(Debug, Default)]
pub struct NodeCounts {
    received: AtomicU64,
    answered: AtomicU64,
    unconfirmed: AtomicU64,
    unserved: AtomicU64,
    lost: AtomicU64,
    refused: [AtomicU64; REFUSED.len()],
}

/// The names of the reasons, in the order of the checks.
const REFUSED: [&str; 6] = [
    "not a P-NET datagram",
    "not for IP",
    "for another node",
    "no password",
    "wrong password",
    "no way back",
];

impl NodeCounts {
    /// Datagrams taken from both ports.
    pub fn received(&self) -> u64 {
        self.received.load(Relaxed)
    }

    /// Responses sent.
    pub fn answered(&self) -> u64 {
        self.answered.load(Relaxed)
    }

    /// Requests that nobody waits for, so they get no response.
    pub fn unconfirmed(&self) -> u64 {
        self.unconfirmed.load(Relaxed)
    }

    /// Requests that the service did not answer.
    pub fn unserved(&self) -> u64 {
        self.unserved.load(Relaxed)
    }

    /// Responses lost, by a fault that was asked for or because the system refused to send them.
    pub fn lost(&self) -> u64 {
        self.lost.load(Relaxed)
    }

    /// Datagrams that the node refused, by reason.
    pub fn refused(&self) -> impl Iterator<Item = (&'static str, u64)> {
        REFUSED.into_iter().zip(self.refused.iter().map(|count| count.load(Relaxed)))
    }

    /// All datagrams that the node refused.
    pub fn refused_total(&self) -> u64 {
        self.refused().map(|(_, count)| count).sum()
    }

    pub(super) fn count_received(&self) {
        self.received.fetch_add(1, Relaxed);
    }

    pub(super) fn count_answered(&self) {
        self.answered.fetch_add(1, Relaxed);
    }

    pub(super) fn count_unconfirmed(&self) {
        self.unconfirmed.fetch_add(1, Relaxed);
    }

    pub(super) fn count_unserved(&self) {
        self.unserved.fetch_add(1, Relaxed);
    }

    pub(super) fn count_lost(&self) {
        self.lost.fetch_add(1, Relaxed);
    }

    pub(super) fn count_refused(&self, reason: Ignored) {
        let index = match reason {
            Ignored::NotADatagram(_) => 0,
            Ignored::NotOnIp => 1,
            Ignored::OtherNode => 2,
            Ignored::NoPassword => 3,
            Ignored::WrongPassword => 4,
            Ignored::NoWayBack(_) => 5,
        };
        self.refused[index].fetch_add(1, Relaxed);
    }
}
