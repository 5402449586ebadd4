//! Where the fuzzer begins: sound octets for each parser, most of them emitted by the codec.

use pnet_nat::profinet::endpoint_mapper::{Handle, HandleFree, InterfaceId, Lookup};
use pnet_nat::profinet::rpc::{Flags1, Header, Interface, PacketType, ReadImplicit};
use pnet_nat::profinet::{ByteOrder, ObjectUuid, Uuid};

use super::ORDERS;

const ACTIVITY: Uuid = Uuid::new(0x1234_5678_9ABC_DEF0_1122_3344_5566_7788);

/// Names of files of the corpus, and what is in them.
pub fn all() -> Vec<(String, Vec<u8>)> {
    let mut seeds = Vec::new();
    let mut put = |parser: u8, name: &str, octets: Vec<u8>| {
        seeds.push((format!("seed-{name}"), [&[parser], &octets[..]].concat()));
    };
    for (name, octets) in layer_2() {
        let parser = match name.split('-').next() {
            Some("rt") => 0,
            Some("dcp") => 1,
            Some("alarm") => 2,
            Some("lldp") => 3,
            Some("mrp") => 4,
            _ => 5,
        };
        put(parser, name, octets);
    }
    for order in ORDERS {
        let ending = if order == ByteOrder::Big { "big" } else { "little" };
        for (name, octets) in datagrams(order) {
            put(6, &format!("rpc-{name}-{ending}"), octets.clone());
            if name.starts_with("ndr") {
                put(7, &format!("{name}-{ending}"), octets[Header::LEN..].to_vec());
            }
            if name.starts_with("mapper") {
                put(8, &format!("{name}-{ending}"), octets[Header::LEN..].to_vec());
            }
        }
    }
    for (name, octets) in rows_of_blocks() {
        put(9, &format!("blocks-{name}"), octets);
    }
    let entry = [0, 1, 0x08, 0, 0, 6, 0x80, 0, 0, 0, 0, 7, 0, 0x80, 0, 0];
    for (usi, len) in [(0x8000_u16, 6), (0x8002, 12), (0x8003, 16)] {
        let entries = [&usi.to_be_bytes(), &entry[..len], &entry[..len]].concat();
        put(10, &format!("diagnosis-{usi:x}"), entries);
    }
    seeds
}

fn layer_2() -> Vec<(&'static str, Vec<u8>)> {
    let notification =
        block(0x0002, 0, &[0, 1, 0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 9, 0, 0, 0, 8, 0, 1]);
    let alarm = [&[0, 1, 0, 2, 0x11, 0x11, 0, 5, 0xFF, 0xFE][..], &length(&notification)];
    let alarm = [&alarm.concat(), &notification[..]].concat();
    let identify = [&[5, 1, 0, 0, 0, 7, 0, 0, 0, 34][..], &[2, 2, 0, 5, 0, 0, b'd', b'-', b'7', 0]];
    let ip = [&[1, 2, 0, 14, 0, 1][..], &[172, 17, 17, 7, 255, 255, 255, 0, 0, 0, 0, 0]].concat();
    let identify = [&identify.concat(), &ip[..], &[2, 4, 0, 2, 0, 0]].concat();
    let set = [&[4, 0, 0, 0, 0, 8, 0, 0, 0, 8][..], &[5, 3, 0, 4, 0, 0, 1, 0]].concat();
    let test = [&[2, 18, 0x80, 0][..], &[2; 6], &[0, 0, 0, 1, 0, 3, 0, 0, 0, 9]].concat();
    let common = [&[1, 18, 0, 5][..], &[0xAB; 16]].concat();
    let ptcp = [&[0; 12][..], &[0x23, 0xAD, 0, 0, 0, 0, 0, 9, 0x0C, 6], &[2; 6], &[0, 0]].concat();
    let sync = [&[0; 12][..], &[0, 5, 3, 0, 0, 0, 0, 73, 0x02, 22], &[2; 22], &[0, 0]].concat();
    vec![
        ("rt-cyclic", [&[0x80, 1][..], &[0x80; 40], &[0x12, 0x34, 0x35, 0]].concat()),
        ("rt-alarm", [&[0xFE, 1], &alarm[..]].concat()),
        ("rt-dcp", [&[0xFE, 0xFF], &identify[..]].concat()),
        ("rt-ptcp", [&[0xFF, 0x40], &ptcp[..]].concat()),
        ("dcp-identify", identify),
        ("dcp-set", set),
        ("dcp-get", vec![3, 0, 0, 0, 0, 9, 0, 0, 0, 4, 1, 2, 2, 5]),
        ("alarm-data", alarm),
        ("alarm-error", vec![0, 1, 0, 2, 0x14, 1, 0, 5, 0, 4, 0, 4, 0xCF, 0x81, 0xFD, 5]),
        ("lldp", lldp()),
        ("mrp-test", [&[0, 1][..], &test, &common, &[0, 0]].concat()),
        ("mrp-option", [&[0, 1, 0x7F, 5, 0, 0x80, 0x63, 3, 0, 0][..], &common, &[0, 0]].concat()),
        ("ptcp-delay", [&[4], &ptcp[..]].concat()),
        ("ptcp-sync", [&[1], &sync[..]].concat()),
    ]
}

