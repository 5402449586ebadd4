use super::*;

const SOURCE: MacAddress = MacAddress([2, 0, 0, 0, 0, 7]);
const OTHER: MacAddress = MacAddress([2, 0, 0, 0, 0, 8]);

/// A frame of version 1 with this TLV, and the common one behind it.
fn frame(tlv: &[u8]) -> Vec<u8> {
    [&[0, 1][..], tlv, &[1, 18, 0x12, 0x34], &[0xFF; 16], &[0, 0], &[0; 20]].concat()
}

/// The TLV in front of the common one.
#[track_caller]
fn read(octets: &[u8]) -> (MrpValue<'_>, &'static str, Option<&'static str>) {
    let mrp = Mrp::parse(octets).unwrap();
    assert_eq!(mrp.version, 1);
    let all: Vec<_> = mrp.tlvs().map(Result::unwrap).collect();
    let common = MrpValue::Common { sequence_id: 0x1234, domain_uuid: [0xFF; 16] };
    assert_eq!((all.len(), all[1].value), (2, common));
    (all[0].value, all[0].name(), all[0].sender_role())
}

/// The length, these two octets, the address, and the numbers behind it.
fn tlv(kind: u8, front: &[u8], behind: &[u8]) -> Vec<u8> {
    let value = [front, &SOURCE.0, behind].concat();
    [&[kind, value.len() as u8][..], &value].concat()
}

#[test]
fn p_12_a_test_tells_of_the_ring() {
    let octets = frame(&tlv(2, &[0x80, 0], &[0, 1, 0, 1, 0, 5, 0, 0, 1, 0]));
    let test = Test {
        priority: 0x8000,
        source: SOURCE,
        port_role: 1,
        state: 1,
        transitions: 5,
        timestamp: 256,
    };
    assert_eq!(read(&octets), (MrpValue::Test(test), "MRP_Test", Some("manager (MRM)")));
    assert_eq!((test.state_name(), priority_name(test.priority)), ("closed", "default"));
    assert_eq!(port_role_name(test.port_role), "secondary ring port");
}

#[test]
fn p_12_changes_of_the_ring() {
    let octets = frame(&tlv(3, &[0x10, 0], &[0, 20]));
    let change = MrpValue::TopologyChange { priority: 0x1000, source: SOURCE, interval: 20 };
    assert_eq!(read(&octets), (change, "MRP_TopologyChange", Some("manager (MRM)")));
    for (kind, is_up, name) in [(4, false, "MRP_LinkDown"), (5, true, "MRP_LinkUp")] {
        let octets = frame(&tlv(kind, &[], &[0, 0, 0, 20, 0, 1]));
        let (port_role, interval, blocked) = (0, 20, 1);
        let change = MrpValue::LinkChange { is_up, source: SOURCE, port_role, interval, blocked };
        assert_eq!(read(&octets), (change, name, Some("client (MRC)")));
        // Padded to a multiple of four.
        let octets = frame(&[tlv(kind, &[], &[0, 0, 0, 20, 0, 1]), vec![0, 0]].concat());
        assert_eq!(read(&octets).0, change);
    }
}

#[test]
fn p_12_frames_of_an_interconnection() {
    let octets = frame(&tlv(6, &[0, 9], &[0, 2, 0, 0, 0, 5, 0, 0, 1, 0]));
    let (value, name, role) = read(&octets);
    let MrpValue::InTest { interconnection_id: 9, test } = value else { panic!("{value:?}") };
    assert_eq!((test.source, test.state_name(), test.timestamp), (SOURCE, "open", 256));
    assert_eq!((name, role), ("MRP_InTest", Some("interconnection manager (MIM)")));
    assert_eq!(port_role_name(test.port_role), "interconnection port");

    let octets = frame(&tlv(7, &[], &[0, 9, 0, 20]));
    let (source, interconnection_id, interval) = (SOURCE, 9, 20);
    let change = MrpValue::InTopologyChange { source, interconnection_id, interval };
    assert_eq!(read(&octets).0, change);
    for (kind, is_up) in [(8, false), (9, true)] {
        let octets = frame(&tlv(kind, &[], &[0, 2, 0, 9, 0, 20]));
        let port_role = 2;
        let change =
            MrpValue::InLinkChange { is_up, source, port_role, interconnection_id, interval };
        assert_eq!(read(&octets).0, change);
    }
    let octets = frame(&tlv(10, &[], &[0, 2, 0, 9]));
    let poll = MrpValue::InLinkStatusPoll { source, port_role: 2, interconnection_id };
    assert_eq!((read(&octets).0, read(&octets).1), (poll, "MRP_InLinkStatusPoll"));
}

#[test]
fn p_12_managers_choose_one_of_them() {
    let ends = [&[0x80, 0][..], &SOURCE.0, &[0xF0, 0], &OTHER.0].concat();
    for (kind, name) in [(1, "MRP_TestMgrNAck"), (2, "MRP_TestPropagate")] {
        // Data of the first edition, of two octets; and none.
        for front in [&[8, 0, 6, 0, 0, 0][..], &[8, 0, 6, 4, 9, 9], &[0, 0x0E, 0xCF, 1]] {
            let value = [front, &[kind, 16], &ends].concat();
            let octets = frame(&[&[0x7F, value.len() as u8][..], &value].concat());
            let (value, option, _) = read(&octets);
            let MrpValue::Option { auto_manager: Some(auto_manager), .. } = value else {
                panic!("{value:?}")
            };
            assert_eq!((option, auto_manager.name()), ("MRP_Option", name));
            assert_eq!(auto_manager.ends, Some([(0x8000, SOURCE), (0xF000, OTHER)]));
        }
    }
    let octets = frame(&[0x7F, 8, 8, 0, 6, 0, 0, 0, 3, 0]);
    let auto_manager = Some(AutoManager { kind: 3, ends: None });
    let option = MrpValue::Option { oui: [8, 0, 6], auto_manager, octets: &[0, 0, 0, 3, 0] };
    assert_eq!(read(&octets).0, option);
    // Whatever else a manufacturer writes stays octets.
    for octets in [&[1][..], &[0, 0, 0], &[0, 0, 0, 1, 9, 0], &[1, 0xF1, 1, 7]] {
        let tlv = [&[0x7F, octets.len() as u8 + 3, 8, 0, 6][..], octets].concat();
        let option = MrpValue::Option { oui: [8, 0, 6], auto_manager: None, octets };
        assert_eq!(read(&frame(&tlv)).0, option);
    }
}

#[test]
fn priorities_and_unknown_tlvs() {
    let names = [0x0000, 0x0001, 0x7000, 0x9000, 0xF000, 0xFFFF].map(priority_name);
    assert_eq!(names, ["highest", "other", "high", "low", "lowest", "lowest"]);
    let octets = frame(&[0x55, 2, 1, 2]);
    assert_eq!(read(&octets), (MrpValue::Octets(&[1, 2]), "unknown", None));
}

#[test]
fn a_tlv_that_is_cut_off_ends_them_with_an_error() {
    for octets in [&[0, 1, 2][..], &[0, 1, 2, 9, 0], &[0, 1, 2, 1, 0]] {
        let mrp = Mrp::parse(octets).unwrap();
        let all: Vec<_> = mrp.tlvs().collect();
        assert!(matches!(&all[..], [Err(Malformed { .. })]), "{all:?}");
    }
    assert_eq!(Mrp::parse(&[0]).unwrap_err().offset, 1);
}
