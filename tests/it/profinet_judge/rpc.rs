//! Datagrams of RPC for the judge: every packet type in both byte orders, every block that has a view, calls
//! in fragments, and the blocks of alarms.

use pnet_nat::profinet::endpoint_mapper::{Handle, HandleFree, Lookup};
use pnet_nat::profinet::rpc::{
    Flags1, Header, Interface, PacketType, ReadImplicit, Representation,
};
use pnet_nat::profinet::{ByteOrder, ObjectUuid, Uuid};

const CLIENT: (u8, u16) = (1, 49153);
const DEVICE: (u8, u16) = (2, 34964);
/// A device answers from another port than was asked.
const ANSWERS: (u8, u16) = (2, 49152);
const AR: &str = "00112233445566778899AABBCCDDEEFF";
const OBJECT: &str = "DEA000006C9711D1827100010203002A";
const ACTIVITY: u128 = 0x0102_0304_0506_0708_090A_0B0C_0D0E_0F10;

const ORDERS: [ByteOrder; 2] = [ByteOrder::Big, ByteOrder::Little];

/// Octets of hexadecimal digits; spaces are left out.
fn hex(digits: &str) -> Vec<u8> {
    let digits: String = digits.split_whitespace().collect();
    let pair = |at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap();
    (0..digits.len()).step_by(2).map(pair).collect()
}

/// A datagram in an IPv4 packet.
fn udp(from: (u8, u16), to: (u8, u16), payload: &[u8]) -> (u16, Vec<u8>) {
    let length = payload.len() as u16 + 8;
    let packet = [
        &[0x45, 0][..],
        &(length + 20).to_be_bytes(),
        &[0, 0, 0x40, 0, 64, 17, 0, 0, 192, 0, 2, from.0, 192, 0, 2, to.0],
        &from.1.to_be_bytes(),
        &to.1.to_be_bytes(),
        &length.to_be_bytes(),
        &[0, 0],
        payload,
    ];
    (0x0800, packet.concat())
}

fn header(packet_type: PacketType, order: ByteOrder, operation: u16, sequence: u32) -> Header {
    Header {
        packet_type,
        serial: 0x0203,
        object: ObjectUuid { instance: 1, device: 0x0203, vendor: 42 }.to_uuid(),
        activity: Uuid::new(ACTIVITY + u128::from(operation)),
        server_boot: 1_234_567,
        sequence,
        representation: Representation { order, ebcdic: false, floating_point: 0 },
        ..Header::request(order, Interface::Device.uuid(), operation)
    }
}

fn sent(header: &Header, body: &[u8]) -> (u16, Vec<u8>) {
    let mut buffer = vec![0; Header::LEN + body.len()];
    header.emit(body, &mut buffer).unwrap();
    if header.packet_type.is_from_client() {
        udp(CLIENT, DEVICE, &buffer)
    } else {
        udp(ANSWERS, CLIENT, &buffer)
    }
}

fn numbers(order: ByteOrder, numbers: &[u32]) -> Vec<u8> {
    let to_octets = |number: &u32| match order {
        ByteOrder::Big => number.to_be_bytes(),
        ByteOrder::Little => number.to_le_bytes(),
    };
    numbers.iter().flat_map(to_octets).collect()
}

fn stub(first: u32, order: ByteOrder, blocks: &[u8]) -> Vec<u8> {
    let length = blocks.len() as u32;
    [numbers(order, &[first, length, 0x4000, 0, length]), blocks.to_vec()].concat()
}

fn request(order: ByteOrder, operation: u16, sequence: u32, blocks: &[u8]) -> (u16, Vec<u8>) {
    let header = header(PacketType::Request, order, operation, sequence);
    sent(&header, &stub(0x4000, order, blocks))
}

fn response(operation: u16, sequence: u32, status: u32, blocks: &[u8]) -> (u16, Vec<u8>) {
    let order = ORDERS[sequence as usize % 2];
    let header = header(PacketType::Response, order, operation, sequence);
    sent(&header, &stub(status, order, blocks))
}

fn block(block_type: u16, version: u16, contents: &str) -> Vec<u8> {
    let contents = hex(contents);
    let length = contents.len() as u16 + 2;
    [&block_type.to_be_bytes()[..], &length.to_be_bytes(), &version.to_be_bytes(), &contents]
        .concat()
}