fn lldp() -> Vec<u8> {
    let tlv = |kind: u8, contents: &[u8]| [&[kind << 1, contents.len() as u8], contents].concat();
    let pno = |subtype, contents: &[u8]| [&[0, 0x0E, 0xCF, subtype], contents].concat();
    [
        tlv(1, b"\x07drive-7"),
        tlv(2, b"\x07port-001.drive-7"),
        tlv(3, &[0, 20]),
        tlv(7, &[0, 0x84, 0, 0x84]),
        tlv(8, &[5, 1, 172, 17, 17, 7, 2, 0, 0, 0, 1, 0]),
        tlv(127, &pno(1, &[1; 20])),
        tlv(127, &pno(2, &[0, 1, 0, 2])),
        tlv(127, &pno(5, &[2; 6])),
        tlv(127, &[0, 0x12, 0x0F, 1, 3, 0x6C, 0x11, 0, 0x10]),
        vec![0, 0],
    ]
    .concat()
}

/// What clients and devices send with this byte order.
fn datagrams(order: ByteOrder) -> Vec<(&'static str, Vec<u8>)> {
    let object = ObjectUuid { instance: 1, device: 2, vendor: 3 }.to_uuid();
    let read = ReadImplicit {
        order,
        object,
        activity: ACTIVITY,
        sequence: 7,
        api: 0,
        slot: 0,
        subslot: 1,
        index: 0xAFF0,
        record_length: 1000,
        target_ar: Uuid::NIL,
    };
    let interface = InterfaceId { uuid: Interface::Device.uuid(), major: 1, minor: 0 };
    let handle = Handle { attributes: 0, uuid: ACTIVITY };
    let lookup = Lookup::next_of_all(handle);
    let lookup = Lookup { object: Some(object), interface: Some(interface), ..lookup };
    let mut buffer = [0; 200];
    let emitted = |len: usize, buffer: &[u8; 200]| buffer[..len].to_vec();
    let mut all = Vec::new();
    let len = read.emit(&mut buffer).unwrap();
    all.push(("ndr-read", emitted(len, &buffer)));
    let len = lookup.emit(order, ACTIVITY, 0, &mut buffer).unwrap();
    all.push(("mapper-lookup", emitted(len, &buffer)));
    let len = HandleFree { handle }.emit(order, ACTIVITY, 1, &mut buffer).unwrap();
    all.push(("mapper-free", emitted(len, &buffer)));

    let device = Header {
        activity: ACTIVITY,
        object,
        sequence: 7,
        ..Header::request(order, Interface::Device.uuid(), ReadImplicit::OPERATION)
    };
    let mapper = Header {
        packet_type: PacketType::Response,
        interface_version: 3,
        ..Header::request(order, Interface::EndpointMapper.uuid(), 2)
    };
    let record = block(0x0020, 0, &[b'0'; 54]);
    let answer = [&read_answer(0xAFF0, &record)[..], &record].concat();
    all.push(("ndr-answer", of(PacketType::Response, device, &array(order, 0, &answer))));
    let refused = array(order, 0xDE80_B000, &[]);
    all.push(("ndr-refused", of(PacketType::Response, device, &refused)));
    let fragment = Header { flags1: Flags1(Flags1::FRAGMENT | Flags1::LAST_FRAGMENT), ..device };
    all.push(("ndr-fragment", of(PacketType::Response, fragment, &array(order, 0, &answer))));
    all.push(("mapper-answer", of(PacketType::Response, mapper, &mapper_answer(order))));
    let numbers =
        |numbers: &[u32]| numbers.iter().flat_map(|it| number(order, *it)).collect::<Vec<_>>();
    for (name, packet_type, body) in [
        ("ping", PacketType::Ping, vec![]),
        ("working", PacketType::Working, vec![]),
        ("ack", PacketType::Ack, vec![]),
        ("nocall", PacketType::Nocall, vec![]),
        ("fault", PacketType::Fault, numbers(&[0x1C01_0003])),
        ("reject", PacketType::Reject, numbers(&[0x1C01_0003])),
        ("cancel", PacketType::ClCancel, numbers(&[0, 1])),
        ("cancel-ack", PacketType::CancelAck, numbers(&[0, 1, 1])),
        ("fack", PacketType::Fack, fack(order)),
    ] {
        all.push((name, of(packet_type, device, &body)));
    }
    all
}

