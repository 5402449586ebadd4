//! `pnet-nat decode` beside tshark on frames of PROFINET: `tests/profinet/judge.py` compares them field by
//! field, on frames made here, and on real captures where `PNET_NAT_CAPTURES` names a folder of them.

pub(crate) mod rpc;

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use crate::harness::{Process, frame, header, left_out, pnet_nat};

const JUDGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/profinet/judge.py");
const FROM: [u8; 6] = [2, 0, 0, 0, 0, 9];
const OTHER: [u8; 6] = [2, 0, 0, 0, 0, 8];

/// False, and says so, where there is no tshark.
fn has_tshark() -> bool {
    let is_there = Command::new("tshark").arg("--version").output().is_ok();
    if !is_there {
        left_out("tshark");
    }
    is_there
}

/// The exit code of the judge, and what it says.
fn judged(program: &str, captures: &[&Path]) -> (Option<i32>, String) {
    let mut command = Command::new("python3");
    let mut judge = Process::start({
        command.arg(JUDGE).arg(program).args(captures);
        command
    });
    let code = judge.end();
    (code, judge.stdout() + &judge.stderr())
}

/// An Ethernet frame; every second one has a VLAN tag.
fn ethernet(number: usize, ether_type: u16, payload: &[u8]) -> Vec<u8> {
    let tag: &[u8] = if number.is_multiple_of(2) { &[0x81, 0, 0xC0, 5] } else { &[] };
    let to = [1, 0x0E, 0xCF, 0, 0, 0];
    [&to, &FROM, tag, &ether_type.to_be_bytes(), payload].concat()
}

fn capture(frames: &[(u16, Vec<u8>)]) -> Vec<u8> {
    let mut file = header();
    file[20..24].copy_from_slice(&1_u32.to_le_bytes());
    for (number, (ether_type, payload)) in frames.iter().enumerate() {
        let packet = ethernet(number, *ether_type, payload);
        file.extend(frame(&packet, packet.len()));
    }
    file
}

/// Cyclic data of each class, with every bit of the data status.
fn cyclic() -> Vec<(u16, Vec<u8>)> {
    let ids = [0x0100, 0x0700, 0x8000, 0x8001, 0xBBF0, 0xBC00, 0xC000, 0xF7FF];
    let with = |id: u16, data_status: u8| {
        (0x8892, [&id.to_be_bytes()[..], &[0; 40], &[0x12, 0x34, data_status, 0]].concat())
    };
    let bits = (0..8).map(|bit| with(0x8000, 1 << bit));
    ids.map(|id| with(id, 0x35)).into_iter().chain(bits).collect()
}

/// Frame ID, service and type, a number, and these blocks, with padding behind.
fn dcp(frame_id: u16, service_id: u8, service_type: u8, blocks: &[&[u8]]) -> (u16, Vec<u8>) {
    let blocks = blocks.concat();
    let delay = if frame_id == 0xFEFE { 128 } else { 0 };
    let head = [service_id, service_type, 1, 2, 3, 4, 0, delay];
    let length = (blocks.len() as u16).to_be_bytes();
    let payload = [&frame_id.to_be_bytes()[..], &head, &length, &blocks, &[0; 26]].concat();
    (0x8892, payload)
}

