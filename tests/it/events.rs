//! What happened, as `/api/v1/events`, `/api/v1/history` and `pnet-nat status --events` tell it.

use serde_json::Value;

use crate::harness::{
    FIGURE_10, Process, Relay, Settings, Site, WRONG, datagram, eventually, exchange, pnet_nat,
    request, response,
};

/// The events of these kinds, oldest first.
fn events(relay: &Relay, kinds: &[&str]) -> Vec<Value> {
    let (status, text) = relay.get("/api/v1/events").expect("an answer");
    assert_eq!(status, 200, "{text}");
    let answer: Value = serde_json::from_str(&text).unwrap();
    let all = answer["events"].as_array().unwrap();
    let numbers: Vec<_> = all.iter().map(|event| event["number"].as_u64().unwrap()).collect();
    assert!(numbers.is_sorted_by(|newer, older| newer > older), "{text}");
    let is_asked_for = |event: &&Value| kinds.contains(&event["kind"].as_str().unwrap());
    all.iter().rev().filter(is_asked_for).cloned().collect()
}

/// Waits for this many events of a kind, and returns the last one.
#[track_caller]
fn expect(relay: &Relay, kind: &str, count: usize) -> Value {
    let all = eventually(kind, || {
        let all = events(relay, &[kind]);
        (all.len() >= count).then_some(all)
    });
    assert_eq!(all.len(), count, "{all:#?}");
    all.last().unwrap().clone()
}

#[test]
fn a_node_falls_silent_and_answers_again_and_reloads_are_told_of() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    let start = expect(&relay, "start", 1);
    let text = start["text"].as_str().unwrap();
    assert!(text.ends_with("relays: 1 nets, 5 public ports, 1 workers"), "{text}");
    exchange(&client, site.public(4), &node, 4);
    client.send(site.public(4), &request(4));
    let upstream = node.expect(&request(4));

    let configuration = site.configuration(&Settings::default());
    relay.configure(&configuration.replace("\"1-4\", 33", "\"1-4\", 133"));
    assert_eq!(relay.reload()["message"], "reload failed");
    let failed = expect(&relay, "reload_failed", 1);
    let text = failed["text"].as_str().unwrap();
    assert!(text.starts_with("reload failed: the configuration is not sound: "), "{text}");
    assert!(text.contains("133"), "{text}");
    relay.reload_to(&configuration.replace("\"1-4\", 33", "\"1-5\", 33"));
    let done = expect(&relay, "reload", 1);
    assert_eq!(done["text"], "reload: nodes added: section-1: 5");

    let silent = expect(&relay, "node_silent", 1);
    assert_eq!((&silent["net"], &silent["node"]), (&"section-1".into(), &4.into()));
    assert_eq!(silent["text"], "node 4 of section-1 is silent");
    assert!(silent["time"].as_f64() < failed["time"].as_f64(), "since when it is silent");
    node.send(upstream, &response(4));
    let answers = expect(&relay, "node_answers", 1);
    let text = answers["text"].as_str().unwrap();
    assert!(text.starts_with("node 4 of section-1 answers again after "), "{text}");
    assert_eq!(events(&relay, &["node_silent"]).len(), 1);

    let history: Value =
        serde_json::from_str(&relay.get("/api/v1/history?net=section-1").unwrap().1).unwrap();
    let requests = history["hour"]["requests"].as_array().unwrap();
    assert_eq!((requests.len(), history["day"]["flows"].as_array().unwrap().len()), (360, 1440));
    assert!(requests.iter().any(|rate| rate.as_f64() > Some(0.0)), "{requests:?}");
    assert_eq!(history["nodes"]["5"].as_str().unwrap().len(), 1440);
    assert_eq!(relay.get("/api/v1/history?net=nobody").unwrap().0, 404);

    let url = format!("http://{}", site.admin());
    let mut table = Process::start(pnet_nat(&["status", "--events", "--url", &url]));
    assert_eq!(table.end(), Some(0), "{}", table.stderr());
    let table = table.stdout();
    assert!(table.lines().nth(2).unwrap().contains("node 4 of section-1 answers again"), "{table}");
    assert!(table.contains("| reload_failed |"), "{table}");
    let arguments = ["status", "--events", "--format", "json", "--url", &url];
    let mut json = Process::start(pnet_nat(&arguments));
    assert_eq!(json.end(), Some(0), "{}", json.stderr());
    let json: Value = serde_json::from_str(&json.stdout()).unwrap();
    assert_eq!(json["events"].as_array().unwrap().len(), 5, "{json:#}");
    relay.finish();
}

#[test]
fn a_flood_that_begins_and_ends_is_told_of_once_each() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let stranger = site.client();
    let wrong = datagram(&FIGURE_10, &[1, 2, 3], WRONG);
    eventually("the flood is noticed", || {
        (0..1000).for_each(|_| stranger.send(site.public(4), &wrong));
        relay.process.logged("flood: prefilter on").pop()
    });
    (0..1000).for_each(|_| stranger.send(site.public(4), &wrong));
    let began = expect(&relay, "flood_began", 1);
    assert_eq!(began["text"], "flood of section-1: the kernel refuses it");
    eventually("the flood is over", || {
        relay.process.logged("floods are over: prefilter off").pop()
    });
    let ended = expect(&relay, "flood_ended", 1);
    assert_eq!((&ended["net"], &ended["node"]), (&"section-1".into(), &Value::Null));
    let text = ended["text"].as_str().unwrap();
    assert!(text.starts_with("end of the flood of section-1: the kernel refused "), "{text}");
    let throttled = events(&relay, &["throttled"]);
    assert!((1..10).contains(&throttled.len()), "{throttled:#?}");
    let text = throttled[0]["text"].as_str().unwrap();
    assert!(text.ends_with("after too many wrong passwords for node 4 of section-1"), "{text}");
    assert_eq!(events(&relay, &["flood_began", "flood_ended"]).len(), 2);
    relay.finish();
}