fn of(packet_type: PacketType, header: Header, body: &[u8]) -> Vec<u8> {
    let mut octets = vec![0; Header::LEN + body.len()];
    Header { packet_type, ..header }.emit(body, &mut octets).unwrap();
    octets
}

fn number(order: ByteOrder, number: u32) -> [u8; 4] {
    match order {
        ByteOrder::Big => number.to_be_bytes(),
        ByteOrder::Little => number.to_le_bytes(),
    }
}

/// The stub data of an answer: status, lengths, and these blocks.
fn array(order: ByteOrder, status: u32, blocks: &[u8]) -> Vec<u8> {
    let len = blocks.len() as u32;
    let numbers = [status, len, 4096, 0, len].map(|it| number(order, it));
    [&numbers.concat(), blocks].concat()
}

/// Version 0, a window of 8, no masks but one.
fn fack(order: ByteOrder) -> Vec<u8> {
    let short = |it: u16| match order {
        ByteOrder::Big => it.to_be_bytes(),
        ByteOrder::Little => it.to_le_bytes(),
    };
    let sizes = [number(order, 65_535), number(order, 1472)].concat();
    let mask = number(order, 0b101);
    [&[0, 0][..], &short(8), &sizes, &short(7), &short(1), &mask].concat()
}

/// One entry with its tower: the interface of a device, over UDP.
fn mapper_answer(order: ByteOrder) -> Vec<u8> {
    let uuid = Interface::Device.uuid();
    let interface = [&[0x0D][..], &uuid.on_wire(ByteOrder::Little), &[1, 0]].concat();
    let floor = |protocol: &[u8], address: &[u8]| {
        let (protocol_len, address_len) = (protocol.len() as u8, address.len() as u8);
        [&[protocol_len, 0], protocol, &[address_len, 0], address].concat()
    };
    let tower = [
        vec![5, 0],
        floor(&interface, &[0, 0]),
        floor(&interface, &[0, 0]),
        floor(&[0x0A], &[0, 0]),
        floor(&[0x08], &[0x88, 0x94]),
        floor(&[0x09], &[172, 17, 17, 7]),
    ]
    .concat();
    let len = tower.len() as u32;
    let mut octets = [&number(order, 0)[..], &ACTIVITY.on_wire(order)].concat();
    for it in [1, 1, 0, 1] {
        octets.extend(number(order, it));
    }
    octets.extend(uuid.on_wire(order));
    for it in [3, 0, 8] {
        octets.extend(number(order, it));
    }
    octets.extend(b"drive 7\0");
    octets.extend([number(order, len), number(order, len)].concat());
    octets.extend(&tower);
    octets.resize(octets.len().next_multiple_of(4), 0);
    octets.extend(number(order, 0));
    octets
}

