//! The asking of devices, against devices that are written by hand: who is believed, when is sent, and
//! what comes of silence.

mod device;

use std::collections::BTreeSet;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::{Duration, Instant};

use proptest::prelude::*;

use super::device::Device;
use super::passive::Passive;
use super::print::{Format, print};
use super::scan::{Pace, Scan};
use crate::cli::decode::Seen;
use crate::profinet::rpc::{Interface, PacketType, Rpc};
use crate::profinet::{ByteOrder, MacAddress, Uuid};
use device::{Datagram, FakeDevice};

const PACE: Pace =
    Pace { interval: Duration::from_millis(10), timeout: Duration::from_secs(1), retries: 1 };

fn at(text: &str) -> SocketAddrV4 {
    text.parse().unwrap()
}

fn scan(targets: &[&str], now: Instant) -> Scan<impl FnMut() -> Uuid> {
    let targets: BTreeSet<_> = targets.iter().map(|target| at(target)).collect();
    let mut number = 0;
    Scan::new(targets, PACE, now, move || {
        number += 1;
        Uuid::new(number)
    })
}

/// What went over the wire, and when.
struct Log {
    sent: Vec<(Instant, SocketAddrV4, Datagram)>,
    devices: Vec<Device>,
}

/// Runs a scan to its end. Answers arrive at once; without any, time goes on.
fn run(
    mut scan: Scan<impl FnMut() -> Uuid>,
    start: Instant,
    mut answer: impl FnMut(SocketAddrV4, &[u8]) -> Vec<(SocketAddrV4, Datagram)>,
) -> Log {
    let (mut now, mut sent) = (start, Vec::new());
    while !scan.is_over() {
        let mut buffer = [0; 256];
        while let Some((to, length)) = scan.transmit(now, &mut buffer) {
            sent.push((now, to, buffer[..length].to_vec()));
            for (from, octets) in answer(to, &buffer[..length]) {
                scan.receive(now, from, &octets);
            }
        }
        assert!(sent.len() < 10_000, "it goes on for ever");
        if let Some(due) = scan.next_timeout() {
            now = now.max(due);
            scan.handle_timeout(now);
        }
    }
    Log { sent, devices: scan.into_devices() }
}

/// Of one device, which answers from this port.
fn found(mut fake: FakeDevice, from: &str) -> Log {
    let start = Instant::now();
    run(scan(&["172.17.17.7:34964"], start), start, |to, octets| {
        fake.answer(to, octets).into_iter().map(|answer| (at(from), answer)).collect()
    })
}

fn printed(devices: &[Device], format: Format) -> String {
    let mut out = Vec::new();
    print(devices, format, None, &mut out).unwrap();
    String::from_utf8(out).unwrap()
}

/// P-4, P-5: from whatever port and in whatever byte order.
#[test]
fn p_4_a_device_may_answer_from_any_port_and_in_its_own_byte_order() {
    for (from, order) in [
        ("172.17.17.7:34964", ByteOrder::Big),
        ("172.17.17.7:9001", ByteOrder::Little),
        ("172.17.17.7:49200", ByteOrder::Big),
    ] {
        let log = found(FakeDevice { order, ..FakeDevice::default() }, from);
        let [device] = &log.devices[..] else { panic!("{:?}", log.devices) };
        assert_eq!(device.answered_from, Some(at(from).port()));
        assert_eq!((device.vendor_id, device.device_id), (Some(0x1F2E), Some(0x42)));
        let submodule = &device.submodules[0];
        assert_eq!(submodule.product.order_id.as_deref(), Some("VALVE 7"));
        assert_eq!(submodule.product.software_revision.as_deref(), Some("V1.2.3"));
        assert_eq!(submodule.function.as_deref(), Some("steam"));
        assert_eq!(submodule.descriptor, None, "it does not say that it has I&M3");
        let places = device.submodules.iter().map(|it| (it.api, it.slot, it.submodule_ident));
        assert_eq!(places.collect::<Vec<_>>(), [(0, 0, Some(2)), (0x3A00, 2, Some(4))]);
        assert_eq!(device.submodules[1].product, submodule.product);
        assert!(log.sent.iter().all(|(_, to, _)| *to == at("172.17.17.7:34964")));
    }
}

