//! Which calls pass, and why others do not.

use proptest::prelude::*;

use super::*;
use crate::profinet::endpoint_mapper::{Handle, HandleFree, Lookup};
use crate::profinet::rpc::Flags1;
use crate::profinet::{ByteOrder, Uuid};

const ACTIVITY: Uuid = Uuid::new(0x1234_5678_9ABC_DEF0_1122_3344_5566_7788);

fn read(order: ByteOrder, index: u16) -> ReadImplicit {
    ReadImplicit {
        order,
        object: ObjectUuid { instance: 1, device: 2, vendor: 3 }.to_uuid(),
        activity: ACTIVITY,
        sequence: 7,
        api: 0,
        slot: 0,
        subslot: 1,
        index,
        record_length: 1000,
        target_ar: Uuid::NIL,
    }
}

fn octets(call: &ReadImplicit) -> Vec<u8> {
    let mut octets = [0; ReadImplicit::LEN];
    call.emit(&mut octets).unwrap();
    octets.to_vec()
}

fn parse(octets: &[u8]) -> Result<Request<'_>, DropReason> {
    Request::parse(octets, Records::default())
}

/// The datagram with another header.
fn with_header(octets: &[u8], change: impl FnOnce(&mut Header)) -> Vec<u8> {
    let rpc = Rpc::parse(octets).unwrap();
    let mut header = *rpc.header();
    change(&mut header);
    let mut buffer = vec![0; octets.len()];
    header.emit(&octets[Header::LEN..], &mut buffer).unwrap();
    buffer
}

#[test]
fn p_4_reading_passes_in_both_byte_orders() {
    for order in [ByteOrder::Big, ByteOrder::Little] {
        let sound = octets(&read(order, 0xAFF0));
        assert!(parse(&sound).unwrap().wants_answer());
        let mut buffer = [0; 200];
        let length = Lookup::next_of_all(Handle::default()).emit(order, ACTIVITY, 0, &mut buffer);
        assert!(parse(&buffer[..length.unwrap()]).is_ok());
        let free = HandleFree { handle: Handle::default() };
        let length = free.emit(order, ACTIVITY, 1, &mut buffer).unwrap();
        assert!(parse(&buffer[..length]).is_ok());
    }
}

#[test]
fn p_4_each_other_operation_has_a_reason_of_its_own() {
    let sound = octets(&read(ByteOrder::Little, 0xAFF0));
    for (operation, reason) in [
        (0, DropReason::RpcConnect),
        (1, DropReason::RpcRelease),
        (2, DropReason::RpcRead),
        (3, DropReason::RpcWrite),
        (4, DropReason::RpcControl),
        (6, DropReason::RpcInterface),
    ] {
        let other = with_header(&sound, |header| header.operation = operation);
        assert_eq!(parse(&other).unwrap_err(), reason);
        // The same in what goes on with a call.
        let ping = answer(ByteOrder::Little, PacketType::Ping);
        let ping = with_header(&ping, |header| header.operation = operation);
        assert_eq!(parse(&ping).unwrap_err(), reason);
    }
    let interface =
        |interface: Interface| with_header(&sound, |header| header.interface = interface.uuid());
    for other in [Interface::Controller, Interface::Supervisor, Interface::ParameterServer] {
        assert_eq!(parse(&interface(other)).unwrap_err(), DropReason::RpcInterface);
    }
    let version = with_header(&sound, |header| header.interface_version = 2);
    assert_eq!(parse(&version).unwrap_err(), DropReason::RpcInterface);
    let broadcast = with_header(&sound, |header| header.flags1 = Flags1(Flags1::BROADCAST));
    assert_eq!(parse(&broadcast).unwrap_err(), DropReason::Broadcast);
    let response = with_header(&sound, |header| header.packet_type = PacketType::Response);
    assert_eq!(parse(&response).unwrap_err(), DropReason::PacketType);
    let proof = with_header(&sound, |header| header.auth_protocol = 1);
    assert_eq!(parse(&proof).unwrap_err(), DropReason::BadHeader);
}

