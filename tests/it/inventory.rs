//! `pnet-nat inventory` against devices that others wrote, and what it makes of a capture.

use std::fs;
use std::net::UdpSocket;

use pnet_nat::profinet::rpc::ReadImplicit;
use pnet_nat::profinet::{ByteOrder, Uuid};
use serde_json::Value;

use crate::harness::{
    IDENTIFICATION, IoDevice, PATIENCE, PNIO_PORT, Process, Site, Terminal, eventually, frame,
    has_profinet_peers, header, pcap, pnet_nat, profinet_peer,
};

/// What the command prints. It has to end with this exit code.
#[track_caller]
fn inventory(arguments: &[&str], code: i32) -> Process {
    let mut process = Process::start(pnet_nat(&[&["inventory"], arguments].concat()));
    assert_eq!(process.end(), Some(code), "{}{}", process.stdout(), process.stderr());
    process
}

fn json_lines(process: &Process) -> Vec<Value> {
    process.stdout().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// P-4: one device answers from the port that was asked, one from another; the third address is empty.
#[test]
fn p_4_devices_are_found_whatever_port_they_answer_from_and_nothing_is_written() {
    let site = Site::claim();
    let device = |last, port| IoDevice::start(site.address(last).into(), port).unwrap();
    let devices = [device(1, PNIO_PORT), device(2, 9001)];
    let range = format!("{}-3", site.address(1));
    // A busy machine is no silent device: the second try has all the time.
    let start = |format| {
        let arguments = ["inventory", &range, "--timeout", "3s", "--format", format];
        Process::start(pnet_nat(&arguments))
    };
    let mut running = ["json", "csv", "text"].map(start);
    for process in &mut running {
        assert_eq!(process.end(), Some(0), "{}", process.stderr());
    }
    let [json, csv, text] = running;
    let found = json_lines(&json);
    assert_eq!(found.len(), 2);
    for (found, (last, port)) in found.iter().zip([(1, PNIO_PORT), (2, 9001)]) {
        assert_eq!(found["address"], site.address(last).to_string());
        assert_eq!(found["answered_from"], port);
        let submodule = &found["submodules"][0];
        for (name, text) in IDENTIFICATION {
            match submodule[name].as_u64() {
                Some(number) if name == "vendor_id" => assert_eq!(format!("{number:#06x}"), text),
                Some(number) => assert_eq!(number.to_string(), text, "{name}"),
                None => assert_eq!(submodule[name], text, "{name}"),
            }
        }
    }
    let csv = csv.stdout().replace("\"Hall 2, row B\"", "Hall 2");
    let rows: Vec<Vec<_>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 3, "{csv}");
    for (name, text) in IDENTIFICATION.iter().filter(|(_, text)| !text.contains(',')) {
        let column = rows[0].iter().position(|heading| heading == name).unwrap();
        assert_eq!(rows[1][column], *text, "{csv}");
    }
    let text = text.stdout();
    for (_, value) in IDENTIFICATION {
        assert!(text.contains(value), "{value}: {text}");
    }
    assert!(text.ends_with("Answered: 2 of 3\n"), "{text}");
    for device in devices {
        let received = device.received();
        assert!(received.len() >= 3 * 6, "{}", received.len());
        for line in received.iter().map(|datagram| datagram.log()) {
            // Look-up and Read Implicit.
            assert_eq!(line["kind"], "request", "{line}");
            assert!(["2", "5"].contains(&&*line["opnum"].to_string()), "{line}");
        }
    }
}

/// P-8: answers in fragments and in little-endian, several submodules, neighbours, a mapper that alone
/// knows the port.
#[test]
fn p_8_a_device_with_fragments_and_a_mapper_tells_its_modules_and_neighbours() {
    if !has_profinet_peers() {
        return;
    }
    let site = Site::claim();
    for (last, options) in [
        (1, "--answer-from 49200 --little --fragment 100"),
        (2, "--answer-from 49201 --mapper --little"),
    ] {
        let address = site.address(last).to_string();
        let device = format!("serve {address} {options}");
        let device = Process::start(profinet_peer("scapy_peer", &device));
        eventually("it is ready", || device.stdout().contains("ready").then_some(()));
        let found = json_lines(&inventory(&[&address, "--timeout", "5s", "--format", "json"], 0));
        let orders = found[0]["submodules"].as_array().unwrap().iter();
        let orders: Vec<_> = orders.map(|it| it["order_id"].as_str().unwrap()).collect();
        assert_eq!(orders, ["VALVE-0", "VALVE-1", "VALVE-2"], "{found:?}");
        assert_eq!(found[0]["submodules"][0]["function"], "Steam");
        assert_eq!(found[0]["neighbours"][0]["station_name"], "press-3.line-1");
        if last == 2 {
            assert_eq!(
                (&found[0]["vendor_id"], &found[0]["device_id"]),
                (&0x1F2E.into(), &66.into())
            );
            assert_eq!(found[0]["annotation"], "VALVE-7");
        }
    }
}

