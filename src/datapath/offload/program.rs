//! The two programs that carry flows in the kernel.
//!
//! `passing` runs where datagrams come in. It passes on what the core would pass, for flows that the core
//! has opened, and counts it. What it does not hold for good beyond doubt takes the long way, untouched:
//! to the socket and the core. So each block here stands for a check of the core, which is named beside it,
//! and may be stricter than that check, never more lenient.
//!
//! `learning` runs where datagrams leave. From those that the relay sends itself it learns by which
//! interface, and to which hardware address, the datagrams of a flow leave, and renews the flow's lease: for
//! a short time, datagrams of that direction may take the short way. So firewall, limits, routing and the
//! relay itself see a datagram of each flow every now and then. When one of them lets none through any
//! more, the lease runs out, and everything takes the long way.

use std::mem::offset_of;
use std::os::fd::BorrowedFd;

use super::assembler::Alu::{Add, And, Div, Mov, Mul, Or, Shl, Shr, Sub, Xor};
use super::assembler::If::{AnyBit, Equal, Greater, GreaterOrEqual, Less, NotEqual};
use super::assembler::Width::{U8, U16, U32, U64};
use super::assembler::{
    Function, Label, Program, R0, R1, R2, R3, R4, R5, R6, R7, R8, R9, Register, STACK,
};
use super::layout::{
    KernelFlow, LIFE_AND_PROTOCOL, NUMBER_AND_FRAGMENT, VERSION_AND_SERVICE, WayOut, entry,
};
use crate::datapath::socket::sys::bpf::Instruction;
use crate::nat::{Direction, NODE_LAYOUT, RESPONSE_LAYOUT, SharedFlow};
use crate::pnet::wire;

/// The maps that the programs use.
pub(super) struct Maps<'a> {
    /// From [`Key`](super::layout::Key) to entry.
    pub(super) entries: BorrowedFd<'a>,
    /// [`KernelFlow`]s.
    pub(super) flows: BorrowedFd<'a>,
    pub(super) nodes: BorrowedFd<'a>,
    pub(super) credentials: BorrowedFd<'a>,
    /// How long a lease lasts, in nanoseconds: the one element.
    pub(super) lease: BorrowedFd<'a>,
}

/// The program ends; the packet goes on its way through the kernel (`TCX_NEXT`).
const LONG_WAY: i32 = -1;
/// The packet is dropped (`TC_ACT_SHOT`).
const DROP: i32 = 2;

/// Offsets in `struct __sk_buff`.
mod packet {
    pub(super) const LEN: i16 = 0;
    pub(super) const KIND: i16 = 4;
    pub(super) const PROTOCOL: i16 = 16;
    pub(super) const HAS_VLAN: i16 = 20;
    pub(super) const CAME_IN_BY: i16 = 36;
    pub(super) const INTERFACE: i16 = 40;
    pub(super) const MARK_OF_TC: i16 = 44;
    pub(super) const DATA: i16 = 76;
    pub(super) const DATA_END: i16 = 80;
    pub(super) const BURST: i16 = 176;
}

/// Offsets in a frame: Ethernet, IPv4 without options, UDP.
mod frame {
    pub(super) const ETHERNET: i16 = 14;
    pub(super) const VERSION: i16 = 14;
    pub(super) const TOTAL_LENGTH: i16 = 16;
    pub(super) const FRAGMENT: i16 = 20;
    pub(super) const TIME_TO_LIVE: i16 = 22;
    pub(super) const PROTOCOL: i16 = 23;
    pub(super) const SOURCE: i16 = 26;
    pub(super) const DESTINATION: i16 = 30;
    pub(super) const SOURCE_PORT: i16 = 34;
    pub(super) const DESTINATION_PORT: i16 = 36;
    pub(super) const UDP_LENGTH: i16 = 38;
    pub(super) const UDP_CHECKSUM: i16 = 40;
    pub(super) const PAYLOAD: i16 = 42;
    /// Octets that are replaced: all in front of the UDP length.
    pub(super) const REPLACED: i16 = 38;
}