#[test]
fn p_5_what_contradicts_itself_is_malformed() {
    let sound = octets(&read(ByteOrder::Big, 0xAFF0));
    for (at, octet, reason) in [
        (0, 5, DropReason::BadHeader),
        (1, 11, DropReason::BadHeader),
        (4, 0x20, DropReason::BadHeader),
        (75, 103, DropReason::BadLength),
        (8, 0, DropReason::BadNdr),   // an object that is none of PROFINET
        (83, 1, DropReason::BadNdr),  // the arguments' maximum
        (87, 65, DropReason::BadNdr), // their length
        (95, 1, DropReason::BadNdr),  // offset
        (99, 63, DropReason::BadNdr), // actual count
        (101, 8, DropReason::BadNdr), // another block
        (103, 59, DropReason::BadNdr), // its length
        (110, 1, DropReason::RpcRead), // an AR
    ] {
        let mut other = sound.clone();
        other[at] = octet;
        assert_eq!(parse(&other).unwrap_err(), reason, "octet {at} is {octet}");
    }
    assert_eq!(parse(&sound[..79]).unwrap_err(), DropReason::TooShort);
    assert_eq!(parse(&[&sound[..], &[0; 1400]].concat()).unwrap_err(), DropReason::TooLong);
    assert_eq!(parse(&[&sound[..], &[0]].concat()).unwrap_err(), DropReason::BadLength);
}

#[test]
fn p_9_only_listed_records_are_read() {
    let reason = |index| parse(&octets(&read(ByteOrder::Big, index))).err();
    for index in [0xAFF0, 0xAFF5, 0xF840, 0xF841, 0xF80C, 0xF830, 0xF000] {
        assert_eq!(reason(index), None, "{index:#06x}");
    }
    for index in [0x0001, 0x8000, 0xE040, 0xF821, 0xB02E, 0xAFF6] {
        assert_eq!(reason(index), Some(DropReason::RecordNotAllowed), "{index:#06x}");
    }
}

/// A read in fragments of this many octets.
fn fragments(order: ByteOrder, octets_each: usize, change: impl FnOnce(&mut [u8])) -> Vec<Vec<u8>> {
    let mut whole = octets(&read(order, 0xAFF0));
    let header = *Rpc::parse(&whole).unwrap().header();
    change(&mut whole[Header::LEN..]);
    let parts: Vec<_> = whole[Header::LEN..].chunks(octets_each).collect();
    let cut = |(number, part): (usize, &&[u8])| {
        let last = if number + 1 == parts.len() { Flags1::LAST_FRAGMENT } else { 0 };
        let flags1 = Flags1(Flags1::FRAGMENT | last);
        let header = Header { flags1, fragment_number: number as u16, ..header };
        let mut buffer = [0; 200];
        let length = header.emit(part, &mut buffer).unwrap();
        buffer[..length].to_vec()
    };
    parts.iter().enumerate().map(cut).collect()
}

/// What becomes of datagrams of one client, one after the other.
fn verdicts(datagrams: &[Vec<u8>]) -> Vec<Result<bool, DropReason>> {
    let mut exchanges = Exchanges::default();
    let judge = |octets: &Vec<u8>| {
        let request = parse(octets)?;
        request.goes_on(Some(&exchanges), 1)?;
        exchanges.asked(&request, 1);
        Ok(request.wants_answer())
    };
    datagrams.iter().map(judge).collect()
}

#[test]
fn p_8_fragments_are_checked_as_they_come() {
    for order in [ByteOrder::Big, ByteOrder::Little] {
        for octets_each in [20, 28, 30, 42, 83] {
            let sound = fragments(order, octets_each, |_| ());
            let seen = verdicts(&sound);
            let (last, before) = seen.split_last().unwrap();
            assert!(before.iter().all(|verdict| *verdict == Ok(false)), "{seen:?}");
            assert_eq!(*last, Ok(true), "it asks with its last one");
            let again: Vec<_> = sound.iter().flat_map(|it| [it.clone(), it.clone()]).collect();
            assert!(verdicts(&again).iter().all(Result::is_ok), "each is sent again");
        }
    }
}

/// The fragment that makes a request one that may not pass does not pass.
#[test]
fn p_8_what_is_refused_in_one_piece_is_refused_in_fragments() {
    let end_with = |change: fn(&mut [u8])| {
        let fragments = fragments(ByteOrder::Big, 28, change);
        let verdicts = verdicts(&fragments);
        verdicts.into_iter().find_map(Result::err)
    };
    assert_eq!(end_with(|stub| stub[55] = 0x09), Some(DropReason::RecordNotAllowed));
    assert_eq!(end_with(|stub| stub[30] = 1), Some(DropReason::RpcRead));
    assert_eq!(end_with(|stub| stub[7] = 1), Some(DropReason::BadNdr));
    assert_eq!(end_with(|stub| stub[21] = 8), Some(DropReason::BadNdr));
    assert_eq!(end_with(|_| ()), None);
}

