//! Tests the text that a scraper gets. A parser of its own reads the text back.

use std::collections::BTreeMap;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::*;
use crate::config::fixture::{NODE_1, NODE_33, SECTION, config};
use crate::nat::{CloseReason, Direction, DropReason, NetKind, RESPONSE_BUCKETS, Writer};
use crate::sandbox::Sandbox;

/// One scrape: the samples by their series as written, and the families with their types in order.
struct Scrape {
    samples: BTreeMap<String, f64>,
    types: Vec<(String, String)>,
}

impl Scrape {
    fn of(router: &Arc<Router>) -> Self {
        Self::parse(
            &Metrics::new(router.clone(), Sandbox::off("in a test")).chunks().collect::<String>(),
        )
    }

    /// Reads the text format. Panics unless each family is one block: HELP, TYPE, then its samples.
    fn parse(text: &str) -> Self {
        let mut scrape = Self { samples: BTreeMap::new(), types: Vec::new() };
        let mut helped = Vec::new();
        for line in text.lines() {
            if let Some(help) = line.strip_prefix("# HELP ") {
                helped.push(help.split_once(' ').unwrap().0.to_owned());
            } else if let Some(kind) = line.strip_prefix("# TYPE ") {
                let (name, kind) = kind.split_once(' ').unwrap();
                assert_eq!(helped.last().unwrap(), name, "HELP comes first");
                scrape.types.push((name.to_owned(), kind.to_owned()));
            } else {
                scrape.sample(line);
            }
        }
        let mut once = helped.clone();
        once.sort_unstable();
        once.dedup();
        assert_eq!(once.len(), helped.len(), "a family has one HELP");
        assert_eq!(scrape.types.len(), helped.len(), "a family has one TYPE");
        scrape
    }

    fn sample(&mut self, line: &str) {
        let (series, value) = line.rsplit_once(' ').unwrap();
        let name = series.split('{').next().unwrap();
        let (family, kind) = self.types.last().expect("TYPE comes first");
        let suffix = name.strip_prefix(family).expect("a family's samples stand together");
        let suffixes: &[_] =
            if kind == "histogram" { &["_bucket", "_sum", "_count"] } else { &[""] };
        assert!(suffixes.contains(&suffix), "{line}");
        let before = self.samples.insert(series.to_owned(), value.parse().unwrap());
        assert!(before.is_none(), "a series appears once: {series}");
    }

    fn get(&self, series: &str) -> f64 {
        *self.samples.get(series).unwrap_or_else(|| panic!("{series} is missing"))
    }

    fn of_family(&self, name: &str) -> Vec<f64> {
        let series = self.samples.iter().filter(|(series, _)| series.starts_with(name));
        series.map(|(_, &value)| value).collect()
    }
}

#[test]
fn every_family_is_there_once_and_whole() {
    let scrape = Scrape::of(&Router::idle(config(), 1));
    let own = NET_FAMILIES.iter().map(|f| f.name).chain(ROUTER_FAMILIES.iter().map(|f| f.name));
    let own = own.chain([families::SANDBOX_LAYER]);
    let got: Vec<_> = scrape.types.iter().map(|(name, _)| name.as_str()).collect();
    let own: Vec<_> = own.collect();
    assert_eq!(got[..own.len()], own);
    assert!(got[own.len()..].iter().all(|name| name.starts_with("process_")));
    assert!(got.contains(&"process_resident_memory_bytes"));
    assert!(scrape.get("process_resident_memory_bytes") > 0.0);
}

#[test]
fn counters_end_in_total_and_nothing_else_does() {
    for (name, kind) in Scrape::of(&Router::idle(config(), 1)).types {
        assert_eq!(name.ends_with("_total"), kind == "counter", "{name} is a {kind}");
    }
}

