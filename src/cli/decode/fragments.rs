//! Datagrams that came in IP fragments, put together again.
//!
//! No datagram of P-NET has more than [`MAX_DATAGRAM`] octets, so fragments of larger ones are not kept.
//! Invariant: at most [`MOST`] datagrams are open, and each has at most [`LARGEST`] octets.

use std::collections::VecDeque;
use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, SystemTime};

use etherparse::defrag::IpDefragBuf;
use etherparse::{IpFragOffset, IpNumber, UdpHeader, UdpSlice};

use super::packet::Udp;
use crate::pnet::wire::MAX_DATAGRAM;

/// Datagrams that wait for more of their fragments.
const MOST: usize = 256;
/// How long a datagram waits for its fragments, by the clock of the capture: as long as Linux.
const PATIENCE: Duration = Duration::from_secs(30);
/// Octets of the largest datagram, with its UDP header.
const LARGEST: usize = UdpHeader::LEN + MAX_DATAGRAM;

/// A part of a UDP datagram.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Fragment<'a> {
    pub(super) whole: Identity,
    pub(super) offset: IpFragOffset,
    pub(super) more_follow: bool,
    pub(super) octets: &'a [u8],
    /// Whether all of its octets were captured.
    pub(super) is_complete: bool,
}

/// What all fragments of a datagram have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Identity {
    pub(super) from: IpAddr,
    pub(super) to: IpAddr,
    pub(super) identification: u32,
}

/// Why a datagram could not be put together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Broken {
    #[error("some of its fragments are missing")]
    Missing,
    #[error("its fragments contradict each other")]
    Contradictory,
    #[error("it came in fragments; a datagram has at most {MAX_DATAGRAM} octets")]
    TooLong,
}

/// What became of a fragment.
#[derive(Debug)]
pub(super) enum Outcome {
    /// Others are needed too.
    Waits,
    Whole(Whole),
    Broken(Partial, Broken),
}

/// A datagram that was put together.
#[derive(Debug)]
pub(super) struct Whole {
    identity: Identity,
    octets: Vec<u8>,
    pub(super) fragments: u64,
}

impl Whole {
    /// The datagram; none when its UDP header is wrong.
    pub(super) fn udp(&self) -> Option<Udp<'_>> {
        let Identity { from, to, .. } = self.identity;
        Udp::of(from, to, &UdpSlice::from_slice_lax(&self.octets).ok()?)
    }
}

/// A datagram of which something is still missing.
#[derive(Debug)]
pub(super) struct Partial {
    identity: Identity,
    /// The packet with the fragment that came first, and its time.
    pub(super) packet: u64,
    pub(super) time: Option<SystemTime>,
    /// What the first fragment says of the datagram, once it is there.
    pub(super) head: Option<Head>,
    pub(super) fragments: u64,
    buffer: IpDefragBuf,
}

/// What the first fragment says of a datagram.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    pub(super) from: SocketAddr,
    pub(super) to: SocketAddr,
    pub(super) length: usize,
    /// Octets of the payload in this fragment.
    pub(super) captured: usize,
}

/// The datagrams that wait for more of their fragments, the oldest first.
#[derive(Debug, Default)]
pub(super) struct Fragments(VecDeque<Partial>);

impl Fragments {
    /// Takes the oldest datagram out if it has waited too long, or if there is no room for another one.
    pub(super) fn overdue(&mut self, now: Option<SystemTime>) -> Option<Partial> {
        let oldest = self.0.front()?;
        let waited = now.zip(oldest.time).and_then(|(now, then)| now.duration_since(then).ok());
        let is_overdue = self.0.len() >= MOST || waited.is_some_and(|waited| waited > PATIENCE);
        is_overdue.then(|| self.0.pop_front())?
    }

    /// Takes the oldest datagram out.
    pub(super) fn next(&mut self) -> Option<Partial> {
        self.0.pop_front()
    }

    /// Adds a fragment of this packet.
    pub(super) fn add(
        &mut self,
        packet: u64,
        time: Option<SystemTime>,
        fragment: &Fragment<'_>,
    ) -> Outcome {
        let start = usize::from(fragment.offset.byte_offset());
        // One of a datagram that is no P-NET one. Where it is the first, its head tells.
        if start > 0 && start + fragment.octets.len() > LARGEST {
            return Outcome::Waits;
        }
        let open = self.0.iter().position(|partial| partial.identity == fragment.whole);
        let at = open.unwrap_or_else(|| {
            self.0.push_back(Partial::new(fragment.whole, packet, time));
            self.0.len() - 1
        });
        let verdict = self.0[at].add(start, fragment);
        if verdict == Ok(false) {
            return Outcome::Waits;
        }
        match (verdict, self.0.remove(at)) {
            (_, None) => Outcome::Waits,
            (Err(why), Some(partial)) => Outcome::Broken(partial, why),
            (Ok(_), Some(Partial { identity, buffer, fragments, .. })) => {
                Outcome::Whole(Whole { identity, octets: buffer.take_bufs().0, fragments })
            }
        }
    }
}

impl Partial {
    fn new(identity: Identity, packet: u64, time: Option<SystemTime>) -> Self {
        let buffer = IpDefragBuf::new(IpNumber::UDP, Vec::new(), Vec::new());
        Self { identity, packet, time, head: None, fragments: 0, buffer }
    }

    /// Adds a fragment. True when the datagram is whole.
    fn add(&mut self, start: usize, fragment: &Fragment<'_>) -> Result<bool, Broken> {
        if start == 0 {
            self.head = self.head.or(Head::of(fragment));
            if self.head.is_some_and(|head| head.length > MAX_DATAGRAM) {
                return Err(Broken::TooLong);
            }
        }
        if !fragment.is_complete {
            return Err(Broken::Missing);
        }
        let end = start + fragment.octets.len();
        if end > LARGEST {
            return Err(Broken::Contradictory);
        }
        let sections = || self.buffer.sections().iter();
        let [start, end] = [start, end].map(|place| place as u16);
        if sections().any(|section| section.start < end && start < section.end) {
            // A capture on several interfaces shows a packet twice. Other overlaps are refused
            // (RFC 5722): which octets count would be a guess.
            let is_same = sections().any(|section| section.start <= start && end <= section.end)
                && self.buffer.data().get(usize::from(start)..usize::from(end))
                    == Some(fragment.octets);
            return if is_same { Ok(false) } else { Err(Broken::Contradictory) };
        }
        if !fragment.more_follow && self.buffer.data().len() > usize::from(end) {
            return Err(Broken::Contradictory);
        }
        self.fragments += 1;
        let added = self.buffer.add(fragment.offset, fragment.more_follow, fragment.octets);
        added.map_err(|_| Broken::Contradictory)?;
        Ok(self.buffer.is_complete())
    }
}

impl Head {
    fn of(fragment: &Fragment<'_>) -> Option<Self> {
        let Identity { from, to, .. } = fragment.whole;
        let udp = UdpSlice::from_slice_lax(fragment.octets).ok()?;
        let Udp { from, to, octets, length } = Udp::of(from, to, &udp)?;
        Some(Self { from, to, length, captured: octets.len() })
    }
}

#[cfg(test)]
mod tests;