/// Only what others were told is read from a capture.
#[test]
fn a_capture_of_another_reader_gives_the_same() {
    let site = Site::claim();
    let address = site.address(1);
    let _device = IoDevice::start(address.into(), PNIO_PORT).unwrap();
    let reader = UdpSocket::bind((site.address(100), 0)).unwrap();
    reader.set_read_timeout(Some(PATIENCE)).unwrap();
    let answers: Vec<_> = (0..4)
        .map(|number: u16| {
            let mut octets = [0; 2048];
            let request = ReadImplicit {
                order: ByteOrder::Little,
                object: Uuid::new(0xDEA0_0000_6C97_11D1_8271_0001_0042_1F2E),
                activity: Uuid::new(7),
                sequence: number.into(),
                api: 0,
                slot: 0,
                subslot: 1,
                index: 0xAFF0 + number,
                record_length: 4096,
                target_ar: Uuid::NIL,
            };
            let length = request.emit(&mut octets).unwrap();
            reader.send_to(&octets[..length], (address, PNIO_PORT)).unwrap();
            let length = reader.recv(&mut octets).unwrap();
            octets[..length].to_vec()
        })
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("capture.pcap");
    fs::write(&file, pcap(answers.iter().map(|answer| (50000, &answer[..])))).unwrap();
    let file = file.to_str().unwrap();
    let found = json_lines(&inventory(&[file, "--format", "json"], 0));
    assert_eq!(found.len(), 1);
    assert_eq!(found[0]["address"], "198.51.100.20", "where the capture says that they are from");
    assert_eq!((&found[0]["device_id"], &found[0]["asked"]), (&0x42.into(), &Value::Null));
    for (name, text) in IDENTIFICATION.iter().filter(|(name, _)| !name.ends_with("_id")) {
        let value = &found[0]["submodules"][0][name];
        assert_eq!(value.as_str().map_or_else(|| value.to_string(), str::to_owned), *text);
    }
    let text = inventory(&[file], 0).stdout();
    assert!(text.contains("PUMP-4711") && text.ends_with("Devices: 1\n"), "{text}");
}

/// P-3: an answer of DCP behind a VLAN tag, as Ethernet carries it.
#[test]
fn p_3_a_capture_of_ethernet_tells_names_and_addresses() {
    let frame_of = |name: &[u8; 8], last: u8| {
        let block = |option: [u8; 2], contents: &[u8]| {
            let length = (contents.len() as u16 + 2).to_be_bytes();
            [&option[..], &length, &[0, 0], contents].concat()
        };
        let address = [172, 17, 17, last];
        let ip = [address, [255, 255, 255, 0], address].concat();
        let blocks =
            [block([2, 2], name), block([2, 3], &[0x1F, 0x2E, 0, last]), block([1, 2], &ip)]
                .concat();
        let ethernet = [&[2, 0, 0, 0, 0, 1][..], &[2, 0, 0, 0, 0, last]].concat();
        let tagged = [0x81, 0, 0xC0, 0, 0x88, 0x92, 0xFE, 0xFF, 5, 1, 0, 0, 0, 9, 0, 0];
        let octets =
            [&ethernet[..], &tagged, &(blocks.len() as u16).to_be_bytes(), &blocks].concat();
        frame(&octets, octets.len())
    };
    let mut file = header();
    file[20] = 1; // Ethernet
    let frames = [frame_of(b"valve-20", 20), frame_of(b"valve-04", 4), frame_of(b"valve-20", 20)];
    file.extend(frames.concat());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture.pcap");
    fs::write(&path, file).unwrap();
    let csv = inventory(&[path.to_str().unwrap(), "--format", "csv"], 0).stdout();
    let rows: Vec<_> = csv.lines().skip(1).collect();
    let row = |name: &str, last: u8| {
        format!(
            "172.17.17.{last},02:00:00:00:00:{last:02x},{name},,0x1f2e,{last:#06x},,,,,,,,,,,,,,,,"
        )
    };
    assert_eq!(rows, [row("valve-04", 4), row("valve-20", 20)]);
}

#[test]
fn where_nobody_answers_the_exit_code_is_1() {
    let site = Site::claim();
    let nobody = site.address(9).to_string();
    let text = inventory(&[&nobody, "--timeout", "10ms"], 1).stdout();
    assert_eq!(text, "Answered: 0 of 1\n");
    let json = inventory(&[&nobody, "--timeout", "10ms", "--format", "json"], 1);
    assert_eq!(json.stdout(), "");
}

#[test]
fn what_makes_no_sense_is_refused() {
    for (arguments, why) in [
        (&["172.17.17.300"][..], "is no address"),
        (&["239.0.0.1"], "is not the address of one device"),
        (&["10.0.0.0/8"], "name fewer at once"),
        (&["172.17.17.7", "capture.pcap"], "addresses, or one capture"),
        (&["172.17.17.7", "--rate", "0"], "1..=10000"),
        (&[], "ADDRESS|FILE"),
    ] {
        let stderr = inventory(arguments, 2).stderr();
        assert!(stderr.contains(why), "{arguments:?}: {stderr}");
    }
    let text = inventory(&["Cargo.toml"], 1).stderr();
    assert!(text.contains("Cargo.toml: neither pcap nor pcapng"), "{text}");
}

#[test]
fn a_long_search_shows_how_far_it_is() {
    let site = Site::claim();
    let range = format!("{}-60", site.address(1));
    let mut terminal = Terminal::start(&mut pnet_nat(&["inventory", &range, "--timeout", "2s"]));
    assert_eq!(terminal.end(), Some(1), "{}", terminal.text());
    let text = terminal.text();
    assert!(text.contains(" %, ") && text.contains(" of 60 addresses, 0 devices"), "{text:?}");
}
