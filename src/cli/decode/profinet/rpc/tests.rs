//! What decode says of datagrams that are written out here, and of any octets at all.

use proptest::collection::vec;
use proptest::prelude::*;
use serde_json::{Value as Json, json};

use super::*;
use crate::profinet::endpoint_mapper::{Handle, Lookup};
use crate::profinet::rpc::{Flags1, ReadImplicit};
use crate::profinet::{ByteOrder, ObjectUuid, Uuid};

const PORTS: [u16; 2] = [50000, PORT];
const ACTIVITY: Uuid = Uuid::new(0x0102_0304_0506_0708_090A_0B0C_0D0E_0F10);

pub(in super::super) fn read_api_data(order: ByteOrder) -> Vec<u8> {
    let mut buffer = vec![0; ReadImplicit::LEN];
    let read = ReadImplicit {
        order,
        object: ObjectUuid { instance: 1, device: 2, vendor: 42 }.to_uuid(),
        activity: ACTIVITY,
        sequence: 7,
        api: 0,
        slot: 0,
        subslot: 1,
        index: 0xF821,
        record_length: 4096,
        target_ar: Uuid::NIL,
    };
    read.emit(&mut buffer).unwrap();
    buffer
}

/// A datagram to a device with these stub data.
fn call(packet_type: PacketType, operation: u16, order: ByteOrder, stub: &[u8]) -> Vec<u8> {
    let mut header = Header::request(order, Interface::Device.uuid(), operation);
    (header.packet_type, header.activity) = (packet_type, ACTIVITY);
    emit(&header, stub)
}

pub(in super::super) fn emit(header: &Header, body: &[u8]) -> Vec<u8> {
    let mut buffer = vec![0; Header::LEN + body.len()];
    header.emit(body, &mut buffer).unwrap();
    buffer
}

/// Numbers before the blocks, in this order, and the blocks.
fn stub(first: u32, blocks: &[u8], order: ByteOrder) -> Vec<u8> {
    let len = blocks.len() as u32;
    let numbers = [first, len, if first > len { first } else { 4096 }, 0, len];
    let octets = numbers.map(|number| match order {
        ByteOrder::Big => number.to_be_bytes(),
        ByteOrder::Little => number.to_le_bytes(),
    });
    [&octets.concat(), blocks].concat()
}

fn json_of(payload: &[u8]) -> Json {
    serde_json::to_value(RpcFields::of(payload, PORTS).unwrap()).unwrap()
}

fn text_of(payload: &[u8]) -> String {
    RpcFields::of(payload, PORTS).unwrap().to_string()
}

#[test]
fn p_4_a_request_has_all_its_fields_in_both_byte_orders() {
    for (order, name) in [(ByteOrder::Big, "big-endian"), (ByteOrder::Little, "little-endian")] {
        assert_eq!(
            json_of(&read_api_data(order)),
            json!({
                "length": 164,
                "packet_type": 0, "packet_type_name": "request",
                "flags1": {
                    "value": 32, "last_fragment": false, "fragment": false, "no_fack": false,
                    "maybe": false, "idempotent": true, "broadcast": false,
                },
                "flags2": {"value": 0, "cancel_pending": false},
                "data_representation": {
                    "byte_order": name, "characters": "ASCII",
                    "floating_point": 0, "floating_point_name": "IEEE",
                },
                "serial": 0,
                "object": "dea00000-6c97-11d1-8271-00010002002a",
                "object_node": {"instance": 1, "device_id": 2, "vendor_id": 42},
                "interface": "dea00001-6c97-11d1-8271-00a02442df7d",
                "interface_name": "IO device",
                "activity": "01020304-0506-0708-090a-0b0c0d0e0f10",
                "server_boot": 0, "interface_version": 1, "sequence": 7,
                "opnum": 5, "opnum_name": "Read Implicit",
                "interface_hint": 65535, "activity_hint": 65535,
                "fragment": 0, "auth_protocol": 0,
                "args_maximum": 4160, "args_length": 64,
                "blocks": [{
                    "type": 9, "name": "IODReadReqHeader", "version": "1.0", "length": 60,
                    "sequence": 7, "ar_uuid": "00000000-0000-0000-0000-000000000000",
                    "api": 0, "slot": 0, "subslot": 1,
                    "index": 63521, "index_name": "APIData", "record_data_length": 4096,
                    "target_ar_uuid": "00000000-0000-0000-0000-000000000000",
                }],
            })
        );
        assert_eq!(
            text_of(&read_api_data(order)),
            "RPC Read Implicit request to IO device, sequence 7; IODReadReqHeader APIData"
        );
    }
}