/// A block with others behind its first fields.
fn around(block_type: u16, version: u16, first: &str, inside: &[Vec<u8>]) -> Vec<u8> {
    let inside: String = inside.concat().iter().map(|octet| format!("{octet:02x}")).collect();
    block(block_type, version, &format!("{first}{inside}"))
}

/// Every packet type with each body that it may have.
pub(super) fn packet_types() -> Vec<(u16, Vec<u8>)> {
    let of = |order: ByteOrder| {
        let fack = [
            vec![0, 0],
            if order == ByteOrder::Big { vec![0, 8] } else { vec![8, 0] },
            numbers(order, &[4096, 1464]),
            if order == ByteOrder::Big { vec![0, 7, 0, 2] } else { vec![7, 0, 2, 0] },
            numbers(order, &[5, 0x8000_0001]),
        ]
        .concat();
        let status = numbers(order, &[0x1C01_0003]);
        [
            (PacketType::Ping, vec![]),
            (PacketType::Working, vec![]),
            (PacketType::Ack, vec![]),
            (PacketType::Nocall, vec![]),
            (PacketType::Fack, fack),
            (PacketType::Fault, status.clone()),
            (PacketType::Reject, status),
            (PacketType::ClCancel, numbers(order, &[0, 9])),
            (PacketType::CancelAck, numbers(order, &[0, 9, 1])),
        ]
        .map(|(packet_type, body)| {
            let mut header = header(packet_type, order, 2, 99);
            (header.flags1, header.fragment_number) = (Flags1(0x7E), 3);
            sent(&header, &body)
        })
    };
    ORDERS.into_iter().flat_map(of).collect()
}

/// Read Implicit, and a look-up with its answer.
pub(super) fn without_connection() -> Vec<(u16, Vec<u8>)> {
    let of = |order: ByteOrder| {
        let mut read = [0; ReadImplicit::LEN];
        let request = ReadImplicit {
            order,
            object: ObjectUuid { instance: 1, device: 2, vendor: 42 }.to_uuid(),
            activity: Uuid::new(77),
            sequence: 0,
            api: 1,
            slot: 2,
            subslot: 0x8001,
            index: 0x802A,
            record_length: 4096,
            target_ar: Uuid::new(88),
        };
        request.emit(&mut read).unwrap();
        let activity = Uuid::new(if order == ByteOrder::Big { 78 } else { 79 });
        let (mut lookup, mut free) = ([0; Lookup::MAX_LEN], [0; HandleFree::LEN]);
        let next = Lookup::next_of_all(Handle::default());
        let len = next.emit(order, activity, 0, &mut lookup).unwrap();
        HandleFree { handle: Handle::default() }.emit(order, activity, 1, &mut free).unwrap();
        let mut answer = header(PacketType::Response, order, 2, 0);
        answer.interface = Interface::EndpointMapper.uuid();
        (answer.interface_version, answer.activity) = (3, activity);
        [
            udp(CLIENT, DEVICE, &read),
            udp(CLIENT, DEVICE, &lookup[..len]),
            sent(&answer, &entry(order)),
            udp(CLIENT, DEVICE, &free),
        ]
    };
    ORDERS.into_iter().flat_map(of).collect()
}

/// Stub data of a look-up's answer: one entry.
fn entry(order: ByteOrder) -> Vec<u8> {
    let little = |uuid: Uuid| uuid.on_wire(ByteOrder::Little);
    let syntax = Uuid::new(0x8A88_5D04_1CEB_11C9_9FE8_0800_2B10_4860);
    let tower = [
        &hex("0500 1300 0D")[..],
        &little(Interface::Device.uuid()),
        &hex("0100 0200 0000 1300 0D"),
        &little(syntax),
        &hex("0200 0200 0000 0100 0A 0200 0000 0100 08 0200 C000 0100 09 0400 C0000207 00"),
    ]
    .concat();
    let annotation = format!("{:<63}\0", "Valve terminal  6ES7 000-0AA00  1 V  1  0  0");
    [
        numbers(order, &[0]),
        Uuid::new(0x1234).on_wire(order).to_vec(),
        numbers(order, &[1, 1, 0, 1]),
        Uuid::new(0x5678).on_wire(order).to_vec(),
        numbers(order, &[3, 0, 64]),
        annotation.into_bytes(),
        numbers(order, &[75, 75]),
        tower,
        numbers(order, &[0]),
    ]
    .concat()
}

