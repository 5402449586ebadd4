//! Another configuration for a relay at work: what did not change goes on as if nothing happened,
//! what did is in force at once, and what cannot be leaves everything as it was.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs::{self, Permissions};
use std::net::{SocketAddr, UdpSocket};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use nix::sys::signal::Signal;
use nix::sys::stat::Mode;
use nix::unistd::{geteuid, mkfifo};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::{
    DEVICE, FIGURE_10, Network, Over, PASSWORD, PATIENCE, Peer, Place, Process, Relay, SECOND,
    Settings, Site, close, datagram, eventually, exchange, folder, left_out, pause, pnet_nat,
    request, response,
};

const SUCCESSFUL: &str = "pnet_nat_config_last_reload_successful";
const SUCCESS_TIME: &str = "pnet_nat_config_last_reload_success_timestamp_seconds";

/// With one worker, and with two.
const RUNTIMES: [&str; 2] = ["workers = 1\ndrain = \"100ms\"", "workers = 2\ndrain = \"100ms\""];

pub(crate) const FIRST_AND_SECOND: &str = r#"
[[udp_range_net.password]]
name = "first"
file = "secrets/section-1"
[[udp_range_net.password]]
name = "second"
file = "secrets/press"
"#;

pub(crate) const FIRST: &str = r#"
[[udp_range_net.password]]
name = "first"
file = "secrets/section-1"
"#;

/// Another section, whose servers are nowhere.
fn section(name: &str, start_port: u16, subnet: &str) -> String {
    format!(
        "[[udp_range_net]]\nname = \"{name}\"\nstart_port = {start_port}\nsubnet = \"{subnet}\"\n\
         nodes = [\"1-20\"]\nallow = [\"127.0.0.0/8\"]\n[[udp_range_net.password]]\n\
         name = \"service\"\nfile = \"secrets/press\"\n"
    )
}

/// The configuration with another section before all others: in the table, each has a new place.
fn led_by(section: &str, configuration: &str) -> String {
    configuration.replacen("[[udp_range_net]]", &format!("{section}\n[[udp_range_net]]"), 1)
}

/// The relay's ports towards the nodes, by client and node.
fn upstream_ports(relay: &Relay) -> BTreeSet<String> {
    let (_, flows) = relay.get("/api/v1/flows").unwrap();
    let flows: Value = serde_json::from_str(&flows).unwrap();
    let of =
        |flow: &Value| format!("{} {} {}", flow["client"], flow["node"], flow["upstream_port"]);
    flows["flows"].as_array().unwrap().iter().map(of).collect()
}

/// Asks nodes 1 to 4 in turn until it is over; whatever does not come back is lost for good.
fn poll(client: &Peer, site: &Site, answers: &AtomicU64, over: &AtomicBool) {
    for node_address in (1..=4).cycle() {
        if over.load(Relaxed) {
            break;
        }
        client.send(site.public(node_address), &request(node_address));
        assert_eq!(client.receive().1, site.public(node_address), "who answers");
        answers.fetch_add(1, Relaxed);
    }
}

#[test]
fn unchanged_mappings_lose_nothing_while_others_come_and_go() {
    for runtime in RUNTIMES {
        let site = Site::claim();
        let swapped = section("swapped", 22_000, "127.2.2.0");
        let settings = Settings { runtime, sections: &swapped, ..Settings::default() };
        let without = site.configuration(&settings);
        let with = led_by(&section("other", 21_000, "127.2.1.0"), &without);
        let relay = Relay::start(&with, site.admin(), None);
        let nodes = site.simulated_nodes("0s");
        let clients: Vec<_> = (0..5).map(|_| site.client()).collect();
        let (answers, over) = (AtomicU64::new(0), AtomicBool::new(false));
        let reloads = 40;
        thread::scope(|scope| {
            for client in &clients {
                scope.spawn(|| poll(client, &site, &answers, &over));
            }
            let over = Over(&over);
            eventually("every flow is open", || (upstream_ports(&relay).len() == 20).then_some(()));
            let ports = upstream_ports(&relay);
            let mut scrape = relay.metrics();
            for round in 0..reloads {
                let asked = answers.load(Relaxed);
                eventually("there is load", || (answers.load(Relaxed) > asked + 20).then_some(()));
                relay.set_password("press", [SECOND, DEVICE][round % 2]);
                let line = relay.reload_to([&without, &with][round % 2]);
                let (now, away) = ("other: 1-20", round % 2 == 0);
                let key = if away { "mappings_removed" } else { "mappings_added" };
                assert_eq!(line[key], json!([now]), "{line}");
                assert_eq!(line["flows_closed"], 0, "{line}");
                let next = relay.metrics();
                assert_eq!(next.behind(&scrape), [""; 0], "counters run backwards");
                scrape = next;
            }
            assert_eq!(upstream_ports(&relay), ports);
            drop(over);
        });
        // What was asked is what was answered.
        let answers = answers.load(Relaxed);
        let of_section = [("net", "section-1"), ("direction", "response")];
        let metrics = relay.at_rest();
        assert_eq!(metrics.sum("pnet_nat_forwarded_datagrams_total", &of_section), answers);
        assert_eq!(metrics.sum(SUCCESSFUL, &[]), 1);
        relay.expect_drops(&[]);
        let log = relay.finish();
        assert_eq!(log.logged("reload").len(), reloads);
        assert_eq!(log.logged("flow opened").len(), 20);
        drop(nodes);
    }
}

