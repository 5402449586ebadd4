//! `deploy/wireshark/pnet.lua` in a real tshark: its fields are those of `pnet-nat decode`.

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

use pnet_nat::pnet::wire::{
    DatagramRepr, DlRoute, Header, MAX_DATA, MAX_DATAGRAM, Password, Route, RouteBuf,
};
use serde_json::{Map, Value};
use tempfile::TempDir;

use crate::harness::{
    FIGURE_10, PASSWORD, Process, datagram, frame, left_out, pcap, pnet_nat, request, response, udp,
};

const DISSECTOR: &str = include_str!("../../deploy/wireshark/pnet.lua");
const README: &str = include_str!("../../deploy/wireshark/README.md");

/// A home with the dissector where README.md has people put it, and a capture.
struct Home(TempDir);

impl Home {
    /// None, and says so, where there is no tshark.
    fn with(capture: &[u8]) -> Option<Self> {
        if Command::new("tshark").arg("--version").output().is_err() {
            left_out("tshark");
            return None;
        }
        let home = tempfile::tempdir().unwrap();
        let plugins = home.path().join(".local/lib/wireshark/plugins");
        fs::create_dir_all(&plugins).unwrap();
        fs::write(plugins.join("pnet.lua"), DISSECTOR).unwrap();
        fs::write(home.path().join("capture.pcap"), capture).unwrap();
        Some(Self(home))
    }

    fn capture(&self) -> String {
        self.0.path().join("capture.pcap").to_str().unwrap().to_owned()
    }

    /// What tshark prints.
    #[track_caller]
    fn tshark(&self, arguments: &[&str]) -> String {
        let mut command = Command::new("tshark");
        let command = command.env("HOME", self.0.path()).env_remove("XDG_CONFIG_HOME");
        let output = command.args(arguments).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{arguments:?}: {stderr}");
        let stdout = String::from_utf8(output.stdout).unwrap();
        assert!(!stderr.contains("Lua"), "{stderr}");
        stdout
    }

    /// The capture as tshark reads it with the UDP ranges of [`PORTS`].
    #[track_caller]
    fn read(&self, arguments: &[&str]) -> String {
        let ranges = format!("pnet.udp_ranges:{}", PORTS[2]);
        let read = self.tshark(&[&["-r", &self.capture(), "-o", &ranges], arguments].concat());
        assert!(!read.contains("Lua Error"), "{read}");
        read
    }
}

/// One of the Normal port, one of the Secure port, and those of UDP Range nets.
const PORTS: [&str; 3] = ["34378", "34379", "20001-20125"];

fn emitted(route: Route<'_>, data: &[u8], flags: u8, password: Option<Password>) -> Vec<u8> {
    let mut octets = [0; MAX_DATAGRAM];
    let datagram = DatagramRepr {
        header: Header::default(),
        route,
        control_status: data.len() as u8 ^ 0xA5,
        data_field_flags: flags,
        data_octets: data,
        password,
    };
    let length = datagram.emit(&mut octets).unwrap();
    octets[..length].to_vec()
}

