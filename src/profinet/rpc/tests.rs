//! Octets by hand in both byte orders, every packet type, every refusal, and any octets at all.

use proptest::collection::vec;
use proptest::prelude::*;

use super::super::{ByteOrder, Malformed, ObjectUuid, Uuid};
use super::*;

const ACTIVITY: Uuid = Uuid::new(0x0102_0304_0506_0708_090A_0B0C_0D0E_0F10);

/// A ping, big-endian.
const BIG: [u8; 80] = [
    0x04, 0x01, 0x28, 0x02, // version, packet type, flags
    0x00, 0x00, 0x00, 0xAB, // data representation, serial (high)
    0xDE, 0xA0, 0x00, 0x00, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71, 0, 1, 2, 3, 0, 0x2A, // object
    0xDE, 0xA0, 0x00, 0x01, 0x6C, 0x97, 0x11, 0xD1, // interface
    0x82, 0x71, 0x00, 0xA0, 0x24, 0x42, 0xDF, 0x7D, //
    1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, // activity
    0x11, 0x22, 0x33, 0x44, // server boot
    0x00, 0x00, 0x00, 0x01, // interface version
    0x00, 0x00, 0x00, 0x07, // sequence
    0x00, 0x05, 0xFF, 0xFF, 0xFF, 0xFE, // operation, hints
    0x00, 0x00, 0x00, 0x03, 0x00, 0xCD, // body length, fragment number, auth, serial (low)
];

/// The same, little-endian.
const LITTLE: [u8; 80] = [
    0x04, 0x01, 0x28, 0x02, //
    0x10, 0x00, 0x00, 0xAB, //
    0x00, 0x00, 0xA0, 0xDE, 0x97, 0x6C, 0xD1, 0x11, 0x82, 0x71, 0, 1, 2, 3, 0, 0x2A, //
    0x01, 0x00, 0xA0, 0xDE, 0x97, 0x6C, 0xD1, 0x11, //
    0x82, 0x71, 0x00, 0xA0, 0x24, 0x42, 0xDF, 0x7D, //
    4, 3, 2, 1, 6, 5, 8, 7, 9, 10, 11, 12, 13, 14, 15, 16, //
    0x44, 0x33, 0x22, 0x11, //
    0x01, 0x00, 0x00, 0x00, //
    0x07, 0x00, 0x00, 0x00, //
    0x05, 0x00, 0xFF, 0xFF, 0xFE, 0xFF, //
    0x00, 0x00, 0x03, 0x00, 0x00, 0xCD, //
];

/// A datagram of this type: the ping's header with another body.
fn datagram(packet_type: PacketType, body: &[u8]) -> Vec<u8> {
    let mut octets = [&BIG, body].concat();
    octets[1] = packet_type as u8;
    octets[74..76].copy_from_slice(&(body.len() as u16).to_be_bytes());
    octets[76..78].fill(0);
    octets
}

#[test]
fn p_4_one_header_in_both_byte_orders() {
    let big = Rpc::parse(&BIG).unwrap();
    let header = *big.header();
    assert_eq!(
        header,
        Header {
            packet_type: PacketType::Ping,
            flags1: Flags1(0x28),
            flags2: Flags2(Flags2::CANCEL_PENDING),
            representation: Representation::default(),
            serial: 0xABCD,
            object: ObjectUuid { instance: 1, device: 0x0203, vendor: 42 }.to_uuid(),
            interface: Interface::Device.uuid(),
            activity: ACTIVITY,
            server_boot: 0x1122_3344,
            interface_version: 1,
            sequence: 7,
            operation: 5,
            interface_hint: 0xFFFF,
            activity_hint: 0xFFFE,
            fragment_number: 3,
            auth_protocol: 0,
        }
    );
    assert!(header.flags1.is_no_fack() && header.flags1.is_idempotent());
    assert!(!header.flags1.is_fragment() && !header.flags1.is_last_fragment());
    assert!(!header.flags1.is_maybe() && !header.flags1.is_broadcast());
    assert!(header.flags2.is_cancel_pending());

    let little = Rpc::parse(&LITTLE).unwrap();
    assert_eq!(little.header().activity, ACTIVITY);
    let representation = Representation { order: ByteOrder::Little, ..Default::default() };
    assert_eq!(*little.header(), Header { representation, ..header });

    for (rpc, octets) in [(big, BIG), (little, LITTLE)] {
        let mut buffer = [0; 80];
        assert_eq!(rpc.emit(&mut buffer), Ok(80));
        assert_eq!(buffer, octets);
        assert_eq!(rpc.emit(&mut buffer[..79]), Err(BufferTooSmall(80)));
    }
}

