//! The calls that are under way, as far as they can be told from outside the router.
//!
//! The router has room for a few calls of a flow. Which of them it still knows is certain for the latest
//! one only; of the others something holds if they are answered.

use std::time::{Duration, Instant};

use pnet_nat::nat::{FlowRecord, Records};
use pnet_nat::profinet::rpc::Header;
use pnet_nat::profinet::{ByteOrder, Uuid};

use super::reading::{self, Part};

/// How long a call is known after its last datagram (P-8).
const EXPIRY: Duration = Duration::from_secs(10);

/// What a call is known by.
pub(super) type Name = (Uuid, u32);

/// In the order of their latest requests.
#[derive(Default)]
pub(super) struct Calls(Vec<Call>);

struct Call {
    /// The upstream port of its flow.
    flow: u16,
    name: Name,
    last: Instant,
    /// Where it was answered from last; 0: it was not.
    port: u16,
    /// What the device has of a request in fragments, and how it is to be read.
    pieces: Vec<(u16, Vec<u8>)>,
    order: ByteOrder,
    /// The number of the last fragment, once it has come.
    end: Option<u16>,
}

/// What was known of a call when a datagram for it came.
pub(super) struct Known {
    pub was_known: bool,
    /// Whether the router has to know it as well.
    pub is_certain: bool,
    pub port: u16,
}

fn name(header: &Header) -> Name {
    (header.activity, header.sequence)
}

impl Calls {
    /// A flow was closed.
    pub(super) fn forget(&mut self, flow: u16) {
        self.0.retain(|call| call.flow != flow);
    }

    /// A call, and the upstream port of its flow.
    pub(super) fn known(&self, choice: u8) -> Option<(u16, Name)> {
        let index = usize::from(choice) % self.0.len().max(1);
        self.0.get(index).map(|call| (call.flow, call.name))
    }

    fn place(&self, flow: u16, name: Name) -> Option<usize> {
        self.0.iter().position(|call| (call.flow, call.name) == (flow, name))
    }

    /// Whether it is the latest call of its flow, and not too old.
    pub(super) fn is_certain(&self, now: Instant, flow: u16, name: Name) -> bool {
        let latest = self.0.iter().rev().find(|call| call.flow == flow);
        latest.is_some_and(|call| call.name == name && now - call.last < EXPIRY)
    }

    /// Notes a datagram that has passed to this port of the device.
    pub(super) fn asked(
        &mut self,
        now: Instant,
        flow: &FlowRecord,
        header: &Header,
        to: u16,
    ) -> Known {
        let (flow, name) = (flow.upstream_port, name(header));
        let is_certain = self.is_certain(now, flow, name);
        let before = self.place(flow, name).map(|place| self.0.remove(place));
        let before = before.filter(|call| now - call.last < EXPIRY);
        let (was_known, port) = (before.is_some(), before.as_ref().map_or(0, |call| call.port));
        let (pieces, order) = (Vec::new(), header.representation.order);
        let new = Call { flow, name, last: now, port: 0, pieces, order, end: None };
        // Where the router has forgotten the call, it has begun again, without an answer.
        let port_now = if to == port { port } else { 0 };
        self.0.push(Call { last: now, port: port_now, ..before.unwrap_or(new) });
        // A call that begins has no port for certain.
        Known { was_known, is_certain: is_certain || !was_known, port }
    }

    /// The device has a fragment more. With the last one that it waits for, it has a read.
    pub(super) fn fragment(
        &mut self,
        flow: &FlowRecord,
        header: &Header,
        is_certain: bool,
        part: Part<'_>,
        records: Records,
    ) {
        let Part::Fragment { number, is_last, stub } = part else { return };
        assert!(!stub.is_empty(), "a fragment of nothing");
        let place = self.place(flow.upstream_port, name(header)).expect("it was asked");
        let call = &mut self.0[place];
        if number == 0 {
            let first = call.pieces.iter().find(|(other, _)| *other == 0);
            let is_again = first.is_some_and(|(_, first)| first == stub);
            // The router may have forgotten the call; then it begins again.
            if !is_again || !is_certain {
                (call.pieces, call.end) = (Vec::new(), None);
                call.order = header.representation.order;
            }
        }
        call.pieces.retain(|(other, _)| *other != number);
        call.pieces.push((number, stub.to_vec()));
        call.pieces.sort();
        call.end = if is_last { Some(number) } else { call.end };
        let all: Vec<u8> = call.pieces.iter().flat_map(|(_, piece)| piece.clone()).collect();
        if call.end.is_some_and(|end| call.pieces.len() == usize::from(end) + 1) {
            reading::is_sound(&all, call.order, records);
        }
    }

    /// Notes a datagram that has passed to the client of this flow.
    pub(super) fn answered(&mut self, now: Instant, flow: &FlowRecord, header: &Header, port: u16) {
        let place = self.place(flow.upstream_port, name(header)).expect("it belongs to no call");
        let call = &mut self.0[place];
        assert!(now - call.last < EXPIRY, "it belongs to an old call");
        (call.last, call.port) = (now, port);
    }
}