fn length(octets: &[u8]) -> [u8; 2] {
    (octets.len() as u16).to_be_bytes()
}

/// A block of this version 1.x.
fn block(block_type: u16, minor: u8, contents: &[u8]) -> Vec<u8> {
    let len = contents.len() as u16 + 2;
    [&block_type.to_be_bytes()[..], &len.to_be_bytes(), &[1, minor], contents].concat()
}

/// An IODReadResHeader for a record of these octets.
fn read_answer(index: u16, record: &[u8]) -> Vec<u8> {
    let place = [&[0, 7][..], &[0; 16], &[0; 4], &[0, 0, 0, 1, 0, 0], &index.to_be_bytes()];
    let place = [&place.concat()[..], &(record.len() as u32).to_be_bytes(), &[0; 24]].concat();
    block(0x8009, 0, &place)
}

/// Every block that has a view, and some with elements in their lists.
fn rows_of_blocks() -> Vec<(String, Vec<u8>)> {
    const TYPES: [u16; 42] = [
        0x0001, 0x8001, 0x0008, 0x8008, 0x0009, 0x8009, 0x0010, 0x0012, 0x0014, 0x0019, 0x001A,
        0x0020, 0x0021, 0x0022, 0x0023, 0x0024, 0x0025, 0x0030, 0x0034, 0x0101, 0x8101, 0x0102,
        0x8102, 0x0103, 0x8103, 0x0104, 0x8104, 0x0105, 0x0106, 0x8106, 0x0107, 0x0108, 0x0110,
        0x0119, 0x020A, 0x020C, 0x020E, 0x0240, 0x0250, 0x0251, 0x0F00, 0x7777,
    ];
    // Zeros are numbers of no elements, and padding.
    let of_zeros = |types: &[u16]| {
        let blocks: Vec<_> = types.iter().map(|it| block(*it, 0, &[0; 180])).collect();
        (format!("zeros-{:04x}", types[0]), blocks.concat())
    };
    let mut rows: Vec<_> = TYPES.chunks(6).map(of_zeros).collect();
    let subslots = [&[0, 1, 0, 0, 0, 9][..], &[0, 1, 0, 1, 0, 0, 0, 8]].concat();
    let slots = [&[0, 1, 0, 0, 0, 0][..], &[0, 1], &subslots].concat();
    rows.push(("identification".into(), block(0x0013, 1, &slots)));
    let filter = [&[0, 1, 0, 0, 0, 0, 0, 1][..], &subslots].concat();
    rows.push(("filter".into(), block(0x0030, 0, &filter)));
    let channel =
        [&[0; 4][..], &[0, 1, 0x80, 0, 0, 0, 0x80, 2], &[0, 1, 0, 0, 0, 6, 0x80, 0, 0, 0, 0, 7]];
    rows.push(("diagnosis".into(), block(0x0010, 1, &channel.concat())));
    let port =
        [&[0, 0, 0, 0, 0x80, 1][..], b"\x08port-001\x01\0\0\x08port-002\x07drive-8", &[0; 60]];
    rows.push(("port".into(), block(0x020F, 0, &port.concat())));
    let inner = block(0x0251, 0, &[0; 26]);
    let multiple = block(0x0400, 0, &[&[0; 10][..], &inner].concat());
    rows.push(("multiple".into(), multiple.clone()));
    let check = block(0x020C, 0, &[0, 0x1E]);
    rows.push((
        "port-check".into(),
        block(0x0200, 0, &[&[0, 0, 0, 0, 0x80, 1][..], &check].concat()),
    ));
    let deep = (0..8).fold(multiple, |inner, _| block(0x0400, 0, &[&[0; 10][..], &inner].concat()));
    rows.push(("deep".into(), deep));
    let record = block(0x0020, 0, &[b'0'; 54]);
    rows.push(("read".into(), [read_answer(0xAFF0, &record), record.clone()].concat()));
    let own = [read_answer(0x0001, &[7; 9]), vec![7; 9]].concat();
    rows.push(("own-record".into(), own));
    rows
}
