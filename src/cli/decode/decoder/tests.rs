//! What a whole capture gives: every request ends once, and every datagram is shown by its protocol.

use std::time::{Duration, UNIX_EPOCH};

use clap::Parser;
use etherparse::PacketBuilder;
use pcap_parser::Linktype;
use proptest::prelude::*;
use serde_json::Value;

use super::super::Args;
use super::*;
use crate::profinet::rpc::{Flags1, Header, Interface};
use crate::profinet::{ByteOrder, Uuid};

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    args: Args,
}

/// A request of this endpoint, or its answer, between the client and a port of the server.
fn packet(endpoint: u8, port: u16, is_answer: bool) -> Vec<u8> {
    let (client, server) = ([198, 51, 100, 20], [203, 0, 113, 5]);
    let (packet, octets) = if is_answer {
        let udp = PacketBuilder::ipv4(server, client, 64).udp(port, 50000);
        (udp, vec![2, 0, 0, 0, 125, 1, 4, endpoint, 0x8B, 0x84, 0x80, 0, 3, 1, 2, 3])
    } else {
        let udp = PacketBuilder::ipv4(client, server, 64).udp(50000, port);
        (udp, vec![2, 0, 0, 0, 11, 4, 3, 0x8B, 0x83, 0x80 | endpoint, 0, 3, 1, 2, 3])
    };
    let mut written = Vec::new();
    packet.write(&mut written, &octets).unwrap();
    written
}

/// A datagram from port 50000 to this one.
fn datagram(to: u16, payload: &[u8]) -> Vec<u8> {
    let mut written = Vec::new();
    let packet = PacketBuilder::ipv4([192, 0, 2, 1], [192, 0, 2, 2], 64).udp(50000, to);
    packet.write(&mut written, payload).unwrap();
    written
}

/// A request without blocks in two fragments, of which the first has so many octets.
fn fragments(first: usize) -> [Vec<u8>; 2] {
    let stub = [0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0, 0];
    let last = Flags1::FRAGMENT | Flags1::LAST_FRAGMENT;
    let fragments = [(0, Flags1::FRAGMENT, &stub[..first]), (1, last, &stub[first..])];
    fragments.map(|(number, flags, octets)| {
        let mut header = Header::request(ByteOrder::Big, Interface::Device.uuid(), 0);
        header.activity = Uuid::new(7);
        header.fragment_number = number;
        header.flags1 = Flags1(flags);
        let mut buffer = [0; 120];
        let len = header.emit(octets, &mut buffer).unwrap();
        buffer[..len].to_vec()
    })
}

fn decoded(arguments: &[&str], packets: &[Vec<u8>]) -> Vec<Value> {
    let arguments = ["decode", "--format", "json"].iter().chain(arguments);
    let settings = Settings::new(&Cli::parse_from(arguments).args).unwrap();
    let output = RefCell::new(Vec::new());
    let mut decoder = Decoder::new(settings, &output);
    for (number, octets) in (1..).zip(packets) {
        let (link, length) = (Linktype::RAW, octets.len());
        decoder.packet(&Captured { number, time: None, link, octets, length }).unwrap();
    }
    decoder.finish(&Stop::default()).unwrap();
    let text = String::from_utf8(output.take()).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn p_8_a_call_in_fragments_is_whole_at_the_one_that_was_missing() {
    let [first, last] = fragments(6);
    // It does not matter which one comes last, or to which port they go.
    for order in [[&first, &last], [&last, &first]] {
        let lines = decoded(&[], &order.map(|payload| datagram(49152, payload)));
        assert_eq!(lines[0]["protocol"], "profinet-rpc");
        assert!(lines[0].get("args_maximum").is_none());
        assert_eq!((&lines[1]["frame"], &lines[1]["args_maximum"]), (&2.into(), &9.into()));
        assert_eq!(lines[1]["reassembled_length"], 20);
        assert_eq!(lines[2]["profinet_summary"]["frames"]["rpc"], 2);
    }
}

#[test]
fn rpc_is_shown_where_it_is_wanted_and_never_on_a_port_of_p_net() {
    let [payload, _] = fragments(6);
    let packets = [datagram(34964, &payload), datagram(34378, &payload)];
    let protocols = |arguments: &[&str]| {
        let lines = decoded(arguments, &packets);
        let of =
            |line: &Value| Some((line["frame"].as_u64()?, line["protocol"].as_str()?.to_owned()));
        lines.iter().filter_map(of).collect::<Vec<_>>()
    };
    let (rpc, p_net) = ((1, "profinet-rpc".to_owned()), (2, "p-net".to_owned()));
    assert_eq!(protocols(&[]), [rpc.clone(), p_net.clone()]);
    assert_eq!(protocols(&["--protocol", "profinet-rpc"]), [rpc]);
    assert_eq!(protocols(&["--protocol", "p-net"]), [p_net]);
    assert_eq!(protocols(&["--protocol", "lldp"]), []);
}

proptest! {
    /// Each request ends once, with its answer or without, whatever else is in the capture.
    #[test]
    fn the_books_are_balanced(
        packets in prop::collection::vec(
            (1_u8..4, 20003_u16..20006, any::<bool>(), 0_u64..4_000_000, any::<[u8; 3]>()),
            1..100,
        )
    ) {
        let arguments = ["decode", "--ports", "20004-20010", "--format", "json"];
        let settings = Settings::new(&Cli::parse_from(arguments).args).unwrap();
        let output = RefCell::new(Vec::new());
        let mut decoder = Decoder::new(settings, &output);
        let mut micros = 0;
        for ((endpoint, port, is_answer, later, [damage, at, to]), number) in
            packets.into_iter().zip(1..)
        {
            micros += later;
            let mut octets = packet(endpoint, port, is_answer);
            if damage < 60 {
                let at = usize::from(at) % octets.len();
                octets[at] = to;
            }
            if damage < 20 {
                octets.truncate(to.into());
            }
            let time = Some(UNIX_EPOCH + Duration::from_micros(micros));
            let link = Linktype::RAW;
            let length = octets.len();
            decoder.packet(&Captured { number, time, link, octets: &octets, length }).unwrap();
        }
        decoder.finish(&Stop::default()).unwrap();
        let text = String::from_utf8(output.take()).unwrap();
        let lines = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        let lines: Vec<_> = lines.collect();
        let Some(summary) = lines.last().map(|line| &line["summary"]) else { return Ok(()) };
        let [datagrams, requests, answers, unanswered, malformed, other_port] = [
            "datagrams", "requests", "answers", "unanswered", "malformed",
            "answers_from_another_port",
        ]
        .map(|name| summary[name].as_u64().unwrap());
        prop_assert_eq!(requests, answers + unanswered);
        let count = |field: &str| lines.iter().filter(|line| line.get(field).is_some()).count() as u64;
        prop_assert_eq!(count("packet"), datagrams);
        prop_assert_eq!(count("unanswered"), unanswered);
        prop_assert_eq!(count("answer_to"), answers + other_port);
        prop_assert_eq!(count("error"), malformed);
    }
}