/// Octets of the headers in front of the payload, without Ethernet.
const HEADERS: i32 = 28;
/// In `tc_index`: this packet took the short way, and there is nothing to learn from it.
const SHORT_WAY: i32 = 0x504E;

// What is kept on the stack.
const KEY: i16 = -16;
const INDEX: i16 = -20;
const NOW: i16 = -32;
/// Octets of payload.
const LENGTH: i16 = -40;
/// The remaining-route-length.
const REMAINING: i16 = -48;
/// How long an answer took.
const ELAPSED: i16 = -48;
/// The new front of the frame, so that the addresses are aligned.
const FRONT: i16 = -94;

/// Octets of payload in front of the route, and of what it has besides header, route and data octets:
/// control-status, data-field-format and password.
const ROUTE: i16 = frame::PAYLOAD + 4;
const LONGEST_REMAINING: i32 = wire::MAX_ROUTE as i32 - 3;
/// Octets of a secure datagram whose remaining-route-length and data size are 0.
const SECURE: i32 = 4 + 3 + 2 + 8;

const SOURCES: u64 = 0x8080_8080_8080_8080;

/// Makes the program for the place where datagrams come in. `start` is the time of the kernel's clock that
/// all times of the relay count from.
pub(super) fn passing(maps: &Maps<'_>, start: u64) -> Vec<Instruction> {
    let mut program = Program::default();
    let p = &mut program;
    let long_way = p.label();
    p.copy(R6, R1);
    check_packet(p, long_way);
    find(p, maps, [frame::SOURCE, frame::DESTINATION], long_way);
    time(p, start);
    check_lease(p, long_way);
    check_payload(p, long_way);
    check_ip_header(p, long_way);
    let lost = p.label();
    replace_front(p, long_way, lost);
    count(p, maps);
    p.store_number(U32, R6, packet::MARK_OF_TC, SHORT_WAY);
    way(p, R1, false);
    p.load(U32, R1, R1, WAYS + offset_of!(WayOut, interface) as i16);
    p.copy(R2, 0);
    p.call(Function::Redirect);
    p.exit();
    p.place(long_way);
    p.copy(R0, LONG_WAY);
    p.exit();
    p.place(lost);
    p.copy(R0, DROP);
    p.exit();
    program.finish()
}

/// Makes the program for the place where datagrams leave.
pub(super) fn learning(maps: &Maps<'_>, start: u64) -> Vec<Instruction> {
    let mut program = Program::default();
    let p = &mut program;
    let over = p.label();
    p.copy(R6, R1);
    for (field, wanted) in [(packet::HAS_VLAN, 0), (packet::CAME_IN_BY, 0)] {
        p.load(U32, R2, R6, field);
        p.jump_if(NotEqual, R2, wanted, over); // it is not the relay's own
    }
    p.load(U32, R2, R6, packet::MARK_OF_TC);
    p.jump_if(Equal, R2, SHORT_WAY, over);
    check_ipv4(p, frame::PAYLOAD, over);
    p.load(U8, R2, R7, 0);
    p.jump_if(AnyBit, R2, 1, over); // to many stations
    // The other direction of the flow comes in with the addresses the other way round.
    find(p, maps, [frame::DESTINATION, frame::SOURCE], over);
    time(p, start);
    p.store_number(U32, STACK, INDEX, 0);
    element(p, maps.lease, over);
    // A quarter of it by chance, so that the flows of a moment do not renew theirs in one moment.
    p.load(U64, R3, R0, 0);
    p.load(U64, R1, STACK, NOW);
    p.copy(R2, R1);
    p.alu(And, R2, 0xFFFF);
    p.copy(R4, R3);
    p.alu(Shr, R4, 18);
    p.alu(Mul, R2, R4);
    p.alu(Add, R1, R2);
    p.alu(Add, R1, R3);
    p.alu(Shr, R3, 2);
    p.alu(Sub, R1, R3);
    way(p, R9, true);
    let at = |field: usize| WAYS + field as i16;
    let (lease, interface) = (at(offset_of!(WayOut, lease)), at(offset_of!(WayOut, interface)));
    let hardware = at(offset_of!(WayOut, hardware));
    let (renewed, another) = (p.label(), p.label());
    let same = |p: &mut Program, stored: i16, from: Register, offset: i16| {
        p.load(U32, R2, from, offset);
        p.load(U32, R3, R9, stored);
        p.jump_if(NotEqual, R2, R3, another);
    };
    same(p, interface, R6, packet::INTERFACE);
    (0..3).for_each(|word| same(p, hardware + 4 * word, R7, 4 * word));
    p.jump(renewed);
    p.place(another);
    p.store_number(U64, R9, lease, 0); // nobody uses one half of it
    p.load(U32, R2, R6, packet::INTERFACE);
    p.store(U32, R9, interface, R2);
    for word in 0..3 {
        p.load(U32, R2, R7, 4 * word);
        p.store(U32, R9, hardware + 4 * word, R2);
    }
    p.place(renewed);
    p.store(U64, R9, lease, R1);
    p.place(over);
    p.copy(R0, LONG_WAY);
    p.exit();
    program.finish()
}

