use std::net::IpAddr;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use foldhash::fast::FixedState;
use serde_json::{Value, json};

use super::*;
use crate::config::fixture::{NODE_1, NODE_33, SECTION, config};
use crate::logging::tests::logged;
use crate::nat::{Direction, Refused, Writer, net_key};

/// Writes one report and returns its lines.
fn report(drops: &mut DropReport) -> Vec<Value> {
    logged(|| drops.report(DropReport::WINDOW, false))
}

fn counts(lines: &[Value]) -> Vec<u64> {
    lines.iter().map(|line| line["count"].as_u64().unwrap()).collect()
}

/// Nanoseconds. Any two datagrams are 5 ms apart.
static CLOCK: AtomicU64 = AtomicU64::new(1);

/// Each of these senders sends a request; those with an even number, to node 1.
fn drop_some(router: &Router, reason: DropReason, senders: impl IntoIterator<Item = u32>) {
    let (active, writer) = (router.active_config(), Writer::of_worker());
    for (source, worker) in senders.into_iter().zip(active.counters.iter().cycle()) {
        let now = CLOCK.fetch_add(5_000_000, Relaxed);
        let sender = IpAddr::from((0xc633_6400 + source).to_be_bytes());
        let (node, counters) = match source % 2 {
            0 => (1, worker.node(NODE_1)),
            _ => (33, worker.node(NODE_33)),
        };
        let direction = Direction::Request;
        counters.direction(direction).dropped(reason).add(&writer, 1);
        let (net, hash) = (net_key("section-1"), FixedState::default());
        worker.net(SECTION).note_source(&writer, reason, now, sender, source.into());
        let refused = Refused { sender, net, node, direction, reason };
        worker.refusals.note(&writer, now, &refused, &hash);
    }
}

#[test]
fn a_window_names_who_sent_what() {
    let router = Router::idle(config(), 2);
    drop_some(&router, DropReason::BadHeader, 0..100);
    let mut drops = DropReport::new(router.clone());
    assert_eq!(report(&mut drops), Vec::<Value>::new(), "what was before is not reported");

    drop_some(&router, DropReason::PasswordWrong, (0..11).map(|n| n % 2 + 8));
    drop_some(&router, DropReason::TooShort, [232]);
    assert_eq!(
        report(&mut drops),
        [
            json!({
                "level": "WARN", "net": "section-1", "reason": "too_short", "count": 1,
                "sources": 1, "last_sender": "198.51.100.232", "nodes": "1",
                "message": "1 datagram too short from 198.51.100.232 in 10 s",
            }),
            json!({
                "level": "WARN", "net": "section-1", "reason": "password_wrong", "count": 6,
                "sources": 1, "last_sender": "198.51.100.8", "nodes": "1",
                "message": "6 wrong passwords from 198.51.100.8 in 10 s",
            }),
            json!({
                "level": "WARN", "net": "section-1", "reason": "password_wrong", "count": 5,
                "sources": 1, "last_sender": "198.51.100.9", "nodes": "33",
                "message": "5 wrong passwords from 198.51.100.9 in 10 s",
            }),
        ]
    );
    assert_eq!(report(&mut drops), Vec::<Value>::new(), "a quiet window says nothing");
    drop_some(&router, DropReason::PasswordWrong, [8, 9, 10]);
    let lines = report(&mut drops);
    assert_eq!(lines.len(), 1, "two are known: {lines:?}");
    assert_eq!(lines[0]["message"], "1 wrong password from 198.51.100.10 in 10 s");
}

/// A mistyped client makes two lines in fourteen minutes, and another one is named beside it.
#[test]
fn what_goes_on_is_told_of_every_ten_minutes() {
    let router = Router::idle(config(), 1);
    let mut drops = DropReport::new(router.clone());
    let mut lines = Vec::new();
    for window in 0..14 * 6 {
        drop_some(&router, DropReason::SourceNotAllowed, [9; 100]);
        if window > 80 {
            drop_some(&router, DropReason::SourceNotAllowed, [7]);
        }
        lines.extend(report(&mut drops));
    }
    assert_eq!(counts(&lines), [100, 6000, 1], "{lines:?}");
    let message = |line: &Value| line["message"].as_str().unwrap().to_owned();
    assert_eq!(message(&lines[1]), "6000 requests not allowed from 198.51.100.9 in 600 s");
    assert_eq!(lines[1]["nodes"], "33");
    assert_eq!(message(&lines[2]), "1 request not allowed from 198.51.100.7 in 10 s");
    lines.extend(logged(|| drops.report(Duration::ZERO, true)));
    assert_eq!(counts(&lines[3..]), [2, 2300], "the rest, at the end");

    for _ in 0..60 {
        assert_eq!(report(&mut drops), Vec::<Value>::new(), "a pause");
    }
    drop_some(&router, DropReason::SourceNotAllowed, [9]);
    assert_eq!(counts(&report(&mut drops)), [1], "it is new again");
}