fn connect_request() -> Vec<u8> {
    [
        block(
            0x0101,
            0x0100,
            &format!("0001 {AR} 0002 020000000001 {OBJECT} E0000F19 0258 8892 0003 706C63"),
        ),
        block(
            0x0102,
            0x0100,
            "0001 0001 8892 E0000801 0028 8001 0020 0010 0001 0000 FFFFFFFF 0003 0004 C005 \
             000000000000 0001 00000000 0002 0001 0001 0004 0001 0002 0006 0001 0002 8000 0009",
        ),
        block(0x0103, 0x0100, "0001 8892 00000003 0001 0003 0001 00C8 C000 A000"),
        block(
            0x0104,
            0x0100,
            "0001 00000000 0001 00000030 0000 0002 \
             0001 00000130 003F 0001 0001 01 01 0002 0002 01 01 0002 00000131 0000 0001 0000 01 01",
        ),
        block(0x0105, 0x0100, &format!("{OBJECT} 00000000 0258 0002 7071")),
        block(0x0109, 0x0100, &format!("0000 {AR} 0000 0001 0001 000D 00000102")),
        block(0x010A, 0x0100, "0096 00000005"),
        around(
            0x010B,
            0x0100,
            "0000",
            &[
                block(0x0600, 0x0100, "0000 00000001 00000064 00000003 00000032"),
                block(0x0601, 0x0100, &format!("0000 00000001 {AR}")),
            ],
        ),
    ]
    .concat()
}

fn connect_response() -> Vec<u8> {
    [
        block(0x8101, 0x0100, &format!("0001 {AR} 0002 020000000002 8892")),
        block(0x8102, 0x0100, "0001 0001 8001"),
        block(0x8103, 0x0100, "0001 0005 00C8"),
        block(
            0x8104,
            0x0100,
            "0001 00000000 0001 0001 00000031 0001 0002 0001 00000131 0000 0002 00000132 98FD",
        ),
        block(0x8106, 0x0100, "0004 61626364"),
    ]
    .concat()
}

/// A Connect and its answer: slot 0 without data, slot 1 with three octets in and two out, one behind the
/// other in their frames. The device chooses the frame ID of the outputs.
pub(crate) fn connect() -> [(u16, Vec<u8>); 2] {
    let asked = [
        block(
            0x0101,
            0x0100,
            &format!("0001 {AR} 0002 020000000001 {OBJECT} 00000011 0258 8892 0003 706C63"),
        ),
        block(
            0x0102,
            0x0100,
            "0001 0001 8892 00000002 0028 8001 0020 0001 0001 0000 FFFFFFFF 0003 0003 C000 \
             000000000000 0001 00000000 0002 0000 0001 0000 0001 0001 0001 0001 0001 0001 0005",
        ),
        block(
            0x0102,
            0x0100,
            "0002 0002 8892 00000002 0028 FFFF 0020 0001 0001 0000 FFFFFFFF 0003 0003 C000 \
             000000000000 0001 00000000 0001 0001 0001 0000 0002 0000 0001 0003 0001 0001 0004",
        ),
        block(0x0103, 0x0100, "0001 8892 00000000 0001 0003 0001 00C8 C000 A000"),
        block(
            0x0104,
            0x0100,
            "0001 00000000 0000 00000001 0000 0001 0001 00000001 0000 0001 0000 01 01",
        ),
        block(
            0x0104,
            0x0100,
            "0001 00000000 0001 00000030 0000 0001 \
             0001 00000130 0003 0001 0003 01 01 0002 0002 01 01",
        ),
    ];
    let answered = [
        block(0x8101, 0x0100, &format!("0001 {AR} 0002 020000000002 8892")),
        block(0x8102, 0x0100, "0001 0001 8001"),
        block(0x8102, 0x0100, "0002 0002 8005"),
        block(0x8103, 0x0100, "0001 0005 00C8"),
    ];
    [request(ByteOrder::Little, 0, 0, &asked.concat()), response(0, 0, 0, &answered.concat())]
}