/// Octets in front of the ways out.
const WAYS: i16 = offset_of!(KernelFlow, ways) as i16;

/// IPv4 without options and in one piece, UDP; the frame has so many octets at least. R7 is the frame then.
fn check_ipv4(p: &mut Program, octets: i16, otherwise: Label) {
    p.load(U32, R2, R6, packet::PROTOCOL);
    p.jump_if(NotEqual, R2, i32::from(0x0800_u16.to_be()), otherwise);
    p.load(U32, R7, R6, packet::DATA);
    p.load(U32, R3, R6, packet::DATA_END);
    p.copy(R2, R7);
    p.alu(Add, R2, i32::from(octets));
    p.jump_if(Greater, R2, R3, otherwise);
    p.load(U8, R2, R7, frame::VERSION);
    p.jump_if(NotEqual, R2, i32::from(VERSION_AND_SERVICE[0]), otherwise);
    p.load(U8, R2, R7, frame::PROTOCOL);
    p.jump_if(NotEqual, R2, libc::IPPROTO_UDP, otherwise);
    p.load(U16, R2, R7, frame::FRAGMENT);
    let not_dont_fragment = u16::from_ne_bytes([0xBF, 0xFF]);
    p.jump_if(AnyBit, R2, i32::from(not_dont_fragment), otherwise);
}

/// What the kernel would check, and what only the kernel can do: a frame for this machine alone, one
/// datagram, lengths that agree, a UDP checksum, more than one hop to live.
fn check_packet(p: &mut Program, otherwise: Label) {
    for field in [packet::KIND, packet::HAS_VLAN, packet::BURST] {
        p.load(U32, R2, R6, field);
        p.jump_if(NotEqual, R2, 0, otherwise);
    }
    check_ipv4(p, frame::PAYLOAD + wire::MIN_SECURE_DATAGRAM as i16, otherwise);
    p.load(U8, R2, R7, frame::TIME_TO_LIVE);
    p.jump_if(Less, R2, 2, otherwise);
    p.load(U16, R5, R7, frame::TOTAL_LENGTH);
    p.swap16(R5);
    p.load(U32, R2, R6, packet::LEN);
    p.alu(Sub, R2, i32::from(frame::ETHERNET));
    p.jump_if(NotEqual, R2, R5, otherwise);
    p.alu(Sub, R5, HEADERS);
    p.jump_if(Less, R5, wire::MIN_SECURE_DATAGRAM as i32, otherwise);
    p.jump_if(Greater, R5, wire::MAX_DATAGRAM as i32, otherwise);
    p.store(U64, STACK, LENGTH, R5);
    p.load(U16, R2, R7, frame::UDP_LENGTH);
    p.swap16(R2);
    p.alu(Sub, R2, 8);
    p.jump_if(NotEqual, R2, R5, otherwise);
    p.load(U16, R2, R7, frame::UDP_CHECKSUM);
    p.jump_if(Equal, R2, 0, otherwise);
}