#[test]
fn p_8_fragments_that_do_not_belong_together_are_refused() {
    let sound = fragments(ByteOrder::Big, 28, |_| ());
    let unknown = Err(DropReason::UnknownExchange);
    let bad = Err(DropReason::BadNdr);
    assert_eq!(verdicts(&sound[1..2]), [unknown]);
    assert_eq!(parse(&sound[1]).unwrap().goes_on(None, 1), Err(DropReason::UnknownExchange));
    assert_eq!(verdicts(&[sound[0].clone(), sound[2].clone()]), [Ok(false), bad], "a gap");
    // What has passed does not change any more: here the API, which alone would be right.
    let other = fragments(ByteOrder::Big, 50, |stub| stub[44] = 9);
    let first = fragments(ByteOrder::Big, 50, |_| ()).remove(0);
    assert_eq!(verdicts(&other[..1]), [Ok(false)]);
    assert_eq!(verdicts(&[first, other[0].clone()]), [Ok(false), bad], "not as it was");
    let (header, mut shorter) = (*Rpc::parse(&sound[1]).unwrap().header(), vec![0; 100]);
    header.emit(&sound[1][Header::LEN..Header::LEN + 20], &mut shorter).unwrap();
    assert_eq!(verdicts(&[sound[0].clone(), shorter]), [Ok(false), bad], "another length");
    let last = with_header(&sound[1], |header| {
        header.flags1 = Flags1(Flags1::FRAGMENT | Flags1::LAST_FRAGMENT);
    });
    assert_eq!(verdicts(&[sound[0].clone(), last]), [Ok(false), bad], "it ends too early");
    let look_up = with_header(&sound[1], |header| {
        header.interface = Interface::EndpointMapper.uuid();
        (header.interface_version, header.operation) = (3, 2);
    });
    assert_eq!(verdicts(&[sound[0].clone(), look_up]), [Ok(false), bad], "another operation");
    let whole = octets(&read(ByteOrder::Big, 0xAFF0));
    let alone = |flags| with_header(&whole, |header| header.flags1 = Flags1(flags));
    assert_eq!(verdicts(&[alone(Flags1::FRAGMENT)]), [bad], "nothing is left for others");
    assert_eq!(verdicts(&[alone(Flags1::FRAGMENT | Flags1::LAST_FRAGMENT)]), [Ok(true)]);
}

/// A device reads the numbers in the byte order of the first fragment, or of the last one.
#[test]
fn p_8_fragments_of_two_byte_orders_are_refused() {
    for (order, other) in [(ByteOrder::Big, ByteOrder::Little), (ByteOrder::Little, ByteOrder::Big)]
    {
        let mut fragments = fragments(order, 28, |_| ());
        fragments[1] = with_header(&fragments[1], |header| header.representation.order = other);
        let verdicts = verdicts(&fragments);
        assert_eq!(verdicts[0], Ok(false));
        assert!(verdicts[1..].iter().all(|it| *it == Err(DropReason::BadNdr)), "{verdicts:?}");
    }
}

/// Fragments of two requests that a device takes for one are a read that may pass, too.
#[test]
fn p_8_what_is_checked_together_is_in_one_fragment() {
    let refused = |octets_each: usize| {
        let verdicts = verdicts(&fragments(ByteOrder::Big, octets_each, |_| ()));
        verdicts.into_iter().find_map(Result::err)
    };
    for inside in [1, 3, 19, 55] {
        assert_eq!(refused(inside), Some(DropReason::BadNdr), "cut behind {inside} octets");
    }
    assert!([20, 21, 54, 56].iter().all(|between| refused(*between).is_none()));
}

#[test]
fn p_8_fragments_without_octets_are_refused() {
    let whole = octets(&read(ByteOrder::Big, 0xAFF0));
    let sound = fragments(ByteOrder::Big, 28, |_| ());
    let nothing = |number, last| {
        let header = *Rpc::parse(&whole).unwrap().header();
        let flags1 = Flags1(Flags1::FRAGMENT | last);
        let mut buffer = [0; Header::LEN];
        Header { flags1, fragment_number: number, ..header }.emit(&[], &mut buffer).unwrap();
        buffer.to_vec()
    };
    let bad = Err(DropReason::BadNdr);
    let more = nothing(3, Flags1::LAST_FRAGMENT);
    assert_eq!(verdicts(&[&sound[..], &[more]].concat()).last(), Some(&bad), "one too many");
    for number in [0, 1, 7] {
        assert_eq!(verdicts(&[whole.clone(), nothing(number, 0)]), [Ok(true), bad]);
    }
}

