use std::time::{Duration, UNIX_EPOCH};

use clap::Parser;
use etherparse::PacketBuilder;
use pcap_parser::Linktype;
use proptest::prelude::*;
use serde_json::Value;

use super::super::Args;
use super::*;

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

proptest! {
    /// Each request ends once, with its answer or without, whatever else is in the capture.
    #[test]
    fn the_books_are_balanced(
        packets in prop::collection::vec(
            (1_u8..4, 40003_u16..40006, any::<bool>(), 0_u64..4_000_000, any::<[u8; 3]>()),
            1..100,
        )
    ) {
        let arguments = ["decode", "--ports", "40004-40010", "--format", "json"];
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