/// The flow of these addresses, source first: R8 is its entry then, and R9 its [`KernelFlow`].
fn find(p: &mut Program, maps: &Maps<'_>, [source, destination]: [i16; 2], otherwise: Label) {
    let port_of = |address| match address {
        frame::SOURCE => frame::SOURCE_PORT,
        _ => frame::DESTINATION_PORT,
    };
    for (offset, address) in [(0, source), (4, destination)] {
        p.load(U32, R2, R7, address);
        p.store(U32, STACK, KEY + offset, R2);
    }
    for (offset, address) in [(8, source), (10, destination)] {
        p.load(U16, R2, R7, port_of(address));
        p.store(U16, STACK, KEY + offset, R2);
    }
    p.map(R1, maps.entries);
    p.copy(R2, STACK);
    p.alu(Add, R2, i32::from(KEY));
    p.call(Function::MapLookUp);
    p.jump_if(Equal, R0, 0, otherwise);
    p.copy(R8, R0);
    look_up(p, maps.flows, entry::FLOW, otherwise);
    p.copy(R9, R0);
}

/// Looks up the element whose index stands in the entry. R0 is the element then.
fn look_up(p: &mut Program, map: BorrowedFd<'_>, index: i16, otherwise: Label) {
    p.load(U32, R2, R8, index);
    p.store(U32, STACK, INDEX, R2);
    element(p, map, otherwise);
}

/// Looks up the element whose index is on the stack. R0 is the element then.
fn element(p: &mut Program, map: BorrowedFd<'_>, otherwise: Label) {
    p.map(R1, map);
    p.copy(R2, STACK);
    p.alu(Add, R2, i32::from(INDEX));
    p.call(Function::MapLookUp);
    p.jump_if(Equal, R0, 0, otherwise);
}

/// The time as the core counts it: `nanos` in `nat/core`.
fn time(p: &mut Program, start: u64) {
    p.call(Function::Nanoseconds);
    p.set(R2, start.wrapping_sub(1));
    p.alu(Sub, R0, R2);
    p.store(U64, STACK, NOW, R0);
}

/// The [`WayOut`] of the entry's direction, or of the other one, [`WAYS`] octets before it.
fn way(p: &mut Program, to: Register, of_the_other: bool) {
    p.load(U8, R2, R8, entry::DIRECTION);
    p.alu(And, R2, 1);
    if of_the_other {
        p.alu(Xor, R2, 1);
    }
    p.alu(Shl, R2, const { size_of::<WayOut>().ilog2() as i32 });
    if to != R9 {
        p.copy(to, R9);
    }
    p.alu(Add, to, R2);
}

/// The lease is valid, and the datagram comes by the interface by which those of the other direction leave.
fn check_lease(p: &mut Program, otherwise: Label) {
    way(p, R1, false);
    p.load(U64, R2, R1, WAYS + offset_of!(WayOut, lease) as i16);
    p.jump_if(GreaterOrEqual, R0, R2, otherwise);
    way(p, R1, true);
    p.load(U32, R2, R1, WAYS + offset_of!(WayOut, interface) as i16);
    p.load(U32, R3, R6, packet::INTERFACE);
    p.jump_if(NotEqual, R2, R3, otherwise);
}