/// Whether the kernel knows the passwords or not.
#[test]
fn a_withdrawn_password_stops_at_once_and_an_added_one_works_at_once() {
    for (runtime, prefilter) in
        RUNTIMES.iter().flat_map(|r| ["off", "auto", "always"].map(|p| (r, p)))
    {
        let site = Site::claim();
        let sections = format!("[datapath]\nprefilter = \"{prefilter}\"");
        let settings = Settings { runtime, sections: &sections, ..Settings::default() };
        let both =
            site.configuration(&Settings { passwords: FIRST_AND_SECOND, ..settings.clone() });
        let one = site.configuration(&Settings { passwords: FIRST, ..settings });
        let relay = Relay::start(&one, site.admin(), None);
        let node = site.node(4);
        let (stays, goes) = (site.client(), site.client());
        let port = exchange(&stays, site.public(4), &node, 4);

        let line = relay.reload_to(&both);
        assert_eq!(line["credentials_added"], json!(["section-1: second"]), "{line}");
        let second = datagram(&FIGURE_10, &[], SECOND);
        goes.send(site.public(4), &second);
        node.expect(&second);

        let line = relay.reload_to(&one);
        assert_eq!(line["credentials_withdrawn"], json!(["section-1: second"]), "{line}");
        assert_eq!(line["flows_closed"], 1, "{line}");
        let closed = relay.process.logged("flow closed");
        assert_eq!(closed.len(), 1);
        assert_eq!(closed[0]["reason"], "password_withdrawn");
        assert_eq!(closed[0]["client"], json!(goes.address()));
        assert_eq!(closed[0]["credential"], "second");
        goes.send(site.public(4), &second);
        assert_eq!(exchange(&stays, site.public(4), &node, 4), port, "its flow goes on");
        assert_eq!(node.waiting(), None, "a withdrawn password opens nothing");

        // Another password in the same file.
        relay.set_password("section-1", DEVICE);
        let line = relay.reload();
        assert_eq!(line["credentials_changed"], json!(["section-1: first"]), "{line}");
        assert_eq!(line["flows_closed"], 1, "{line}");
        stays.send(site.public(4), &request(4));
        let third = datagram(&FIGURE_10, &[], DEVICE);
        goes.send(site.public(4), &third);
        node.expect(&third);
        eventually("both old passwords are refused", || {
            let metrics = relay.metrics();
            let refused = metrics.sum("pnet_nat_kernel_dropped_datagrams_total", &[]);
            let dropped = metrics.drops().values().sum::<u64>();
            (refused + dropped == 2 && (refused > 0) == (prefilter == "always")).then_some(())
        });
        relay.finish();
    }
}

#[test]
fn a_removed_mapping_stops_listening_and_works_again_when_put_back() {
    for runtime in RUNTIMES {
        let site = Site::claim();
        let with = site.configuration(&Settings { runtime, ..Settings::default() });
        let without = with.replace("\"1-4\", 33", "\"1-3\", 33");
        assert_ne!(with, without);
        let relay = Relay::start(&with, site.admin(), None);
        let (client, node, stays) = (site.client(), site.node(4), site.node(3));
        exchange(&client, site.public(4), &node, 4);
        exchange(&client, site.public(3), &stays, 3);

        let line = relay.reload_to(&without);
        assert_eq!(line["mappings_removed"], json!(["section-1: 4"]), "{line}");
        let closed = relay.process.logged("flow closed");
        assert_eq!(closed.len(), 1);
        assert_eq!(
            (&closed[0]["reason"], &closed[0]["node"]),
            (&json!("mapping_removed"), &json!(4))
        );
        let other = UdpSocket::bind(site.public(4)).expect("the port is free");
        client.send(site.public(4), &request(4));
        let mut octets = [0; 128];
        other.set_read_timeout(Some(PATIENCE)).unwrap();
        assert_eq!(other.recv(&mut octets).unwrap(), request(4).len(), "the relay has it no more");

        // Another program has the port: all else comes into force, above all what is withdrawn.
        relay.configure(&with);
        relay.set_password("section-1", SECOND);
        let line = relay.reload();
        assert_eq!(
            (&line["message"], &line["level"]),
            (&json!("reload"), &json!("INFO")),
            "{line}"
        );
        let item = line["not_in_force"].to_string();
        let public = site.public(4).to_string();
        assert!(item.contains(&public) && item.contains("in use"), "{line}");
        assert_eq!(line["credentials_changed"], json!(["section-1: service"]), "{line}");
        let told = relay.process.logged("not in force").pop().expect("a line for each item");
        assert_eq!(told["what"], format!("UDP port {public}"), "{told}");
        assert_eq!(relay.metrics().sum(SUCCESSFUL, &[]), 0);
        client.send(site.public(3), &request(3));
        let mut second = request(3);
        let password = second.len() - SECOND.len();
        second[password..].copy_from_slice(SECOND);
        client.send(site.public(3), &second);
        stays.expect(&second);

        // It is tried again until the port is free, without anybody's doing.
        close(other);
        let line = eventually("it listens", || relay.process.logged("listening").pop());
        assert_eq!(line["listen"], format!("UDP port {public}"), "{line}");
        assert_eq!(relay.metrics().sum(SUCCESSFUL, &[]), 1);
        relay.set_password("section-1", PASSWORD);
        assert_eq!(relay.reload_to(&with)["not_in_force"], json!([]));
        exchange(&client, site.public(4), &node, 4);
        exchange(&client, site.public(3), &stays, 3);
        relay.finish();
    }
}

