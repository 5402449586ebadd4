//! `pnet-nat decode`, as it is called; what its parts read is shown beside them.

use std::fs::{self, File, Permissions};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use nix::sys::stat::Mode;
use nix::unistd::mkfifo;
use serde_json::{Value, json};

use crate::harness::{
    FIGURE_10, PASSWORD, Process, Terminal, datagram, eventually, frame, header, pcap, pnet_nat,
    request, response, udp,
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
        "line": 2, "protocol": "p-net", "length": 25, "header": "02000000", "route": "0b040502218b839f",
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
    let ports = [(34379, &question[..]), (20004, &question), (20125, &answer), (53, b"query")];
    fs::write(&file, pcap(ports)).unwrap();

    let numbers = |arguments: &[&str]| {
        let (code, stdout, stderr) = ended(&file, &[&["--format", "json"], arguments].concat());
        assert_eq!((code, &stderr[..]), (Some(0), ""));
        let lines = stdout.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        lines.filter_map(|line| line["packet"].as_u64()).collect::<Vec<_>>()
    };
    assert_eq!(numbers(&[]), [1]);
    assert_eq!(numbers(&["--ports", "20001-20100"]), [1, 2]);
    assert_eq!(numbers(&["--ports", "53,20001-20125"]), [1, 2, 3, 4]);
    // That of the sender counts as well.
    assert_eq!(numbers(&["--ports", "50000"]), [1, 2, 3, 4]);

    let (_, text, _) = ended(&file, &[]);
    assert_eq!(
        text.lines().next().unwrap().to_owned() + "\n",
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
    let mut lines: Vec<Value> =
        json.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    lines.retain(|line| line.get("packet").is_some());
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
fn the_page_shows_a_capture_as_it_is_printed() {
    let page = include_str!("../../docs/troubleshooting.md");
    let (_, section) = page.split_once("### Captures").unwrap();
    let (_, printed) = section.split_once("```text\n").unwrap();
    let [answered, silent] = [4, 5].map(|node| udp(20000 + u16::from(node), &request(node)));
    let answer = back(&answered, &response(4));
    let capture = at([(0, &answered[..]), (1_234, &answer), (500_000, &silent)]);
    let (text, _) = shown(&capture, &["--ports", "20001-20125"]);
    assert_eq!(text, printed.split("```").next().unwrap());
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
    assert_eq!(code, Some(1), "{stderr}");
    // What there was is still told.
    assert!(stdout.contains("\nDatagrams: 1, malformed: 0. Requests: 1, "), "{stdout}");
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
    fs::write(&file, pcap([(20004, &request(4)[..])])).unwrap();
    let (code, stdout, stderr) = ended(&file, &[]);
    assert_eq!((code, &stdout[..]), (Some(0), ""));
    assert!(stderr.contains("--ports"), "{stderr}");

    let mut usb = pcap([(34379, &datagram(&FIGURE_10, b"", b"")[..])]);
    usb[20] = 220;
    fs::write(&file, usb).unwrap();
    assert!(ended(&file, &[]).2.contains("link type 220"));
}

/// A capture of raw IP packets at these microseconds after a whole second.
fn at<'a>(packets: impl IntoIterator<Item = (u32, &'a [u8])>) -> Vec<u8> {
    packets.into_iter().fold(header(), |file, (micros, packet)| {
        let mut frame = frame(packet, packet.len());
        let time = [1_790_000_000 + micros / 1_000_000, micros % 1_000_000].map(u32::to_le_bytes);
        frame[..8].copy_from_slice(time.as_flattened());
        [file, frame].concat()
    })
}

/// The packet of an answer: from where the request went, back to where it came from.
fn back(request: &[u8], payload: &[u8]) -> Vec<u8> {
    let from = u16::from_be_bytes([request[22], request[23]]);
    let mut packet = udp(0, payload);
    packet[12..16].copy_from_slice(&request[16..20]);
    packet[16..20].copy_from_slice(&request[12..16]);
    packet[20..22].copy_from_slice(&from.to_be_bytes());
    packet[22..24].copy_from_slice(&request[20..22]);
    packet
}

/// What a capture shows, as text and as JSON.
fn shown(capture: &[u8], arguments: &[&str]) -> (String, Vec<Value>) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("capture.pcap");
    fs::write(&file, capture).unwrap();
    let of = |format| {
        let (code, stdout, stderr) = ended(&file, &[arguments, &["--format", format]].concat());
        assert_eq!((code, &stderr[..]), (Some(0), ""));
        stdout
    };
    let json = of("json").lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    (of("text"), json)
}