/// What one connection says, step by step.
pub(super) fn connection() -> Vec<(u16, Vec<u8>)> {
    let control = |block_type: u16, command: u16| {
        block(block_type, 0x0100, &format!("0000 {AR} 0002 0000 {command:04X} 0000"))
    };
    let mut frames = vec![
        request(ByteOrder::Big, 0, 0, &connect_request()),
        response(0, 0, 0, &connect_response()),
        request(ByteOrder::Little, 0, 1, &connect_request()),
        response(0, 1, 0xDB81_4004, &[]),
    ];
    for (sequence, (block_type, command)) in
        [(0x0110, 1), (0x0112, 2), (0x0116, 16), (0x0117, 32), (0x0118, 64)].into_iter().enumerate()
    {
        let order = ORDERS[sequence % 2];
        let sequence = sequence as u32;
        frames.push(request(order, 4, sequence, &control(block_type, command)));
        frames.push(response(4, sequence, 0, &control(block_type | 0x8000, 8)));
    }
    frames.push(request(ByteOrder::Big, 1, 0, &control(0x0114, 4)));
    frames.push(response(1, 0, 0, &control(0x8114, 8)));
    frames
}

/// A header of a record, up to its padding.
fn record(block_type: u16, index: u16, record: &[u8]) -> Vec<u8> {
    let behind = match block_type {
        0x8009 => "0001 0002".to_owned() + &"00".repeat(20),
        0x8008 => "0001 0002 DF80B500".to_owned() + &"00".repeat(16),
        _ => "00".repeat(24),
    };
    let length = record.len();
    let fields = format!("0007 {AR} 00000000 0001 8001 0000 {index:04X} {length:08X} {behind}");
    [block(block_type, 0x0100, &fields), record.to_vec()].concat()
}

fn identification() -> Vec<(u16, Vec<u8>)> {
    let text = |len: usize| "41".repeat(len);
    let slots = "0002 0001 00000030 0001 0001 00000130 0002 00000031 0000";
    vec![
        (
            0xAFF0,
            block(
                0x0020,
                0x0100,
                &format!("012A {} {} 0003 56 010203 0004 F600 0005 0101 001E", text(20), text(16)),
            ),
        ),
        (0xAFF1, block(0x0021, 0x0100, &format!("{} {}", text(32), text(22)))),
        (0xAFF2, block(0x0022, 0x0100, "323032362D31312D32372030373A3030")),
        (0xAFF3, block(0x0023, 0x0100, &text(54))),
        (0xF840, block(0x0030, 0x0100, &format!("0001 00000000 {slots}"))),
        (0xF840, block(0x0031, 0x0100, &format!("0001 00000000 {slots}"))),
        (0xF000, block(0x0013, 0x0101, &format!("0001 00000007 {slots}"))),
        (0xE000, block(0x0012, 0x0101, &format!("0001 00000007 {slots}"))),
        (0xF821, block(0x001A, 0x0100, "0002 00000000 00003A00")),
        (0x801E, block(0x0014, 0x0100, "0002 80 AABB80")),
        (
            0xF830,
            block(
                0x0019,
                0x0100,
                &format!("0000000000000009 0001 0000000000000008 {AR} CF81FD05 00000007"),
            ),
        ),
    ]
}

fn diagnosis() -> Vec<(u16, Vec<u8>)> {
    let head = "00000000 0001 0002 8000 0800";
    vec![
        (0x800A, block(0x0010, 0x0101, &format!("{head} 8000 0003 3B05 0001"))),
        (0xC00B, block(0x0010, 0x0101, &format!("{head} 8002 0003 3A05 8001 8005 00000007"))),
        (0x800C, block(0x0010, 0x0101, &format!("{head} 7FFF 010203"))),
        (0x800C, block(0x0010, 0x0100, "0001 0002 8000 0800 8000 0003 3A05 0006")),
    ]
}