/// An answer leaves from where its request came to, or not at all.
#[test]
fn a_flow_ends_with_the_address_that_it_came_by() {
    for runtime in RUNTIMES {
        let site = Site::claim();
        let [first, second] = [site.public_address(), site.address(199)];
        let both = site.configuration(&Settings { runtime, ..Settings::default() }).replacen(
            &format!("[\"{first}\"]"),
            &format!("[\"{first}\", \"{second}\"]"),
            1,
        );
        let relay = Relay::start(&both, site.admin(), None);
        let (client, node) = (site.client(), site.node(4));
        exchange(&client, site.public(4), &node, 4);
        let by_second = (second, site.public(4).port()).into();
        let port = exchange(&client, by_second, &node, 4);

        let third = site.address(198);
        let line = relay.reload_to(&both.replacen(&first.to_string(), &third.to_string(), 1));
        assert_eq!(line["settings_changed"], json!(["[public] listen"]), "{line}");
        assert_eq!(line["flows_closed"], 1, "{line}");
        let closed = relay.process.logged("flow closed");
        assert_eq!(closed[0]["public_address"], json!(first), "{}", closed[0]);
        UdpSocket::bind(site.public(4)).expect("the port is free");
        assert_eq!(exchange(&client, by_second, &node, 4), port);
        exchange(&client, (third, site.public(4).port()).into(), &node, 4);
        relay.finish();
    }
}

/// Each fault alone leaves the relay as it was.
#[test]
fn a_fault_changes_nothing() {
    let site = Site::claim();
    let sound = site.configuration(&Settings::default());
    let relay = Relay::start(&sound, site.admin(), None);
    let (client, node) = (site.client(), site.node(4));
    let port = exchange(&client, site.public(4), &node, 4);
    let (_, in_force) = relay.get("/api/v1/config").unwrap();
    let started = relay.metrics().sum(SUCCESS_TIME, &[]);
    for (number, wrong) in [
        sound.replace("\"1-4\", 33", "\"1-4\", 126"),
        sound.replace("secrets/section-1", "secrets/absent"),
        sound.replace("[public]", "[public"),
    ]
    .iter()
    .enumerate()
    {
        assert_ne!(*wrong, sound);
        relay.configure(wrong);
        let line = relay.reload();
        assert_eq!(line["message"], "reload failed", "{line}");
        assert_eq!(line["error"], "the configuration is not sound", "{line}");
        assert_eq!(relay.metrics().sum(SUCCESSFUL, &[]), 0);
        assert_eq!(relay.metrics().sum(SUCCESS_TIME, &[]), started);
        assert_eq!(exchange(&client, site.public(4), &node, 4), port);
        assert_eq!(relay.get("/api/v1/config").unwrap().1, in_force);
        let state = reload_state(&relay);
        assert_eq!(state["error"], "the configuration is not sound", "{state}");
        assert_eq!((&state["number"], &state["begun"]), (&json!(number + 1), &json!(number + 1)));
        let fault = state["faults"][0].as_str().unwrap();
        assert!(fault.contains("pnet-nat.toml:"), "{state}");
    }
    let faults = relay.process.logged("configuration fault");
    assert_eq!(faults.len(), 3);
    assert_eq!(faults[0]["key"], "udp_range_net[0].nodes[1]");
    assert_eq!(faults[1]["key"], "udp_range_net[0].password[0].file");
    for fault in faults {
        assert!(fault["file"].as_str().unwrap().ends_with("pnet-nat.toml"), "{fault}");
        assert!(fault["line"].as_u64().unwrap() > 1, "{fault}");
        assert!(!fault["remedy"].as_str().unwrap().is_empty(), "{fault}");
    }

    let line = relay.reload_to(&sound);
    assert_eq!(line["flows_closed"], 0, "{line}");
    let mut lists = line.as_object().unwrap().iter().filter(|(key, _)| key.contains("s_"));
    assert!(lists.all(|(key, value)| key == "flows_closed" || *value == json!([])), "{line}");
    assert_eq!(relay.metrics().sum(SUCCESSFUL, &[]), 1);
    assert_eq!(exchange(&client, site.public(4), &node, 4), port);
    relay.finish();
}

/// What the admin server tells of the last reload.
fn reload_state(relay: &Relay) -> Value {
    let status: Value = serde_json::from_str(&relay.get("/api/v1/status").unwrap().1).unwrap();
    status["reload"].clone()
}

