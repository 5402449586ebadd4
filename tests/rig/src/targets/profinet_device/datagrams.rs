//! Datagrams from the octets of a fuzzer: sound ones, damaged ones, and any octets.

use pnet_nat::profinet::endpoint_mapper::{Handle, HandleFree, Lookup};
use pnet_nat::profinet::rpc::{Flags1, Header, Interface, PacketType, ReadImplicit, Rpc};
use pnet_nat::profinet::{ByteOrder, ObjectUuid, Uuid};

use super::super::input::Input;
use super::calls::Name;

/// Some are in no list, some in one of them, some in all.
const INDEXES: [u16; 8] = [0xAFF0, 0xF841, 0xF80C, 0xF821, 0xE040, 0x0001, 0x800B, 0xAFF6];

/// Octets of each fragment of a read, which has 84.
const PIECES: [usize; 8] = [28, 42, 83, 50, 21, 30, 4, 84];

/// What a client sends.
pub(super) struct Sent {
    pub octets: Vec<u8>,
    /// The record that it reads if it is a whole read of some record.
    pub is_sound_read: Option<u16>,
}

/// Who calls what, from one octet: two bits of activity, two of sequence, the byte order, three of index.
fn read(fields: u8) -> ReadImplicit {
    ReadImplicit {
        order: order(fields & 0x10 != 0),
        object: ObjectUuid { instance: 1, device: 2, vendor: 3 }.to_uuid(),
        activity: Uuid::new(1 + u128::from(fields & 3)),
        sequence: u32::from(fields >> 2 & 3),
        api: 0,
        slot: 0,
        subslot: 1,
        index: INDEXES[usize::from(fields >> 5)],
        record_length: 1000,
        target_ar: Uuid::NIL,
    }
}

fn order(is_little: bool) -> ByteOrder {
    if is_little { ByteOrder::Little } else { ByteOrder::Big }
}

pub(super) fn of_client(input: &mut Input<'_>) -> Sent {
    let shape = input.octet();
    if shape >= 0xF8 {
        return Sent { octets: input.octets(255), is_sound_read: None };
    }
    let read = read(input.octet());
    let mut octets = match shape % 8 {
        0..=2 => whole(&read),
        3 | 4 => fragment(&read, input.octet(), input.octet()),
        5 => look_up(&read, input.octet()),
        6 => signal(&read, input.choice(&PacketType::ALL)),
        _ => another_operation(&read, input),
    };
    let is_damaged = shape / 8 % 4 == 3;
    if is_damaged {
        input.damage(&mut octets);
    }
    let is_sound_read = (shape % 8 <= 2 && !is_damaged).then_some(read.index);
    Sent { octets, is_sound_read }
}

fn whole(read: &ReadImplicit) -> Vec<u8> {
    let mut octets = vec![0; ReadImplicit::LEN];
    read.emit(&mut octets).unwrap();
    octets
}

/// A piece of a read. One bit gives the header another byte order than the numbers have, another one
/// makes it the last one, or not.
fn fragment(read: &ReadImplicit, cut: u8, number: u8) -> Vec<u8> {
    let whole = whole(read);
    let header = *Rpc::parse(&whole).unwrap().header();
    let (stub, len) = (&whole[Header::LEN..], PIECES[usize::from(cut % 8)]);
    let pieces = stub.len().div_ceil(len);
    // There may be one too many.
    let number = usize::from(number) % (pieces + 1);
    let is_last = (number + 1 == pieces) != (cut & 0x40 != 0);
    let last = if is_last { Flags1::LAST_FRAGMENT } else { 0 };
    let mut header = Header {
        flags1: Flags1(Flags1::FRAGMENT | last),
        fragment_number: number as u16,
        ..header
    };
    if cut & 0x80 != 0 {
        header.representation.order = order(read.order == ByteOrder::Big);
    }
    emit(&header, stub.chunks(len).nth(number).unwrap_or_default())
}

