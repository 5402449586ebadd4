use std::time::{Duration, SystemTime, UNIX_EPOCH};

use pcap_parser::Linktype;
use proptest::prelude::*;
use serde_json::{Value, json};

use super::*;
use crate::cli::decode::capture::Captured;

/// An Ethernet frame with priority 6.
fn packet(ether_type: u16, payload: &[u8]) -> Vec<u8> {
    let addresses = [1, 0x0E, 0xCF, 0, 0, 0, 2, 0, 0, 0, 0, 9];
    [&addresses[..], &[0x81, 0, 0xC0, 0], &ether_type.to_be_bytes(), payload].concat()
}

fn time() -> Option<SystemTime> {
    Some(UNIX_EPOCH + Duration::from_secs(1_790_000_000))
}

/// As text on one line, as a tree, and as JSON.
fn shown(packet: &[u8], length: usize) -> (String, String, Value) {
    let link = Linktype::ETHERNET;
    let captured = Captured { number: 7, time: time(), link, octets: packet, length };
    let frame = frame(&captured).unwrap();
    let connections = Connections::default();
    let (protocol, fields) = Fields::of(&frame, &connections);
    let line = FrameLine {
        frame: 7,
        time: time(),
        from: Shown(frame.from),
        to: frame.to.map(Shown),
        vlan: frame.vlan,
        protocol,
        fields,
    };
    let (mut text, mut tree) = (String::new(), Vec::new());
    line.write_text(&mut text).unwrap();
    line.write_tree(&mut tree).unwrap();
    let tree = String::from_utf8(tree).unwrap();
    (text, tree, serde_json::from_str(&serde_json::to_string(&line).unwrap()).unwrap())
}

/// What stands behind the addresses, and the JSON without what all frames have.
#[track_caller]
fn says(ether_type: u16, payload: &[u8], text: &str, json: Value) {
    let packet = packet(ether_type, payload);
    let (line, _, mut found) = shown(&packet, packet.len());
    let head = "packet 7, 2026-09-21T14:13:20.000000Z, 02:00:00:00:00:09 > 01:0e:cf:00:00:00, \
                VLAN 0 priority 6: ";
    assert_eq!(line.strip_prefix(head).map(str::trim_end), Some(text));
    let fields = found.as_object_mut().unwrap();
    for (name, right) in [
        ("frame", json!(7)),
        ("time", json!("2026-09-21T14:13:20.000000Z")),
        ("from", json!("02:00:00:00:00:09")),
        ("to", json!("01:0e:cf:00:00:00")),
        ("vlan", json!({"id": 0, "priority": 6, "drop_eligible": false})),
    ] {
        assert_eq!(fields.remove(name), Some(right), "{name}");
    }
    assert_eq!(found, json);
}

#[test]
fn p_2_cyclic_data_has_its_status() {
    let payload = [&[0x80, 0x01][..], &[0xAB; 3], &[0x12, 0x34, 0x31, 0x02]].concat();
    says(
        0x8892,
        &payload,
        "RT class 1 $8001, cycle 4660, invalid, run, ok, primary, transfer status $02, 3 octets",
        json!({
            "protocol": "profinet-rt", "frame_id": 0x8001, "frame_id_name": "RT class 1",
            "cycle_counter": 0x1234,
            "data_status": {
                "value": 0x31, "primary": true, "redundancy": false, "data_valid": false,
                "provider_running": true, "station_ok": true, "ignore": false,
            },
            "transfer_status": 2, "transfer_faults": ["length"],
            "data_length": 3, "data": "ababab", "submodules": null,
        }),
    );
    // Of what was not captured, no status is made up.
    let packet = packet(0x8892, &payload);
    let (text, _, json) = shown(&packet, packet.len() + 1);
    let fault = "7 octets; malformed at octet 9: it was not captured to its end\n";
    assert!(text.ends_with(fault), "{text}");
    assert_eq!((json.get("cycle_counter"), &json["error_offset"]), (None, &json!(9)));
}