/// Strangers make no lines of their own, and do not hide who is refused again and again.
#[test]
fn a_flood_makes_one_line_and_whoever_goes_on_beside_it_another() {
    let router = Router::idle(config(), 2);
    let mut drops = DropReport::new(router.clone());
    drop_some(&router, DropReason::BadHeader, 0..20_000);
    let lines = report(&mut drops);
    assert_eq!(lines.len(), 1);
    let expected =
        "20000 wrong headers from 7098 sources or more in 10 s, the last one 198.51.178.31";
    assert_eq!(lines[0]["message"], expected);

    let mut lines = Vec::new();
    for window in 0..60 {
        drop_some(&router, DropReason::BadHeader, (0..1000).map(|n| (window + 30) * 1000 + n));
        drop_some(&router, DropReason::BadHeader, [1_000_007; 20]);
        lines.extend(report(&mut drops));
    }
    let messages: Vec<_> = lines.iter().map(|line| line["message"].as_str().unwrap()).collect();
    let [one, others] = messages[..] else { panic!("{lines:?}") };
    assert!(one.ends_with(" from 198.66.166.71 in 10 s"), "{one}");
    assert!(others.ends_with(" from 7098 other sources or more in 600 s"), "{others}");
    lines.extend(logged(|| drops.report(Duration::ZERO, true)));
    assert_eq!(counts(&lines).iter().sum::<u64>(), 60 * 1020, "each is told of once");
}

/// Each sends often enough to be named, but there is no room for all.
#[test]
fn those_without_lines_of_their_own_share_one() {
    let router = Router::idle(config(), 1);
    let mut drops = DropReport::new(router.clone());
    // Senders 1 to 12, and each of them as often as its number.
    drop_some(&router, DropReason::PasswordMissing, (1..=12).flat_map(|n| (0..n).map(move |_| n)));
    let lines = report(&mut drops);
    let mut named = counts(&lines);
    assert_eq!((named.len(), named.pop()), (9, Some(1 + 2 + 3 + 4)), "{lines:?}");
    named.sort_unstable();
    assert_eq!(named, [5, 6, 7, 8, 9, 10, 11, 12]);
    assert_eq!(
        lines[8]["message"],
        "10 missing passwords from 4 other sources in 10 s, the last one 198.51.100.4"
    );
}

/// In the meantime, nets and nodes may have come, gone or changed places.
#[test]
fn a_window_goes_on_over_a_reload() {
    let router = Router::idle(config(), 1);
    drop_some(&router, DropReason::BadHeader, 0..100);
    let mut drops = DropReport::new(router.clone());
    drop_some(&router, DropReason::BadHeader, 0..5);
    let turned = Router::idle(turned(), 1);
    let carried = (NODE_1.0, 50 + 3);
    let of_turned = turned.active_config();
    for (mapping, count) in [carried, (NODE_33.0, 7)] {
        let node = of_turned.counters[0].node(MappingId(mapping));
        node.direction(Direction::Request)
            .dropped(DropReason::BadHeader)
            .add(&Writer::of_worker(), count);
    }
    drops.router = turned;
    assert_eq!(counts(&report(&mut drops)), [3 + 7]);
}

/// Node 33 is gone. A node that was not there before has its place.
fn turned() -> crate::config::Config {
    let mut turned = config();
    let mut mappings = turned.table.mappings().to_vec();
    mappings[NODE_33.0 as usize].node_address = 34;
    let nets = turned.table.nets().to_vec();
    turned.table = Arc::new(crate::nat::Table::new(turned.table.header, nets, mappings));
    turned
}