fn answer(order: ByteOrder, packet_type: PacketType) -> Vec<u8> {
    let header = Header {
        packet_type,
        activity: ACTIVITY,
        sequence: 7,
        ..Header::request(order, Interface::Device.uuid(), ReadImplicit::OPERATION)
    };
    let stub: &[u8] = match packet_type {
        PacketType::Response => &[0; 20],
        PacketType::Fault | PacketType::Reject => &[0; 4],
        _ => &[],
    };
    let mut buffer = [0; 200];
    let length = header.emit(stub, &mut buffer).unwrap();
    buffer[..length].to_vec()
}

/// Requests and answers of one call may have different byte orders, and any port of the device.
#[test]
fn p_7_an_answer_belongs_to_its_call() {
    let asked = octets(&read(ByteOrder::Little, 0xAFF0));
    let request = parse(&asked).unwrap();
    let mut exchanges = Exchanges::default();
    let sound = answer(ByteOrder::Big, PacketType::Response);
    let unknown = Err(DropReason::UnknownExchange);
    assert_eq!(response(&sound, &mut exchanges, 49_153, 1), unknown);
    assert_eq!(exchanges.asked(&request, 1), None, "to the device's own port");
    for (packet_type, is_answer) in [
        (PacketType::Working, false),
        (PacketType::Fack, false),
        (PacketType::CancelAck, false),
        (PacketType::Nocall, false),
        (PacketType::Fault, true),
        (PacketType::Reject, true),
        (PacketType::Response, true),
    ] {
        let octets = answer(ByteOrder::Big, packet_type);
        assert_eq!(response(&octets, &mut exchanges, 49_153, 2), Ok(is_answer), "{packet_type:?}");
    }
    assert_eq!(exchanges.asked(&request, 3), Some(49_153), "it goes on where the answer came from");
    for packet_type in
        [PacketType::Request, PacketType::Ping, PacketType::Ack, PacketType::ClCancel]
    {
        let octets = answer(ByteOrder::Big, PacketType::Working);
        let octets = with_header(&octets, |header| header.packet_type = packet_type);
        let refused = response(&octets, &mut exchanges, 49_153, 3).unwrap_err();
        assert!(matches!(refused, DropReason::PacketType | DropReason::BadNdr), "{refused:?}");
    }
    let other = with_header(&sound, |header| header.sequence = 8);
    assert_eq!(response(&other, &mut exchanges, 49_153, 4), unknown);
    let other = with_header(&sound, |header| header.activity = Uuid::new(1));
    assert_eq!(response(&other, &mut exchanges, 49_153, 4), unknown);
    let late = 3 + 10_000_000_000;
    assert_eq!(response(&sound, &mut exchanges, 49_153, late), unknown, "late");
    let mut malformed = sound;
    malformed[99] = 1;
    assert_eq!(response(&malformed, &mut exchanges, 49_153, 4), Err(DropReason::BadNdr));
}

#[test]
fn of_many_calls_the_newest_are_known() {
    let mut exchanges = Exchanges::default();
    let call = |sequence| octets(&ReadImplicit { sequence, ..read(ByteOrder::Big, 0xAFF0) });
    let answer = |sequence| {
        let sound = answer(ByteOrder::Little, PacketType::Response);
        with_header(&sound, |header| header.sequence = sequence)
    };
    for sequence in 0..20 {
        exchanges.asked(&parse(&call(sequence)).unwrap(), 100 + u64::from(sequence));
    }
    let known = |sequence| response(&answer(sequence), &mut exchanges.clone(), 1, 200).is_ok();
    assert!((0..12).all(|sequence| !known(sequence)) && (12..20).all(known));
}

proptest! {
    /// Whatever is changed, nothing but a read that is listed begins a call, and nothing panics.
    #[test]
    fn only_reading_begins_a_call(
        changes in prop::collection::vec((0..ReadImplicit::LEN, any::<u8>()), 0..6),
        cut in prop::option::of(0..ReadImplicit::LEN),
        little in any::<bool>(),
    ) {
        let order = if little { ByteOrder::Little } else { ByteOrder::Big };
        let mut octets = octets(&read(order, 0xAFF0));
        for (at, octet) in changes {
            octets[at] = octet;
        }
        octets.truncate(cut.unwrap_or(ReadImplicit::LEN));
        let is_whole = parse(&octets).is_ok_and(|request| matches!(request.part, Part::Whole));
        if is_whole {
            let mut octets = octets.clone();
            octets[2] &= !Flags1::FRAGMENT; // one fragment may be all of them
            let rpc = Rpc::parse(&octets).unwrap();
            let read = ReadImplicit::parse(&rpc);
            prop_assert!(matches!(read, Ok(Some(read)) if Records::default().include(read.index)));
        }
        let _ = response(&octets, &mut Exchanges::default(), 1, 1);
    }
}
