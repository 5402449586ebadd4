//! `pnet-nat decode`, as it is called; what its parts read is shown beside them.

use std::fs::{self, File};
use std::io::Write;
use std::path::Path;
use std::process::Command;

use nix::sys::stat::Mode;
use nix::unistd::mkfifo;
use serde_json::{Value, json};

use crate::harness::{
    FIGURE_10, PASSWORD, Process, datagram, eventually, frame, header, pcap, pnet_nat, request,
    response, udp,
};

fn decode(file: &Path, arguments: &[&str]) -> Process {
    let file = file.to_str().unwrap();
    Process::start(pnet_nat(&[&["decode", file], arguments].concat()))
}

fn ended(file: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut process = decode(file, arguments);
    (process.end(), process.stdout(), process.stderr())
}

fn hex(octets: &[u8]) -> String {
    octets.iter().map(|octet| format!("{octet:02X} ")).collect()
}

#[test]
fn a_request_as_hex_text_has_all_its_fields_but_the_password() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("datagrams");
    fs::write(&file, format!("# a request\n{}\n", hex(&request(4)))).unwrap();
    let (code, stdout, stderr) = ended(&file, &["--format", "json"]);
    assert_eq!((code, &stderr[..]), (Some(0), ""));
    let right = json!({
        "line": 2, "length": 25, "header": "02000000", "route": "0b040502218b839f",
        "route_format": "ip", "remaining_route_length": 5,
        "destinations": [11, 4, 2, 33], "sources": [11, 3, 31],
        "ip_net_id": 11, "node_address": 4, "source_ip_net_id": 11, "source_node_address": 3,
        "dlpdu_type": "confirmed", "control_status": 12, "data_field_format": 3,
        "data_field_flags": 0, "data_size": 3, "data": "112204", "password": "present",
    });
    assert_eq!(serde_json::from_str::<Value>(&stdout).unwrap(), right);

    let (_, text, _) = ended(&file, &["--header", "02000001"]);
    assert_eq!(text, "line 2: malformed at octet 3 of 25: the header is not the expected one\n");
}

#[test]
fn a_capture_is_searched_on_the_ports_of_p_net_and_those_that_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("capture.pcap");
    let (question, answer) = (request(4), response(4));
    let ports = [(34379, &question[..]), (40004, &question), (40125, &answer), (53, b"query")];
    fs::write(&file, pcap(ports)).unwrap();

    let numbers = |arguments: &[&str]| {
        let (code, stdout, stderr) = ended(&file, &[&["--format", "json"], arguments].concat());
        assert_eq!((code, &stderr[..]), (Some(0), ""));
        let lines = stdout.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        lines.map(|line| line["packet"].as_u64().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(numbers(&[]), [1]);
    assert_eq!(numbers(&["--ports", "40001-40100"]), [1, 2]);
    assert_eq!(numbers(&["--ports", "53,40001-40125"]), [1, 2, 3, 4]);
    // That of the sender counts as well.
    assert_eq!(numbers(&["--ports", "50000"]), [1, 2, 3, 4]);

    let (_, text, _) = ended(&file, &[]);
    assert_eq!(
        text,
        "packet 1, 2026-09-21T14:13:20.000007Z, 198.51.100.20:50000 > 203.0.113.5:34379: \
         confirmed; ip route to net 11 node 4, on to 2.33, from net 11 node 3, on to 31; \
         control-status $0C, data-field-format $03, data 112204, password present\n"
    );
}

/// A capture on the router itself shows bursts that the kernel cuts later (UDP_SEGMENT).
#[test]
fn a_payload_that_is_a_row_of_datagrams_is_shown_datagram_by_datagram() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("capture.pcap");
    // 11 of 38 octets, the last of them shorter.
    let one = |node, data: &[u8]| datagram(&[0x0B, node, 0x8B, 0x83], data, PASSWORD);
    let mut row: Vec<_> = (1..=11).map(|node| one(node, &[node; 20])).collect();
    row[10] = one(11, b"abc");
    let mut broken = row.clone();
    broken[2][3] = 1;
    let (row, broken) = (row.concat(), broken.concat());
    assert_eq!(row.len(), 10 * 38 + 21);
    fs::write(&file, pcap([(34379, &row[..]), (34379, &broken), (34379, &request(4))])).unwrap();

    let (code, json, stderr) = ended(&file, &["--format", "json"]);
    assert_eq!((code, &stderr[..]), (Some(0), ""));
    let lines: Vec<Value> = json.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 13);
    for (line, number) in lines.iter().zip(1..=11) {
        let (packet, time) = (&line["packet"], &line["time"]);
        assert_eq!((packet, time), (&json!(1), &json!("2026-09-21T14:13:20.000007Z")));
        assert_eq!((&line["datagram"], &line["datagrams"]), (&json!(number), &json!(11)));
        assert_eq!(line["length"], if number == 11 { 21 } else { 38 });
        assert_eq!((&line["node_address"], &line["password"]), (&json!(number), &json!("present")));
    }
    let error = "a datagram has at most 107 octets";
    assert_eq!((&lines[11]["error"], &lines[11]["length"]), (&json!(error), &json!(401)));
    for alone in &lines[11..] {
        assert_eq!((alone.get("datagram"), alone.get("datagrams")), (None, None));
    }

    let (_, text, _) = ended(&file, &[]);
    let last = "packet 1, 2026-09-21T14:13:20.000007Z, 198.51.100.20:50000 > 203.0.113.5:34379: \
                11 of 11: confirmed; extended route to net 11 node 11, from net 11 node 3; \
                control-status $0C, data-field-format $03, data 616263, password present";
    assert_eq!(text.lines().nth(10), Some(last));
    let password: String = PASSWORD.iter().map(|octet| format!("{octet:02x}")).collect();
    for shown in [text, json] {
        assert!(!shown.contains("s3cr3t") && !shown.contains(&password), "{shown}");
    }
}

