//! The calls of one client to one device, as far as the router has to know them.
//!
//! A device may answer from any port (P-8). What belongs to a call is known by its activity and its
//! sequence number, whatever the byte order is. There is room for a few calls at a time. A call is
//! forgotten soon after its last datagram, or when others need its place.

use crate::profinet::rpc::{Header, PacketType};
use crate::profinet::{ByteOrder, Uuid};

use crate::nat::reason::DropReason;
use crate::nat::time::Nanos;

use super::{Fragment, Part, Request, read};

/// Calls of one flow that are known at a time. A client seldom has more than one.
const MOST: usize = 8;

/// How long a call is known after its last datagram. A client that waits for longer asks again.
const EXPIRY: Nanos = 10_000_000_000;

/// The calls of a flow.
#[derive(Clone, Debug, Default)]
pub(in crate::nat) struct Exchanges([Exchange; MOST]);

/// A call: a request, and what belongs to it.
#[derive(Clone, Copy, Debug, Default)]
struct Exchange {
    call: Call,
    operation: u16,
    /// When its last datagram passed; 0: the place is free.
    last: Nanos,
    /// The port that the device answered from last; 0: it has not answered.
    port: u16,
    /// What has passed of a request in fragments.
    begun: Begun,
}

/// What a call is known by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Call {
    activity: Uuid,
    sequence: u32,
}

/// A request in fragments, as far as it has passed. All fragments have the byte order of the first, and
/// all but the last have its length.
#[derive(Clone, Copy, Debug)]
struct Begun {
    stub: [u8; read::LEN],
    /// Octets that have passed.
    len: usize,
    /// Octets of the first fragment.
    first: usize,
    order: ByteOrder,
}

impl Default for Begun {
    fn default() -> Self {
        Self { stub: [0; read::LEN], len: 0, first: 0, order: ByteOrder::Big }
    }
}

impl Begun {
    /// The stub data with this fragment, as far as they are there then, and how many octets that is.
    /// None if the fragment has no place there.
    fn with(&self, fragment: &Fragment<'_>) -> Option<Self> {
        let Fragment { number, is_last, stub, order } = *fragment;
        let is_begun = self.len > 0;
        let first = if is_begun { self.first } else { stub.len() };
        let start = usize::from(number) * first;
        let end = start + stub.len();
        let fits = match is_last {
            true => end == read::LEN,
            false => stub.len() == first && end < read::LEN && read::may_end_behind(end),
        };
        // Who puts the fragments together takes the byte order of one of them for all.
        if !fits || start > self.len || is_begun && order != self.order {
            return None;
        }
        let mut with = Self { first, order, ..*self };
        with.stub[start..end].copy_from_slice(stub);
        // One that was lost on the way is sent again as it was.
        let again = end.min(self.len);
        if start < self.len && with.stub[start..again] != self.stub[start..again] {
            return None;
        }
        with.len = end.max(self.len);
        Some(with)
    }
}

impl Call {
    pub(super) fn of(header: &Header) -> Self {
        Self { activity: header.activity, sequence: header.sequence }
    }
}

impl Exchanges {
    fn find(&self, call: Call, now: Nanos) -> Option<&Exchange> {
        let is_it = |it: &&Exchange| it.last > 0 && it.call == call && now - it.last < EXPIRY;
        self.0.iter().find(is_it)
    }

    fn find_mut(&mut self, call: Call, now: Nanos) -> Option<&mut Exchange> {
        let is_it = |it: &&mut Exchange| it.last > 0 && it.call == call && now - it.last < EXPIRY;
        self.0.iter_mut().find(is_it)
    }

    /// Whether a part of a call goes on with one that is known. The first fragment may begin one.
    pub(super) fn know(&self, request: &Request<'_>, now: Nanos) -> Result<(), DropReason> {
        let exchange = match self.find(request.call, now) {
            Some(exchange) if exchange.operation == request.operation => exchange,
            None if matches!(request.part, Part::Fragment(Fragment { number: 0, .. })) => {
                return Ok(());
            }
            _ => return Err(DropReason::UnknownExchange),
        };
        let Part::Fragment(fragment) = &request.part else { return Ok(()) };
        let begun = exchange.begun.with(fragment).ok_or(DropReason::BadNdr)?;
        read::check(&begun.stub[..begun.len], fragment.order, request.records)
    }

    /// Notes a datagram of the client that may pass. Returns the port that the device answers this
    /// call from, if it has answered from some port.
    pub(in crate::nat) fn asked(&mut self, request: &Request<'_>, now: Nanos) -> Option<u16> {
        let exchange = match self.find_mut(request.call, now) {
            Some(exchange) => exchange,
            None => self.begin(request, now),
        };
        exchange.last = now;
        if let Part::Whole = request.part {
            exchange.operation = request.operation;
        }
        if let Part::Fragment(fragment) = &request.part {
            exchange.begun = exchange.begun.with(fragment).unwrap_or(exchange.begun);
        }
        (exchange.port > 0).then_some(exchange.port)
    }

    /// A call in a free place, or in that of the call that has been silent for longest.
    fn begin(&mut self, request: &Request<'_>, now: Nanos) -> &mut Exchange {
        let index = (0..MOST).min_by_key(|&index| self.0[index].last).unwrap_or_default();
        let Request { call, operation, .. } = *request;
        self.0[index] = Exchange { call, operation, last: now, port: 0, begun: Begun::default() };
        &mut self.0[index]
    }

    /// Notes a datagram of the device, from this port. True if the call has its answer with it.
    pub(super) fn answered(
        &mut self,
        header: &Header,
        port: u16,
        now: Nanos,
    ) -> Result<bool, DropReason> {
        let exchange = self.find_mut(Call::of(header), now).ok_or(DropReason::UnknownExchange)?;
        (exchange.last, exchange.port) = (now, port);
        Ok(match header.packet_type {
            PacketType::Response => {
                !header.flags1.is_fragment() || header.flags1.is_last_fragment()
            }
            PacketType::Fault | PacketType::Reject => true,
            _ => false,
        })
    }
}