#[test]
fn p_4_every_packet_type_has_its_body() {
    let quit = [0, 0, 0, 0, 0, 0, 0, 9];
    let fack = [
        1, 0, 0, 8, 0, 0, 0x10, 0, 0, 0, 5, 0xB8, 0, 2, 0, 2, // up to the number of masks
        0, 0, 0, 5, 0x80, 0, 0, 0,
    ];
    for packet_type in PacketType::ALL {
        let bodies: &[&[u8]] = match packet_type {
            PacketType::Request | PacketType::Response => &[&[], &[1, 2, 3]],
            PacketType::Ping | PacketType::Working | PacketType::Ack => &[&[]],
            PacketType::Fault | PacketType::Reject => &[&[0x1C, 1, 0, 3]],
            PacketType::Nocall | PacketType::Fack => &[&[], &fack],
            PacketType::ClCancel => &[&quit],
            PacketType::CancelAck => &[&[], &[0, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0, 1]],
        };
        for body in bodies {
            let octets = datagram(packet_type, body);
            let rpc = Rpc::parse(&octets).unwrap();
            assert_eq!(rpc.header().packet_type, packet_type);
            match (rpc.body(), body.len()) {
                (Body::Stub(stub), _) => assert_eq!((stub.rest(), stub.offset()), (*body, 80)),
                (Body::Empty | Body::Fack(None) | Body::CancelAck(None), 0) => {}
                (Body::Status(status), _) => {
                    assert_eq!(status, 0x1C01_0003);
                    assert!(rpc.body().status_words().unwrap().starts_with("nca_unk_if"));
                }
                (Body::Fack(Some(fack)), _) => {
                    assert_eq!((fack.version, fack.window_size), (1, 8));
                    assert_eq!((fack.max_tsdu, fack.max_fragment_size), (4096, 1464));
                    assert_eq!(fack.serial, 2);
                    assert_eq!(fack.masks().collect::<Vec<_>>(), [5, 0x8000_0000]);
                }
                (Body::Quit(quit), _) => assert_eq!(quit, Quit { version: 0, cancel_id: 9 }),
                (Body::CancelAck(Some(ack)), _) => {
                    assert_eq!(ack, CancelAck { version: 0, cancel_id: 9, is_accepting: true });
                }
                (body, len) => panic!("{packet_type:?}: {body:?} of {len} octets"),
            }
        }
    }
}

#[test]
fn p_4_what_does_not_fit_is_refused_with_its_place() {
    let refused = |octets: &[u8], offset, what| {
        assert_eq!(Rpc::parse(octets).unwrap_err(), Malformed { offset, what });
    };
    let changed = |at: usize, value: u8| {
        let mut octets = BIG;
        octets[at] = value;
        octets
    };
    refused(&changed(0, 5), 0, "the version of DCE/RPC is not 4");
    refused(&changed(1, 11), 1, "an unknown packet type");
    let reserved = "a data representation that is reserved";
    for (at, value) in [(4, 0x20), (4, 0x02), (5, 4), (6, 1)] {
        refused(&changed(at, value), 4, reserved);
    }
    refused(&changed(75, 1), 80, "the octets end too early");
    refused(&BIG[..79], 79, "the octets end too early");
    refused(&[&BIG[..], &[0]].concat(), 80, "octets behind the body");
    refused(&changed(1, 0), 76, "a fragment number without fragments");
    refused(&datagram(PacketType::Ping, &[0]), 80, "more octets than this packet type has");
    refused(&datagram(PacketType::Fault, &[0; 3]), 83, "the octets end too early");
    refused(&datagram(PacketType::Reject, &[0; 5]), 84, "more octets than this packet type has");
    refused(&datagram(PacketType::Fack, &[0; 15]), 95, "the octets end too early");
    // A fack that says it has 0xFFFF masks.
    let mut masks = [0; 16];
    masks[14..].fill(0xFF);
    refused(&datagram(PacketType::Fack, &masks), 96, "the octets end too early");
}

