//! `pnet-nat decode` on captures with PROFINET in them; what single frames say is shown beside the code.

use std::fs;
use std::process::Command;

use serde_json::{Value, json};

use crate::harness::{Process, frame, header, pnet_nat, request, udp};
use crate::profinet_judge::rpc::connect;

const CONTROLLER: [u8; 6] = [2, 0, 0, 0, 0, 9];
const DEVICE: [u8; 6] = [2, 0, 0, 0, 0, 1];
const VLAN: [u8; 4] = [0x81, 0, 0xC0, 0];

/// A capture of Ethernet frames at these microseconds after a whole second.
fn at<'a>(packets: impl IntoIterator<Item = (u32, &'a [u8])>) -> Vec<u8> {
    let mut file = header();
    file[20..24].copy_from_slice(&1_u32.to_le_bytes());
    for (micros, packet) in packets {
        let mut frame = frame(packet, packet.len());
        frame[4..8].copy_from_slice(&micros.to_le_bytes());
        file.extend(frame);
    }
    file
}

fn identify() -> Vec<u8> {
    let to = [1, 0x0E, 0xCF, 0, 0, 0];
    let head = [0x88, 0x92, 0xFE, 0xFE, 5, 0, 1, 0, 0, 2, 0, 1, 0, 12, 2, 2, 0, 7];
    [&to, &CONTROLLER, &head[..], b"press-1\0", &[0; 18]].concat()
}

fn lldp() -> Vec<u8> {
    let to = [1, 0x80, 0xC2, 0, 0, 0x0E];
    let names = b"\x88\xCC\x02\x08\x07press-1\x04\x09\x07port-001\x06\x02\x00\x14";
    let line = [0xFE, 9, 0, 0x12, 0x0F, 1, 3, 0x0C, 0, 0, 0x10, 0, 0];
    [&to, &DEVICE, &names[..], &line].concat()
}

fn cyclic(cycle_counter: u16, data_status: u8) -> Vec<u8> {
    let [high, low] = cycle_counter.to_be_bytes();
    let status = [high, low, data_status, 0];
    let head = [0x88, 0x92, 0x80, 0x01];
    [&CONTROLLER, &DEVICE, &VLAN[..], &head, &[0; 40], &status].concat()
}

/// A datagram of P-NET in an Ethernet frame.
fn p_net() -> Vec<u8> {
    [&CONTROLLER, &DEVICE, &[8, 0][..], &udp(34379, &request(4))].concat()
}

/// What a capture shows in a format.
fn shown(capture: &[u8], arguments: &[&str]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("capture.pcap");
    fs::write(&file, capture).unwrap();
    let file = file.to_str().unwrap();
    let mut decode = Process::start(pnet_nat(&[&["decode", file], arguments].concat()));
    assert_eq!((decode.end(), &decode.stderr()[..]), (Some(0), ""));
    decode.stdout()
}