#[test]
fn every_reason_stands_at_0_before_anything_happened() {
    let scrape = Scrape::of(&Router::idle(config(), 2));
    for (net, node) in [("section-1", 1), ("section-1", 33), ("press", 7), ("none", 0)] {
        for direction in Direction::ALL {
            for reason in NetKind::Server.drop_reasons(direction) {
                let (direction, reason) = (direction.label(), reason.label());
                let series = format!(
                    "pnet_nat_dropped_datagrams_total{{net=\"{net}\",node=\"{node}\",direction=\"{direction}\",reason=\"{reason}\"}}"
                );
                assert_eq!(scrape.get(&series), 0.0);
            }
        }
    }
    // The three nodes and the strays have these series, and nothing else has.
    let of = |direction| NetKind::Server.drop_reasons(direction).len();
    let reasons: usize = Direction::ALL.into_iter().map(of).sum();
    assert_eq!(scrape.of_family("pnet_nat_dropped_datagrams_total").len(), 4 * reasons);
    for credential in ["service", "team-b"] {
        let labels = format!("net=\"section-1\",credential=\"{credential}\"");
        assert_eq!(scrape.get(&format!("pnet_nat_accepted_requests_total{{{labels}}}")), 0.0);
    }
    assert_eq!(scrape.of_family("pnet_nat_last_response_timestamp_seconds"), [0.0; 3]);
}

#[test]
fn the_kernel_carries_nothing_where_it_is_not_asked_to() {
    let scrape = Scrape::of(&Router::idle(config(), 1));
    for gauge in ["pnet_nat_kernel_offload", "pnet_nat_kernel_flows"] {
        assert_eq!(scrape.get(gauge), 0.0);
    }
}

#[test]
fn each_net_has_the_checksum_of_its_configuration() {
    let config = config();
    let of = |net| config.hash_of(net);
    let [section, press] = [of(SECTION), of(crate::nat::NetId(1))];
    assert_ne!(section, press);
    let scrape = Scrape::of(&Router::idle(config, 1));
    for (net, hash) in [("section-1", section), ("press", press)] {
        let series = format!("pnet_nat_config_hash{{net=\"{net}\",hash=\"{hash}\"}}");
        assert_eq!(scrape.get(&series), 1.0);
    }
    assert_eq!(scrape.of_family("pnet_nat_config_hash"), [1.0; 2], "strays have none");
}

#[test]
fn workers_are_added_up() {
    let (router, writer) = (Router::idle(config(), 2), Writer::of_worker());
    for (worker, n) in router.active_config().counters.iter().zip([3, 40]) {
        let requests = worker.node(NODE_33).direction(Direction::Request);
        requests.received.add(&writer, n);
        requests.forwarded.add(&writer, n - 1);
        requests.forwarded_bytes.add(&writer, 20 * (n - 1));
        requests.dropped(DropReason::PasswordWrong).add(&writer, 1);
        worker.net(SECTION).flows.add(&writer, n);
        worker.net(SECTION).flows_opened.add(&writer, n + 1);
        worker.net(SECTION).flows_closed(CloseReason::Idle).add(&writer, 1);
        worker.accepted(SECTION)[1].add(&writer, n);
        worker.stray.direction(Direction::Response).received.add(&writer, n);
        worker
            .stray
            .direction(Direction::Response)
            .dropped(DropReason::UnknownFlow)
            .add(&writer, n);
    }
    let scrape = Scrape::of(&router);
    let node_33 = "net=\"section-1\",node=\"33\",direction=\"request\"";
    let stray = "net=\"none\",node=\"0\",direction=\"response\"";
    for (series, value) in [
        (format!("pnet_nat_received_datagrams_total{{{node_33}}}"), 43.0),
        (format!("pnet_nat_forwarded_datagrams_total{{{node_33}}}"), 41.0),
        (format!("pnet_nat_forwarded_bytes_total{{{node_33}}}"), 820.0),
        (format!("pnet_nat_dropped_datagrams_total{{{node_33},reason=\"password_wrong\"}}"), 2.0),
        ("pnet_nat_accepted_requests_total{net=\"section-1\",credential=\"team-b\"}".into(), 43.0),
        ("pnet_nat_accepted_requests_total{net=\"section-1\",credential=\"service\"}".into(), 0.0),
        ("pnet_nat_flows{net=\"section-1\"}".into(), 43.0),
        ("pnet_nat_flows_opened_total{net=\"section-1\"}".into(), 45.0),
        ("pnet_nat_flows_closed_total{net=\"section-1\",reason=\"idle\"}".into(), 2.0),
        ("pnet_nat_flows_closed_total{net=\"section-1\",reason=\"shutdown\"}".into(), 0.0),
        ("pnet_nat_flow_limit{net=\"press\"}".into(), 4096.0),
        (format!("pnet_nat_received_datagrams_total{{{stray}}}"), 43.0),
        (format!("pnet_nat_dropped_datagrams_total{{{stray},reason=\"unknown_flow\"}}"), 43.0),
    ] {
        assert_eq!(scrape.get(&series), value, "{series}");
    }
}

