//! The audit log as docs/log.md tells it: every event by its name, with its fields, and never more lines
//! than are allowed.

use std::collections::BTreeSet;
use std::net::UdpSocket;

use nix::sys::signal::Signal;
use serde_json::{Value, json};

use crate::harness::{
    FIGURE_10, Peer, Process, Relay, Settings, Site, WRONG, close, datagram, eventually, exchange,
    left_out, request,
};

const PAGE: &str = include_str!("../../docs/log.md");
const IN_THE_KERNEL: &str = "the kernel carries open flows";

/// Ten wrong passwords, and what shows that there were enough.
fn guess(relay: &Relay, site: &Site, stranger: &Peer) {
    for _ in 0..5 {
        stranger.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
    }
    eventually("the throttling is logged", || {
        let begun = relay.process.logged("throttling begun");
        begun.into_iter().find(|line| line["client"] == json!(stranger.address()))
    });
}

/// Each row of the page's table: an event happens here, and its line has these fields and no others.
#[test]
fn every_event_of_the_page_is_written_as_it_says() {
    let site = Site::claim();
    let limits = "[limits]\nwrong_password_burst = 2\nwrong_password_interval = \"500ms\"\n\
                  [log]\naudit_lines = 2";
    let net = "idle_timeout = \"1s\"";
    let configuration =
        site.configuration(&Settings { net, sections: limits, ..Settings::default() });
    let relay = Relay::start(&configuration, site.admin(), None);
    let (client, node, stranger) = (site.client(), site.node(4), site.client());
    exchange(&client, site.public(4), &node, 4);
    guess(&relay, &site, &stranger);
    eventually("all is over", || {
        let ended = relay.process.logged("throttling ended").pop()?;
        relay.process.logged("flow closed").pop().map(|_| ended)
    });
    for _ in 0..20 {
        exchange(&site.client(), site.public(4), &node, 4);
    }
    // Another program has the port of node 5, for a while.
    let other = UdpSocket::bind(site.public(5)).unwrap();
    relay.reload_to(&configuration.replace("\"1-4\"", "\"1-5\""));
    close(other);
    eventually("it listens", || relay.process.logged("listening").pop());
    relay.configure("no TOML");
    relay.reload();
    let log = relay.finish();
    let (impatient, not_carried) = (stopped_at_once(), not_carried());
    for (event, level, fields) in events() {
        let mut logs = [&log, &impatient, &not_carried].into_iter();
        if event == IN_THE_KERNEL && log.logged(IN_THE_KERNEL).is_empty() {
            left_out("flows in the kernel, which need privileges");
            continue;
        }
        let line = logs.find_map(|log| log.logged(&event).pop());
        let line = line.unwrap_or_else(|| panic!("{event}: {}", log.stderr()));
        assert_eq!(line["level"], json!(level), "{event}");
        let keys = line.as_object().unwrap().keys().map(String::as_str);
        let keys = keys.filter(|key| !["timestamp", "level", "message", "target"].contains(key));
        assert_eq!(keys.collect::<BTreeSet<_>>(), fields, "{event}");
    }
    let opened = log.logged("flow opened").len() as u64;
    assert_eq!(opened + lines_left_out(&log, "flow opened"), 21, "{}", log.stderr());
}