#[test]
fn somebody_else_another_activity_or_another_sequence_is_no_answer() {
    let log = found(FakeDevice::default(), "172.17.17.8:34964");
    assert!(log.devices.is_empty());
    // Activity UUID, sequence number, as they stand in the header.
    for octet in [40, 67] {
        let fake = FakeDevice { changed: Some(octet), ..FakeDevice::default() };
        assert!(found(fake, "172.17.17.7:34964").devices.is_empty(), "{octet}");
    }
}

/// Nothing but look-ups and Read Implicit leaves, and each activity counts from 0.
#[test]
fn nothing_is_ever_written() {
    let log = found(FakeDevice { fragment: 40, ..FakeDevice::default() }, "172.17.17.7:9001");
    let mut expected = (Uuid::NIL, 0);
    let mut facks = 0;
    for (_, _, octets) in &log.sent {
        let rpc = Rpc::parse(octets).unwrap();
        let header = rpc.header();
        if header.packet_type == PacketType::Fack {
            facks += 1;
            continue;
        }
        let call = (Interface::of(header.interface), header.operation);
        let calls = [(Some(Interface::EndpointMapper), 2), (Some(Interface::Device), 5)];
        assert!(header.packet_type == PacketType::Request && calls.contains(&call), "{header:?}");
        let next = if header.activity == expected.0 { expected.1 + 1 } else { 0 };
        assert_eq!(header.sequence, next);
        expected = (header.activity, next);
    }
    assert!(facks > 5, "{facks}");
    assert_eq!(log.devices[0].submodules[0].product.order_id.as_deref(), Some("VALVE 7"));
}

#[test]
fn a_device_that_has_another_port_in_its_mapper_is_asked_there_when_it_refuses() {
    let fake = FakeDevice { port: 49201, ..FakeDevice::default() };
    let log = found(fake, "172.17.17.7:49201");
    let ports: Vec<_> = log.sent.iter().map(|(_, to, _)| to.port()).collect();
    assert_eq!(ports[..4], [34964, 34964, 34964, 49201]);
    assert_eq!(log.devices[0].submodules[0].product.order_id.as_deref(), Some("VALVE 7"));
    assert_eq!(log.devices[0].error, None);
}

#[test]
fn a_device_without_mapper_and_filter_data_tells_slot_0_alone() {
    let fake = FakeDevice { has_mapper: false, has_filter_data: false, ..FakeDevice::default() };
    let log = found(fake, "172.17.17.7:34964");
    let [device] = &log.devices[..] else { panic!("{:?}", log.devices) };
    assert_eq!((device.device_id, device.submodules.len()), (None, 1));
    assert_eq!((device.submodules[0].slot, device.submodules[0].subslot), (0, 1));
}

#[test]
fn a_device_without_i_and_m_is_listed_with_the_reason() {
    let fake = FakeDevice { has_im: false, has_filter_data: false, ..FakeDevice::default() };
    let log = found(fake, "172.17.17.7:34964");
    let text = printed(&log.devices, Format::Text);
    assert!(text.contains("172.17.17.7: Read failed: invalid index"), "{text}");
}

/// Nobody is there: each question is sent as often as the pace says, and never faster.
#[test]
fn requests_keep_their_distance_and_end() {
    let start = Instant::now();
    let targets: Vec<_> = (1..=100).map(|host| format!("172.17.17.{host}:34964")).collect();
    let targets: Vec<_> = targets.iter().map(String::as_str).collect();
    let log = run(scan(&targets, start), start, |_, _| Vec::new());
    assert!(log.devices.is_empty());
    // Two questions, each sent twice.
    assert_eq!(log.sent.len(), 100 * 2 * 2);
    for pair in log.sent.windows(2) {
        assert!(pair[1].0 - pair[0].0 >= PACE.interval);
    }
}

/// A device that never ends its answer is given up.
#[test]
fn a_device_that_is_always_at_work_is_given_up() {
    let fake = FakeDevice { is_working: true, ..FakeDevice::default() };
    assert!(found(fake, "172.17.17.7:34964").devices.is_empty());
}