/// The datagram is what `nat/protocol/pnet.rs` lets pass, and has the password of the flow.
fn check_payload(p: &mut Program, otherwise: Label) {
    p.load(U32, R1, R7, frame::PAYLOAD);
    p.load(U32, R2, R8, entry::HEADER);
    p.jump_if32(NotEqual, R1, R2, otherwise);
    // IPNetID and node: two destinations, and no broadcast.
    let (of_a_node, both, tail) = (p.label(), p.label(), p.label());
    p.load(U8, R1, R7, ROUTE);
    p.jump_if(GreaterOrEqual, R1, i32::from(wire::BNA), otherwise);
    p.load(U8, R1, R7, ROUTE + 1);
    p.load(U8, R2, R8, entry::NODE_ADDRESS);
    p.jump_if(NotEqual, R2, i32::from(entry::ANY_NODE), of_a_node);
    p.jump_if(GreaterOrEqual, R1, i32::from(wire::BNA), otherwise);
    p.jump(both);
    p.place(of_a_node);
    p.jump_if(NotEqual, R1, R2, otherwise);
    p.place(both);
    p.load(U64, R5, STACK, LENGTH);
    let extended = p.label();
    p.load(U8, R1, R7, ROUTE + 2);
    p.jump_if(AnyBit, R1, 0x80, extended);
    check_remaining_route(p, otherwise);
    p.jump(tail);
    // Two destinations, two sources. It is as long as a route whose remaining-route-length is 1.
    p.place(extended);
    p.load(U8, R4, R7, ROUTE + 3);
    p.jump_if(Less, R4, 0x80, otherwise);
    p.copy(R1, 1);
    p.copy(R3, R7);
    p.alu(Add, R3, R1);
    // R1 is the remaining-route-length, R3 the frame plus R1, R4 the last source.
    p.place(tail);
    let answered = p.label();
    p.load(U8, R2, R8, entry::DIRECTION);
    p.jump_if(NotEqual, R2, Direction::Request as i32, answered);
    p.jump_if(Equal, R4, 0x80, otherwise); // it wants no answer
    p.place(answered);
    // The data size, and nothing behind the password.
    p.load(U8, R2, R3, ROUTE + 4);
    p.alu(And, R2, 0x3F);
    p.alu(Add, R2, R1);
    p.alu(Add, R2, SECURE);
    p.jump_if(NotEqual, R2, R5, otherwise);
    // The password: eight octets in one comparison.
    p.copy(R3, R7);
    p.alu(Add, R3, R5);
    p.copy(R4, R3);
    p.alu(Add, R4, i32::from(frame::PAYLOAD));
    p.load(U32, R2, R6, packet::DATA_END);
    p.jump_if(Greater, R4, R2, otherwise);
    way(p, R4, false);
    p.load(U64, R4, R4, WAYS + offset_of!(WayOut, password) as i16);
    p.load(U64, R2, R3, frame::PAYLOAD - 8);
    p.jump_if(NotEqual, R2, R4, otherwise);
}