/// What needs a restart, or a socket that cannot be had, keeps nothing else from coming into force.
#[test]
fn what_cannot_come_into_force_is_named_and_all_else_does() {
    let site = Site::claim();
    let both = site.configuration(&Settings { passwords: FIRST_AND_SECOND, ..Settings::default() });
    let one = site.configuration(&Settings { passwords: FIRST, ..Settings::default() });
    let relay = Relay::start(&both, site.admin(), None);
    let (stays, goes, node) = (site.client(), site.client(), site.node(4));
    let port = exchange(&stays, site.public(4), &node, 4);
    let listen = format!("listen = [\"{}\"]", site.public_address());
    let gone = format!("listen = [\"{}\", \"192.0.2.1\"]", site.public_address());
    let low = section("low", 600, "127.2.3.0");
    for (wrong, what, why) in [
        (one.replace("workers = 1", "workers = 2"), "[runtime] workers", "until a restart"),
        (one.replace("[runtime]", "[runtime]\nuser = \"nobody\""), "[runtime] user", "restart"),
        (one.clone() + "\n[datapath]\nkernel = \"required\"\n", "[datapath] kernel", "a restart"),
        (one.replace(":9378", ":9379"), "[admin] listen", "until a restart"),
        (one.replace("[admin]", "[admin]\nenabled = false"), "[admin] enabled", "a restart"),
        (
            one.clone() + &low,
            &format!("UDP ports 601-620 of {}", site.public_address()),
            "needs CAP_NET_BIND_SERVICE",
        ),
        (
            one.replacen(&listen, &gone, 1),
            "UDP ports 20001-20004, 20033 of 192.0.2.1",
            "no address of this host",
        ),
    ] {
        let second = datagram(&FIGURE_10, &[], SECOND);
        goes.send(site.public(4), &second);
        node.expect(&second);
        assert_ne!(wrong, one);
        relay.configure(&wrong);
        let line = relay.reload();
        assert_eq!(line["message"], "reload", "{line}");
        assert_eq!(line["credentials_withdrawn"], json!(["section-1: second"]), "{line}");
        let told = relay.process.logged("not in force").pop().unwrap();
        assert_eq!(told["what"], *what, "{told}");
        assert!(told["why"].as_str().unwrap().contains(why), "{told}");
        assert_eq!(relay.metrics().sum(SUCCESSFUL, &[]), 0);
        let state = reload_state(&relay);
        assert_eq!((&state["successful"], &state["error"]), (&json!(false), &Value::Null));
        assert_eq!(state["not_in_force"], json!([{"what": what, "why": told["why"]}]), "{state}");

        goes.send(site.public(4), &second);
        assert_eq!(exchange(&stays, site.public(4), &node, 4), port);
        assert_eq!(node.waiting(), None, "the password is withdrawn");
        relay.reload_to(&both);
        assert_eq!(relay.metrics().sum(SUCCESSFUL, &[]), 1);
    }
    relay.finish();
}

/// `pnet-nat reload` tells the relay's own verdict, and its exit code is that.
#[test]
fn the_command_tells_the_verdict() {
    let site = Site::claim();
    let sound = site.configuration(&Settings::default());
    let relay = Relay::start(&sound, site.admin(), None);
    let pid = relay.process.id().to_string();
    let file = relay.folder.path().join("pnet-nat.toml");
    let file = file.to_str().unwrap();
    let reload = |arguments: &[&str]| {
        let mut command = Process::start(pnet_nat(&[&["reload"][..], arguments].concat()));
        (command.end(), command.stdout(), command.stderr())
    };
    let by_signal = ["--pid", &pid, "--config", file];
    let (code, stdout, stderr) = reload(&by_signal);
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    assert_eq!(stdout, "nothing changed\nall of the configuration is in force\n");

    for (wrong, expected) in [
        (sound.replace("\"1-4\", 33", "\"1-500\""), "1-500"),
        (sound.replace("[public]", "[public"), "pnet-nat.toml:2"),
        (sound.replace("workers = 1", "workers = 2"), "not in force: [runtime] workers"),
    ] {
        relay.configure(&wrong);
        // What is wrong may be where the admin server's address would be read.
        let url = format!("http://{}", site.admin());
        let (code, stdout, stderr) = reload(&["--pid", &pid, "--url", &url]);
        assert_eq!(code, Some(1), "{stdout}{stderr}");
        assert!(stdout.contains(expected), "{stdout}{stderr}");
    }

    // Without a process, through the admin server, where that may.
    relay.configure(&sound);
    let (code, _, stderr) = reload(&["--config", file]);
    assert!(code == Some(1) && stderr.contains("--pid"), "{stderr}");
    relay.configure(&sound.replace("[admin]", "[admin]\nreload = true"));
    assert_eq!(reload(&by_signal).0, Some(0));
    let (code, stdout, stderr) = reload(&["--config", file]);
    assert_eq!(code, Some(0), "{stdout}{stderr}");

    // With the admin server switched off nobody tells; the signal is sent all the same.
    relay.configure(&sound.replace("[admin]", "[admin]\nenabled = false"));
    let before = relay.process.logged("reload").len();
    let (code, _, stderr) = reload(&by_signal);
    assert!(code == Some(1) && stderr.contains("the outcome is not known"), "{stderr}");
    eventually("it has reloaded", || (relay.process.logged("reload").len() > before).then_some(()));
    let (code, _, stderr) = reload(&["--pid", "999999999", "--config", file]);
    assert!(code == Some(1) && stderr.contains("cannot be signalled"), "{stderr}");
    relay.finish();
}

/// The relay's own ports towards the plant are all of those that a new net listens on: it gives them
/// up. What is withdrawn by the same reload is withdrawn, and whoever had such a port goes on at once
/// with another.
#[test]
fn a_new_net_on_ports_that_the_relay_has_itself() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        fs::write("/proc/sys/net/ipv4/ip_local_port_range", "40000 40249").unwrap();
        for runtime in RUNTIMES {
            let place = Place { start_port: 20000, ..network.place(r#"["198.51.100.1"]"#) };
            let settings = Settings { runtime, ..Settings::default() };
            let both = place.configuration(&Settings { passwords: FIRST_AND_SECOND, ..settings });
            let one = both.replace(FIRST_AND_SECOND, FIRST);
            let relay = Relay::start(&both, place.admin, None);
            let (node, public) = (network.node(4), "198.51.100.1:20004".parse().unwrap());
            let clients: Vec<_> = (0..100).map(|_| network.client("198.51.100.7")).collect();
            let ports: BTreeSet<_> =
                clients.iter().map(|client| exchange(client, public, &node, 4)).collect();
            assert_eq!(ports.len(), 100);
            let second = datagram(&FIGURE_10, &[], SECOND);
            let goes = network.client("198.51.100.8");
            goes.send(public, &second);
            node.expect(&second);

            let new = section("new", 40_000, "172.17.18.0").replace("1-20", "1-125");
            let new = new.replace("127.0.0.0/8", "0.0.0.0/0");
            let line = relay.reload_to(&(one.clone() + &new));
            assert_eq!(line["not_in_force"], json!([]), "{line}");
            assert_eq!(line["credentials_withdrawn"], json!(["section-1: second"]), "{line}");
            let closed = relay.process.logged("flow closed");
            let wanted = closed.iter().filter(|line| line["reason"] == "port_wanted").count();
            assert!(wanted >= 20, "of 250 ports, 125 are listened on: {wanted} flows closed");
            goes.send(public, &second);
            for client in &clients[..20] {
                let port = exchange(client, public, &node, 4);
                assert!(!(40_001..=40_125).contains(&port), "{port}");
            }
            assert_eq!(node.waiting(), None, "the password is withdrawn");
            relay.finish();
        }
    });
}