/// What our codec emits: every route format, with and without data and password.
fn sound() -> Vec<Vec<u8>> {
    let route = |to: &[u8], from: &[u8]| DlRoute::new(to, from).unwrap().to_route().unwrap();
    let routes: Vec<RouteBuf> = [
        (&[4][..], &[3][..]),
        (&[126], &[3]),
        (&[4], &[0]),
        (&[11, 4], &[11, 3]),
        (&[11, 126], &[11, 3]),
        (&[126, 4], &[11, 0]),
        (&[4, 2, 33, 5], &[3]),
        (&[4, 126, 33, 5], &[3]),
        (&[4, 2, 33, 5], &[0]),
        (&[11, 4, 2, 33], &[11, 3, 31]),
        (&[126, 4, 2, 33], &[126, 3, 126]),
        (&[11, 127, 2], &[11, 3, 0]),
        (&[11, 4, 2, 126], &[11, 3, 31]),
        (&[5; 2], &[6; 27]),
        (&[5; 27], &[6; 2]),
        (&[5; 28], &[6; 1]),
    ]
    .map(|(to, from)| route(to, from))
    .into();
    let immediate = [[0x83, 0x04], [0x83, 0x84]];
    let immediate = immediate.iter().map(|octets| Route::parse(octets).unwrap());
    let all = routes.iter().map(RouteBuf::as_route).chain(immediate);
    let data: Vec<u8> = (0..MAX_DATA as u8).map(|octet| octet ^ 0xC3).collect();
    let with = |route: Route<'_>| {
        [0, 1, 2, 3, 4, MAX_DATA]
            .into_iter()
            .flat_map(move |size| {
                let flags = (size as u8 & 3) << 6;
                [None, Some(Password::new(*PASSWORD))]
                    .map(move |password| (route, size, flags, password))
            })
            .map(|(route, size, flags, password)| emitted(route, &data[..size], flags, password))
            .collect::<Vec<_>>()
    };
    all.flat_map(with).collect()
}

/// No datagrams, or not quite: every length that two of them can be cut to, and each octet in front
/// of the data changed in ways that matter.
fn damaged() -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    for whole in [request(4), datagram(&[0x0B, 0x04, 0x8B, 0x83], b"abc", PASSWORD), response(4)] {
        all.extend((1..whole.len()).map(|end| whole[..end].to_vec()));
        all.extend((1..20).map(|more| [&whole[..], &vec![0xEE; more]].concat()));
        for at in 0..18 {
            for change in [0x01, 0x02, 0x04, 0x1B, 0x3F, 0x40, 0x7F, 0x80, 0xFF] {
                let mut octets = whole.clone();
                octets[at] ^= change;
                all.push(octets);
            }
        }
    }
    all.extend([vec![0; 107], vec![0; 108], vec![0xFF; 300]]);
    all.push(datagram(&FIGURE_10[..2], b"", b""));
    all
}

/// Payloads that are rows of datagrams, as a router's own capture shows bursts, and some that are
/// not quite: alone, with and without a password, of two lengths, with a last one that is shorter.
fn rows() -> Vec<Vec<u8>> {
    let with =
        |node, data: &[u8], password: &[u8]| datagram(&[0x0B, node, 0x8B, 0x83], data, password);
    let row = |count: u8, password: &[u8], last: &[u8]| {
        let mut row: Vec<_> = (1..count).map(|node| with(node, &[node; 20], password)).collect();
        row.push(with(count, last, password));
        row
    };
    let mut all = Vec::new();
    for password in [&PASSWORD[..], b""] {
        all.push(row(11, password, &[7; 20]));
        all.push(row(2, password, b"abc"));
        all.push(row(64, password, &[7; 20]));
        all.push(row(65, password, &[7; 20]));
        all.push(row(3, password, &[7; 21]));
        // A change in each octet of the third.
        for at in 0..38 {
            for change in [0x01, 0x80] {
                let mut row = row(4, password, &[7; 20]);
                if let Some(octet) = row[2].get_mut(at) {
                    *octet ^= change;
                }
                all.push(row);
            }
        }
    }
    // With and without a password in one row.
    all.push(vec![with(4, &[4; 9], PASSWORD), with(5, &[5; 17], b""), with(6, b"", PASSWORD)]);
    all.push(vec![with(4, &[4; 17], b""), with(5, &[5; 9], PASSWORD), with(6, b"", b"")]);
    all.iter().map(|row| row.concat()).collect()
}

