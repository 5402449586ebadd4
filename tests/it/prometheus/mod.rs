//! `deploy/prometheus` and `deploy/grafana` at work: a Prometheus server scrapes a relay under
//! traffic, its sums are right, the alerts that ought to fire do, and whatever the dashboard and
//! docs/monitoring.md ask has an answer.

mod fleet;
mod grafana;
mod rules;
mod server;

use std::collections::BTreeSet;
use std::io::Write;
use std::process::{Command, Stdio};

use serde_json::Value;

use self::server::{Prometheus, Sample, has_prometheus};
use crate::harness::{
    FIGURE_10, Relay, Settings, Site, WRONG, datagram, eventually, exchange, request, response,
};

const DASHBOARD: &str = include_str!("../../../deploy/grafana/dashboards/pnet-nat.json");
const FLEET: &str = include_str!("../../../deploy/grafana/dashboards/pnet-nat-fleet.json");
const PAGE: &str = include_str!("../../../docs/monitoring.md");

const ANSWERED: u64 = 25;
const UNANSWERED: u64 = 5;
const WRONG_PASSWORDS: u64 = 30;

#[test]
fn a_server_scrapes_a_relay_under_traffic() {
    if !has_prometheus() {
        return;
    }
    let site = Site::claim();
    // Flows close while somebody looks.
    let settings = Settings { net: "idle_timeout = \"3s\"", ..Settings::default() };
    let relay = site.relay(settings.clone());
    let prometheus = Prometheus::start(&site);
    // What is counted before the first scrape is no increase.
    prometheus.eventually("pnet_nat_received_datagrams_total");
    traffic(&site, &relay);

    let metrics = relay.get("/metrics").unwrap().1;
    check_metrics(&metrics);
    the_sums_are_right(&prometheus);
    the_right_alerts_fire(&prometheus);
    a_failed_reload_is_told_until_one_succeeds(&prometheus, &relay, &site.configuration(&settings));
    let queries = every_query_of_a_dashboard_has_an_answer(&prometheus, DASHBOARD);
    assert!(queries > 30, "{queries}");
    every_query_of_the_page_is_understood(&prometheus);
    relay.finish();
}

#[test]
fn a_server_shows_the_token() {
    if !has_prometheus() {
        return;
    }
    let site = Site::claim();
    let admin = format!("listen = \"{}\"", site.admin());
    let with_token = format!("{admin}\ntoken_file = \"secrets/admin\"");
    let configuration = site.configuration(&Settings::default()).replace(&admin, &with_token);
    let _relay = Relay::start(&configuration, site.admin(), None);
    let with_token = [
        ("# authorization:", "authorization:"),
        ("#   credentials_file: /etc/prometheus/pnet-nat-token", "  credentials_file: token"),
    ];
    let prometheus = Prometheus::start_with(&site, &with_token);
    let up = prometheus.eventually("up{job=\"pnet-nat\"}");
    assert_eq!(up[0].1, 1.0);
}

/// Node 4 answers, node 3 does not; three strangers guess, and a device sends what nobody asked for.
fn traffic(site: &Site, relay: &Relay) {
    let (client, node, silent) = (site.client(), site.node(4), site.node(3));
    for _ in 0..ANSWERED {
        exchange(&client, site.public(4), &node, 4);
    }
    let asked = (0..UNANSWERED).map(|_| {
        client.send(site.public(3), &request(3));
        silent.expect(&request(3))
    });
    let upstream = asked.last().unwrap();
    let device = site.client();
    device.send(upstream, &response(4));
    for stranger in (0..3).map(|_| site.client()) {
        for _ in 0..WRONG_PASSWORDS / 3 {
            stranger.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
        }
    }
    relay.expect_drops(&[
        ("request", "password_wrong", WRONG_PASSWORDS),
        ("response", "unknown_flow", 1),
    ]);
    eventually("the flows close", || {
        let closed = [("reason", "idle")];
        (relay.metrics().sum("pnet_nat_flows_closed_total", &closed) >= 2).then_some(())
    });
}

