//! Whatever the octets are, every view reads them to their end without a panic, and shows nothing that is
//! not in them.

use proptest::prelude::*;

use super::alarm::AlarmFrame;
use super::dcp::{Dcp, DcpValue};
use super::lldp::{Lldp, LldpValue, Names};
use super::mrp::{Mrp, MrpValue};
use super::ptcp::Ptcp;
use super::rt::{CyclicData, FrameKind, RtFrame};

/// A view's octets are some of the frame's.
#[track_caller]
fn inside(frame: &[u8], shown: &[u8]) {
    let (all, part) = (frame.as_ptr_range(), shown.as_ptr_range());
    assert!(shown.is_empty() || all.start <= part.start && part.end <= all.end);
}

/// Reads all of it. An error is at most one octet behind the frame.
fn read_rt(octets: &[u8]) {
    let Ok(frame) = RtFrame::parse(octets) else { return };
    let error = match frame.frame_id.kind() {
        FrameKind::Cyclic(_) => {
            CyclicData::parse(frame.behind).map(|it| inside(octets, it.data)).err()
        }
        FrameKind::Alarm(_) => {
            let read = AlarmFrame::parse(frame.behind);
            read.and_then(|it| {
                inside(octets, it.contents.rest());
                it.error_status()
            })
            .err()
        }
        FrameKind::Dcp(_) => Dcp::parse(frame.behind)
            .and_then(|dcp| {
                dcp.blocks().try_for_each(|block| block.map(|it| dcp_block(octets, &it.value)))
            })
            .err(),
        FrameKind::Ptcp(kind) => Ptcp::parse(kind, frame.behind)
            .and_then(|ptcp| ptcp.map_or(Ok(()), |it| it.tlvs().try_for_each(|tlv| tlv.map(drop))))
            .err(),
        FrameKind::Fragment | FrameKind::Reserved => None,
    };
    assert!(error.is_none_or(|it| it.offset <= octets.len()), "{error:?}");
}

fn dcp_block(octets: &[u8], value: &DcpValue<'_>) {
    match value {
        DcpValue::Text(shown)
        | DcpValue::DeviceOptions(shown)
        | DcpValue::Octets(shown)
        | DcpValue::Dhcp { value: shown, .. } => inside(octets, shown),
        _ => {}
    }
}

fn read_lldp(octets: &[u8]) {
    for tlv in Lldp::new(octets).tlvs() {
        match tlv.map(|tlv| tlv.value) {
            Ok(LldpValue::Text(shown) | LldpValue::Octets(shown)) => inside(octets, shown),
            Ok(_) => {}
            Err(error) => assert!(error.offset <= octets.len()),
        }
    }
}

fn read_mrp(octets: &[u8]) {
    let Ok(mrp) = Mrp::parse(octets) else { return };
    for tlv in mrp.tlvs() {
        match tlv.map(|tlv| tlv.value) {
            Ok(MrpValue::Octets(shown) | MrpValue::Option { octets: shown, .. }) => {
                inside(octets, shown);
            }
            Ok(_) => {}
            Err(error) => assert!(error.offset <= octets.len()),
        }
    }
}

/// Frame IDs of every kind.
fn frame_id() -> impl Strategy<Value = u16> {
    prop_oneof![
        any::<u16>(),
        prop::sample::select(vec![
            0x0020, 0x0080, 0x8000, 0xFC01, 0xFE01, 0xFEFC, 0xFEFD, 0xFEFE, 0xFEFF, 0xFF00, 0xFF20,
            0xFF40, 0xFF41, 0xFF43,
        ]),
    ]
}

/// Small numbers are lengths and types that fit, more often than not.
fn octets() -> impl Strategy<Value = Vec<u8>> {
    let octet = prop_oneof![Just(0), 0_u8..8, 0_u8..32, any::<u8>()];
    prop::collection::vec(octet, 0..300)
}

proptest! {
    #[test]
    fn no_octets_bring_a_view_down(frame_id in frame_id(), octets in octets()) {
        read_rt(&[&frame_id.to_be_bytes()[..], &octets].concat());
        read_rt(&octets);
        read_lldp(&octets);
        read_mrp(&octets);
    }

    /// Frames whose lengths are right, with other contents and cut off anywhere.
    #[test]
    fn no_tlvs_bring_a_view_down(
        tlvs in prop::collection::vec((0_u8..=127, octets()), 0..6),
        cut in 0_usize..1000,
    ) {
        let mut lldp = Vec::new();
        let mut mrp = vec![0, 1];
        let mut ptcp = [&[0xFF, 0x00][..], &[0; 20]].concat();
        let mut dcp = Vec::new();
        for (kind, octets) in &tlvs {
            let head = u16::from(*kind) << 9 | octets.len() as u16;
            lldp.extend([&head.to_be_bytes()[..], octets].concat());
            ptcp.extend([&head.to_be_bytes()[..], octets].concat());
            let short = &octets[..octets.len().min(255)];
            mrp.extend([&[*kind, short.len() as u8][..], short].concat());
            let length = (octets.len() as u16).to_be_bytes();
            dcp.extend([&[kind % 8, kind / 8], &length[..], octets].concat());
            dcp.resize(dcp.len().next_multiple_of(2), 0);
        }
        let length = (dcp.len() as u16).to_be_bytes();
        for [service_id, service_type] in [[3, 0], [3, 1], [4, 0], [4, 1], [5, 0], [6, 0]] {
            let head = [0xFE, 0xFD, service_id, service_type, 0, 0, 0, 1, 0, 0];
            let frame = [&head[..], &length, &dcp].concat();
            read_rt(&frame[..cut.min(frame.len())]);
        }
        read_lldp(&lldp[..cut.min(lldp.len())]);
        read_mrp(&mrp[..cut.min(mrp.len())]);
        read_rt(&ptcp[..cut.min(ptcp.len())]);
    }

    #[test]
    fn no_names_bring_it_down(chassis in octets(), port in "port-[0-9]{0,4}(-[0-9]{0,6})?(\\..*)?") {
        if let Some(names) = Names::of(&chassis, port.as_bytes()) {
            assert!(names.port.starts_with("port-") && !names.station.is_empty());
        }
    }
}