#[test]
fn csv_has_no_formula_and_one_line_a_submodule() {
    let fake = FakeDevice { order_id: *b"=cmd,\"x\"\x1b[2J        ", ..FakeDevice::default() };
    let log = found(fake, "172.17.17.7:34964");
    let csv = printed(&log.devices, Format::Csv);
    let lines: Vec<_> = csv.split("\r\n").collect();
    assert_eq!(lines.len(), 4, "a heading, two submodules, the end: {csv}");
    assert!(lines[1].contains(",\"'=cmd,\"\"x\"\"\u{FFFD}[2J\","), "{csv}");
    assert_eq!(lines[0].split(',').next(), Some("address"));
    let text = printed(&log.devices, Format::Text);
    assert!(!text.contains('\x1b') && text.contains("0x1f2e"), "{text}");
    let json: serde_json::Value =
        serde_json::from_str(&printed(&log.devices, Format::Json)).unwrap();
    assert_eq!(json["submodules"][0]["hardware_revision"], 3);
    assert_eq!(json["asked"], "172.17.17.7:34964");
}

/// P-8: what others are told is put together from a capture, whatever comes in between.
#[test]
fn p_8_what_is_overheard_is_what_was_asked() {
    for fragment in [0, 40] {
        let (start, mut passive) = (Instant::now(), Passive::default());
        let mut fake = FakeDevice { fragment, ..FakeDevice::default() };
        let mut log = run(scan(&["172.17.17.7:34964"], start), start, |to, octets| {
            let answers = fake.answer(to, octets);
            for answer in &answers {
                // The same datagram of another device belongs to another answer.
                for from in ["172.17.17.7:9001", "172.17.17.8:9001"] {
                    passive.note(&Seen::Udp { from: at(from).into(), octets: answer });
                }
            }
            answers.into_iter().map(|answer| (to, answer)).collect()
        });
        let asked = &mut log.devices[0];
        (asked.asked, asked.answered_from) = (None, None);
        let overheard = passive.into_devices();
        assert_eq!((overheard.len(), &overheard[0]), (2, &*asked));
    }
}

#[test]
fn a_capture_of_endless_devices_takes_no_endless_memory() {
    let (start, mut passive, mut answers) = (Instant::now(), Passive::default(), Vec::new());
    let mut fake = FakeDevice::default();
    run(scan(&["172.17.17.7:34964"], start), start, |to, octets| {
        answers.extend(fake.answer(to, octets));
        answers.last().map(|answer| (to, answer.clone())).into_iter().collect()
    });
    for host in 0..5000_u32 {
        let from = (Ipv4Addr::from(0x0A00_0000 + host), 34964).into();
        answers.iter().for_each(|octets| passive.note(&Seen::Udp { from, octets }));
    }
    assert!(passive.left_out > 900, "{}", passive.left_out);
    assert_eq!(passive.into_devices().len(), 4096);
}

const MAC: MacAddress = MacAddress([2, 0, 0, 0, 0, 7]);
/// Identify response: name of station "press-3", vendor 0x1F2E, device 0x0042, 172.17.17.7.
const IDENTIFY: &[u8] = b"\xfe\xff\x05\x01\x00\x00\x00\x07\x00\x00\x00\x2a\
    \x02\x02\x00\x09\x00\x00press-3\x00\x02\x03\x00\x06\x00\x00\x1f\x2e\x00\x42\
    \x01\x02\x00\x0e\x00\x01\xac\x11\x11\x07\xff\xff\xff\x00\xac\x11\x11\x07";
/// Port port-001 of press-3, whose interface is [`MAC`].
const LLDP: &[u8] = b"\x02\x08\x07press 3\x04\x11\x07port-001.press-3\x06\x02\x00\x14\
    \xfe\x0a\x00\x0e\xcf\x05\x02\x00\x00\x00\x00\x07\x00\x00";

fn rt(octets: &[u8]) -> Seen<'_> {
    Seen::Frame { from: MAC, ether_type: 0x8892, octets }
}

