//! What a person or a machine that watches gets to see: logs, API, health. And what never.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::{Value, json};

use crate::harness::{
    FIGURE_10, Settings, Site, WRONG, datagram, eventually, exchange, pause, pnet_nat, request,
};
use crate::harness::{PASSWORDS, Process};

/// DropReport makes one line a sender, however much it sends.
#[test]
fn wrong_passwords_make_one_line_for_each_sender() {
    let site = Site::claim();
    let limits = "[limits]\nwrong_password_burst = 1000";
    let relay = site.relay(Settings { sections: limits, ..Settings::default() });
    let strangers: Vec<_> = (0..5).map(|_| site.client()).collect();
    for n in 0..35 {
        strangers[n % 5].send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
    }
    relay.expect_drops(&[("request", "password_wrong", 35)]);
    let log = relay.finish();
    let lines = log.log().filter(|line| line["reason"] == "password_wrong").collect::<Vec<_>>();
    assert_eq!(lines.len(), 5, "{}", log.stderr());
    for (line, stranger) in lines.iter().zip(&strangers) {
        let sender = stranger.address().ip();
        let message = line["message"].as_str().unwrap();
        assert!(message.starts_with(&format!("7 wrong passwords from {sender} in ")), "{message}");
        assert_eq!((&line["level"], &line["net"]), (&json!("WARN"), &json!("section-1")));
        assert_eq!((&line["count"], &line["sources"]), (&json!(7), &json!(1)));
        assert_eq!((&line["last_sender"], &line["nodes"]), (&json!(sender), &json!("4")));
    }
}