#[test]
fn p_7_interfaces_and_their_operations_have_names() {
    for interface in Interface::ALL {
        assert_eq!(Interface::of(interface.uuid()), Some(interface));
    }
    assert_eq!(Interface::of(Uuid::NIL), None);
    let device = Interface::Device.uuid().to_string();
    assert_eq!(device, "dea00001-6c97-11d1-8271-00a02442df7d");
    let mapper = Interface::EndpointMapper.uuid().to_string();
    assert_eq!(mapper, "e1af8308-5d1f-11c9-91a4-08002b14a0fa");
    assert_eq!(operation_name(Interface::Device, 0), Some("Connect"));
    assert_eq!(operation_name(Interface::Controller, 4), Some("Control"));
    assert_eq!(operation_name(Interface::Device, 5), Some("Read Implicit"));
    assert_eq!(operation_name(Interface::Device, 6), None);
    assert_eq!(operation_name(Interface::EndpointMapper, 2), Some("ept_lookup"));
}

fn read_im0(order: ByteOrder) -> ReadImplicit {
    ReadImplicit {
        order,
        object: ObjectUuid { instance: 1, device: 0x0203, vendor: 42 }.to_uuid(),
        activity: ACTIVITY,
        sequence: 0x0001_0007,
        api: 0,
        slot: 0,
        subslot: 0x8000,
        index: 0xAFF0,
        record_length: 0x1000,
        target_ar: Uuid::NIL,
    }
}

#[test]
fn p_4_a_read_implicit_has_these_octets() {
    let mut buffer = [0xEE; ReadImplicit::LEN];
    let read = read_im0(ByteOrder::Little);
    assert_eq!(read.emit(&mut buffer), Ok(164));
    assert_eq!(buffer[..8], [0x04, 0x00, 0x20, 0x00, 0x10, 0x00, 0x00, 0x00]);
    assert_eq!(buffer[8..56], LITTLE[8..56]);
    let behind =
        [0, 0, 0, 0, 1, 0, 0, 0, 7, 0, 1, 0, 5, 0, 0xFF, 0xFF, 0xFF, 0xFF, 84, 0, 0, 0, 0, 0];
    assert_eq!(buffer[56..80], behind);
    assert_eq!(
        buffer[80..],
        [
            0x40, 0x10, 0, 0, 0x40, 0, 0, 0, // arguments' maximum and length
            0x40, 0x10, 0, 0, 0, 0, 0, 0, 0x40, 0, 0, 0, // the array
            0x00, 0x09, 0x00, 0x3C, 0x01, 0x00, 0x00, 0x07, // IODReadReqHeader, sequence
            0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, // AR
            0, 0, 0, 0, 0x00, 0x00, 0x80, 0x00, 0, 0, // API, slot, subslot
            0xAF, 0xF0, 0x00, 0x00, 0x10, 0x00, // index, length
            0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, // target AR
            0, 0, 0, 0, 0, 0, 0, 0,
        ]
    );
    assert_eq!(read.emit(&mut buffer[..163]), Err(BufferTooSmall(164)));
}

#[test]
fn p_4_only_a_read_implicit_is_one() {
    let mut buffer = [0; ReadImplicit::LEN];
    read_im0(ByteOrder::Big).emit(&mut buffer).unwrap();
    let parsed = |octets: &[u8]| ReadImplicit::parse(&Rpc::parse(octets).unwrap());
    assert_eq!(parsed(&buffer), Ok(Some(read_im0(ByteOrder::Big))));
    for (at, value) in [(1, 2), (2, 0x24), (69, 2), (27, 2)] {
        let mut other = buffer;
        other[at] = value;
        assert_eq!(parsed(&other), Ok(None), "octet {at}");
    }
    let mut other = buffer;
    other[101] = 0x0A;
    let what = "the block is not an IODReadReqHeader";
    assert_eq!(parsed(&other), Err(Malformed { offset: 100, what }));
}