/// A remaining-route-length, in R1, and so many elements: destinations, none of them a broadcast, and then
/// two or more sources (`format_of_remaining` in `pnet/wire/route.rs`). R5 is the length of the payload.
fn check_remaining_route(p: &mut Program, otherwise: Label) {
    p.jump_if(Less, R1, 2, otherwise);
    p.jump_if(Greater, R1, LONGEST_REMAINING, otherwise);
    p.store(U64, STACK, REMAINING, R1);
    p.copy(R2, R1);
    p.alu(Add, R2, SECURE);
    p.jump_if(Greater, R2, R5, otherwise);
    p.load(U32, R3, R6, packet::DATA_END);
    let ordered = p.label();
    // Eight elements at a time.
    for at in (0..LONGEST_REMAINING).step_by(8) {
        let elements = ROUTE + 3 + at as i16;
        if elements + 8 > frame::PAYLOAD + wire::MIN_SECURE_DATAGRAM as i16 {
            p.copy(R2, R7);
            p.alu(Add, R2, i32::from(elements + 8));
            p.jump_if(Greater, R2, R3, otherwise);
        }
        p.load(U64, R2, R7, elements);
        // What is behind the route counts as sources, which are right everywhere behind others.
        let all = p.label();
        p.load(U64, R4, STACK, REMAINING);
        p.alu(Sub, R4, at);
        p.jump_if(GreaterOrEqual, R4, 8, all);
        if cfg!(target_endian = "little") {
            p.alu(Shl, R4, 3);
            p.copy(R0, -1);
            p.alu(Shl, R0, R4);
        } else {
            p.alu(Shl, R4, 3);
            p.copy(R0, -1);
            p.alu(Shr, R0, R4);
        }
        p.alu(Or, R2, R0);
        p.place(all);
        // A destination behind a source.
        p.copy(R4, R2);
        p.alu(if cfg!(target_endian = "little") { Shl } else { Shr }, R4, 8);
        if at > 0 {
            p.load(U8, R0, R7, elements - 1);
            if cfg!(target_endian = "big") {
                p.alu(Shl, R0, 56);
            }
            p.alu(Or, R4, R0);
        }
        p.copy(R0, R2);
        p.alu(Xor, R0, -1);
        p.alu(And, R4, R0);
        // A destination of 126 or 127: with 2 more, it has the highest bit.
        p.set(R1, !SOURCES);
        p.alu(And, R2, R1);
        p.set(R1, SOURCES / 0x40); // 2 in each octet
        p.alu(Add, R2, R1);
        p.alu(And, R2, R0);
        p.alu(Or, R2, R4);
        p.set(R1, SOURCES);
        p.alu(And, R2, R1);
        p.jump_if(NotEqual, R2, 0, otherwise);
        p.load(U64, R4, STACK, REMAINING);
        p.jump_if(Less, R4, at + 9, ordered);
    }
    p.place(ordered);
    p.load(U64, R1, STACK, REMAINING);
    p.copy(R3, R7);
    p.alu(Add, R3, R1);
    p.copy(R4, R3);
    p.alu(Add, R4, i32::from(ROUTE) + 6);
    p.load(U32, R2, R6, packet::DATA_END);
    p.jump_if(Greater, R4, R2, otherwise);
    // The last but one is a source, so the last is one, too.
    p.load(U8, R2, R3, ROUTE + 1);
    p.jump_if(Less, R2, 0x80, otherwise);
    p.load(U8, R4, R3, ROUTE + 2);
}

/// The checksum of the IP header, which gets another one.
fn check_ip_header(p: &mut Program, otherwise: Label) {
    p.copy(R1, 0);
    for word in (0..20).step_by(4) {
        p.load(U32, R2, R7, frame::VERSION + word);
        p.alu(Add, R1, R2);
    }
    fold(p);
    p.jump_if(NotEqual, R1, 0xFFFF, otherwise);
}

/// Makes 16 bits of a sum in R1, by adding what is above them (RFC 1071).
fn fold(p: &mut Program) {
    p.copy(R2, R1);
    p.alu(Shr, R2, 32);
    p.alu32(Mov, R1, R1);
    p.alu(Add, R1, R2);
    for _ in 0..3 {
        p.copy(R2, R1);
        p.alu(Shr, R2, 16);
        p.alu(And, R1, 0xFFFF);
        p.alu(Add, R1, R2);
    }
}

