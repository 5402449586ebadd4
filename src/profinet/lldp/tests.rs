use super::*;

/// A TLV with its type and length in front.
fn tlv(kind: u8, contents: &[u8]) -> Vec<u8> {
    let head = u16::from(kind) << 9 | contents.len() as u16;
    [&head.to_be_bytes()[..], contents].concat()
}

#[track_caller]
fn shows(kind: u8, contents: &[u8], right: LldpValue<'_>) {
    let octets = [tlv(kind, contents), vec![0, 0, 0xEE]].concat();
    let all: Vec<_> = Lldp::new(&octets).tlvs().collect();
    assert_eq!(all, [Ok(LldpTlv { kind, value: right })]);
}

#[test]
fn p_11_stations_and_ports_are_named_by_address_or_text() {
    let mac = MacAddress([2, 0, 0, 0, 0, 9]);
    let id = |subtype, value| Id { subtype, value };
    shows(1, &[4, 2, 0, 0, 0, 0, 9], LldpValue::ChassisId(id(4, Address::Mac(mac))));
    let v4 = Address::V4([192, 168, 0, 5].into());
    shows(1, &[5, 1, 192, 168, 0, 5], LldpValue::ChassisId(id(5, v4)));
    shows(1, b"\x07plc", LldpValue::ChassisId(id(7, Address::Text(b"plc"))));
    shows(2, &[3, 2, 0, 0, 0, 0, 9], LldpValue::PortId(id(3, Address::Mac(mac))));
    shows(2, &[4, 1, 192, 168, 0, 5], LldpValue::PortId(id(4, v4)));
    shows(2, b"\x07port-001", LldpValue::PortId(id(7, Address::Text(b"port-001"))));
    shows(3, &[0, 20], LldpValue::TimeToLive(20));
    for (kind, name) in [(4, "port description"), (5, "system name"), (6, "system description")] {
        shows(kind, b"text", LldpValue::Text(b"text"));
        assert_eq!(LldpTlv { kind, value: LldpValue::Text(b"") }.name(), name);
    }
}

#[test]
fn p_11_capabilities_and_where_a_station_is_managed() {
    shows(7, &[0, 0x94, 0, 0x80], LldpValue::Capabilities { supported: 0x94, enabled: 0x80 });
    let names: Vec<_> = capability_names(0x94).collect();
    assert_eq!(names, ["bridge", "router", "station only"]);
    let managed = |address, object_id| LldpValue::ManagementAddress {
        address,
        interface_subtype: 2,
        interface_number: 7,
        object_id,
    };
    let contents = [5, 1, 192, 168, 0, 5, 2, 0, 0, 0, 7, 2, 0x2B, 6];
    shows(8, &contents, managed(Address::V4([192, 168, 0, 5].into()), &[0x2B, 6]));
    let contents = [&[17, 2][..], &[0; 15], &[1, 2, 0, 0, 0, 7, 0]].concat();
    shows(8, &contents, managed(Address::V6(Ipv6Addr::LOCALHOST), &[]));
    let contents = [3, 9, 1, 2, 2, 0, 0, 0, 7, 0];
    shows(8, &contents, managed(Address::Other { family: 9, octets: &[1, 2] }, &[]));
    shows(100, &[1], LldpValue::Octets(&[1]));
}

/// Of an organisation.
#[track_caller]
fn organisation(oui: [u8; 3], subtype: u8, contents: &[u8], right: OrganisationValue<'_>) {
    let octets = [&oui[..], &[subtype], contents].concat();
    shows(127, &octets, LldpValue::Organisation { oui, subtype, value: right });
}

#[test]
fn p_11_tlvs_of_profinet() {
    use OrganisationValue as Value;
    const PNO: [u8; 3] = [0x00, 0x0E, 0xCF];
    let delays = [[0, 0, 0, 1], [0, 0, 0, 2], [0, 0, 0, 3], [0, 0, 0, 4], [0, 0, 0, 5]].concat();
    let right = Value::Delay {
        receive_local: 1,
        receive_remote: 2,
        transmit_local: 3,
        transmit_remote: 4,
        cable: 5,
    };
    organisation(PNO, 1, &delays, right);
    organisation(PNO, 2, &[0, 2, 0, 4], Value::PortStatus { class_2: 2, class_3: 4 });
    assert_eq!((class_2_name(2), class_3_name(4)), ("synchronised", "running"));
    organisation(PNO, 3, b"port-001.b", Value::Alias(b"port-001.b"));
    let ring = [&[0xFF; 16][..], &[0, 1]].concat();
    let right = Value::MrpPortStatus { domain_uuid: [0xFF; 16], mrrt_status: 1 };
    organisation(PNO, 4, &ring, right);
    let mac = MacAddress([2, 0, 0, 0, 0, 9]);
    organisation(PNO, 5, &mac.0, Value::ChassisMac(mac));
    let clock = [&mac.0[..], &[1; 16], &[2; 16], &[0x80, 0, 0, 9], &[0; 12]].concat();
    let right = Value::PtcpStatus {
        master: mac,
        subdomain_uuid: [1; 16],
        ir_data_uuid: [2; 16],
        periods: [0x8000_0009, 0, 0, 0],
    };
    organisation(PNO, 6, &clock, right);
    organisation(PNO, 7, &[2, 0], Value::MauTypeExtension(0x0200));
    organisation(PNO, 99, &[1], Value::Octets(&[1]));
    assert_eq!(Value::name(PNO, 5), "chassis MAC");
}

#[test]
fn p_11_tlvs_of_ieee_802_3() {
    use OrganisationValue as Value;
    const IEEE: [u8; 3] = [0x00, 0x12, 0x0F];
    let right = Value::MacPhy { autonegotiation: 3, advertised: 0x0C01, mau_type: 0x10 };
    organisation(IEEE, 1, &[3, 0x0C, 1, 0, 0x10], right);
    let speeds: Vec<_> = advertised_speeds(0xE403).collect();
    assert_eq!(
        speeds,
        [
            "1000BASE-T full duplex",
            "1000BASE-T half duplex",
            "100BASE-TX full duplex",
            "10BASE-T full duplex",
            "10BASE-T half duplex",
            "unknown speed"
        ]
    );
    organisation(IEEE, 4, &[5, 0xEE], Value::MaximumFrameSize(1518));
    organisation([0, 0x80, 0xC2], 1, &[0, 7], Value::Octets(&[0, 7]));
    assert_eq!(Value::name([0, 0x80, 0xC2], 1), "IEEE 802.1");
}

#[test]
fn what_is_cut_off_ends_them_with_an_error_and_its_place() {
    let octets = [tlv(3, &[0, 20]), tlv(1, b"\x07plc")].concat();
    let all: Vec<_> = Lldp::new(&octets[..8]).tlvs().collect();
    assert!(matches!(all[..], [Ok(_), Err(Malformed { offset: 8, .. })]), "{all:?}");
    // Without the TLV that ends them, they end with the frame.
    assert_eq!(Lldp::new(&octets).tlvs().filter(Result::is_ok).count(), 2);
    let octets = tlv(3, &[0]);
    let all: Vec<_> = Lldp::new(&octets).tlvs().collect();
    assert!(matches!(all[..], [Err(Malformed { offset: 3, .. })]), "{all:?}");
}