#[test]
fn p_5_an_answer_has_its_status_in_words_whatever_the_byte_order_is() {
    for order in [ByteOrder::Big, ByteOrder::Little] {
        let datagram = call(PacketType::Response, 0, order, &stub(0xDB81_4004, &[], order));
        assert_eq!(
            json_of(&datagram)["status"],
            json!({
                "code": 219, "decode": 129, "code1": 64, "code2": 4,
                "words": "Connect failed: CMRPC, no resources for another AR",
            })
        );
        assert_eq!(
            text_of(&datagram),
            "RPC Connect response, sequence 0: \
             Connect failed: CMRPC, no resources for another AR"
        );
    }
}

#[test]
fn p_6_blocks_are_shown_with_words_parts_octets_and_text() {
    let blocks = [
        &[0x00, 0x0C, 0x00, 0x03, 0x01, 0x00, 0xFE][..], // no known block
        &[0x81, 0x02, 0x00, 0x08, 0x01, 0x00, 0, 1, 0, 1, 0x80, 0x00], // IOCRBlockRes
        &[0x81, 0x02, 0x00, 0x08, 0x01, 0x00, 0, 2, 0, 2, 0x80, 0x01],
        &[0x81, 0x06, 0x00, 0x09, 0x01, 0x00, 0, 5, b'a', 0x1B, b'"', 0, 0], // ARServerBlock
    ]
    .concat();
    let order = ByteOrder::Little;
    let datagram = call(PacketType::Response, 0, order, &stub(0, &blocks, order));
    let json = json_of(&datagram);
    assert_eq!(json["args_length"], 44);
    assert_eq!(
        json["blocks"],
        json!([
            {"type": 12, "version": "1.0", "length": 3, "octets": "fe"},
            {
                "type": 0x8102, "name": "IOCRBlockRes", "version": "1.0", "length": 8,
                "iocr_type": 1, "iocr_type_name": "input", "iocr_reference": 1, "frame_id": 0x8000,
            },
            {
                "type": 0x8102, "name": "IOCRBlockRes", "version": "1.0", "length": 8,
                "iocr_type": 2, "iocr_type_name": "output", "iocr_reference": 2, "frame_id": 0x8001,
            },
            {
                "type": 0x8106, "name": "ARServerBlock", "version": "1.0", "length": 9,
                "cm_responder_station_name": "a\\x1b\"", "padding": "",
            },
        ])
    );
    assert_eq!(
        text_of(&datagram),
        "RPC Connect response, sequence 0: OK; block 0x000c, IOCRBlockRes (2), ARServerBlock"
    );
}

#[test]
fn what_is_malformed_has_its_place_beside_what_could_be_read() {
    // A body that is shorter than the header says.
    let datagram = read_api_data(ByteOrder::Big);
    let json = json_of(&datagram[..163]);
    assert_eq!((&json["sequence"], &json["error_offset"]), (&json!(7), &json!(163)));
    assert_eq!(json["error"], "the octets end too early");
    assert!(json.get("blocks").is_none());
    // Numbers before the blocks that contradict each other.
    let mut wrong = datagram.clone();
    wrong[87] = 63;
    assert!(
        text_of(&wrong)
            .ends_with("; malformed at octet 96: the actual count is not the arguments' length")
    );
    // A block that is cut: those before it are shown.
    let blocks = [0x00, 0x1A, 0x00, 0x04, 0x01, 0x00, 0, 0, 0xFF];
    let datagram = call(PacketType::Response, 2, ByteOrder::Big, &stub(0, &blocks, ByteOrder::Big));
    let json = json_of(&datagram);
    assert_eq!(json["blocks"][0]["name"], "APIData");
    assert_eq!(json["blocks"][1]["error_offset"], 109);
    assert_eq!(json["error_offset"], 109);
    // One inside a record is found, too.
    let mut header = vec![0x80, 0x09, 0x00, 0x3C, 0x01, 0x00];
    header.resize(64, 0);
    (header[34], header[35], header[39]) = (0xF8, 0x21, 8);
    let blocks = [&header[..], &[0x00, 0x1A, 0x00, 0x04, 0x01, 0x00, 0, 1]].concat();
    let datagram = call(PacketType::Response, 2, ByteOrder::Big, &stub(0, &blocks, ByteOrder::Big));
    let fields = RpcFields::of(&datagram, PORTS).unwrap();
    assert_eq!(fields.fault().unwrap().offset, 172);
    // A header that is not even one, at the port.
    let mut noise = [0x55; 80];
    noise[0] = 4;
    let json = json_of(&noise);
    assert_eq!(json["error"], "an unknown packet type");
    assert_eq!((&json["length"], &json["error_offset"]), (&json!(80), &json!(1)));
}