/// Gives the frame its new front, up to the ports, and the UDP checksum that goes with it. Nothing of the
/// old IP header is left.
fn replace_front(p: &mut Program, otherwise: Label, lost: Label) {
    const PSEUDO_HEADER: i32 = 0x10;
    const NEVER_NONE: i32 = 0x20; // a sum of 0 would mean that there is none
    let changes = [
        (entry::ADDRESSES_CHANGE, PSEUDO_HEADER | NEVER_NONE, otherwise),
        (entry::PORTS_CHANGE, NEVER_NONE, lost),
    ];
    for (change, flags, failed) in changes {
        p.copy(R1, R6);
        p.copy(R2, i32::from(frame::UDP_CHECKSUM));
        p.copy(R3, 0);
        p.load(U32, R4, R8, change);
        p.copy(R5, flags);
        p.call(Function::ReplaceChecksum);
        p.jump_if(NotEqual, R0, 0, failed);
    }
    way(p, R3, false);
    let hardware = WAYS + offset_of!(WayOut, hardware) as i16;
    for (width, at) in [(U16, 0), (U32, 2), (U32, 6), (U16, 10)] {
        p.load(width, R2, R3, hardware + at);
        p.store(width, STACK, FRONT + at, R2);
    }
    let number = |octets: [u8; 2]| i32::from(u16::from_ne_bytes(octets));
    p.store_number(U16, STACK, FRONT + 12, number([0x08, 0x00]));
    p.store_number(U16, STACK, FRONT + frame::VERSION, number(VERSION_AND_SERVICE));
    p.load(U64, R1, STACK, LENGTH);
    p.alu(Add, R1, HEADERS);
    p.swap16(R1);
    p.store(U16, STACK, FRONT + frame::TOTAL_LENGTH, R1);
    let fragment = i32::from_ne_bytes(NUMBER_AND_FRAGMENT);
    p.store_number(U32, STACK, FRONT + frame::FRAGMENT - 2, fragment);
    p.store_number(U16, STACK, FRONT + frame::TIME_TO_LIVE, number(LIFE_AND_PROTOCOL));
    p.load(U32, R2, R8, entry::IP_SUM);
    p.alu(Add, R1, R2);
    fold(p);
    p.alu(Xor, R1, 0xFFFF);
    p.store(U16, STACK, FRONT + frame::PROTOCOL + 1, R1);
    for (from, to) in [(0, 0), (4, 4)] {
        p.load(U32, R2, R8, entry::ADDRESSES + from);
        p.store(U32, STACK, FRONT + frame::SOURCE + to, R2);
    }
    p.load(U32, R2, R8, entry::PORTS);
    p.store(U32, STACK, FRONT + frame::SOURCE_PORT, R2);
    p.copy(R1, R6);
    p.copy(R2, 0);
    p.copy(R3, STACK);
    p.alu(Add, R3, i32::from(FRONT));
    p.copy(R4, i32::from(frame::REPLACED));
    p.copy(R5, 0);
    p.call(Function::StoreOctets);
    p.jump_if(NotEqual, R0, 0, lost);
}

/// Counts the datagram as the core does: `request`, `request_sent`, `response`, `response_sent`.
fn count(p: &mut Program, maps: &Maps<'_>) {
    let (response, counted) = (p.label(), p.label());
    p.load(U64, R7, STACK, NOW);
    p.store(U64, R9, offset_of!(SharedFlow, last_used) as i16, R7);
    p.load(U64, R2, STACK, LENGTH);
    p.add_to_memory(R9, offset_of!(SharedFlow, octets) as i16, R2);
    p.load(U8, R2, R8, entry::DIRECTION);
    p.jump_if(NotEqual, R2, Direction::Request as i32, response);

    let unanswered = offset_of!(SharedFlow, unanswered) as i16;
    let (asked_first, asked) = (p.label(), p.label());
    p.copy(R1, 1);
    p.add_to_memory(R9, offset_of!(SharedFlow, requests) as i16, R1);
    p.load(U64, R1, R9, unanswered);
    p.jump_if(Equal, R1, 0, asked_first);
    p.copy(R2, R7);
    p.alu(Sub, R2, R1);
    p.set(R3, SharedFlow::LOST_AFTER);
    p.jump_if(Less, R2, R3, asked);
    p.place(asked_first);
    p.store(U64, R9, unanswered, R7);
    p.place(asked);
    look_up(p, maps.credentials, entry::CREDENTIAL, counted);
    p.copy(R1, 1);
    p.add_to_memory(R0, 0, R1);
    count_for_node(p, maps, Direction::Request, counted);
    p.store(U64, R0, NODE_LAYOUT.last_request as i16, R7);
    p.load(U64, R1, R0, NODE_LAYOUT.unanswered_since as i16);
    p.jump_if(NotEqual, R1, 0, counted);
    p.store(U64, R0, NODE_LAYOUT.unanswered_since as i16, R7);
    p.jump(counted);

    p.place(response);
    p.copy(R1, 1);
    p.add_to_memory(R9, offset_of!(SharedFlow, responses) as i16, R1);
    p.copy(R1, 0);
    p.exchange(R9, unanswered, R1);
    p.store(U64, STACK, ELAPSED, R1);
    count_for_node(p, maps, Direction::Response, counted);
    p.store(U64, R0, NODE_LAYOUT.last_response as i16, R7);
    p.store_number(U64, R0, NODE_LAYOUT.unanswered_since as i16, 0);
    p.load(U64, R1, STACK, ELAPSED);
    p.jump_if(Equal, R1, 0, counted);
    p.alu(Sub, R7, R1);
    count_time(p);
    p.place(counted);
}