#[test]
fn answers_show_their_request_and_unanswered_requests_are_marked() {
    let asked: Vec<_> = (4..=7).map(|node| udp(20000 + u16::from(node), &request(node))).collect();
    let mut other_port = back(&asked[2], &response(6));
    other_port[20..22].copy_from_slice(&55_555_u16.to_be_bytes());
    let capture = at([
        (0, &asked[0][..]),
        (1_000, &asked[1]),
        (1_234, &back(&asked[0], &response(4))),
        (2_000, &asked[2]),
        (3_500, &other_port),
        (4_000, &back(&asked[3], &response(7))),
        (10_001_500, &asked[3]),
    ]);
    let (text, json) = shown(&capture, &["--ports", "20001-20125"]);
    let found: Vec<_> =
        text.lines().map(|line| line.split_once("Z, ").map_or(line, |it| it.1)).collect();
    let client = "198.51.100.20:50000";
    assert!(found[2].starts_with("203.0.113.5:20004 > 198.51.100.20:50000: unconfirmed; "));
    assert!(found[2].ends_with(", password present; answer to packet 1, +1.234 ms"), "{text}");
    assert!(found[4].starts_with("203.0.113.5:55555 > "), "{text}");
    let other = "; answer to packet 4 from another port than 20006, +1.500 ms";
    assert!(found[4].ends_with(other), "{text}");
    assert!(found[5].ends_with(", password present"), "{text}");
    // Before the packet that shows how late it is.
    assert_eq!(
        found[6],
        format!(
            "{client} > 203.0.113.5:20005: unanswered request to net 11 node 5, no answer within 10 s"
        )
    );
    assert!(text.lines().nth(6).unwrap().starts_with("packet 2, 2026-09-21T14:13:20.001000Z, "));
    assert!(found[7].starts_with("198.51.100.20:50000 > 203.0.113.5:20007: confirmed; "));
    let at_the_end = "unanswered request to net 11 node 6, the capture ended";
    assert_eq!(found[8], format!("{client} > 203.0.113.5:20006: {at_the_end}"));
    assert_eq!(
        found[11..].join("\n"),
        "\
Datagrams: 7, malformed: 0. Requests: 4, answered: 1, unanswered: 3.

| Server            | Node | Requests | Answers | Unanswered | Median |   99 % | Faults |
|-------------------|------|----------|---------|------------|--------|--------|--------|
| 203.0.113.5:20004 |    4 |        1 |       1 |          0 | 1.2 ms | 1.2 ms |      0 |
| 203.0.113.5:20005 |    5 |        1 |       0 |          1 |      – |      – |      0 |
| 203.0.113.5:20006 |    6 |        1 |       0 |          1 |      – |      – |      1 |
| 203.0.113.5:20007 |    7 |        1 |       0 |          1 |      – |      – |      0 |

Answers from another port than was asked: 1. The relay drops them.
Answers whose request is not in the capture: 1."
    );

    assert_eq!(json.len(), 11);
    assert_eq!(
        (&json[2]["answer_to"], &json[2]["response_time_seconds"]),
        (&json!(1), &json!(0.001234))
    );
    assert_eq!((&json[4]["answer_to"], &json[4]["asked_port"]), (&json!(4), &json!(20006)));
    let unanswered = json!({"unanswered": {
        "packet": 2, "time": "2026-09-21T14:13:20.001000Z", "from": client, "to": "203.0.113.5:20005",
        "ip_net_id": 11, "node_address": 5, "reason": "time",
    }});
    assert_eq!(json[6], unanswered);
    assert_eq!(json[8]["unanswered"]["reason"], "end");
    let summary = &json[10]["summary"];
    let counts = ["datagrams", "requests", "answers", "unanswered", "answers_from_another_port"];
    assert_eq!(counts.map(|name| summary[name].as_u64().unwrap()), [7, 4, 1, 3, 1]);
    assert_eq!(summary["servers"][0]["response_time_median_seconds"], 0.0012);
}