fn physical() -> Vec<(u16, Vec<u8>)> {
    let port = block(
        0x020F,
        0x0100,
        "0000 0000 8001 03 706F72 01 000000 04 706F7274 01 78 00 00000005 020000000003 0000 \
         0010 0000 00000003 00000004 05 01 0000 00000001",
    );
    let alone = block(
        0x020F,
        0x0100,
        "0000 0000 8002 04 706F7274 00 0000 001E 0000 00000000 00000000 01 02 0000 00000002",
    );
    let interface =
        block(0x0240, 0x0100, "03 616263 0000 020000000004 0000 C0000207 FFFFFF00 C0000201");
    let statistic =
        block(0x0251, 0x0101, "0000 00000001 00000002 00000003 00000004 00000005 00000006");
    let role = format!("0000 {AR} 0001 0000 04 6D727031 000000");
    let client = block(0x0217, 0x0100, "0014 0015 0004");
    let manager = block(0x0216, 0x0100, "8000 0001 0003 000A 0014 0003 0000 0000");
    let ring_state = block(0x0219, 0x0100, "0001");
    let adjust = around(0x0211, 0x0100, &role, &[client]);
    let many = around(0x0400, 0x0100, "0000 00000000 0000 8001", &[port, statistic]);
    let other = around(0x0400, 0x0100, "0000 00000000 0000 8000", &[interface]);
    let instance =
        around(0x0231, 0x0100, &format!("0000 {AR} 0002 0000 04 6D727031 000000"), &[manager]);
    vec![
        (0xF841, [many, other].concat()),
        (0x802A, alone),
        (0x8052, adjust),
        (0x8050, around(0x0400, 0x0100, "0000 00000000 0000 8000", &[ring_state])),
        (0x8052, around(0x0211, 0x0101, "00 01", &[instance])),
        (0x8051, block(0x0213, 0x0100, &format!("0000 {AR} 00000003"))),
        (0x8053, block(0x0214, 0x0100, &format!("0000 {AR}"))),
        (0x8054, block(0x0215, 0x0101, &format!("00 03 {AR}"))),
        (0x802B, block(0x0200, 0x0100, "0000 0000 8001 020A 0008 0100 01 01 70 02 7171")),
        (0x802F, block(0x0202, 0x0100, "0000 0000 8001 020E 0008 0100 0000 0010 0000")),
        (0x8071, block(0x0250, 0x0100, "0000 00000001")),
    ]
}

/// Every record, as it is read and as it is written.
pub(super) fn records() -> Vec<(u16, Vec<u8>)> {
    let mut frames = vec![];
    let all = [identification(), diagnosis(), physical()].concat();
    for (sequence, (index, blocks)) in (0..).zip(&all) {
        let order = ORDERS[sequence as usize % 2];
        frames.push(request(order, 2, sequence, &record(0x0009, *index, &[])));
        frames.push(response(2, sequence, 0, &record(0x8009, *index, blocks)));
    }
    let write = |index, record_data: &[u8]| {
        let mut octets = record(0x0008, index, record_data);
        octets.resize(octets.len().next_multiple_of(4), 0);
        octets
    };
    let several = [write(0x8071, &all[all.len() - 1].1), write(1, &[1, 2, 3]), write(2, &[4])];
    let written = [record(0x8008, 0xE040, &[]), record(0x8008, 1, &[])].concat();
    frames.push(request(ByteOrder::Big, 3, 0, &record(0x0008, 0xE040, &several.concat())));
    frames.push(response(3, 0, 0, &written));
    frames
}

/// A call in three fragments.
pub(super) fn fragments() -> Vec<(u16, Vec<u8>)> {
    let stub = stub(0x4000, ByteOrder::Little, &connect_request());
    let parts = [&stub[..100], &stub[100..300], &stub[300..]];
    let send = |(number, octets): (u16, &[u8])| {
        let mut header = header(PacketType::Request, ByteOrder::Little, 0, 7);
        let last = if number == 2 { Flags1::LAST_FRAGMENT } else { 0 };
        header.flags1 = Flags1(Flags1::FRAGMENT | Flags1::IDEMPOTENT | last);
        header.fragment_number = number;
        sent(&header, octets)
    };
    (0..).zip(parts).map(send).collect()
}

/// The blocks of alarms.
pub(super) fn alarms() -> Vec<(u16, Vec<u8>)> {
    let head = "0001 00000000 0001 0002 00000030 00000130 B807";
    let notification = |block_type: u16, item: &str| {
        (block_type, block(block_type, 0x0100, &format!("{head} {item}")))
    };
    let ack = |block_type: u16| {
        (block_type, block(block_type, 0x0100, "000C 00000000 0001 0002 0007 DA813C01"))
    };
    [
        notification(1, "8100 0F00 0008 0100 0000 00000003"),
        notification(2, "8000 8000 0800 0006"),
        notification(1, "8002 0001 6D05 8001 8005 00000007"),
        notification(2, "0012 AABB"),
        ack(0x8001),
        ack(0x8002),
    ]
    .map(|(block_type, block)| {
        let frame_id: u16 = if block_type & 1 == 1 { 0xFC01 } else { 0xFE01 };
        let length = block.len() as u8;
        let header = [0, 1, 0x80, 2, 0x11, 0x11, 0, 5, 0xFF, 0xFE, 0, length];
        (0x8892, [&frame_id.to_be_bytes()[..], &header, &block].concat())
    })
    .to_vec()
}