#[test]
fn p_3_dcp_says_who_is_meant_and_what_became_of_it() {
    let head = [0xFE, 0xFE, 5, 0, 1, 0, 0, 2, 0, 128, 0, 8];
    says(
        0x8892,
        &[&head[..], &[2, 2, 0, 4], b"plc1", &[0; 20]].concat(),
        "DCP identify request, xid $01000002, response delay 128; name of station \"plc1\"",
        json!({
            "protocol": "profinet-dcp", "frame_id": 0xFEFE,
            "frame_id_name": "DCP identify request",
            "service_id": 5, "service_id_name": "identify",
            "service_type": 0, "service_type_name": "request",
            "xid": 0x0100_0002, "response_delay": 128, "data_length": 8,
            "blocks": [{
                "option": 2, "suboption": 2, "name": "name of station", "length": 4,
                "name_of_station": "plc1",
            }],
        }),
    );
    let head = [0xFE, 0xFD, 4, 0, 1, 0, 0, 2, 0, 0, 0, 32];
    let ip = [1, 2, 0, 14, 0, 1, 192, 168, 0, 5, 255, 255, 255, 0, 192, 168, 0, 1];
    let reset = [5, 6, 0, 2, 0, 4, 5, 3, 0, 4, 0, 0, 1, 0];
    let packet = packet(0x8892, &[&head[..], &ip, &reset].concat());
    let (text, _, json) = shown(&packet, packet.len());
    assert!(
        text.ends_with(
            ": DCP set request, xid $01000002; IP parameter 192.168.0.5 mask 255.255.255.0 gateway \
             192.168.0.1 (permanent), reset to factory (communication parameters), signal flash \
             once\n"
        ),
        "{text}"
    );
    assert_eq!(
        json["blocks"][0],
        json!({
            "option": 1, "suboption": 2, "name": "IP parameter", "length": 14,
            "qualifier": 1, "permanent": true,
            "ip_address": "192.168.0.5", "netmask": "255.255.255.0", "gateway": "192.168.0.1",
        })
    );
    assert_eq!(json["blocks"][1]["reset"], "communication parameters");
    assert_eq!(json["blocks"][2]["flash_once"], true);
}

#[test]
fn a_block_that_is_cut_off_is_told_beside_those_before_it() {
    let head = [0xFE, 0xFF, 5, 1, 1, 0, 0, 2, 0, 0, 0, 16];
    let blocks = [2, 4, 0, 4, 0, 0, 1, 0, 2, 2, 0, 99, 0, 0, b'a', b'b'];
    let packet = packet(0x8892, &[&head[..], &blocks].concat());
    let (text, tree, json) = shown(&packet, packet.len());
    let end = "; device role IO device; malformed at octet 28: the octets end too early\n";
    assert!(text.ends_with(end), "{text}");
    assert_eq!(json["blocks"].as_array().unwrap().len(), 1);
    assert_eq!(
        (&json["error"], &json["error_offset"]),
        (&json!("the octets end too early"), &json!(28))
    );
    assert_eq!(
        tree.split_once('\n').unwrap().1,
        "    frame id: 65279
    frame id name: DCP identify response
    service id: 5
    service id name: identify
    service type: 1
    service type name: response
    xid: 16777218
    data length: 16
    blocks:
        1:
            option: 2
            suboption: 4
            name: device role
            length: 4
            block info: 0
            role: 1
            roles: IO device
    error: the octets end too early
    error offset: 28
"
    );
}