/// A relay that was signalled once more while it waited for an answer.
fn stopped_at_once() -> Process {
    let site = Site::claim();
    let mut relay = site.relay(Settings { runtime: "drain = \"1h\"", ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    client.send(site.public(4), &request(4));
    node.expect(&request(4));
    relay.process.signal(Signal::SIGTERM);
    eventually("it is stopping", || relay.process.logged("stopping").pop());
    relay.process.signal(Signal::SIGINT);
    assert_eq!(relay.process.end(), Some(1));
    relay.process
}

/// A relay of IPv6 alone, whose flows the kernel does not carry.
fn not_carried() -> Process {
    let site = Site::claim();
    let configuration = format!(
        "[public]\nlisten = [\"::1\"]\n[admin]\nlisten = \"{}\"\n[[server]]\nname = \"press\"\n\
         public_port = {}\nnode = 7\naddress = \"[::1]:34379\"\nallow = [\"::1\"]\n\
         [[server.password]]\nname = \"service\"\nfile = \"secrets/press\"",
        site.admin(),
        site.start_port()
    );
    Relay::start(&configuration, site.admin(), None).finish()
}

/// Whoever wants no flows in the kernel is not told that there are none.
#[test]
fn what_is_switched_off_is_not_told() {
    let site = Site::claim();
    let sections = "[datapath]\nkernel = \"off\"";
    let log = site.relay(Settings { sections, ..Settings::default() }).finish();
    assert_eq!(log.logged("open flows stay on the sockets"), [json!(null); 0]);
}

/// The other way round: what the sources of the audit log write stands in the page's table.
#[test]
fn every_event_of_the_code_is_on_the_page() {
    let told: BTreeSet<_> = events().into_iter().map(|(event, ..)| event).collect();
    let mut written = BTreeSet::new();
    for source in [
        include_str!("../../src/cli/run.rs"),
        include_str!("../../src/logging/faults.rs"),
        include_str!("../../src/reload.rs"),
        include_str!("../../src/datapath/reload.rs"),
        include_str!("../../src/logging/audit.rs"),
    ] {
        let source = source.replace("tracing::field", "field");
        // The message is the text that ends a call; those with a name in braces are made elsewhere.
        let calls = source.split("tracing::").skip(1).filter_map(|call| call.split_once("!("));
        let calls = calls.filter(|(level, _)| ["info", "warn", "error"].contains(level));
        let message = |(_, call): (_, &str)| {
            let pieces: Vec<_> = call.split('"').collect();
            let ends = |pair: &&[&str]| {
                pair[1].trim_start().starts_with(')') && pair[0] != "CARGO_PKG_VERSION"
            };
            pieces.windows(2).find(ends).map(|pair| pair[0].to_owned())
        };
        let names = source.split("=> \"").skip(1).map(|name| name.split('"').next().unwrap());
        let messages = calls.filter_map(message).filter(|message| !message.contains('{'));
        written.extend(messages.chain(names.map(str::to_owned)));
    }
    assert_eq!(written, told);
}

/// Event, level and fields, from the page's table.
fn events() -> Vec<(String, String, BTreeSet<&'static str>)> {
    let (_, table) =
        PAGE.split_once("| event | level | when | fields |\n|---|---|---|---|\n").unwrap();
    let rows = table.lines().take_while(|line| line.starts_with('|'));
    let events = rows.map(|row| {
        let cells: Vec<_> = row.split('|').map(str::trim).collect();
        let fields = cells[4].split('`').skip(1).step_by(2).collect();
        (cells[1].trim_matches('`').to_owned(), cells[2].to_uppercase(), fields)
    });
    let events: Vec<_> = events.collect();
    assert!(events.len() > 7, "{events:?}");
    events
}

/// What the windows together say was left out of one event's lines.
fn lines_left_out(log: &Process, event: &str) -> u64 {
    let lines = log.logged("audit lines left out").into_iter();
    lines.filter(|line| line["of"] == event).map(|line| line["count"].as_u64().unwrap()).sum()
}

/// Opened, closed and left out add up, for somebody with a right password and many ports, and for
/// somebody with wrong ones.
#[test]
fn many_events_make_few_lines_and_all_are_counted() {
    const TIMES: usize = 60;
    let site = Site::claim();
    let limits = "[limits]\nwrong_password_burst = 1\nwrong_password_interval = \"1h\"\n\
                  [datapath]\nprefilter = \"off\"\n[log]\naudit_lines = 10";
    let relay = site.relay(Settings { sections: limits, ..Settings::default() });
    let node = site.node(4);
    // Two addresses; all ports at once, or some would get one that another one had.
    let [clients, strangers] = [site.client(), site.client()].map(|peer| {
        let address = peer.address().ip();
        (0..TIMES).map(|_| Peer::bind((address, 0).into())).collect::<Vec<_>>()
    });
    for (client, stranger) in clients.iter().zip(&strangers) {
        exchange(client, site.public(4), &node, 4);
        for _ in 0..3 {
            stranger.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
        }
    }
    let times = TIMES as u64;
    relay
        .expect_drops(&[("request", "password_wrong", times), ("request", "throttled", 2 * times)]);
    let lines = |event| relay.process.logged(event).len() as u64;
    eventually("what is not written is counted", || {
        let left_out = relay.metrics().sum("pnet_nat_audit_lines_left_out_total", &[]);
        (lines("flow opened") + lines("throttling begun") + left_out == 2 * times).then_some(())
    });
    assert_eq!(relay.at_rest().sum("pnet_nat_flows_opened_total", &[]), times);
    let log = relay.finish();
    for event in ["flow opened", "flow closed", "throttling begun"] {
        let lines = log.logged(event).len();
        // A busy machine may need more than one window of 10 s.
        assert!((10..TIMES).contains(&lines), "{event}: {lines}");
        assert_eq!(lines as u64 + lines_left_out(&log, event), times, "{event}: {}", log.stderr());
    }
}

/// By which a firewall can act, and a person tell what happened.
#[test]
fn throttling_names_the_sender_or_the_address() {
    let site = Site::claim();
    let limits = "[limits]\nwrong_password_burst = 2\nwrong_password_interval = \"1h\"\n\
                  [datapath]\nprefilter = \"off\"\n[log]\naudit_lines = 10";
    let relay = site.relay(Settings { sections: limits, ..Settings::default() });
    let stranger = site.client();
    guess(&relay, &site, &stranger);
    // Two from each of 512 ports are what an address may send.
    let wrong = datagram(&FIGURE_10, &[], WRONG);
    let mut sent = 5;
    let of_address = eventually("the address is throttled", || {
        for _ in 0..20 {
            let other_port = Peer::bind((stranger.address().ip(), 0).into());
            (0..2).for_each(|_| other_port.send(site.public(4), &wrong));
            sent += 2;
        }
        let begun = relay.process.logged("throttling begun");
        begun.into_iter().find(|line| line["scope"] == "address")
    });
    let drops = eventually("all are dropped", || {
        let drops = relay.metrics().drops();
        (drops.values().sum::<u64>() == sent).then_some(drops)
    });
    let wrong = drops[&("request".to_owned(), "password_wrong".to_owned())];
    assert_eq!(wrong, 2 * 512, "{drops:?}");
    let log = relay.finish();
    let of_sender = &log.logged("throttling begun")[0];
    for (line, scope) in [(of_sender, "sender"), (&of_address, "address")] {
        let expected = json!({
            "level": "INFO",
            "scope": scope,
            "address": stranger.address().ip(),
            "net": "section-1",
            "node": 4,
            "public_port": site.public(4).port(),
        });
        for (key, value) in expected.as_object().unwrap() {
            assert_eq!(&line[key], value, "{key} in {line}");
        }
    }
    assert_eq!(of_sender["client"], Value::String(stranger.address().to_string()));
}
