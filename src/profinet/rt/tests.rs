use super::*;

/// 40 octets of data, the status 12 34 35 00.
fn frame(frame_id: u16) -> Vec<u8> {
    [&frame_id.to_be_bytes()[..], &[0x80; 40], &[0x12, 0x34, 0x35, 0]].concat()
}

#[test]
fn p_2_frame_ids_have_their_ranges() {
    for (frame_id, name) in [
        (0x0000, "PTCP reserved"),
        (0x0020, "PTCP sync with follow-up"),
        (0x0080, "PTCP sync"),
        (0x00FF, "PTCP reserved"),
        (0x0100, "RT class 3"),
        (0x06FF, "RT class 3"),
        (0x0700, "RT class 3 redundant"),
        (0x0FFF, "RT class 3 redundant"),
        (0x1000, "reserved"),
        (0x7FFF, "reserved"),
        (0x8000, "RT class 1"),
        (0x8001, "RT class 1"),
        (0xBBFF, "RT class 1"),
        (0xBC00, "RT class 1 multicast"),
        (0xC000, "RT class 1 legacy"),
        (0xF800, "RT class 1 legacy multicast"),
        (0xFBFF, "RT class 1 legacy multicast"),
        (0xFC00, "reserved"),
        (0xFC01, "alarm high"),
        (0xFE01, "alarm low"),
        (0xFEFC, "DCP hello"),
        (0xFEFD, "DCP get or set"),
        (0xFEFE, "DCP identify request"),
        (0xFEFF, "DCP identify response"),
        (0xFF00, "PTCP announce"),
        (0xFF20, "PTCP follow-up"),
        (0xFF40, "PTCP delay request"),
        (0xFF41, "PTCP delay response with follow-up"),
        (0xFF42, "PTCP delay follow-up"),
        (0xFF43, "PTCP delay response"),
        (0xFF44, "PTCP reserved"),
        (0xFF80, "RT fragment"),
        (0xFFFF, "reserved"),
    ] {
        assert_eq!(FrameId(frame_id).name(), name, "{frame_id:#06X}");
    }
}

#[test]
fn p_1_cyclic_data_has_a_header_of_two_octets_and_four_behind_it() {
    let octets = frame(0x8001);
    let frame = RtFrame::parse(&octets).unwrap();
    assert_eq!(frame.frame_id, FrameId(0x8001));
    let cyclic = CyclicData::parse(frame.behind).unwrap();
    assert_eq!(cyclic.data, [0x80; 40]);
    let ApduStatus { cycle_counter, data_status, transfer_status } = cyclic.status;
    assert_eq!((cycle_counter, data_status.0, transfer_status.0), (0x1234, 0x35, 0));
}

#[test]
fn p_2_each_bit_of_the_data_status_has_its_meaning() {
    let bits = |octet| {
        let it = DataStatus(octet);
        let meant = [
            it.is_primary(),
            it.has_redundancy_fault(),
            it.is_valid(),
            it.is_running(),
            it.is_without_problem(),
            it.is_ignored(),
        ];
        (meant.map(u8::from), it.reserved())
    };
    assert_eq!(bits(0x01), ([1, 0, 0, 0, 0, 0], 0));
    assert_eq!(bits(0x02), ([0, 1, 0, 0, 0, 0], 0));
    assert_eq!(bits(0x04), ([0, 0, 1, 0, 0, 0], 0));
    assert_eq!(bits(0x10), ([0, 0, 0, 1, 0, 0], 0));
    assert_eq!(bits(0x20), ([0, 0, 0, 0, 1, 0], 0));
    assert_eq!(bits(0x80), ([0, 0, 0, 0, 0, 1], 0));
    assert_eq!(bits(0x48), ([0; 6], 0x48));
}

#[test]
fn p_2_transfer_faults_are_named() {
    let faults = |octet| TransferStatus(octet).faults().collect::<Vec<_>>();
    assert!(faults(0).is_empty());
    assert_eq!(faults(0x82), ["length", "reserved bits"]);
}

#[test]
fn a_submodules_status_is_good_or_names_who_says_no() {
    assert!(IoStatus(0x80).is_good() && !IoStatus(0x7F).is_good());
    let names = [0x00, 0x20, 0x40, 0x60].map(|octet| IoStatus(octet).instance_name());
    assert_eq!(names, ["subslot", "slot", "device", "controller"]);
}

#[test]
fn what_is_too_short_says_so() {
    assert_eq!(RtFrame::parse(&[0x80]).unwrap_err().offset, 1);
    let frame = RtFrame::parse(&[0x80, 0, 1, 2, 3]).unwrap();
    assert_eq!(CyclicData::parse(frame.behind).unwrap_err().offset, 2);
}