/// The node answers what it was asked before the reload after it: nobody's exchange is lost.
#[test]
fn the_last_answers_come_in_over_ports_that_a_new_net_wants() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        fs::write("/proc/sys/net/ipv4/ip_local_port_range", "40000 40249").unwrap();
        for runtime in RUNTIMES {
            let place = Place { start_port: 20000, ..network.place(r#"["198.51.100.1"]"#) };
            let one = place.configuration(&Settings { runtime, ..Settings::default() });
            let relay = Relay::start(&one, place.admin, None);
            let (node, public) = (network.node(4), "198.51.100.1:20004".parse().unwrap());
            let clients: Vec<_> = (0..100).map(|_| network.client("198.51.100.7")).collect();
            let asked: Vec<_> = { clients.iter() }
                .map(|client| {
                    client.send(public, &request(4));
                    node.expect(&request(4))
                })
                .collect();
            let is_wanted = |address: &&SocketAddr| (40_001..=40_125).contains(&address.port());
            assert!(asked.iter().filter(is_wanted).count() >= 20, "{asked:?}");

            let new = section("new", 40_000, "172.17.18.0").replace("1-20", "1-125");
            let new = new.replace("127.0.0.0/8", "0.0.0.0/0");
            thread::scope(|scope| {
                scope.spawn(|| {
                    pause(Duration::from_millis(100));
                    asked.iter().for_each(|&relay| node.send(relay, &response(4)));
                });
                relay.reload_to(&(one.clone() + &new));
            });
            for client in &clients {
                assert_eq!(client.expect(&response(4)), public);
            }
            eventually("all of it is in force", || {
                let metrics = relay.metrics();
                let successful = metrics.sum(SUCCESSFUL, &[]);
                (successful == 1).then_some(())
            });
            clients.iter().for_each(|client| {
                let port = exchange(client, public, &node, 4);
                assert!(!(40_001..=40_125).contains(&port), "{port}");
            });
            relay.expect_drops(&[]);
            relay.finish();
        }
    });
}

/// From one address to all of them and back: the old sockets are in the way of the new ones, and go.
#[test]
fn from_one_address_to_all_and_back() {
    for runtime in RUNTIMES {
        let site = Site::claim();
        let one = site.configuration(&Settings { runtime, ..Settings::default() });
        let listen = format!("listen = [\"{}\"]", site.public_address());
        // On all addresses, so none of the ports that other scenarios have on theirs.
        let start = 25_000 + u16::from(site.address(0).octets()[2]) % 56 * 128;
        let one = one.replace("start_port = 20000", &format!("start_port = {start}"));
        let all = one.replacen(&listen, "listen = [\"0.0.0.0\"]", 1);
        assert_ne!(one, all);
        let relay = Relay::start(&one, site.admin(), None);
        let (client, node) = (site.client(), site.node(4));
        let public = (site.public_address(), start + 4).into();
        let other = (site.address(199), start + 4).into();
        exchange(&client, public, &node, 4);
        for _ in 0..2 {
            let line = relay.reload_to(&all);
            assert_eq!(line["not_in_force"], json!([]), "{line}");
            exchange(&client, public, &node, 4);
            exchange(&client, other, &node, 4);
            let line = relay.reload_to(&one);
            assert_eq!(line["not_in_force"], json!([]), "{line}");
            exchange(&client, public, &node, 4);
            UdpSocket::bind(other).expect("nobody has the port of the other address");
        }
        relay.finish();
    }
}

/// While it goes over to other ports, the relay would have the old sockets and the new ones: with
/// this hard limit, each half fits and both together do not. So it opens the rest once the old ones
/// are closed.
#[test]
fn other_ports_come_into_force_where_both_halves_together_are_too_many_descriptors() {
    let site = Site::claim();
    let sections = [section("a", 21_000, "127.2.1.0"), section("b", 22_000, "127.2.2.0")].concat();
    let sections = sections.replace("1-20", "1-125");
    let settings = Settings { sections: &sections, descriptors: Some(440), ..Settings::default() };
    let first = site.configuration(&settings);
    let second = first.replace("= 21000", "= 23000").replace("= 22000", "= 24000");
    let relay = site.relay(settings);
    let descriptors = || fs::read_dir(format!("/proc/{}/fd", relay.process.id())).unwrap().count();
    let (client, node) = (site.client(), site.node(4));
    let port = exchange(&client, site.public(4), &node, 4);
    let before = descriptors();
    for next in [&second, &first, &second, &first] {
        let line = relay.reload_to(next);
        assert_eq!(line["not_in_force"], json!([]), "{line}");
        assert_eq!(exchange(&client, site.public(4), &node, 4), port);
        // The connection of a request may still be open.
        assert!(descriptors() <= before + 2, "{} of {before}", descriptors());
    }
    UdpSocket::bind((site.public_address(), 23_001)).expect("what was bound is free again");

    // More than the limit ever allows: as many as fit, and the rest is named.
    let more = first.clone() + &section("c", 23_000, "127.2.3.0").replace("1-20", "1-125");
    let line = relay.reload_to(&more);
    assert!(line["not_in_force"].to_string().contains("hard limit is 440"), "{line}");
    assert_eq!(exchange(&client, site.public(4), &node, 4), port);
    assert!(descriptors() <= 440 - 100, "{} descriptors: enough are kept", descriptors());
    relay.reload_to(&first);
    relay.finish();
}