/// One line of `pnet-nat decode --format json` for each datagram.
fn decoded(capture: &str) -> Vec<Map<String, Value>> {
    let arguments = ["decode", capture, "--ports", PORTS[2], "--format", "json"];
    let mut process = Process::start(pnet_nat(&arguments));
    assert_eq!(process.end(), Some(0), "{}", process.stderr());
    let lines = process.stdout();
    let lines = lines.lines().map(|line| serde_json::from_str::<Map<_, _>>(line).unwrap());
    // Beside datagrams there are requests without an answer, and the summary.
    lines.filter(|line| line.contains_key("packet")).collect()
}

/// A field of the datagrams of a packet as tshark prints it: with commas, nothing for what is not
/// there.
fn printed(packet: &[Map<String, Value>], name: &str) -> String {
    let values = packet.iter().filter_map(|datagram| datagram.get(name));
    let texts = values.flat_map(|value| match value {
        Value::String(text) => vec![text.clone()],
        Value::Array(list) => list.iter().map(ToString::to_string).collect(),
        value => vec![value.to_string()],
    });
    texts.filter(|text| !text.is_empty()).collect::<Vec<_>>().join(",")
}

#[test]
fn every_field_is_that_of_decode() {
    let (datagrams, rows) = ([sound(), damaged()].concat(), rows());
    let ports = [34378, 34379, 20001, 20125].into_iter().cycle();
    let payloads = datagrams.iter().chain(&rows);
    let mut capture = pcap(ports.zip(payloads.map(|octets| &octets[..])));
    let cut = udp(34379, &request(4));
    capture.extend(frame(&cut, cut.len() - 5));
    let Some(home) = Home::with(&capture) else { return };

    // All that the dissector knows, but what depends on a preference, and the label of errors.
    let fields = home.tshark(&["-G", "fields"]);
    let fields = fields.lines().filter_map(|line| line.split('\t').nth(2)?.strip_prefix("pnet."));
    let fields: BTreeSet<_> =
        fields.filter(|name| !["password_octets", "malformed"].contains(name)).collect();
    let decoded = decoded(&home.capture());
    let packets: Vec<_> = decoded.chunk_by(|a, b| a["packet"] == b["packet"]).collect();
    assert_eq!(packets.len(), datagrams.len() + rows.len() + 1);
    let in_rows = packets.iter().filter(|packet| packet.len() > 1).count();
    assert!(in_rows > 10 && rows.len() - in_rows > 10, "{in_rows} of {}", rows.len());
    let places = ["packet", "frame", "time", "from", "to", "protocol"];
    let names = decoded.iter().flat_map(Map::keys).map(String::as_str);
    let names: BTreeSet<_> = names.filter(|name| !places.contains(name)).collect();
    assert_eq!(fields, names);

    let wanted: Vec<_> = fields.iter().map(|name| format!("pnet.{name}")).collect();
    let wanted: Vec<_> = wanted.iter().flat_map(|name| ["-e", name]).collect();
    let read = home.read(&[&["-T", "fields"], &wanted[..]].concat());
    assert_eq!(read.lines().count(), packets.len());
    for (line, packet) in read.lines().zip(&packets) {
        let columns: Vec<_> = line.split('\t').map(str::to_owned).collect();
        let right: Vec<_> = fields.iter().map(|name| printed(packet, name)).collect();
        assert_eq!(columns, right, "{packet:?}");
    }

    // Errors, and they alone, are marked as Wireshark marks them.
    let marked = home.read(&["-Y", "pnet.malformed", "-T", "fields", "-e", "frame.number"]);
    let errors = decoded.iter().filter(|datagram| datagram.contains_key("error"));
    let errors: Vec<_> = errors.map(|datagram| datagram["packet"].to_string()).collect();
    assert_eq!(marked.lines().collect::<Vec<_>>(), errors);
    assert!(errors.len() > 100 && decoded.len() - errors.len() > 100, "{}", errors.len());
}

