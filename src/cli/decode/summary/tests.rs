//! Summaries of made-up exchanges.

use std::time::Duration;

use super::*;
use crate::pnet::wire::{Datagram, Header};

fn server(number: u16) -> SocketAddr {
    ([203, 0, 113, 5], number).into()
}

/// A request to this node.
fn request(to: SocketAddr, node_address: u8) -> Request {
    let octets = [2, 0, 0, 0, 0x0B, node_address, 0x8B, 0x83, 0, 3, 1, 2, 3];
    let datagram = Datagram::parse(&octets, Header::default()).unwrap();
    Request::of(&datagram, 1, None, [server(50000), to]).unwrap()
}

fn asked(server: SocketAddr, micros: u64, from_another_port: bool) -> Asked {
    Asked { packet: 1, elapsed: Some(Duration::from_micros(micros)), server, from_another_port }
}

fn some() -> Summary {
    let mut summary = Summary { datagrams: 12, ..Summary::default() };
    for micros in [5200, 5200, 5200, 820_000] {
        summary.request(&request(server(40004), 4));
        summary.answer(&asked(server(40004), micros, false));
    }
    summary.request(&request(server(40004), 4));
    summary.unanswered(&request(server(40004), 4));
    summary.answer(&asked(server(40004), 1, true));
    summary.malformed(server(40004));
    summary.request(&request(server(34379), 7));
    summary.request(&request(server(34379), 8));
    summary.malformed(server(34378));
    summary
}

#[test]
fn servers_have_a_row_each() {
    let text = some().report(false, |_| None).to_string();
    let right = "
Datagrams: 12, malformed: 2. Requests: 7, answered: 4, unanswered: 1.

| Server            | Node    | Requests | Answers | Unanswered | Median |   99 % | Faults |
|-------------------|---------|----------|---------|------------|--------|--------|--------|
| 203.0.113.5:34378 | –       |        0 |       0 |          0 |      – |      – |      1 |
| 203.0.113.5:34379 | several |        2 |       0 |          0 |      – |      – |      0 |
| 203.0.113.5:40004 | 4       |        5 |       4 |          1 | 5.2 ms | 820 ms |      2 |

Answers from another port than was asked: 1. The relay drops them.
";
    assert_eq!(text, right);
}

#[test]
fn nets_are_named_and_what_is_missing_is_said() {
    let summary = Summary { unasked: 3, lost_fragments: 2, ..some() };
    let name = |address: SocketAddr| (address.port() == 40004).then_some(("section-1", 5));
    let text = summary.report(true, name).to_string();
    assert!(text.contains("| 203.0.113.5:40004 | section-1 | 5       |        5 |"), "{text}");
    assert!(text.contains("| 203.0.113.5:34379 | –         | several |        2 |"), "{text}");
    let (_, notes) = text.split_once("them.\n").unwrap();
    assert_eq!(
        notes,
        "Answers whose request is not in the capture: 3.\n\
         Fragments of datagrams whose first fragment is missing: 2.\n\
         A signal came before the end of the input.\n"
    );
    let json = serde_json::to_value(summary.report(true, name)).unwrap();
    let right = serde_json::json!({
        "server": "203.0.113.5:40004", "net": "section-1", "node_address": 5,
        "requests": 5, "answers": 4, "unanswered": 1, "malformed": 1,
        "answers_from_another_port": 1,
        "response_time_median_seconds": 0.0052, "response_time_p99_seconds": 0.82,
    });
    assert_eq!(json["servers"][2], right);
    assert_eq!((&json["stopped"], &json["lost_fragments"]), (&true.into(), &2.into()));
}

#[test]
fn many_servers_share_the_last_row() {
    let mut summary = Summary::default();
    for number in 1..=MOST as u16 + 100 {
        summary.request(&request(server(number), 1));
    }
    assert_eq!(summary.rows.len(), MOST + 1);
    let text = summary.report(false, |_| None).to_string();
    let others = text.lines().find(|line| line.starts_with("| others ")).unwrap();
    assert!(others.contains(" 100 "), "{others}");
}