/// P-3, P-11: what DCP and LLDP tell belongs to the device that others read records of, in any order.
#[test]
fn p_3_p_11_names_from_dcp_and_ports_from_lldp_join_a_device() {
    let (start, mut answers) = (Instant::now(), Vec::new());
    let mut fake = FakeDevice::default();
    run(scan(&["172.17.17.7:34964"], start), start, |to, octets| {
        answers.extend(fake.answer(to, octets));
        answers.last().map(|answer| (to, answer.clone())).into_iter().collect()
    });
    let records = |passive: &mut Passive| {
        let from = at("172.17.17.7:9001").into();
        answers.iter().for_each(|octets| passive.note(&Seen::Udp { from, octets }));
    };
    // The frames of a port have an address of their own.
    let of_port = MacAddress([2, 0, 0, 0, 0, 8]);
    let lldp = |passive: &mut Passive| {
        passive.note(&Seen::Frame { from: of_port, ether_type: 0x88CC, octets: LLDP });
    };
    let dcp = |passive: &mut Passive| passive.note(&rt(IDENTIFY));
    let steps: [&dyn Fn(&mut Passive); 3] = [&records, &lldp, &dcp];
    let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    for order in orders {
        let mut passive = Passive::default();
        order.iter().for_each(|&step: &usize| steps[step](&mut passive));
        let devices = passive.into_devices();
        let [device] = &devices[..] else { panic!("{devices:?}") };
        assert_eq!((device.mac, device.address), (Some(MAC), Some([172, 17, 17, 7].into())));
        assert_eq!(device.station_name.as_deref(), Some("press-3"));
        assert_eq!((device.vendor_id, device.device_id), (Some(0x1F2E), Some(0x42)));
        assert_eq!((&device.ports[..], device.submodules.len()), (&["port-001".to_owned()][..], 2));
    }
}

/// Requests say what somebody wants, and a name without its device is nobody's.
#[test]
fn requests_of_dcp_and_frames_of_others_are_no_devices() {
    let mut passive = Passive::default();
    for (at, value) in [(3, 0), (2, 4), (0, 0x80)] {
        let mut octets = IDENTIFY.to_vec();
        octets[at] = value;
        passive.note(&rt(&octets));
    }
    let switch = b"\x02\x05\x07core\x04\x05\x07eth0\x06\x02\x00\x14\x00\x00";
    passive.note(&Seen::Frame { from: MAC, ether_type: 0x88CC, octets: switch });
    assert_eq!(passive.into_devices(), []);
}

proptest! {
    #[test]
    fn no_frames_bring_it_down(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        end in any::<prop::sample::Index>(),
    ) {
        let mut passive = Passive::default();
        for (ether_type, frame) in [(0x8892, IDENTIFY), (0x88CC, LLDP)] {
            let mut octets = frame.to_vec();
            for (place, value) in &changes {
                let place = place.index(octets.len());
                octets[place] = *value;
            }
            octets.truncate(end.index(octets.len() + 1));
            for from in [MAC, MacAddress([2, 0, 0, 0, 0, 9])] {
                passive.note(&Seen::Frame { from, ether_type, octets: &octets });
            }
        }
        printed(&passive.into_devices(), Format::Csv);
    }

    /// Whatever a device sends, the scan comes to its end, and what it keeps can be printed.
    #[test]
    fn no_octets_bring_it_down(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        fragment in 0_usize..80,
        at_call in 0_usize..12,
    ) {
        let start = Instant::now();
        let mut fake = FakeDevice { fragment, ..FakeDevice::default() };
        let (mut call, mut passive) = (0, Passive::default());
        let mut log = run(scan(&["172.17.17.7:34964"], start), start, |to, octets| {
            let mut answers = fake.answer(to, octets);
            call += 1;
            if call >= at_call {
                for answer in &mut answers {
                    for (place, value) in &changes {
                        let place = place.index(answer.len());
                        answer[place] = *value;
                    }
                }
            }
            for octets in &answers {
                passive.note(&Seen::Udp { from: to.into(), octets });
            }
            answers.into_iter().map(|answer| (to, answer)).collect()
        });
        log.devices.extend(passive.into_devices());
        for format in [Format::Text, Format::Csv, Format::Json] {
            printed(&log.devices, format);
        }
    }
}