#[test]
fn the_password_is_shown_on_demand_alone() {
    let Some(home) = Home::with(&pcap([(34379, &request(4)[..])])) else { return };
    let octets: String = PASSWORD.iter().map(|octet| format!("{octet:02x}")).collect();
    let text = String::from_utf8(PASSWORD.to_vec()).unwrap();
    let masked = home.read(&["-O", "pnet"]);
    assert!(masked.contains("Password: present"), "{masked}");
    assert!(!masked.contains(&octets) && !masked.contains(&text), "{masked}");
    let shown = home.read(&["-O", "pnet", "-o", "pnet.show_password:TRUE"]);
    assert!(shown.contains(&format!("Password octets: {octets}")), "{shown}");
}

#[test]
fn a_row_of_datagrams_says_so_in_the_list_of_packets() {
    let row = [request(4), request(5), request(6)].concat();
    let Some(home) = Home::with(&pcap([(34379, &row[..])])) else { return };
    let summary = home.read(&["-T", "fields", "-e", "_ws.col.Info"]);
    let first = "Confirmed to 11.4.2.33 from 11.3.31, 3 data octets, password present";
    assert_eq!(summary, format!("3 datagrams in a row, the first: {first}\n"));
    let masked = home.read(&["-O", "pnet"]);
    assert!(masked.contains("P-NET on IP, 2 of 3"), "{masked}");
    assert!(!masked.contains("s3cr3t"), "{masked}");
}

#[test]
fn header_and_ports_are_preferences() {
    let mut other = request(4);
    other[3] = 1;
    let capture = pcap([(20003, &other[..]), (20200, &other)]);
    let Some(home) = Home::with(&capture) else { return };
    let summary = |options: &[&str]| {
        let read = home.read(&[options, &["-T", "fields", "-e", "_ws.col.Info"]].concat());
        read.lines().map(str::to_owned).collect::<Vec<_>>()
    };
    let udp = "50000 → 20200 Len=25";
    let refused = "Malformed: the header is not the expected one";
    assert_eq!(summary(&[]), [refused, udp]);
    assert_eq!(summary(&["-o", "pnet.header:zz"]), [refused, udp]);
    let found = "Confirmed to 11.4.2.33 from 11.3.31, 3 data octets, password present";
    assert_eq!(summary(&["-o", "pnet.header:02000001"]), [found, udp]);
    let ranges = ["-o", "pnet.header:02000001", "-o", "pnet.udp_ranges:20200"];
    assert_eq!(summary(&ranges), ["50000 → 20003 Len=25", found]);
}

/// Wireshark's dialogue changes ranges that were in force; tshark has no way to do that.
#[test]
fn ranges_that_covered_the_ports_of_p_net_leave_them_behind() {
    let capture = pcap([(34378, &request(4)[..]), (34379, &request(4)), (34400, &request(4))]);
    let Some(home) = Home::with(&capture) else { return };
    let before = "\nranges = \"34000-35000\"\nby_port:add(ranges, pnet)\n";
    let plugin = home.0.path().join(".local/lib/wireshark/plugins/pnet.lua");
    fs::write(plugin, DISSECTOR.to_owned() + before).unwrap();
    let protocols = home.read(&["-T", "fields", "-e", "_ws.col.Protocol"]);
    assert_eq!(protocols.lines().collect::<Vec<_>>(), ["P-NET", "P-NET", "UDP"]);
}

#[test]
fn the_commands_of_readme_work_as_written() {
    let Some(home) = Home::with(&pcap([(20003, &request(3)[..])])) else { return };
    fs::remove_dir_all(home.0.path().join(".local")).unwrap();
    let (_, commands) = README.split_once("```sh\n").unwrap();
    let commands = commands.split("```").next().unwrap();
    let commands = commands.replace("capture.pcap", &home.capture());
    let mut bash = Command::new("bash");
    bash.args(["-ec", &commands]).env("HOME", home.0.path()).env_remove("XDG_CONFIG_HOME");
    let output = bash.current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
    let stdout = String::from_utf8_lossy(&output.stdout);
    assert!(stdout.contains("P-NET") && stdout.contains("to 11.3.2.33"), "{output:?}");
}