fn all_dcp() -> Vec<(u16, Vec<u8>)> {
    const IP: [u8; 12] = [192, 168, 0, 5, 255, 255, 255, 0, 192, 168, 0, 1];
    let info = |option: u8, suboption: u8, info: u8, contents: &[u8]| {
        let length = contents.len() as u8 + 2;
        let mut block = [&[option, suboption, 0, length, 0, info][..], contents].concat();
        block.resize(block.len().next_multiple_of(2), 0);
        block
    };
    let servers = [&IP[..], &[10, 0, 0, 1, 10, 0, 0, 2, 10, 0, 0, 3, 10, 0, 0, 4]].concat();
    let all = [
        info(1, 2, 0x81, &IP),
        info(2, 1, 0, b"type of it"),
        info(2, 2, 0, b"plc-1.line"),
        info(2, 3, 0, &[0, 0x2A, 3, 0x13]),
        info(2, 4, 0, &[3, 0]),
        info(2, 5, 0, &[1, 2, 2, 2, 5, 3]),
        info(2, 7, 0, &[1, 2]),
        info(2, 8, 0, &[1, 0x2A, 4, 0x13]),
        info(6, 1, 0, &[0, 1]),
    ];
    let all: Vec<_> = all.iter().map(|block| &block[..]).collect();
    let permanent = info(2, 2, 1, b"plc");
    vec![
        dcp(0xFEFE, 5, 0, &[&[2, 2, 0, 3], b"plc\0", &[2, 6, 0, 10], b"port-001.b"]),
        dcp(0xFEFE, 5, 0, &[&[255, 255, 0, 0]]),
        dcp(0xFEFF, 5, 1, &all),
        dcp(0xFEFC, 6, 0, &[&info(2, 2, 0, b"plc"), &info(1, 2, 1, &IP), &info(6, 1, 0, &[0, 1])]),
        dcp(0xFEFD, 3, 0, &[&[2, 2, 1, 2, 1, 1]]),
        dcp(0xFEFD, 3, 1, &[&info(1, 1, 0, &FROM), &info(1, 3, 1, &servers)]),
        dcp(0xFEFD, 4, 0, &[&permanent, &info(1, 2, 0, &IP), &[5, 3, 0, 4, 0, 0, 1, 0]]),
        dcp(0xFEFD, 4, 0, &[&[5, 1, 0, 2, 0, 0, 5, 6, 0, 2, 0, 4, 5, 2, 0, 2, 0, 0]]),
        dcp(0xFEFD, 4, 1, &[&[5, 4, 0, 3, 2, 2, 6, 0, 5, 4, 0, 3, 1, 2, 0, 0]]),
        dcp(0xFEFD, 4, 5, &[]),
    ]
}

/// An acknowledgement and an end: DATA has blocks, which are another matter.
fn alarms() -> Vec<(u16, Vec<u8>)> {
    let alarm = |frame_id: u16, kind: u8, contents: &[u8]| {
        let header = [0, 1, 0x80, 2, kind, 0x11, 0, 5, 0xFF, 0xFE, 0, contents.len() as u8];
        (0x8892, [&frame_id.to_be_bytes()[..], &header, contents, &[0; 28]].concat())
    };
    let status = [0xCF, 0x81, 0xFD, 5];
    vec![
        alarm(0xFC01, 0x13, &[]),
        alarm(0xFE01, 0x23, &[]),
        alarm(0xFE01, 0x12, &[]),
        alarm(0xFE01, 0x14, &status),
    ]
}

/// A TLV with seven bits of type and nine of length.
fn tlv(kind: u8, contents: &[&[u8]]) -> Vec<u8> {
    let contents = contents.concat();
    let head = u16::from(kind) << 9 | contents.len() as u16;
    [&head.to_be_bytes()[..], &contents].concat()
}

