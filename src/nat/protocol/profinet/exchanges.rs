//! The calls of one client to one device, as far as the router has to know them.
//!
//! A device may answer from any port (P-8). What belongs to a call is known by its activity and its
//! sequence number, whatever the byte order is. There is room for a few calls at a time. A call is
//! forgotten soon after its last datagram, or when others need its place.

use crate::profinet::Uuid;
use crate::profinet::rpc::{Header, PacketType};

use crate::nat::reason::DropReason;
use crate::nat::time::Nanos;

use super::{Continued, Request};

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
    /// What of the request is still to come.
    rest: Rest,
}

/// What a call is known by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Call {
    activity: Uuid,
    sequence: u32,
}

/// The fragments of a request that are still to come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Rest {
    /// The number of the next fragment.
    pub next: u16,
    /// Octets of arguments.
    pub octets: u32,
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

    /// Whether a datagram of the client goes on with one of the calls.
    pub(super) fn know(
        &self,
        call: Call,
        operation: u16,
        continued: Continued,
        now: Nanos,
    ) -> Result<(), DropReason> {
        let exchange = self.find(call, now).filter(|exchange| exchange.operation == operation);
        let exchange = exchange.ok_or(DropReason::UnknownExchange)?;
        let Continued::Fragment { number, octets, is_last } = continued else { return Ok(()) };
        let Rest { next, octets: left } = exchange.rest;
        if number < next {
            return Ok(()); // it was lost on the way, and is sent again
        }
        // The fragments are as long together as the first one said.
        let fits = number == next && if is_last { octets == left } else { octets < left };
        if fits { Ok(()) } else { Err(DropReason::BadNdr) }
    }

    /// Notes a datagram of the client that may pass. Returns the port that the device answers this
    /// call from, if it has answered from some port.
    pub(in crate::nat) fn asked(&mut self, request: &Request, now: Nanos) -> Option<u16> {
        let exchange = match self.find_mut(request.call, now) {
            Some(exchange) => exchange,
            None => self.begin(request, now),
        };
        exchange.last = now;
        if let Some(Continued::Fragment { number, octets, .. }) = request.continued
            && number == exchange.rest.next
        {
            exchange.rest.next += 1;
            exchange.rest.octets = exchange.rest.octets.saturating_sub(octets);
        }
        (exchange.port > 0).then_some(exchange.port)
    }

    /// A call in a free place, or in that of the call that has been silent for longest.
    fn begin(&mut self, request: &Request, now: Nanos) -> &mut Exchange {
        let index = (0..MOST).min_by_key(|&index| self.0[index].last).unwrap_or_default();
        let Request { call, operation, rest, .. } = *request;
        self.0[index] = Exchange { call, operation, last: now, port: 0, rest };
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