/// Beside the relay, a capture has each exchange twice: with the client, and with the node.
#[test]
fn both_legs_of_a_relay_are_paired_and_named_by_its_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("pnet-nat.toml");
    let secret = folder.path().join("secret");
    fs::write(&secret, PASSWORD).unwrap();
    fs::set_permissions(&secret, Permissions::from_mode(0o600)).unwrap();
    let text = "[public]\nlisten = [\"203.0.113.5\"]\n[protocol]\nheader = \"02000001\"\n\
        [[udp_range_net]]\nname = \"press\"\nstart_port = 20000\nsubnet = \"172.17.17.0\"\n\
        nodes = [\"1-9\"]\nallow = [\"198.51.100.0/24\"]\nserver_port = 4379\n\
        [[udp_range_net.password]]\nname = \"service\"\nfile = \"secret\"\n";
    fs::write(&config, text).unwrap();
    let header = |mut octets: Vec<u8>| {
        octets[3] = 1;
        octets
    };
    let (question, answer) = (header(request(4)), header(response(4)));
    let public = udp(20004, &question);
    let mut plant = udp(4379, &question);
    plant[12..20].copy_from_slice(&[172, 17, 17, 1, 172, 17, 17, 4]);
    let capture = at([
        (0, &public[..]),
        (100, &plant),
        (1_100, &back(&plant, &answer)),
        (1_300, &back(&public, &answer)),
    ]);
    let (text, json) = shown(&capture, &["--config", config.to_str().unwrap()]);
    let answers = json.iter().filter(|line| line.get("packet").is_some());
    let answers: Vec<_> = answers.map(|line| line["answer_to"].as_u64()).collect();
    assert_eq!(answers, [None, None, Some(2), Some(1)]);
    let rows: Vec<_> = text.lines().filter(|line| line.contains("| press")).collect();
    assert_eq!(
        rows,
        [
            "| 172.17.17.4:4379  | press |    4 |        1 |       1 |          0 | 1.0 ms | 1.0 ms |      0 |",
            "| 203.0.113.5:20004 | press |    4 |        1 |       1 |          0 | 1.3 ms | 1.3 ms |      0 |",
        ],
        "{text}"
    );

    fs::write(&config, "[public").unwrap();
    let file = folder.path().join("absent");
    let (code, stdout, stderr) = ended(&file, &["--config", config.to_str().unwrap()]);
    assert_eq!((code, &stdout[..]), (Some(2), ""));
    assert!(stderr.contains("pnet-nat.toml"), "{stderr}");
}

/// The same datagram behind each link layer, and in fragments.
#[test]
fn link_layers_and_fragments_do_not_hide_a_datagram() {
    let packet = udp(34379, &request(4));
    let link = |link: u8, front: &[u8]| {
        let mut capture = at([(0, &[front, &packet].concat()[..])]);
        capture[20..22].copy_from_slice(&[link, if link == 20 { 1 } else { 0 }]);
        capture
    };
    let ethernet = [2; 12];
    let right = shown(&link(101, &[]), &[]);
    assert!(right.0.contains(": confirmed; ip route"), "{}", right.0);
    for (number, front) in [
        (1, [&ethernet[..], &[8, 0]].concat()),
        (1, [&ethernet[..], &[0x81, 0, 0, 7, 8, 0]].concat()),
        (1, [&ethernet[..], &[0x88, 0xA8, 0, 7, 0x81, 0, 0, 9, 8, 0]].concat()),
        (113, [&[0; 14][..], &[8, 0]].concat()),
        // 276, Linux cooked v2.
        (20, [&[8, 0][..], &[0; 18]].concat()),
        (0, vec![2, 0, 0, 0]),
    ] {
        assert_eq!(shown(&link(number, &front), &[]), right, "{number}");
    }

    let fragment = |start: usize, end: usize| {
        let mut part = [&packet[..20], &packet[20 + start..20 + end]].concat();
        let more = if end + 20 < packet.len() { 0x20 } else { 0 };
        let length = part.len() as u16;
        part[2..4].copy_from_slice(&length.to_be_bytes());
        part[4..8].copy_from_slice(&[0x12, 0x34, more, (start / 8) as u8]);
        part
    };
    let all = packet.len() - 20;
    let (text, json) = shown(&at([(0, &fragment(16, all)[..]), (0, &fragment(0, 16))]), &[]);
    assert!(text.contains("of 2 fragments: confirmed; ip route to net 11 node 4"), "{text}");
    assert_eq!((&json[0]["packet"], &json[0]["fragments"]), (&json!(2), &json!(2)));

    let (text, _) = shown(&at([(0, &fragment(0, 16)[..]), (0, &udp(34379, &request(5)))]), &[]);
    let missing = "malformed at octet 8 of 25: some of its fragments are missing\n";
    assert!(text.contains(missing), "{text}");
    let (text, _) = shown(&at([(0, &fragment(16, all)[..]), (0, &udp(34379, &request(5)))]), &[]);
    assert!(
        text.ends_with("Fragments of datagrams whose first fragment is missing: 1.\n"),
        "{text}"
    );
}