/// N-10, RFC 6888 section 4.
#[test]
fn a_flow_is_logged_when_it_opens_and_when_it_closes() {
    let site = Site::claim();
    let relay = site.relay(Settings { net: "idle_timeout = \"1s\"", ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    let port = exchange(&client, site.public(4), &node, 4);
    exchange(&client, site.public(4), &node, 4);
    let closed = eventually("the idle flow closes", || relay.process.logged("flow closed").pop());
    let port_after = exchange(&client, site.public(4), &node, 4);
    assert_eq!(port_after, port, "R-41: its own pair does not have to rest for it");
    let log = relay.finish();

    let opened = log.logged("flow opened");
    assert_eq!(opened.len(), 2, "{}", log.stderr());
    let reasons = log.logged("flow closed").into_iter().map(|line| line["reason"].clone());
    assert_eq!(reasons.collect::<Vec<_>>(), ["idle", "shutdown"]);
    for line in [&opened[0], &closed] {
        let expected = json!({
            "level": "INFO",
            "net": "section-1",
            "node": 4,
            "client": client.address(),
            "public_address": site.public_address(),
            "public_port": site.public(4).port(),
            "credential": "service",
            "upstream_port": port,
        });
        for (key, value) in expected.as_object().unwrap() {
            assert_eq!(&line[key], value, "{key} in {line}");
        }
        assert!(line["timestamp"].as_str().unwrap().ends_with('Z'), "{line}");
    }
}

#[test]
fn the_api_shows_nets_flows_and_configuration_without_passwords() {
    let site = Site::claim();
    let passwords = "[[udp_range_net.password]]\nname = \"service\"\nfile = \"secrets/section-1\"\n\
                     [[udp_range_net.password]]\nname = \"other\"\nfile = \"secrets/press\"\n\
                     device_file = \"secrets/section-1-device\"";
    let relay = site.relay(Settings { passwords, ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    let port = exchange(&client, site.public(4), &node, 4);
    let ask = |path: &str| {
        let (status, body) = relay.get(path).unwrap();
        assert_eq!(status, 200);
        for password in PASSWORDS {
            assert!(!body.contains(str::from_utf8(password).unwrap()), "{body}");
        }
        serde_json::from_str::<Value>(&body).unwrap()
    };
    let config = ask("/api/v1/config");
    assert_eq!(config["listen"], json!([site.public_address()]));
    assert_eq!(
        config["nets"][0]["credentials"],
        json!([
            {"name": "service", "has_device_password": false},
            {"name": "other", "has_device_password": true},
        ])
    );
    assert_eq!(config["nets"][0]["nodes"].as_array().unwrap().len(), 5);

    let flows = ask("/api/v1/flows");
    assert_eq!(flows["flows"].as_array().unwrap().len(), 1);
    let flow = &flows["flows"][0];
    assert_eq!(flow["client"], json!(client.address()));
    assert_eq!((&flow["node"], &flow["upstream_port"]), (&json!(4), &json!(port)));

    let nets = ask("/api/v1/nets");
    assert_eq!(nets["nets"][0]["accepted_requests"], json!({"service": 1, "other": 0}));
    relay.finish();
}

/// A slow answer is seen in the histogram, a last one in its time.
#[test]
fn response_times_are_measured() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    client.send(site.public(4), &request(4));
    let from_relay = node.expect(&request(4));
    crate::harness::pause(std::time::Duration::from_millis(60));
    node.send(from_relay, &request(4));
    client.expect(&request(4));
    let metrics = relay.at_rest();
    let of_node = [("net", "section-1"), ("node", "4")];
    assert_eq!(metrics.sum("pnet_nat_response_seconds_count", &of_node), 1);
    let under = |bound| [("node", "4"), ("le", bound)];
    assert_eq!(metrics.sum("pnet_nat_response_seconds_bucket", &under("0.05")), 0);
    assert_eq!(metrics.sum("pnet_nat_response_seconds_bucket", &under("+Inf")), 1);
    let last = metrics.sum("pnet_nat_last_response_timestamp_seconds", &of_node);
    let now = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap().as_secs();
    assert!(now.abs_diff(last) <= 5, "{last} is about {now}");
    relay.finish();
}

#[test]
fn healthcheck_says_whether_the_relay_is_ready() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let url = format!("http://{}/-/ready", site.admin());
    let healthcheck = || Process::start(pnet_nat(&["healthcheck", "--url", &url])).end();
    assert_eq!(healthcheck(), Some(0));
    relay.finish();
    assert_eq!(healthcheck(), Some(1));
}

/// While nothing is open, no thread of the relay wakes up. The history has no gap for that.
#[test]
fn a_relay_with_nothing_to_do_sleeps() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let mut tries = (0..6).map(|_| {
        let before = wake_ups(relay.process.id());
        pause(Duration::from_secs(11));
        wake_ups(relay.process.id()) - before
    });
    assert!(tries.any(|woken| woken == 0), "it wakes up again and again");

    exchange(&site.client(), site.public(4), &site.node(4), 4);
    let requests = eventually("a step with the request", || {
        let (_, history) = relay.get("/api/v1/history")?;
        let history: Value = serde_json::from_str(&history).ok()?;
        let requests = history["hour"]["requests"].as_array()?.clone();
        requests.last()?.as_f64().filter(|&rate| rate > 0.0).map(|_| requests)
    });
    let since_start: Vec<_> = requests.iter().skip_while(|rate| rate.is_null()).collect();
    assert!(since_start.len() > 2 && !since_start.contains(&&Value::Null), "{since_start:?}");
    relay.finish();
}

/// How often the threads of a process have woken up. One is left out: it follows changes of the machine's
/// interfaces, which other tests make.
fn wake_ups(process: u32) -> u64 {
    let threads = std::fs::read_dir(format!("/proc/{process}/task")).unwrap();
    let threads = threads.map(|thread| thread.unwrap().path());
    let of = |thread: &Path, what| std::fs::read_to_string(thread.join(what)).unwrap();
    let counted = threads.filter(|thread| of(thread, "comm").trim() != "interfaces");
    let woken = |thread: PathBuf| {
        let status = of(&thread, "status");
        let line = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
        line.unwrap().trim().parse::<u64>().unwrap()
    };
    counted.map(woken).sum()
}