#[test]
fn the_histogram_is_cumulative_and_ends_with_the_count() {
    let (router, writer) = (Router::idle(config(), 2), Writer::of_worker());
    let times = [150, 900, 900, 7_000, 60_000_000].map(Duration::from_micros);
    for (worker, time) in router.active_config().counters.iter().cycle().zip(times) {
        worker.node(NODE_1).response_times.observe(&writer, time);
    }
    let scrape = Scrape::of(&router);
    let node = "net=\"section-1\",node=\"1\"";
    let bucket =
        |le: &str| scrape.get(&format!("pnet_nat_response_seconds_bucket{{{node},le=\"{le}\"}}"));
    let bounds = RESPONSE_BUCKETS.map(|bound| bucket(&bound.to_string()));
    assert_eq!(bounds, [1.0, 1.0, 3.0, 3.0, 3.0, 4.0, 4.0, 4.0, 4.0, 4.0]);
    assert_eq!(bucket("+Inf"), 5.0);
    assert_eq!(scrape.get(&format!("pnet_nat_response_seconds_count{{{node}}}")), 5.0);
    let sum = scrape.get(&format!("pnet_nat_response_seconds_sum{{{node}}}"));
    assert!((sum - 60.008_95).abs() < 1e-9, "{sum}");
}

#[test]
fn the_last_response_is_the_latest_of_all_workers_in_unix_time() {
    let (router, writer) = (Router::idle(config(), 2), Writer::of_worker());
    for (worker, nanos) in
        router.active_config().counters.iter().zip([2_500_000_000, 1_000_000_000])
    {
        worker.node(NODE_1).last_response.set(&writer, nanos);
    }
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64();
    let scrape = Scrape::of(&router);
    let series = "pnet_nat_last_response_timestamp_seconds{net=\"section-1\",node=\"1\"}";
    assert!((scrape.get(series) - (now + 2.5)).abs() < 1.0);
    let read = scrape.get("pnet_nat_config_last_reload_success_timestamp_seconds");
    assert!((read - now).abs() < 1.0);
    assert_eq!(scrape.get("pnet_nat_config_last_reload_successful"), 1.0);
}

#[test]
fn who_waits_for_an_answer_is_told_since_when_in_unix_time() {
    let router = Router::idle(config(), 2);
    let (active, writer) = (router.active_config(), Writer::of_worker());
    let [first, second] = [&active.counters[0], &active.counters[1]];
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64();
    let waiting = || {
        let series = "pnet_nat_unanswered_since_timestamp_seconds{net=\"section-1\",node=\"1\"}";
        let since = Scrape::of(&router).get(series);
        (since > 0.0).then(|| (since - now).round())
    };
    assert_eq!(waiting(), None);
    first.node(NODE_1).last_request.set(&writer, 20_000_000_000);
    first.node(NODE_1).unanswered_since.set(&writer, 10_000_000_000);
    assert_eq!(waiting(), Some(10.0));
    second.node(NODE_1).last_response.set(&writer, 15_000_000_000);
    assert_eq!(waiting(), Some(15.0), "another worker passed on an answer");
    second.node(NODE_1).last_response.set(&writer, 25_000_000_000);
    assert_eq!(waiting(), None, "it answers others");
}

#[test]
fn text_comes_net_by_net_and_only_when_asked_for() {
    let router = Router::idle(config(), 1);
    let mut chunks = Metrics::new(router.clone(), Sandbox::off("in a test")).chunks();
    let first = chunks.next().unwrap();
    assert!(first.contains("section-1") && !first.contains("press"), "{first}");
    let active = router.active_config();
    let press = active.counters[0].node(crate::nat::MappingId(1));
    press.direction(Direction::Request).received.add(&Writer::of_worker(), 9);
    let second = chunks.next().unwrap();
    assert!(second.contains("node=\"7\",direction=\"request\"} 9\n"), "{second}");
}

#[test]
fn a_large_table_comes_in_pieces_that_are_small() {
    let mut config = config();
    config.table = crate::config::fixture::large_table(64);
    let (mut series, mut largest) = (0, 0);
    for chunk in Metrics::new(Router::idle(config, 2), Sandbox::off("in a test")).chunks() {
        series += chunk.lines().filter(|line| !line.starts_with('#')).count();
        largest = largest.max(chunk.len());
    }
    assert!(series > 64 * 125 * (23 + 6 + 13 + 2), "{series}");
    assert!(largest < 512 * 1024, "{largest}");
}