#[test]
fn a_tree_has_a_line_for_each_field() {
    let question = udp(34379, &request(4));
    let capture = at([(0, &question[..]), (1_234, &back(&question, &response(4)[..20]))]);
    let (_, without) = shown(&capture, &[]);
    let (text, json) = shown(&capture, &["-v"]);
    assert_eq!(json, without);
    assert_eq!(
        text.split("\n\n").next().unwrap(),
        "\
packet 1, 2026-09-21T14:13:20.000000Z, 198.51.100.20:50000 > 203.0.113.5:34379: confirmed
    length: 25
    header: 02000000
    route: 0b040502218b839f, ip
        remaining route length: 5
        to: net 11 node 4, on to 2.33
        from: net 11 node 3, on to 31
    control-status: $0C
    data-field-format: $03
        flags: $00
        data size: 3
    data: 112204
    password: present
packet 2, 2026-09-21T14:13:20.001234Z, 203.0.113.5:34379 > 198.51.100.20:50000: malformed
    length: 20
    at octet 17: the octets behind the route do not fit the data-field-format
    header: 02000000
    route: 0b03061f8b8482a180, ip
        remaining route length: 6
        to: net 11 node 3, on to 31
        from: net 11 node 4, on to 2.33.0
packet 1, 2026-09-21T14:13:20.000000Z, 198.51.100.20:50000 > 203.0.113.5:34379: \
         unanswered request to net 11 node 4, the capture ended"
    );
}

/// The end of an endless capture, and of a long one.
#[test]
fn a_signal_ends_it_with_the_summary() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    mkfifo(&pipe, Mode::S_IRWXU).unwrap();
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let mut decode = decode(&pipe, &[]);
        let mut writer = File::create(&pipe).unwrap();
        let capture = pcap([(34379, &request(4)[..])]);
        // The next packet has begun.
        writer.write_all(&[&capture[..], &[0; 7]].concat()).unwrap();
        eventually("the datagram is shown", || {
            (decode.stdout().lines().count() == 1).then_some(())
        });
        decode.signal(signal);
        assert_eq!((decode.end(), &decode.stderr()[..]), (Some(0), ""));
        let text = decode.stdout();
        assert!(
            text.contains("Datagrams: 1, malformed: 0. Requests: 1, answered: 0, unanswered: 1.")
        );
        assert!(text.ends_with("\nA signal came before the end of the input.\n"), "{text}");
    }
}

/// Only where the result goes somewhere else.
#[test]
fn a_long_read_shows_on_a_terminal_how_far_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    mkfifo(&pipe, Mode::S_IRWXU).unwrap();
    for (script, shows) in
        [("exec \"$0\" decode \"$1\" > /dev/null", true), ("exec \"$0\" decode \"$1\"", false)]
    {
        let mut command = Command::new("sh");
        command.args(["-c", script, env!("CARGO_BIN_EXE_pnet-nat")]);
        let mut terminal = Terminal::start(command.arg(&pipe));
        let mut writer = File::create(&pipe).unwrap();
        writer.write_all(&header()).unwrap();
        let packet = udp(53, b"");
        let (frame, end) = (frame(&packet, packet.len()), Instant::now() + Duration::from_secs(3));
        eventually("it is shown", || {
            writer.write_all(&frame).unwrap();
            let is_over = Instant::now() > end;
            (terminal.text().contains("MiB/s") || !shows && is_over).then_some(())
        });
        assert_eq!(terminal.text().contains("MiB/s"), shows);
        drop(writer);
        assert_eq!(terminal.end(), Some(0));
        let text = terminal.text();
        let left = text.rsplit("\x1b[K").next().unwrap();
        assert!(left.starts_with("no datagram on these ports"), "{text:?}");
    }
}

/// Rubbish, cut off anywhere, with lengths and fragments that nobody sent.
#[test]
fn no_capture_brings_it_down_or_takes_all_memory() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("capture.pcap");
    let question = udp(34379, &request(4));
    let mut capture = header();
    for number in 0..60_000_u32 {
        let mut packet = question.clone();
        // Each has ends of its own, and every second one is the first fragment of a datagram.
        packet[12..16].copy_from_slice(&(0x0A00_0000 | number).to_be_bytes());
        packet[4..6].copy_from_slice(&(number as u16).to_be_bytes());
        packet[6] = if number % 2 == 0 { 0x20 } else { 0 };
        // Lengths of IP and UDP without reason.
        if number % 7 == 0 {
            packet[2 + number as usize % 2] ^= number as u8;
            packet[25] ^= (number >> 8) as u8;
        }
        capture.extend(frame(&packet, packet.len() - number as usize % 11));
    }
    fs::write(&file, &capture).unwrap();
    let limited = "ulimit -v 400000 && exec \"$0\" decode \"$1\" --format json";
    let mut command = Command::new("bash");
    command.args(["-c", limited, env!("CARGO_BIN_EXE_pnet-nat")]).arg(&file);
    let mut decode = Process::start(command);
    assert_eq!((decode.end(), &decode.stderr()[..]), (Some(0), ""));
    let last: Value = serde_json::from_str(decode.stdout().lines().last().unwrap()).unwrap();
    assert!(last["summary"]["malformed"].as_u64().unwrap() > 10_000, "{last}");
}