fn lldp() -> Vec<(u16, Vec<u8>)> {
    const PNO: [u8; 3] = [0x00, 0x0E, 0xCF];
    const IEEE: [u8; 3] = [0x00, 0x12, 0x0F];
    let named = [
        tlv(1, &[b"\x07plc"]),
        tlv(2, &[b"\x07port-001"]),
        tlv(3, &[&[0, 20]]),
        tlv(4, &[b"a port"]),
        tlv(5, &[b"a system"]),
        tlv(6, &[b"a description"]),
        tlv(7, &[&[0, 0x94, 0, 0x80]]),
        tlv(8, &[&[5, 1, 192, 168, 0, 5, 2, 0, 0, 0, 7, 2, 0x2B, 6]]),
        tlv(127, &[&PNO, &[1], &[0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0, 4, 0, 0, 0, 5]]),
        tlv(127, &[&PNO, &[2, 0, 2, 0, 4]]),
        tlv(127, &[&PNO, &[4], &[0xFF; 16], &[0, 1]]),
        tlv(127, &[&PNO, &[5], &FROM]),
        tlv(
            127,
            &[&PNO, &[6], &OTHER, &[1; 16], &[2; 16], &[0x80, 0, 0, 9], &[0x80, 0, 0, 8], &[7; 8]],
        ),
        tlv(127, &[&IEEE, &[1, 3, 0xEC, 0x03, 0, 0x1E]]),
        tlv(127, &[&IEEE, &[4, 5, 0xEE]]),
        tlv(127, &[&[0x00, 0x80, 0xC2], &[1, 0, 7]]),
        tlv(0, &[]),
    ];
    let by_address =
        [tlv(1, &[&[4], &FROM]), tlv(2, &[&[3], &OTHER]), tlv(3, &[&[0, 120]]), tlv(0, &[])];
    vec![(0x88CC, named.concat()), (0x88CC, by_address.concat())]
}

fn mrp() -> Vec<(u16, Vec<u8>)> {
    let part = |kind: u8, contents: &[&[u8]]| {
        let contents = contents.concat();
        [&[kind, contents.len() as u8][..], &contents].concat()
    };
    let common = part(1, &[&[0, 7], &[0xFF; 16]]);
    // TLVs are padded to a multiple of four.
    let with = |mut tlv: Vec<u8>| {
        tlv.resize(tlv.len().next_multiple_of(4), 0);
        (0x88E3, [&[0, 1][..], &tlv, &common, &[0; 20]].concat())
    };
    let test = part(2, &[&[0x80, 0], &FROM, &[0, 1, 0, 1, 0, 3, 0, 0, 1, 0]]);
    let change = part(3, &[&[0x80, 0], &FROM, &[0, 20]]);
    let link = |kind| part(kind, &[&FROM, &[0, 1, 0, 20, 0, 1]]);
    let ends = [&[0x80, 0][..], &FROM, &[0xF0, 0], &OTHER].concat();
    let option = |kind: u8, ends: &[u8]| {
        let sub = part(kind, &[ends]);
        part(0x7F, &[&[8, 0, 6, 0, 0, 0], &sub])
    };
    // What tshark 4.0 knows by type alone.
    let in_test = part(6, &[&[0, 9], &FROM, &[0, 1, 0, 1, 0, 3, 0, 0, 1, 0]]);
    let in_change = part(7, &[&FROM, &[0, 9, 0, 20]]);
    let in_link = |kind| part(kind, &[&FROM, &[0, 1, 0, 9, 0, 20]]);
    let poll = part(10, &[&FROM, &[0, 1, 0, 9]]);
    let first = [test, change, link(4), link(5), in_test, in_change, poll];
    let options = [option(1, &ends), option(2, &ends), option(3, &[])];
    // tshark does not look for padding behind a TLV that it does not know, so these stand last.
    let last = [in_link(8), in_link(9)]
        .map(|tlv| (0x88E3, [&[0, 1][..], &common, &tlv, &[0; 20]].concat()));
    first.into_iter().chain(options).map(with).chain(last).collect()
}