/// A confined relay reads only folders that its configuration named at the start, and says so.
#[test]
fn a_password_file_in_another_folder_is_refused_with_the_remedy() {
    let site = Site::claim();
    let first = site.configuration(&Settings::default());
    let relay = Relay::start(&first, site.admin(), None);
    if relay.process.logged("confined").is_empty() {
        return left_out("Landlock in the kernel");
    }
    let (client, node) = (site.client(), site.node(4));
    let port = exchange(&client, site.public(4), &node, 4);
    let elsewhere = folder("");
    let password = elsewhere.path().join("secrets/section-1");
    relay.configure(&first.replace("secrets/section-1", password.to_str().unwrap()));
    assert_eq!(relay.reload()["message"], "reload failed");
    let fault = relay.process.logged("configuration fault").pop().unwrap();
    assert_eq!(fault["key"], "udp_range_net[0].password[0].file", "{fault}");
    assert!(fault["problem"].as_str().unwrap().contains("the relay's confinement"), "{fault}");
    let remedy = fault["remedy"].as_str().unwrap();
    assert!(remedy.contains("only the folders that its files were in"), "{fault}");
    assert_eq!(exchange(&client, site.public(4), &node, 4), port);
    relay.reload_to(&first);
    relay.finish();
}

/// What `check` warns of comes true: the relay reads no folder that its link leads to later.
#[test]
fn a_link_that_leads_to_another_folder_is_refused_with_the_remedy() {
    let site = Site::claim();
    let configuration = site.configuration(&Settings::default());
    let [first, second] = [(); 2].map(|()| folder(&configuration));
    let place = tempfile::tempdir().unwrap();
    let current = place.path().join("current");
    symlink(first.path(), &current).unwrap();
    let path = current.join("pnet-nat.toml");
    let path = path.to_str().unwrap();
    let mut checked = Process::start(pnet_nat(&["check", "--config", path]));
    assert_eq!(checked.end(), Some(0));
    let warnings = checked.stderr();
    let told = format!("{path}: is reached by the link {} to the folder", current.display());
    assert_eq!(warnings.matches(&told).count(), 1, "{warnings}");
    assert!(warnings.contains("keep the files in one real folder"), "{warnings}");

    let process = Process::start(pnet_nat(&["run", "--config", path]));
    eventually("it relays", || process.logged("relaying").pop());
    if process.logged("confined").is_empty() {
        return left_out("Landlock in the kernel");
    }
    let (client, node) = (site.client(), site.node(4));
    let port = exchange(&client, site.public(4), &node, 4);
    let switched = place.path().join("next");
    symlink(second.path(), &switched).unwrap();
    fs::rename(&switched, &current).unwrap();
    process.signal(Signal::SIGHUP);
    eventually("it is refused", || process.logged("reload failed").pop());
    let fault = process.logged("configuration fault").pop().unwrap();
    let remedy = fault["remedy"].as_str().unwrap();
    assert!(remedy.contains("links lead elsewhere now"), "{fault}");
    assert!(remedy.contains("keep the files in one real folder"), "{fault}");
    assert_eq!(exchange(&client, site.public(4), &node, 4), port);
}

/// Every setting that can change while it runs does.
#[test]
fn settings_follow_the_configuration() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    let port = exchange(&client, site.public(4), &node, 4);
    let config = || serde_json::from_str::<Value>(&relay.get("/api/v1/config").unwrap().1).unwrap();
    assert_eq!(
        (&config()["prefilter"], &config()["busy_poll_seconds"]),
        (&json!("auto"), &json!(0.0))
    );
    let changed = Settings {
        net: "max_flows = 7",
        runtime: "workers = 1\ndrain = \"200ms\"",
        sections: "[limits]\nmax_flows = 99\n\
                   [datapath]\nprefilter = \"always\"\nbusy_poll = \"20us\"\nreceive_buffer = 8192\n\
                   [log]\naudit_lines = 7",
        ..Settings::default()
    };
    let line = relay.reload_to(&site.configuration(&changed));
    assert_eq!(
        line["settings_changed"],
        json!(["[limits]", "[datapath]", "[log]", "[runtime]"]),
        "{line}"
    );
    assert_eq!(line["nets_changed"], json!(["section-1"]), "{line}");
    let config = config();
    assert_eq!(
        (&config["prefilter"], &config["busy_poll_seconds"]),
        (&json!("always"), &json!(20e-6))
    );
    assert_eq!((&config["max_flows"], &config["drain_seconds"]), (&json!(99), &json!(0.2)));
    assert_eq!(config["receive_buffer_bytes"], 8192);
    assert_eq!(config["audit_lines"], 7);
    assert_eq!(relay.metrics().sum("pnet_nat_flow_limit", &[("net", "section-1")]), 7);
    assert_eq!(exchange(&client, site.public(4), &node, 4), port);

    // Another header: nothing of the old kind passes.
    let line = relay.reload_to(
        &(site.configuration(&Settings::default()) + "[protocol]\nheader = \"02000001\""),
    );
    assert_eq!(
        line["settings_changed"],
        json!(["[protocol] header", "[limits]", "[datapath]", "[log]", "[runtime]"]),
        "{line}"
    );
    client.send(site.public(4), &request(4));
    let mut other = request(4);
    other[3] = 1;
    client.send(site.public(4), &other);
    node.expect(&other);
    relay.expect_drops(&[("request", "bad_header", 1)]);
    relay.finish();
}

