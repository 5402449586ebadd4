//! What may reach a device: reads of listed records and look-ups, told by the codec and by a list of
//! indexes of its own, so that the router's checks do not test themselves.

use pnet_nat::nat::{Record, Records};
use pnet_nat::profinet::blocks::IodReadReqHeader;
use pnet_nat::profinet::endpoint_mapper::{HANDLE_FREE, LOOKUP, Message};
use pnet_nat::profinet::rpc::{Body, Interface, PacketType, ReadImplicit, Rpc};
use pnet_nat::profinet::{ByteOrder, ObjectUuid, Octets, ndr};

/// Which part of a call it is.
pub(super) enum Part<'a> {
    Whole,
    Fragment { number: u16, is_last: bool, stub: &'a [u8] },
    Signal,
}

/// What a client's datagram is. It may pass.
pub(super) fn part_of<'a>(rpc: &Rpc<'a>, records: Records) -> Part<'a> {
    let header = rpc.header();
    assert!(!header.flags1.is_broadcast() && header.auth_protocol == 0);
    let interface = Interface::of(header.interface).expect("an interface of PROFINET");
    assert_eq!(header.interface_version, interface.version());
    let looks = match (interface, header.operation) {
        (Interface::Device, ReadImplicit::OPERATION) => false,
        (Interface::EndpointMapper, LOOKUP | HANDLE_FREE) => true,
        other => panic!("P-4: {other:?}"),
    };
    let Body::Stub(stub) = rpc.body() else {
        let signals = [PacketType::Ping, PacketType::Ack, PacketType::ClCancel, PacketType::Fack];
        assert!(signals.contains(&header.packet_type), "{:?}", header.packet_type);
        return Part::Signal;
    };
    assert_eq!(header.packet_type, PacketType::Request);
    let (flags, number) = (header.flags1, header.fragment_number);
    let is_last = !flags.is_fragment() || flags.is_last_fragment();
    let is_whole = is_last && number == 0;
    if looks {
        let message = Message::of(rpc).expect("a sound look-up");
        assert!(matches!(message, Some(Message::Lookup(_) | Message::HandleFree(_))) && is_whole);
        return Part::Whole;
    }
    assert!(ObjectUuid::of(header.object).is_some(), "P-7");
    if !is_whole {
        return Part::Fragment { number, is_last, stub: stub.rest() };
    }
    is_sound(stub.rest(), stub.order(), records);
    Part::Whole
}

/// The whole stub data of a read.
pub(super) fn is_sound(stub: &[u8], order: ByteOrder, records: Records) {
    let mut request = ndr::Request::read(Octets::new(stub).in_order(order)).expect("P-5");
    assert!(request.args_maximum as usize >= IodReadReqHeader::LEN, "P-5");
    assert_eq!(request.args.rest()[4..6], [1, 0], "P-6: the version of the block");
    let block = IodReadReqHeader::parse(&mut request.args).expect("P-6");
    assert!(block.ar_uuid.is_nil(), "it reads in a connection");
    assert!(is_in(records, block.index), "P-9: {:#06x}", block.index);
}

/// Whether the record with this index may be read.
pub(super) fn is_in(records: Records, index: u16) -> bool {
    let record = match index {
        0xAFF0 => Record::Im0,
        0xAFF1 => Record::Im1,
        0xAFF2 => Record::Im2,
        0xAFF3 => Record::Im3,
        0xAFF4 => Record::Im4,
        0xAFF5 => Record::Im5,
        0xF840 => Record::Im0FilterData,
        0x802A | 0x8072 | 0x8080 | 0xF841 => Record::PdRealData,
        0xF80C => Record::Diagnosis,
        0xF830 => Record::LogBook,
        0x8001 | 0xC001 | 0xF000 => Record::RealIdentificationData,
        0xF821 => Record::ApiData,
        // For a subslot, a slot, or an application process.
        _ => match (index & 0xF000, index & 0x0FFF) {
            (0x8000 | 0xC000 | 0xF000, 0x00A..=0x00C | 0x010..=0x013) => Record::Diagnosis,
            _ => return false,
        },
    };
    records.has(record)
}