#[test]
fn p_10_an_alarm_has_its_connection_and_its_blocks() {
    let header = [0xFC, 0x01, 0, 1, 0, 2, 0x11, 0x11, 0, 5, 0xFF, 0xFE, 0, 22];
    let block =
        [0x80, 0x01, 0, 18, 1, 0, 0, 1, 0, 0, 0, 0, 0, 3, 0, 4, 0x08, 7, 0xDA, 0x81, 0x3C, 1];
    says(
        0x8892,
        &[&header[..], &block, &[0, 0]].concat(),
        "alarm high, DATA-RTA, endpoint 2 to 1, sends 5, acknowledges 65534; AlarmAckHigh",
        json!({
            "protocol": "profinet-alarm", "frame_id": 0xFC01, "frame_id_name": "alarm high",
            "destination_endpoint": 1, "source_endpoint": 2,
            "pdu_type": 1, "pdu_type_name": "DATA-RTA", "version": 1,
            "window_size": 1, "immediate_acknowledge": 1,
            "send_sequence": 5, "acknowledge_sequence": 65534, "contents_length": 22,
            "blocks": [{
                "type": 0x8001, "name": "AlarmAckHigh", "version": "1.0", "length": 18,
                "alarm_type": 1, "alarm_type_name": "diagnosis", "api": 0, "slot": 3, "subslot": 4,
                "alarm_specifier": {
                    "value": 0x0807, "sequence_number": 7, "channel_diagnosis": true,
                    "manufacturer_specific_diagnosis": false, "submodule_diagnosis_state": false,
                    "ar_diagnosis_state": false,
                },
                "status": {
                    "code": 218, "decode": 129, "code1": 60, "code2": 1,
                    "words": "alarm refused: alarm acknowledge, the submodule's state does not fit",
                },
            }],
        }),
    );
    // A block that is cut, and a status.
    let cut = [&header[..13], &[4, 0x80, 0x01, 0, 18]].concat();
    let cut = packet(0x8892, &cut);
    let (text, _, json) = shown(&cut, cut.len());
    assert!(text.ends_with("; malformed at octet 18: the octets end too early\n"), "{text}");
    assert_eq!((&json["error_offset"], &json["contents_length"]), (&json!(18), &json!(4)));
    let error = [0xFE, 0x01, 0, 1, 0, 2, 0x14, 0x01, 0, 5, 0, 4, 0, 4, 0xCF, 0x81, 0xFD, 5];
    let packet = packet(0x8892, &error);
    let (text, _, json) = shown(&packet, packet.len());
    let words = "alarm connection ended: RTA protocol, consumer of cyclic data timed out";
    assert!(text.contains(": alarm low, ERR-RTA, ") && text.ends_with(&format!(", {words}\n")));
    assert_eq!(
        json["status"],
        json!({"code": 0xCF, "decode": 0x81, "code1": 0xFD, "code2": 5, "words": words})
    );
}

#[test]
fn p_11_lldp_names_station_and_port() {
    let tlvs: [&[u8]; 4] = [
        b"\x02\x04\x07plc",
        b"\x04\x09\x07port-001",
        &[0x06, 2, 0, 20],
        &[0xFE, 9, 0, 0x12, 0x0F, 1, 3, 0x0C, 0, 0, 0x10],
    ];
    says(
        0x88CC,
        &[&tlvs.concat()[..], &[0, 0]].concat(),
        "LLDP of port-001.plc (legacy names), for 20 s, 100BASE-TX full duplex",
        json!({
            "protocol": "lldp", "chassis_id": "plc", "port_id": "port-001", "ttl": 20,
            "names": {
                "mode": "legacy", "port": "port-001", "station": "plc",
                "alias_name": "port-001.plc",
            },
            "tlvs": [
                {"type": 1, "name": "chassis ID", "subtype": 7, "id": "plc"},
                {"type": 2, "name": "port ID", "subtype": 7, "id": "port-001"},
                {"type": 3, "name": "time to live", "seconds": 20},
                {
                    "type": 127, "name": "MAC/PHY", "oui": "00:12:0f", "subtype": 1,
                    "autonegotiation_supported": true, "autonegotiation_enabled": true,
                    "advertised": 0x0C00,
                    "advertised_names": ["100BASE-TX full duplex", "100BASE-TX half duplex"],
                    "mau_type": 16, "mau_type_name": "100BASE-TX full duplex",
                },
            ],
        }),
    );
}