fn objects(capture: &[u8], arguments: &[&str]) -> Vec<Value> {
    let json = shown(capture, &[&["--format", "json"], arguments].concat());
    json.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn the_page_shows_profinet_as_it_is_printed() {
    let page = include_str!("../../docs/troubleshooting.md");
    let (_, section) = page.split_once("### PROFINET in a capture").unwrap();
    let (_, printed) = section.split_once("```text\n").unwrap();
    // The frame of cycle 128 is missing; then the station has a problem.
    let capture = at([
        (0, &identify()[..]),
        (1_000, &lldp()),
        (100_000, &cyclic(0, 0x35)),
        (102_000, &cyclic(64, 0x35)),
        (106_100, &cyclic(192, 0x15)),
        (108_000, &cyclic(256, 0x15)),
    ]);
    assert_eq!(shown(&capture, &[]), printed.split("```").next().unwrap());
}

#[test]
fn protocols_are_shown_together_or_some_of_them() {
    let capture = at([(0, &p_net()[..]), (1, &identify()), (2, &cyclic(0, 0x35)), (3, &lldp())]);
    let protocols = |arguments: &[&str]| {
        let objects = objects(&capture, arguments);
        let numbers = objects.iter().filter_map(|object| {
            Some((object.get("frame")?.as_u64()?, object["protocol"].as_str()?.to_owned()))
        });
        let summaries = ["profinet_summary", "summary"];
        let last = summaries.map(|name| objects.iter().any(|object| object.get(name).is_some()));
        (numbers.map(|(number, name)| format!("{number} {name}")).collect::<Vec<_>>(), last)
    };
    let all = ["1 p-net", "2 profinet-dcp", "3 profinet-rt", "4 lldp"].map(str::to_owned);
    assert_eq!(protocols(&[]), (all.to_vec(), [true, true]));
    let some = ["2 profinet-dcp", "4 lldp"].map(str::to_owned);
    assert_eq!(protocols(&["--protocol", "lldp,profinet-dcp"]), (some.to_vec(), [true, false]));
    assert_eq!(protocols(&["--protocol", "p-net"]), (vec![all[0].clone()], [false, true]));

    // The number of a packet has its old name too, in P-NET alone.
    let objects = objects(&capture, &[]);
    assert_eq!((&objects[0]["packet"], &objects[0]["frame"]), (&json!(1), &json!(1)));
    assert_eq!(objects[1].get("packet"), None);
    // The text has the summary of each.
    let text = shown(&capture, &[]);
    assert!(text.contains("\nPROFINET frames: RT 1, DCP 1, ") && text.contains("\nDatagrams: 1, "));
}

#[test]
fn a_tree_has_all_that_json_has() {
    let tree = shown(&at([(0, &cyclic(64, 0x35)[..])]), &["-v"]);
    let tree: Vec<_> = tree.split("\n\n").next().unwrap().lines().skip(1).collect();
    let zeros = "0".repeat(80);
    assert_eq!(
        tree,
        [
            "    frame id: 32769",
            "    frame id name: RT class 1",
            "    cycle counter: 64",
            "    data status:",
            "        value: 53",
            "        primary: yes",
            "        redundancy: no",
            "        data valid: yes",
            "        provider running: yes",
            "        station ok: yes",
            "        ignore: no",
            "    transfer status: 0",
            "    data length: 40",
            &format!("    data: {zeros}"),
            "    submodules: none",
        ]
    );
}

/// The Connect is of these two stations, with alarms from end 1 in the controller to end 5 in the device.
#[test]
fn the_summary_is_by_ar_where_the_capture_has_the_connect() {
    let (controller, device, stranger) =
        ([2, 0, 0, 0, 0, 1], [2, 0, 0, 0, 0, 2], [2, 0, 0, 0, 0, 3]);
    let between = |from: [u8; 6], to: [u8; 6], ether_type: u16, behind: &[u8]| {
        [&to[..], &from, &ether_type.to_be_bytes(), behind].concat()
    };
    let rt = |from, to, id: u16, counter| {
        let behind = [&id.to_be_bytes()[..], &[0; 40], &[0, counter, 0x35, 0]].concat();
        between(from, to, 0x8892, &behind)
    };
    let alarm = [0xFE, 0x01, 0, 1, 0, 5, 0x11, 0x11, 0, 0, 0xFF, 0xFF, 0, 0];
    let [asked, answered] = connect();
    let capture = at([
        (0, &rt(stranger, controller, 0x8001, 0)[..]),
        (1, &between(controller, device, asked.0, &asked.1)),
        (2, &between(device, controller, answered.0, &answered.1)),
        (1_000, &rt(device, controller, 0x8001, 32)),
        (1_100, &rt(controller, device, 0x8005, 32)),
        (2_000, &rt(device, controller, 0x8001, 64)),
        (3_000, &between(device, controller, 0x8892, &alarm)),
    ]);
    let summary = objects(&capture, &[]).pop().unwrap();
    let summary = &summary["profinet_summary"];
    let [ar] = &summary["ars"].as_array().unwrap()[..] else { panic!("{summary}") };
    let sums = ["streams", "frames", "gaps", "data_status_changes", "alarms", "aborts"];
    assert_eq!(sums.map(|name| ar[name].as_u64().unwrap()), [3, 4, 0, 0, 1, 0]);
    let ars: Vec<_> =
        summary["streams"].as_array().unwrap().iter().map(|stream| &stream["ar"]).collect();
    assert_eq!(ars, [&ar["ar"], &ar["ar"], &ar["ar"], &Value::Null]);

    let text = shown(&capture, &[]);
    let first: Vec<_> =
        text.lines().filter_map(|line| line.split(" | ").next()?.strip_prefix("| ")).collect();
    let digits = &ar["ar"].as_str().unwrap()[..8];
    assert_eq!(first, ["AR      ", digits, digits, digits, "–       "]);
}

/// A Linux cooked capture has no receiver.
#[test]
fn a_cooked_capture_has_the_sender_alone() {
    let payload = &cyclic(64, 0x35)[18..];
    let cooked = [&[0, 0, 0, 1, 0, 6][..], &DEVICE, &[0, 0, 0x88, 0x92], payload].concat();
    let mut capture = at([(0, &cooked[..])]);
    capture[20] = 113;
    let object = &objects(&capture, &[])[0];
    assert_eq!((&object["from"], object.get("to")), (&json!("02:00:00:00:00:01"), None));
    assert_eq!((&object["frame_id"], &object["cycle_counter"]), (&json!(0x8001), &json!(64)));
    assert!(shown(&capture, &[]).contains("Z, 02:00:00:00:00:01: RT class 1 $8001, cycle 64, "));
}

/// Streams without end, damaged anywhere.
#[test]
fn no_capture_of_profinet_brings_it_down_or_takes_all_memory() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("capture.pcap");
    let kinds = [identify(), lldp(), cyclic(0, 0x35)];
    let mut capture = at([]);
    for number in 0..60_000_u32 {
        let mut packet = kinds[number as usize % 3].clone();
        packet[8..12].copy_from_slice(&number.to_be_bytes());
        // Not the Ethertypes.
        if number % 5 == 0 {
            let at = 18 + number as usize % (packet.len() - 18);
            packet[at] ^= (number >> 7) as u8;
        }
        capture.extend(frame(&packet, packet.len() - number as usize % 7));
    }
    fs::write(&file, &capture).unwrap();
    let limited = "ulimit -v 400000 && exec \"$0\" decode \"$1\" --format json";
    let mut command = Command::new("bash");
    command.args(["-c", limited, env!("CARGO_BIN_EXE_pnet-nat")]).arg(&file);
    let mut decode = Process::start(command);
    assert_eq!((decode.end(), &decode.stderr()[..]), (Some(0), ""));
    let stdout = decode.stdout();
    assert_eq!(stdout.lines().count(), 60_001);
    let last: Value = serde_json::from_str(stdout.lines().last().unwrap()).unwrap();
    let summary = &last["profinet_summary"];
    assert!(summary["malformed"].as_u64().unwrap() > 10_000, "{summary}");
    assert_eq!(summary["streams"].as_array().unwrap().len(), 1024);
    assert!(summary["frames_of_other_streams"].as_u64().unwrap() > 10_000);
}