#[test]
fn p_4_why_a_call_failed_is_said_in_words() {
    let reject = [0x1C, 0x01, 0x00, 0x03];
    let datagram = call(PacketType::Reject, 2, ByteOrder::Big, &reject);
    let json = json_of(&datagram);
    assert_eq!(json["nca_status"], 0x1C01_0003);
    assert_eq!(json["nca_status_name"], "nca_unk_if: the interface is not known");
    assert_eq!(
        text_of(&datagram),
        "RPC Read reject, sequence 0, nca_unk_if: the interface is not known"
    );
    let unknown = call(PacketType::Fault, 2, ByteOrder::Big, &[0, 0, 0, 9]);
    assert_eq!(text_of(&unknown), "RPC Read fault, sequence 0, status 0x00000009");
}

#[test]
fn p_8_a_fack_says_what_has_come() {
    let fack = [0, 0, 0, 2, 0, 0, 16, 0, 0, 0, 5, 184, 0, 1, 0, 1, 0, 0, 0, 3];
    let datagram = call(PacketType::Fack, 2, ByteOrder::Big, &fack);
    assert_eq!(
        json_of(&datagram)["fack"],
        json!({
            "version": 0, "window_size": 2, "max_tsdu": 4096, "max_fragment_size": 1464,
            "serial": 1, "masks": [3],
        })
    );
    assert_eq!(text_of(&datagram), "RPC Read fack, sequence 0");
}

#[test]
fn p_4_a_look_up_is_shown() {
    let mut buffer = [0; Lookup::MAX_LEN];
    let len = Lookup::next_of_all(Handle::default())
        .emit(ByteOrder::Little, ACTIVITY, 0, &mut buffer)
        .unwrap();
    let json = json_of(&buffer[..len]);
    assert_eq!((&json["inquiry_type"], &json["max_entries"]), (&json!(0), &json!(1)));
    assert_eq!(json["opnum_name"], "ept_lookup");
    assert_eq!(text_of(&buffer[..len]), "RPC ept_lookup request to endpoint mapper, sequence 0");
}

#[test]
fn what_looks_alike_is_not_taken_for_profinet() {
    let other_ports = [50000, 135];
    let ours = read_api_data(ByteOrder::Big);
    assert!(RpcFields::of(&ours, other_ports).is_some());
    let mut other_interface = ours.clone();
    other_interface[24] = 0;
    assert!(RpcFields::of(&other_interface, other_ports).is_none());
    assert!(RpcFields::of(&other_interface, PORTS).is_some());
    for octets in [&[][..], b"not RPC at all", &[0; 200], &ours[..79]] {
        assert!(RpcFields::of(octets, other_ports).is_none());
        assert!(RpcFields::of(octets, PORTS).is_none());
    }
}

#[test]
fn a_fragment_has_its_number_and_no_blocks() {
    let mut header = Header::request(ByteOrder::Big, Interface::Device.uuid(), 3);
    (header.flags1, header.fragment_number) = (Flags1(Flags1::FRAGMENT), 2);
    let datagram = emit(&header, &[1; 10]);
    let json = json_of(&datagram);
    assert_eq!((&json["fragment"], json.get("blocks")), (&json!(2), None));
    assert_eq!(
        text_of(&datagram),
        "RPC Write request to IO device, sequence 0, fragment 2 of 10 octets"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..Default::default() })]

    #[test]
    fn no_octets_panic(
        changes in vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        body in vec(0u8..4, 0..200),
        is_response: bool,
        operation in 0u16..6,
    ) {
        let packet_type =
            if is_response { PacketType::Response } else { PacketType::Request };
        let stub = stub(0, &body, ByteOrder::Big);
        let mut datagram = call(packet_type, operation, ByteOrder::Big, &stub);
        for (index, value) in changes {
            *index.get_mut(&mut datagram) = value;
        }
        if let Some(fields) = RpcFields::of(&datagram, PORTS) {
            let json = serde_json::to_value(&fields).unwrap();
            prop_assert_eq!(json.get("error").is_some(), fields.fault().is_some());
            prop_assert!(!fields.to_string().is_empty());
            let whole = fields.with_call(&stub);
            serde_json::to_value(&whole).unwrap();
        }
    }
}