/// Received and forwarded. R0 is the node then.
fn count_for_node(p: &mut Program, maps: &Maps<'_>, direction: Direction, otherwise: Label) {
    look_up(p, maps.nodes, entry::NODE, otherwise);
    let counters = NODE_LAYOUT.directions[direction as usize];
    p.copy(R1, 1);
    p.add_to_memory(R0, counters.received as i16, R1);
    p.add_to_memory(R0, counters.forwarded as i16, R1);
    p.load(U64, R1, STACK, LENGTH);
    p.add_to_memory(R0, counters.forwarded_bytes as i16, R1);
}

/// Octets in front of the response times.
const TIMES: i16 = NODE_LAYOUT.response_times as i16;

/// Counts the response time in R7 for the node in R0: the closed form of `ResponseTimes::bucket`.
fn count_time(p: &mut Program) {
    const FEW: u64 = 100_000;
    const STEP: i32 = 5_000;
    let (rounded, found) = (p.label(), p.label());
    p.jump_if(NotEqual, R7, 0, rounded);
    p.copy(R7, 1);
    p.place(rounded);
    p.add_to_memory(R0, TIMES + RESPONSE_LAYOUT.sum_nanos as i16, R7);
    let by_decades = p.label();
    p.copy(R2, R7);
    p.jump_if(Greater, R7, FEW as i32, by_decades);
    p.alu(Sub, R2, 1);
    p.alu(Div, R2, STEP);
    p.jump(found);
    p.place(by_decades);
    for decade in 0..5 {
        let begin = FEW * 10_u64.pow(decade);
        let next = p.label();
        let more_than = |p: &mut Program, times: u64, label| {
            p.set(R3, begin * times);
            p.jump_if(Greater, R7, R3, label);
        };
        more_than(p, 10, next);
        let (digit, half) = (begin / 10, begin / 20);
        p.alu(Sub, R2, (begin - half + 1) as i32);
        p.alu(Div, R2, digit as i32);
        p.alu(Add, R2, RESPONSE_LAYOUT.linear + RESPONSE_LAYOUT.of_decade * decade as i32);
        for times in [2, 5] {
            let (above, on) = (p.label(), p.label());
            more_than(p, times, above);
            p.jump(on);
            p.place(above);
            p.alu(Add, R2, 1);
            p.place(on);
        }
        p.jump(found);
        p.place(next);
    }
    p.copy(R2, RESPONSE_LAYOUT.last);
    p.place(found);
    // The verifier does not see how large it can be.
    let known = p.label();
    p.jump_if(Less, R2, RESPONSE_LAYOUT.last + 1, known);
    p.copy(R2, RESPONSE_LAYOUT.last);
    p.place(known);
    p.alu(Shl, R2, 3);
    p.alu(Add, R0, R2);
    p.copy(R1, 1);
    p.add_to_memory(R0, TIMES + RESPONSE_LAYOUT.answers as i16, R1);
}