fn ptcp() -> Vec<(u16, Vec<u8>)> {
    let domain = tlv(1, &[&OTHER, &[0xAB; 16]]);
    let time = tlv(2, &[&[0, 1, 0, 0, 0, 2, 0, 0, 0, 3]]);
    let extension = tlv(3, &[&[0, 1, 0, 37]]);
    let master = tlv(4, &[&[0x89, 255, 255, 0x21, 0xFF, 0xFE]]);
    let port = tlv(6, &[&FROM]);
    let delays = tlv(5, &[&[0, 0, 0, 0, 0, 11, 0, 0, 0, 12]]);
    let port_time = tlv(7, &[&[0, 0, 0, 0, 0, 13]]);
    let end = tlv(0, &[]);
    let with = |frame_id: u16, tlvs: &[&Vec<u8>]| {
        let head = [&frame_id.to_be_bytes()[..], &[0; 12], &[0, 7, 0, 0], &[0, 0, 0, 42]].concat();
        let tlvs: Vec<u8> = tlvs.iter().flat_map(|tlv| (*tlv).clone()).collect();
        (0x8892, [head, tlvs, vec![0; 20]].concat())
    };
    let sync = |frame_id: u16| {
        let head = [&frame_id.to_be_bytes()[..], &[0; 8], &[0, 0, 0, 7, 0, 5, 3, 0, 0, 0, 0, 73]];
        (0x8892, [head.concat(), domain.clone(), time.clone(), end.clone(), vec![0; 20]].concat())
    };
    vec![
        sync(0x0020),
        sync(0x0080),
        with(0xFF00, &[&domain, &master, &end]),
        with(0xFF20, &[&domain, &time, &extension, &end]),
        with(0xFF40, &[&port, &end]),
        with(0xFF41, &[&port, &delays, &port_time, &end]),
        with(0xFF42, &[&port, &end]),
        with(0xFF43, &[&port, &delays, &port_time, &end]),
    ]
}

#[test]
fn datagrams_of_every_kind_are_read_as_tshark_reads_them() {
    if !has_tshark() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("datagrams.pcap");
    let frames = [
        rpc::packet_types(),
        rpc::without_connection(),
        rpc::connection(),
        rpc::records(),
        rpc::fragments(),
        rpc::alarms(),
    ]
    .concat();
    fs::write(&file, capture(&frames)).unwrap();
    let (code, said) = judged(env!("CARGO_BIN_EXE_pnet-nat"), &[&file]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains(&format!(": {} frames in both, ", frames.len())), "{said}");
}

#[test]
fn frames_of_every_kind_are_read_as_tshark_reads_them() {
    if !has_tshark() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("frames.pcap");
    let frames = [cyclic(), all_dcp(), alarms(), lldp(), mrp(), ptcp()].concat();
    fs::write(&file, capture(&frames)).unwrap();
    let (code, said) = judged(env!("CARGO_BIN_EXE_pnet-nat"), &[&file]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains(&format!(": {} frames in both, ", frames.len())), "{said}");
}