/// Names, types, units and help as Prometheus wants them.
fn check_metrics(metrics: &str) {
    let mut promtool = Command::new("promtool")
        .args(["check", "metrics"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    promtool.stdin.take().unwrap().write_all(metrics.as_bytes()).unwrap();
    let output = promtool.wait_with_output().unwrap();
    let said = [output.stdout, output.stderr].concat();
    assert!(output.status.success() && said.is_empty(), "{}", String::from_utf8_lossy(&said));
}

fn the_sums_are_right(prometheus: &Prometheus) {
    let asked = ANSWERED + UNANSWERED;
    for (query, expected) in [
        ("sum(pnet_nat_received_datagrams_total{direction=\"request\"})", asked + WRONG_PASSWORDS),
        ("sum(pnet_nat_received_datagrams_total{direction=\"response\"})", ANSWERED + 1),
        ("sum(pnet_nat_forwarded_datagrams_total{direction=\"request\"})", asked),
        ("sum(pnet_nat_forwarded_datagrams_total{direction=\"response\"})", ANSWERED),
        ("sum(pnet_nat_dropped_datagrams_total{reason=\"password_wrong\"})", WRONG_PASSWORDS),
        ("sum(pnet_nat_dropped_datagrams_total{net=\"none\"})", 1),
        ("sum(pnet_nat_dropped_datagrams_total)", WRONG_PASSWORDS + 1),
        ("pnet_nat_accepted_requests_total{credential=\"service\"}", asked),
        ("sum(pnet_nat_response_seconds_count{net=\"section-1\"})", ANSWERED),
        ("pnet_nat_flows_opened_total - on (net) sum by (net) (pnet_nat_flows_closed_total)", 0),
        ("pnet_nat_flows", 0),
    ] {
        eventually(&format!("{query} is {expected}"), || {
            (prometheus.value(query) == Some(expected as f64)).then_some(())
        });
    }
    let places = "sum by (instance, net, node, direction)";
    let breaches = format!(
        "{places} (pnet_nat_received_datagrams_total) - {places} (pnet_nat_forwarded_datagrams_total) \
         - {places} (pnet_nat_dropped_datagrams_total)"
    );
    let balances = prometheus.query(&breaches).unwrap();
    assert_eq!(balances.len(), 2 * (5 + 1), "five nodes and the strays, two directions");
    assert!(balances.iter().all(|(_, balance)| *balance == 0.0), "{balances:?}");
}

fn the_right_alerts_fire(prometheus: &Prometheus) {
    let firing = "ALERTS{alertstate=\"firing\"}";
    let expected = [("PnetNatNodeSilent", Some("3")), ("PnetNatWrongPasswords", None)];
    eventually("two alerts fire", || (prometheus.query(firing).ok()?.len() == 2).then_some(()));
    let alerts = prometheus.query(firing).unwrap();
    let alerts: BTreeSet<_> = alerts
        .iter()
        .map(|(labels, _)| (labels["alertname"].as_str(), labels.get("node").map(String::as_str)))
        .collect();
    assert_eq!(alerts, BTreeSet::from(expected));
}

fn a_failed_reload_is_told_until_one_succeeds(
    prometheus: &Prometheus,
    relay: &Relay,
    configuration: &str,
) {
    let alert = "ALERTS{alertname=\"PnetNatReloadFailed\",alertstate=\"firing\"}";
    relay.configure(&configuration.replace("start_port", "start_prot"));
    assert_eq!(relay.reload()["message"], "reload failed");
    prometheus.eventually(alert);
    relay.reload_to(configuration);
    eventually("the alert is over", || prometheus.query(alert).ok()?.is_empty().then_some(()));
}

/// Returns how many queries its panels have.
fn every_query_of_a_dashboard_has_an_answer(prometheus: &Prometheus, dashboard: &str) -> usize {
    let dashboard: Value = serde_json::from_str(dashboard).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    let mut queries = 0;
    for panel in panels.iter().filter(|panel| panel["type"] != "row") {
        let title = &panel["title"];
        for target in panel["targets"].as_array().expect("a panel asks for something") {
            // Without what it falls back on, which always has an answer.
            let query = filled_in(&target["expr"]);
            let found = prometheus.eventually(query.trim_end_matches(" or vector(0)"));
            let legend = target["legendFormat"].as_str().unwrap_or_default();
            for label in legend.split("{{").skip(1) {
                has_label(&found, label.split("}}").next().unwrap(), title);
            }
            queries += 1;
        }
    }
    let variables = dashboard["templating"]["list"].as_array().unwrap();
    for variable in variables.iter().filter(|variable| variable["type"] == "query") {
        let query = filled_in(&variable["query"]["query"]);
        let inside = query.strip_prefix("label_values(").and_then(|rest| rest.strip_suffix(')'));
        let (series, label) = inside.unwrap().rsplit_once(", ").unwrap();
        has_label(&prometheus.eventually(series), label, &variable["name"]);
    }
    for annotation in dashboard["annotations"]["list"].as_array().unwrap() {
        prometheus.eventually(&filled_in(&annotation["expr"]));
    }
    queries
}

/// A query as Grafana asks it when everything is chosen.
fn filled_in(query: &Value) -> String {
    let query = query.as_str().expect("a query").replace("$__rate_interval", "5m");
    let query = query.replace("$__range", "5m");
    let query =
        ["$instance", "$node", "$net", "$site"].iter().fold(query, |q, name| q.replace(name, ".*"));
    assert!(!query.contains('$'), "{query}");
    query
}

#[track_caller]
fn has_label(samples: &[Sample], label: &str, shown: &Value) {
    let has = samples.iter().all(|(labels, _)| labels.contains_key(label));
    assert!(has, "{shown}: {label} in {samples:?}");
}

fn every_query_of_the_page_is_understood(prometheus: &Prometheus) {
    let mut queries = 0;
    for block in PAGE.split("```promql\n").skip(1) {
        let block = block.split("```").next().unwrap();
        for query in block.split("\n\n") {
            prometheus.query(query).unwrap_or_else(|error| panic!("{query}: {error}"));
            queries += 1;
        }
    }
    assert!(queries > 1, "{queries}");
}