fn look_up(read: &ReadImplicit, kind: u8) -> Vec<u8> {
    let handle = Handle { attributes: 0, uuid: Uuid::new(u128::from(kind / 4)) };
    let mut buffer = vec![0; Lookup::MAX_LEN];
    let (order, activity, sequence) = (read.order, read.activity, read.sequence);
    let len = match kind % 4 {
        0 => HandleFree { handle }.emit(order, activity, sequence, &mut buffer),
        1 => {
            let object = Some(read.object);
            let lookup = Lookup { inquiry_type: 2, object, ..Lookup::next_of_all(handle) };
            lookup.emit(order, activity, sequence, &mut buffer)
        }
        _ => Lookup::next_of_all(handle).emit(order, activity, sequence, &mut buffer),
    };
    buffer.truncate(len.unwrap());
    buffer
}

/// A datagram of this type with the body that it has to have.
fn signal(read: &ReadImplicit, packet_type: PacketType) -> Vec<u8> {
    let header = Header {
        packet_type,
        object: read.object,
        activity: read.activity,
        sequence: read.sequence,
        ..Header::request(read.order, Interface::Device.uuid(), ReadImplicit::OPERATION)
    };
    let body: &[u8] = match packet_type {
        PacketType::Response => &[0; 20],
        PacketType::Fault | PacketType::Reject => &[0; 4],
        PacketType::ClCancel => &[0; 8],
        _ => &[],
    };
    emit(&header, body)
}

fn another_operation(read: &ReadImplicit, input: &mut Input<'_>) -> Vec<u8> {
    let whole = whole(read);
    let interface = input.choice(&Interface::ALL);
    let header = Header {
        interface: interface.uuid(),
        interface_version: interface.version(),
        operation: u16::from(input.octet() % 8),
        ..*Rpc::parse(&whole).unwrap().header()
    };
    emit(&header, &whole[Header::LEN..])
}

/// What the device sends about a call, or about one that it makes up. True if it is an answer without
/// damage.
pub(super) fn of_device(input: &mut Input<'_>, call: Option<Name>) -> (Vec<u8>, bool) {
    let shape = input.octet();
    if shape >= 0xF8 {
        return (input.octets(255), false);
    }
    let mut read = read(input.octet());
    let is_its = call.is_some() && shape & 0x80 == 0;
    if let Some((activity, sequence)) = call.filter(|_| is_its) {
        (read.activity, read.sequence) = (activity, sequence);
    }
    let mut octets = match shape % 4 {
        0 | 1 => answer(&read, None),
        2 => answer(&read, Some(input.octet())),
        _ => signal(&read, input.choice(&PacketType::ALL)),
    };
    let is_damaged = shape / 4 % 4 == 3;
    if is_damaged {
        input.damage(&mut octets);
    }
    (octets, is_its && shape % 4 <= 2 && !is_damaged)
}

/// An answer with a record of four octets, or a piece of an answer.
fn answer(read: &ReadImplicit, piece: Option<u8>) -> Vec<u8> {
    let last = |number: u8| if number >= 0x80 { Flags1::LAST_FRAGMENT } else { 0 };
    let header = Header {
        packet_type: PacketType::Response,
        flags1: Flags1(piece.map_or(0, |number| Flags1::FRAGMENT | last(number))),
        fragment_number: piece.map_or(0, |number| u16::from(number & 0x7F)),
        activity: read.activity,
        sequence: read.sequence,
        ..Header::request(read.order, Interface::Device.uuid(), ReadImplicit::OPERATION)
    };
    let number = |number: u32| match read.order {
        ByteOrder::Big => number.to_be_bytes(),
        ByteOrder::Little => number.to_le_bytes(),
    };
    let numbers = [0, 4, 1000, 0, 4].map(number).concat();
    emit(&header, &[&numbers[..], &[1, 2, 3, 4]].concat())
}

fn emit(header: &Header, body: &[u8]) -> Vec<u8> {
    let mut octets = vec![0; Header::LEN + body.len()];
    header.emit(body, &mut octets).unwrap();
    octets
}