#[test]
fn p_12_mrp_tells_of_the_ring() {
    let test = [0x80, 0, 2, 0, 0, 0, 0, 9, 0, 0, 0, 1, 0, 3, 0, 0, 0, 9];
    let common = [&[1, 18, 0, 5][..], &[0xFF; 16], &[0, 0]].concat();
    says(
        0x88E3,
        &[&[0, 1, 2, 18][..], &test, &common].concat(),
        "MRP Test priority $8000 (default), ring closed, by 02:00:00:00:00:09, primary ring port, \
         transitions 3; sequence 5, domain ffffffff-ffff-ffff-ffff-ffffffffffff",
        json!({
            "protocol": "mrp", "version": 1,
            "tlvs": [
                {
                    "type": 2, "name": "MRP_Test", "sender": "manager (MRM)",
                    "priority": 0x8000, "priority_name": "default",
                    "source": "02:00:00:00:00:09",
                    "port_role": 0, "port_role_name": "primary ring port",
                    "ring_state": 1, "ring_state_name": "closed",
                    "transitions": 3, "timestamp": 9,
                },
                {
                    "type": 1, "name": "MRP_Common", "sequence_id": 5,
                    "domain_uuid": "ffffffff-ffff-ffff-ffff-ffffffffffff",
                },
            ],
        }),
    );
}

#[test]
fn ptcp_is_shown_by_name() {
    let head = [&[0xFF, 0x40][..], &[0; 12], &[0, 7, 0, 0], &[0, 0, 0, 42]].concat();
    says(
        0x8892,
        &[&head[..], &[0x0C, 6, 2, 0, 0, 0, 0, 9, 0, 0]].concat(),
        "PTCP delay request, sequence 7, delay 42 ns, port 02:00:00:00:00:09",
        json!({
            "protocol": "ptcp", "frame_id": 0xFF40, "frame_id_name": "PTCP delay request",
            "sequence_id": 7, "delay_ns": 42,
            "tlvs": [{"type": 6, "name": "DelayParameter", "port": "02:00:00:00:00:09"}],
        }),
    );
}

#[test]
fn not_even_a_frame_id() {
    says(
        0x8892,
        &[0x80],
        "RT; malformed at octet 1: the octets end too early",
        json!({
            "protocol": "profinet-rt", "error": "the octets end too early", "error_offset": 1,
        }),
    );
}

#[test]
fn a_name_gives_no_orders_to_a_terminal() {
    let payload = [b"\x02\x08\x07\x1b[2J\"\n\xFF", &b"\x04\x09\x07port-001"[..], &[0, 0]].concat();
    let packet = packet(0x88CC, &payload);
    let (text, tree, json) = shown(&packet, packet.len());
    for shown in [&text, &tree] {
        assert!(shown.contains(r#"\x1b[2J"\x0a\xff"#), "{shown}");
        assert!(!shown.contains('\x1b'));
    }
    assert_eq!(json["chassis_id"], r#"\x1b[2J"\x0a\xff"#);
    assert_eq!(json["names"], Value::Null);
}

proptest! {
    /// Whatever the octets are, there is one line, one object, and a tree.
    #[test]
    fn any_octets_are_shown(
        ether_type in prop::sample::select(vec![0x8892_u16, 0x88CC, 0x88E3]),
        frame_id in prop_oneof![any::<u16>(), 0xFC00_u16.., prop::sample::select(vec![0xFC01_u16, 0xFE01])],
        octets in prop::collection::vec(prop_oneof![0_u8..32, any::<u8>()], 0..200),
        missing in 0_usize..2,
    ) {
        let front = if ether_type == 0x8892 { frame_id.to_be_bytes().to_vec() } else { Vec::new() };
        let packet = packet(ether_type, &[front, octets].concat());
        let (text, tree, json) = shown(&packet, packet.len() + missing);
        prop_assert_eq!(text.matches('\n').count(), 1);
        prop_assert!(text.ends_with('\n') && tree.ends_with('\n'));
        prop_assert!(!text.chars().chain(tree.chars()).any(|it| it.is_control() && it != '\n'));
        prop_assert_eq!(&json["frame"], 7);
    }
}