#[test]
fn the_admin_server_reloads_where_it_may() {
    let site = Site::claim();
    let off = site.configuration(&Settings::default());
    let on = off.replace("[admin]", "[admin]\nreload = true");
    let relay = Relay::start(&off, site.admin(), None);
    relay.configure(&on);
    let (status, text) = relay.post_reload();
    assert!(status == 403 && text.contains("SIGHUP"), "{status} {text}");
    assert_eq!(relay.get("/-/reload").unwrap().0, 405);
    assert_eq!(relay.process.logged("reload").len(), 0);

    relay.reload();
    let more = on.replace("\"1-4\", 33", "\"1-4\", \"33-35\"");
    relay.configure(&more);
    let (status, text) = relay.post_reload();
    let changes: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(status, 200);
    assert_eq!(changes["mappings_added"], json!(["section-1: 34-35"]), "{text}");
    assert_eq!(changes["nets_removed"], json!([]), "{text}");

    relay.configure(&more.replace("allow =", "alow ="));
    let (status, text) = relay.post_reload();
    assert_eq!(status, 422);
    assert!(text.contains("udp_range_net[0].alow") && text.contains("did you mean"), "{text}");
    assert_eq!(text.lines().count(), 2, "the key that is missing, and the one that is too much");
    assert_eq!(relay.metrics().sum(SUCCESSFUL, &[]), 0);

    relay.configure(&off);
    assert_eq!(relay.post_reload().0, 200);
    assert_eq!(relay.post_reload().0, 403);
    relay.finish();
}

#[test]
fn file_descriptors_stay_as_many_over_200_reloads() {
    let site = Site::claim();
    let runtime = RUNTIMES[1];
    let other = section("other", 21_000, "127.2.1.0");
    let on = |sections: &str| {
        let configuration =
            site.configuration(&Settings { runtime, sections, ..Settings::default() });
        configuration.replace("[admin]", "[admin]\nreload = true")
    };
    let (with, without) = (on(&other), on(""));
    let relay = Relay::start(&with, site.admin(), None);
    let descriptors = || fs::read_dir(format!("/proc/{}/fd", relay.process.id())).unwrap().count();
    let mut counts = Vec::new();
    for round in 0..200 {
        relay.configure([&without, &with][round % 2]);
        assert_eq!(relay.post_reload().0, 200);
        if round % 2 == 1 {
            counts.push(descriptors());
        }
    }
    // The connection of a request may still be open.
    let (least, most) = (counts.iter().min().unwrap(), counts.iter().max().unwrap());
    assert!(most - least <= 2, "{counts:?}");
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);
    relay.finish();
}

#[test]
fn a_flood_of_hangups_is_a_few_reloads() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    for _ in 0..500 {
        relay.process.signal(Signal::SIGHUP);
    }
    let end = site.configuration(&Settings { net: "max_flows = 5", ..Settings::default() });
    relay.configure(&end);
    relay.process.signal(Signal::SIGHUP);
    eventually("the last one counts", || {
        (relay.metrics().sum("pnet_nat_flow_limit", &[]) == 5).then_some(())
    });
    let reloads = relay.process.logged("reload").len();
    assert!(reloads < 250, "{reloads} reloads");
    relay.finish();
}

/// A service manager may signal whenever it likes: here, to a relay that is stopped in its start.
#[test]
fn a_hangup_during_the_start_is_a_reload_after_it() {
    let site = Site::claim();
    let folder = folder(&site.configuration(&Settings::default()));
    let file = folder.path().join("pnet-nat.toml");
    let mut process = Process::start(pnet_nat(&["run", "--config", file.to_str().unwrap()]));
    eventually("it takes the signal", || {
        let status = fs::read_to_string(format!("/proc/{}/status", process.id())).unwrap();
        let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
        (u64::from_str_radix(caught.trim(), 16).unwrap() & 1 == 1).then_some(())
    });
    process.signal(Signal::SIGSTOP);
    let second = site.configuration(&Settings { net: "max_flows = 5", ..Settings::default() });
    fs::write(&file, second).unwrap();
    process.signal(Signal::SIGHUP);
    process.signal(Signal::SIGCONT);
    eventually("it reloads", || process.logged("reload").pop());
    process.signal(Signal::SIGTERM);
    assert_eq!(process.end(), Some(0));
    assert_eq!(process.logged("reload").len(), 1);
}

/// A name may lead to anything: what is no file is refused, and holds up no later reload.
#[test]
fn what_is_no_file_holds_up_no_reload() {
    let site = Site::claim();
    let configuration = site.configuration(&Settings::default());
    let relay = Relay::start(&configuration, site.admin(), None);
    let (file, secret) = ("pnet-nat.toml", "secrets/section-1");
    for name in [file, secret] {
        let path = relay.folder.path().join(name);
        let octets = fs::read(&path).unwrap();
        fs::remove_file(&path).unwrap();
        mkfifo(&path, Mode::S_IRUSR | Mode::S_IWUSR).unwrap();
        let line = relay.reload();
        assert_eq!(line["message"], "reload failed", "{line}");
        let fault = relay.process.logged("configuration fault").pop().unwrap();
        let problem = fault["problem"].as_str().unwrap();
        assert!(problem.contains("is a named pipe, not a regular file"), "{fault}");
        fs::remove_file(&path).unwrap();
        fs::write(&path, octets).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o600)).unwrap();
        relay.reload_to(&configuration);
    }
    relay.finish();
}