/// Any header; its body belongs to a request.
fn header() -> impl Strategy<Value = Header> {
    let uuids = (any::<u128>(), any::<u128>(), any::<u128>());
    let numbers = (any::<u32>(), any::<u32>(), any::<u32>());
    let shorts = (any::<u16>(), any::<u16>(), any::<u16>(), any::<u16>(), any::<u16>());
    let first = (any::<bool>(), any::<bool>(), 0u8..4, any::<u8>(), any::<u8>(), any::<u8>());
    (uuids, numbers, shorts, first).prop_map(|(uuids, numbers, shorts, first)| Header {
        packet_type: PacketType::Request,
        flags1: Flags1(first.3 | Flags1::FRAGMENT),
        flags2: Flags2(first.4),
        representation: Representation {
            order: if first.0 { ByteOrder::Little } else { ByteOrder::Big },
            ebcdic: first.1,
            floating_point: first.2,
        },
        serial: shorts.0,
        object: Uuid::new(uuids.0),
        interface: Uuid::new(uuids.1),
        activity: Uuid::new(uuids.2),
        server_boot: numbers.0,
        interface_version: numbers.1,
        sequence: numbers.2,
        operation: shorts.1,
        interface_hint: shorts.2,
        activity_hint: shorts.3,
        fragment_number: shorts.4,
        auth_protocol: first.5,
    })
}

/// Noise, and the ping above with octets changed, cut off or added.
fn hostile_octets() -> impl Strategy<Value = Vec<u8>> {
    let changes = vec((any::<prop::sample::Index>(), any::<u8>()), 0..6);
    let damaged = (changes, vec(any::<u8>(), 0..120), any::<bool>()).prop_map(
        |(changes, body, is_little)| {
            let mut octets = [if is_little { &LITTLE } else { &BIG }, &body[..]].concat();
            octets[74..76].copy_from_slice(&[0, body.len() as u8]);
            if is_little {
                octets[74..76].reverse();
            }
            for (index, value) in changes {
                *index.get_mut(&mut octets) = value;
            }
            octets
        },
    );
    prop_oneof![vec(any::<u8>(), 0..200), damaged]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..Default::default() })]

    #[test]
    fn what_is_emitted_is_parsed_again(header in header(), body in vec(any::<u8>(), 0..64)) {
        let mut buffer = [0; 160];
        let len = header.emit(&body, &mut buffer).unwrap();
        let rpc = Rpc::parse(&buffer[..len]).unwrap();
        prop_assert_eq!(rpc.header(), &header);
        let Body::Stub(stub) = rpc.body() else { panic!("{:?}", rpc.body()) };
        prop_assert_eq!(stub.rest(), &body);
    }

    #[test]
    fn p_4_a_read_implicit_is_parsed_again(
        ids in (any::<u128>(), any::<u128>(), any::<u128>()),
        numbers in (any::<u32>(), any::<u32>(), any::<u32>()),
        place in (any::<u16>(), any::<u16>(), any::<u16>()),
        is_little: bool,
    ) {
        let read = ReadImplicit {
            order: if is_little { ByteOrder::Little } else { ByteOrder::Big },
            object: Uuid::new(ids.0),
            activity: Uuid::new(ids.1),
            sequence: numbers.0,
            api: numbers.1,
            slot: place.0,
            subslot: place.1,
            index: place.2,
            record_length: numbers.2,
            target_ar: Uuid::new(ids.2),
        };
        let mut buffer = [0; ReadImplicit::LEN];
        read.emit(&mut buffer).unwrap();
        let rpc = Rpc::parse(&buffer).unwrap();
        prop_assert_eq!(ReadImplicit::parse(&rpc), Ok(Some(read)));
    }

    #[test]
    fn no_octets_panic_and_what_is_parsed_is_emitted_alike(octets in hostile_octets()) {
        if let Ok(rpc) = Rpc::parse(&octets) {
            let mut buffer = [0; 256];
            let len = rpc.emit(&mut buffer).unwrap();
            prop_assert_eq!(&buffer[..len], &octets);
            let _ = ReadImplicit::parse(&rpc);
            if let Body::Fack(Some(fack)) = rpc.body() {
                fack.masks().count();
            }
        }
    }
}