#[test]
fn datagrams_are_shown_as_they_come() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    mkfifo(&pipe, Mode::S_IRWXU).unwrap();
    let mut decode = decode(&pipe, &[]);
    let mut writer = File::create(&pipe).unwrap();
    writer.write_all(&header()).unwrap();
    for shown in 1..=3 {
        let packet = udp(34379, &request(shown));
        writer.write_all(&frame(&packet, packet.len())).unwrap();
        eventually("the datagram is shown", || {
            (decode.stdout().lines().count() == usize::from(shown)).then_some(())
        });
    }
    drop(writer);
    assert_eq!(decode.end(), Some(0));
}

#[test]
fn a_reader_who_has_seen_enough_is_no_fault() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("datagrams");
    // More than a pipe holds.
    fs::write(&file, format!("{}\n", hex(&request(4))).repeat(2000)).unwrap();
    let mut command = Command::new("bash");
    let pipeline = r#"set -o pipefail; "$0" decode "$1" | head --lines 1"#;
    command.args(["-c", pipeline, env!("CARGO_BIN_EXE_pnet-nat")]).arg(&file);
    let mut pipeline = Process::start(command);
    assert_eq!((pipeline.end(), &pipeline.stderr()[..]), (Some(0), ""));
    assert_eq!(pipeline.stdout().lines().count(), 1);
}

#[test]
fn the_page_shows_what_is_printed() {
    let page = include_str!("../../docs/troubleshooting.md");
    let (_, section) = page.split_once("## Looking at datagrams").unwrap();
    let command = section.lines().find(|line| line.starts_with("echo ")).unwrap();
    let (_, printed) = section.split_once("```text\n").unwrap();
    let mut shell = Command::new("bash");
    let binary = Path::new(env!("CARGO_BIN_EXE_pnet-nat")).parent().unwrap();
    let path = format!("{}:{}", binary.display(), std::env::var("PATH").unwrap());
    let mut shell = Process::start({
        shell.args(["-c", command]).env("PATH", path);
        shell
    });
    assert_eq!((shell.end(), &shell.stderr()[..]), (Some(0), ""));
    assert_eq!(shell.stdout(), printed.split("```").next().unwrap());
}

#[test]
fn what_cannot_be_read_to_its_end_is_said_with_exit_code_1() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("input");
    let with = |octets: &[u8]| {
        fs::write(&file, octets).unwrap();
        ended(&file, &[])
    };
    let whole = pcap([(34379, &request(4)[..]), (34379, &request(5))]);
    let (code, stdout, stderr) = with(&whole[..whole.len() - 1]);
    assert_eq!((code, stdout.lines().count()), (Some(1), 1), "{stderr}");
    assert!(stderr.contains("input: the capture ends inside a block"), "{stderr}");

    let (code, stdout, stderr) = with(PASSWORD);
    assert_eq!((code, &stdout[..]), (Some(1), ""));
    assert!(stderr.contains("line 1 is not hex text") && !stderr.contains("s3cr3t"), "{stderr}");

    let (code, _, stderr) = ended(&folder.path().join("absent"), &[]);
    assert_eq!(code, Some(1));
    assert!(stderr.contains("absent: No such file"), "{stderr}");
    assert_eq!(ended(&file, &["--ports", "2-1"]).0, Some(2));
}

#[test]
fn nothing_found_is_not_left_without_a_word() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("capture.pcap");
    fs::write(&file, pcap([(40004, &request(4)[..])])).unwrap();
    let (code, stdout, stderr) = ended(&file, &[]);
    assert_eq!((code, &stdout[..]), (Some(0), ""));
    assert!(stderr.contains("--ports"), "{stderr}");

    let mut usb = pcap([(34379, &datagram(&FIGURE_10, b"", b"")[..])]);
    usb[20] = 220;
    fs::write(&file, usb).unwrap();
    assert!(ended(&file, &[]).2.contains("link type 220"));
}