/// Files that are mounted one by one, as containers are often given them, and then replaced on the
/// host: what is there stays the old file.
#[test]
fn a_mounted_file_that_is_replaced_is_told_from_a_new_one() {
    let site = Site::claim();
    let host = tempfile::tempdir().unwrap();
    let names = ["secrets/section-1", "pnet-nat.toml"];
    let command = |arguments: &[&str]| {
        let folder = Path::new(arguments[2]).parent().unwrap();
        let mut mounts = String::new();
        for name in names {
            let (from, to) = (host.path().join(name.replace('/', "-")), folder.join(name));
            fs::copy(&to, &from).unwrap();
            writeln!(mounts, "mount --bind {} {}", from.display(), to.display()).unwrap();
        }
        let mut command = Command::new("unshare");
        command.args(["--mount", "sh", "-ec", &(mounts + "exec \"$0\" \"$@\"")]);
        let relay = pnet_nat(arguments);
        command.arg(relay.get_program()).args(relay.get_args());
        command
    };
    if !geteuid().is_root() {
        return left_out("root, to mount files");
    }
    let configuration = site.configuration(&Settings::default());
    let relay = Relay::start_as(&configuration, site.admin(), command);
    assert_eq!(relay.reload()["message"], "reload");
    for name in names {
        let path = host.path().join(name.replace('/', "-"));
        fs::copy(&path, path.with_extension("new")).unwrap();
        fs::rename(path.with_extension("new"), path).unwrap();
        let line = relay.reload();
        assert_eq!(line["message"], "reload failed", "{line}");
        let fault = relay.process.logged("configuration fault").pop().unwrap();
        let file = if name == names[0] { &fault["problem"] } else { &fault["file"] };
        assert!(file.as_str().unwrap().contains(name), "{fault}");
        let said = |key: &str, part: &str| fault[key].as_str().unwrap().contains(part);
        assert!(said("problem", "replaced") && said("problem", "nothing has changed"), "{fault}");
        assert!(said("remedy", "mount the folder"), "{fault}");
    }
    relay.finish();
}

/// systemd, played by a socket.
#[test]
fn the_service_manager_is_told() {
    let site = Site::claim();
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("notify");
    let manager = UnixDatagram::bind(&path).unwrap();
    manager.set_read_timeout(Some(PATIENCE)).unwrap();
    let next = || {
        let mut octets = [0; 1024];
        let length = manager.recv(&mut octets).unwrap();
        String::from_utf8(octets[..length].to_vec()).unwrap()
    };
    // The next message that is no ping.
    let next_state = || loop {
        let message = next();
        if message.trim_end() != "WATCHDOG=1" {
            return message;
        }
    };
    let configuration = site.configuration(&Settings::default());
    let environment = [("NOTIFY_SOCKET", path.to_str().unwrap()), ("WATCHDOG_USEC", "2000000")];
    let mut relay = Relay::start_as(&configuration, site.admin(), |arguments| {
        let mut command = pnet_nat(arguments);
        command.envs(environment);
        command
    });
    let ready = next_state();
    assert!(ready.starts_with("READY=1\nSTATUS=relaying; nets: 1, public ports: 5"), "{ready}");
    for _ in 0..3 {
        assert_eq!(next().trim_end(), "WATCHDOG=1");
    }

    relay.configure(&configuration.replace("\"1-4\"", "\"1-3\""));
    for (result, status) in [
        ("reload", "STATUS=relaying; nets: 1, public ports: 4"),
        ("reload failed", "STATUS=reload failed, as before: relaying; nets: 1, public ports: 4"),
    ] {
        assert_eq!(relay.reload()["message"], result);
        let reloading = next_state();
        let time = reloading.strip_prefix("RELOADING=1\nMONOTONIC_USEC=").expect(&reloading);
        let time: u64 = time.split('\n').next().unwrap().parse().unwrap();
        let uptime = fs::read_to_string("/proc/uptime").unwrap();
        let uptime: f64 = uptime.split(' ').next().unwrap().parse().unwrap();
        assert!((uptime - time as f64 / 1e6).abs() < 20.0, "{time} µs, up {uptime} s");
        let ready = next_state();
        assert!(ready.starts_with("READY=1\n") && ready.contains(status), "{ready}");
        relay.configure("no TOML");
    }
    relay.process.signal(Signal::SIGTERM);
    assert!(next_state().starts_with("STOPPING=1\n"));
    assert_eq!(relay.process.end(), Some(0));
}

/// A reload while requests wait at the node: their answers find the way back.
#[test]
fn answers_that_are_due_cross_a_reload() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    client.send(site.public(4), &request(4));
    let way_back = node.expect(&request(4));
    let other = section("other", 21_000, "127.2.1.0");
    let first = site.configuration(&Settings::default());
    relay.reload_to(&led_by(&other, &first));
    node.send(way_back, &response(4));
    assert_eq!(client.expect(&response(4)), site.public(4));
    relay.reload_to(&first);
    assert_eq!(exchange(&client, site.public(4), &node, 4), way_back.port());
    relay.finish();
}