/// With a Connect in front, cyclic data is cut where tshark cuts it.
#[test]
fn submodules_are_those_of_the_connect() {
    let (controller, device) = ([2, 0, 0, 0, 0, 1], [2, 0, 0, 0, 0, 2]);
    let [asked, answered] = rpc::connect();
    let cyclic = |frame_id: u16, data: &[u8]| {
        let mut payload = [&frame_id.to_be_bytes()[..], data].concat();
        payload.resize(42, 0);
        (0x8892, [&payload[..], &[0, 64, 0x35, 0]].concat())
    };
    let inputs = cyclic(0x8001, &[0x80, 0x11, 0x22, 0x33, 0x80, 0x80]);
    let outputs = cyclic(0x8005, &[0xAA, 0xBB, 0x80, 0x80, 0x20]);
    let mut file = capture(&[]);
    for ((ether_type, payload), from, to) in [
        (asked, controller, device),
        (answered, device, controller),
        (inputs, device, controller),
        (outputs, controller, device),
    ] {
        let packet = [&to[..], &from, &ether_type.to_be_bytes(), &payload].concat();
        file.extend(frame(&packet, packet.len()));
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("connect.pcap");
    fs::write(&path, file).unwrap();

    // The Connect teaches, though it is not shown.
    let shown = |more: &[&str]| {
        let arguments = ["decode", path.to_str().unwrap(), "--protocol", "profinet-rt"];
        let mut decode = Process::start(pnet_nat(&[&arguments, more].concat()));
        assert_eq!(decode.end(), Some(0), "{}", decode.stderr());
        decode.stdout()
    };
    let json = shown(&["--format", "json"]);
    let lines = json.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let parts = |line: Value| {
        let parts = line["submodules"].as_array().unwrap().clone();
        parts.into_iter().map(|part| json!([part["data"], part["status"]])).collect::<Vec<_>>()
    };
    let inputs = [json!(["", 128]), json!(["112233", 128]), json!([null, 128])];
    let outputs = [json!(["aabb", 128]), json!([null, 128]), json!([null, 32])];
    assert_eq!(lines.take(2).map(parts).collect::<Vec<_>>(), [inputs, outputs]);
    let text = shown(&[]);
    assert!(text.contains(", 40 octets of 3 parts, 0 bad\n"), "{text}");
    assert!(text.contains(", 40 octets of 3 parts, 1 bad\n"), "{text}");

    if has_tshark() {
        let (code, said) = judged(env!("CARGO_BIN_EXE_pnet-nat"), &[&path]);
        assert_eq!(code, Some(0), "{said}");
        let doctored = doctored(folder.path(), "s/\"status\":32/\"status\":0/");
        let (code, said) = judged(&doctored, &[&path]);
        assert_eq!(code, Some(1), "{said}");
        assert!(said.contains("pn_io.ioxs: decode has [128, 128, 0]"), "{said}");
    }
}

/// A program that decodes, and changes what it says with sed.
fn doctored(folder: &Path, change: &str) -> String {
    let program = folder.join("decode");
    let binary = env!("CARGO_BIN_EXE_pnet-nat");
    fs::write(&program, format!("#!/bin/sh\n{binary} \"$@\" | sed '{change}'\n")).unwrap();
    fs::set_permissions(&program, Permissions::from_mode(0o755)).unwrap();
    program.to_str().unwrap().to_owned()
}

/// A judge who finds nothing wrong may be blind.
#[test]
fn a_field_that_differs_is_found() {
    if !has_tshark() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("frames.pcap");
    let frames = [cyclic(), lldp(), rpc::connection()].concat();
    fs::write(&file, capture(&frames)).unwrap();
    let doctored = |change| judged(&doctored(folder.path(), change), &[&file]);
    assert_eq!(doctored("").0, Some(0));
    for (change, said) in [
        (
            "s/\"cycle_counter\":4660/\"cycle_counter\":4661/",
            "pn_rt.cycle_counter: decode has [4661]",
        ),
        ("s/\"mau_type\":30/\"mau_type\":16/", "lldp.ieee.802_3.pmd_mau_type"),
        ("s/\"iocr_reference\":1/\"iocr_reference\":3/", "pn_io.iocr_reference: decode has [3]"),
        ("s/\"sequence\":4/\"sequence\":5/", "dcerpc.dg_seqnum: decode has [5], tshark has [4]"),
        ("s/\"protocol\":\"lldp\"/\"protocol\":\"mrp\"/", "decode has mrp, tshark has lldp"),
        ("/\"protocol\":\"lldp\"/d", "decode has None, tshark has lldp"),
    ] {
        let (code, problems) = doctored(change);
        assert_eq!(code, Some(1), "{change}: {problems}");
        assert!(problems.contains(said), "{change}: {problems}");
    }
}

#[test]
fn real_captures_are_read_as_tshark_reads_them() {
    let Some(folder) = std::env::var_os("PNET_NAT_CAPTURES") else {
        println!("left out: PNET_NAT_CAPTURES names no folder with captures");
        return;
    };
    if !has_tshark() {
        return;
    }
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let is_capture =
        |path: &Path| path.extension().is_some_and(|it| it == "pcap" || it == "pcapng");
    let captures: Vec<_> = entries.filter(|path| is_capture(path)).collect();
    assert!(!captures.is_empty(), "no capture in that folder");
    for capture in &captures {
        let (code, said) = judged(env!("CARGO_BIN_EXE_pnet-nat"), &[capture]);
        assert_eq!(code, Some(0), "{said}");
    }
}
