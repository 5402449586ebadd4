//! A `[[remote_net]]`: a program that knows neither UDP Range nets nor passwords reaches another
//! plant. Local program, adapter, Internet, router and node are in three network namespaces.
//!
//! Needs root.

use std::collections::VecDeque;
use std::fs;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use serde_json::json;

use crate::harness::{
    Capture, DEVICE, FIGURE_10, Network, Over, PASSWORD, Packet, Peer, Process, Relay, Settings,
    datagram, eventually, folder, pnet_nat, response,
};

/// Of an adapter on a machine on the Internet.
const SETTINGS: &str = r#"
[admin]
listen = "127.0.0.1:9378"
[runtime]
drain = "5s"
"#;

const NET: &str = r#"
[[remote_net]]
name = "plant-2"
router = "198.51.100.1"
start_port = 20000
nodes = ["1-4"]
local_subnet = "127.17.2.0"
allow = ["127.0.0.0/8"]
[[remote_net.password]]
name = "service"
file = "secrets/section-1"
"#;

const PUBLIC: &str = r#"["198.51.100.1"]"#;

/// The router's passwords.
const BOTH: &str = r#"
[[udp_range_net.password]]
name = "service"
file = "secrets/section-1"
[[udp_range_net.password]]
name = "new"
file = "secrets/press"
"#;

/// What a local program has: an IP Range net, without a password.
const TABLE: &str = r#"
node_address = 3
[[ip_net]]
id = 5
type = "IPRange"
address = "127.17.2.0"
port = 34378
router = 0
"#;

/// Where a local program finds a node.
fn local(node_address: u8) -> SocketAddr {
    ([127, 17, 2, node_address], 34378).into()
}

/// The request of Figure 10 without a password, to this node.
fn request(node_address: u8) -> Vec<u8> {
    let mut route = FIGURE_10;
    route[1] = node_address;
    datagram(&route, &[], b"")
}

/// The same octets with the password.
fn with_password(octets: &[u8]) -> Vec<u8> {
    [octets, PASSWORD].concat()
}

fn without_password(octets: &[u8]) -> Vec<u8> {
    octets.strip_suffix(PASSWORD).expect("an answer with a password").to_vec()
}

/// Asks the adapter, which is not where the scenario runs.
fn at_the_adapter<T: Send>(network: &Network, ask: impl FnOnce() -> T + Send) -> T {
    network.internet.enter(ask)
}

/// Ends the scenario on both sides.
fn finish(network: &Network, router: Relay, adapter: Relay) {
    router.expect_drops(&[]);
    router.finish();
    at_the_adapter(network, || {
        adapter.expect_drops(&[]);
        adapter.finish();
    });
}

fn start_adapter(network: &Network) -> Relay {
    let configuration = [SETTINGS, NET].concat();
    at_the_adapter(network, || {
        Relay::start(&configuration, "127.0.0.1:9378".parse().unwrap(), None)
    })
}

/// A router with these passwords.
fn router(passwords: &str) -> Settings<'_> {
    Settings { runtime: "drain = \"5s\"", passwords, ..Settings::default() }
}

fn start_router(network: &Network) -> Relay {
    network.place(PUBLIC).relay(&router(BOTH))
}

/// The nodes 1 to 4 as processes.
fn start_nodes(network: &Network) -> Process {
    let folder = folder("");
    let files = ["section-1", "press"].map(|name| folder.path().join("secrets").join(name));
    let [old, new] = files.each_ref().map(|file| file.to_str().unwrap());
    let of_both = ["--password-file", old, "--password-file", new];
    let arguments = [&["node", "--listen", "172.17.17.1-4"][..], &of_both].concat();
    let nodes = network.plant.enter(|| Process::start(pnet_nat(&arguments)));
    eventually("the nodes are there", || (nodes.stdout().lines().count() == 4).then_some(()));
    nodes
}

/// The UDP datagrams of a capture. On loopback it sees each twice: as it leaves, and as it arrives.
fn datagrams(capture: Capture) -> Vec<(SocketAddr, SocketAddr, Vec<u8>)> {
    let mut all: Vec<_> = capture
        .end()
        .into_iter()
        .map(|packet| match packet {
            Packet::Udp { from, to, octets } => (from, to, octets),
            other => panic!("{other:?}"),
        })
        .collect();
    all.dedup();
    all
}

/// R-3, R-8, R-10, R-16: all three links, octet for octet.
#[test]
fn a_program_without_a_password_reaches_another_plant() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let router = start_router(&network);
        let adapter = start_adapter(&network);
        let (program, node) = (network.client("127.0.0.1"), network.node(4));
        let (outside, inside) = (network.internet.capture(), network.plant.capture());
        program.send(local(4), &request(4));
        let from_router = node.expect(&with_password(&request(4)));
        node.send(from_router, &response(4));
        let answer = without_password(&response(4));
        assert_eq!(program.expect(&answer), local(4), "from the address and port that were asked");

        let (outside, inside) = (datagrams(outside), datagrams(inside));
        let is_local = |(from, _, _): &(SocketAddr, _, _)| from.ip().is_loopback();
        let (links, wire): (Vec<_>, Vec<_>) = outside.into_iter().partition(is_local);
        let [asked, answered] = [&wire[0], &wire[1]];
        let public = network.public("198.51.100.1", 4);
        let (here, there) = (program.address(), node.address());
        assert_eq!(links, [(here, local(4), request(4)), (local(4), here, answer)]);
        assert_eq!(asked, &(asked.0, public, with_password(&request(4))));
        assert_eq!(answered, &(public, asked.0, response(4)));
        assert_eq!(wire.len(), 2);
        assert_eq!(
            inside,
            [(from_router, there, with_password(&request(4))), (there, from_router, response(4)),]
        );
        finish(&network, router, adapter);
    });
}

/// The whole chain of real programs, and what the adapter says of it.
#[test]
fn request_and_node_talk_through_it() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let (router, adapter) = (start_router(&network), start_adapter(&network));
        let nodes = start_nodes(&network);
        let tables = folder("");
        let table = tables.path().join("client.toml");
        fs::write(&table, TABLE).unwrap();
        let table = table.to_str().unwrap();
        let arguments = [
            "request",
            "--table",
            table,
            "--net",
            "5",
            "--node",
            "1-4",
            "--count",
            "5",
            "--interval",
            "1ms",
            "--timeout",
            "20s",
        ];
        let mut program = network.internet.enter(|| Process::start(pnet_nat(&arguments)));
        assert_eq!(program.end(), Some(0), "{}{}", program.stdout(), program.stderr());
        let metrics = at_the_adapter(&network, || adapter.at_rest());
        let of_net = [("net", "plant-2"), ("direction", "response")];
        assert_eq!(metrics.sum("pnet_nat_forwarded_datagrams_total", &of_net), 20);
        let accepted = [("net", "plant-2"), ("credential", "service")];
        assert_eq!(metrics.sum("pnet_nat_accepted_requests_total", &accepted), 20);
        let (_, nets) = at_the_adapter(&network, || adapter.get("/api/v1/nets").unwrap());
        let nets: serde_json::Value = serde_json::from_str(&nets).unwrap();
        let net = &nets["nets"][0];
        assert_eq!((&net["kind"], &net["start_port"]), (&json!("remote_net"), &json!(20000)));
        let node = &net["nodes"][3];
        assert_eq!(node["local_address"], "127.17.2.4");
        assert_eq!(
            (&node["server"], &node["state"]),
            (&json!("198.51.100.1:20004"), &json!("answering"))
        );
        finish(&network, router, adapter);
        drop(nodes);
    });
}

/// Who may use it, and with what; and answers that are no answers.
#[test]
fn what_is_not_in_order_is_refused_and_counted() {
    let Some(network) = Network::build() else { return };
    let adapter = start_adapter(&network);
    network.at_the_edge(|| {
        // In place of the router, so that the answers can be anything.
        let router = network.edge.peer(network.public("198.51.100.1", 4));
        let program = network.client("127.0.0.1");
        program.send(local(4), &with_password(&request(4)));
        program.send(local(4), &datagram(&FIGURE_10, &[], DEVICE));
        let stranger = network.client("198.51.100.7");
        stranger.send(local(4), &request(4));
        program.send(local(4), &request(5));
        program.send(local(4), &request(4));
        let from_adapter = router.expect(&with_password(&request(4)));
        let wrong = [&without_password(&response(4)), &DEVICE[..]].concat();
        router.send(from_adapter, &wrong);
        router.send(from_adapter, &response(4));
        program.expect(&without_password(&response(4)));
    });
    at_the_adapter(&network, || {
        adapter.expect_drops(&[
            ("request", "password_unexpected", 2),
            ("request", "source_not_allowed", 1),
            ("request", "node_mismatch", 1),
            ("response", "password_mismatch", 1),
        ]);
        adapter.finish();
    });
}

/// Asks the nodes in turn until it is over. Returns when the requests without an answer were sent.
fn poll(program: &Peer, over: &AtomicBool, answers: &AtomicU64) -> Vec<Instant> {
    let mut lost = Vec::new();
    for node_address in (1..=4).cycle() {
        if over.load(Relaxed) {
            break;
        }
        let sent = Instant::now();
        program.send(local(node_address), &request(node_address));
        // Late on a busy machine is not lost.
        match program.receive_within(Duration::from_secs(10)) {
            Some((_, from)) => {
                assert_eq!(from, local(node_address), "who answers");
                answers.fetch_add(1, Relaxed);
            }
            None => lost.push(sent),
        }
    }
    lost
}

/// Lets five programs ask while `meanwhile` runs, and returns when requests were sent that were lost.
fn under_load(network: &Network, meanwhile: impl FnOnce(&dyn Fn()) + Send) -> Vec<Instant> {
    let (answers, over) = (AtomicU64::new(0), AtomicBool::new(false));
    let programs: Vec<_> = (0..5).map(|_| network.client("127.0.0.1")).collect();
    thread::scope(|scope| {
        let pollers: Vec<_> =
            programs.iter().map(|program| scope.spawn(|| poll(program, &over, &answers))).collect();
        let over = Over(&over);
        meanwhile(&|| {
            let before = answers.load(Relaxed);
            eventually("there is load", || (answers.load(Relaxed) > before + 20).then_some(()));
        });
        drop(over);
        pollers.into_iter().flat_map(|poller| poller.join().unwrap()).collect()
    })
}

#[test]
fn reloads_of_either_side_lose_nothing() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let (router, adapter) = (start_router(&network), start_adapter(&network));
        let nodes = start_nodes(&network);
        let alone = [SETTINGS, NET].concat();
        let other = NET.replace("plant-2", "plant-3").replace("127.17.2.", "127.17.3.");
        let more = format!("{SETTINGS}{NET}{}", other.replace("198.51.100.1", "198.51.100.8"));
        let lost = under_load(&network, |wait_for_load| {
            for round in 0..10 {
                wait_for_load();
                let line = adapter.reload_to(if round % 2 == 0 { &more } else { &alone });
                let key = if round % 2 == 0 { "nets_added" } else { "nets_removed" };
                assert_eq!(line[key], json!(["plant-3"]), "{line}");
                wait_for_load();
                router.reload();
            }
        });
        assert_eq!(lost, [], "nothing is lost in a reload");
        finish(&network, router, adapter);
        drop(nodes);
    });
}

/// The router and its nodes take both passwords for a while.
#[test]
fn a_password_is_changed_under_load_and_nothing_is_lost() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let (router, adapter) = (start_router(&network), start_adapter(&network));
        let nodes = start_nodes(&network);
        let password = |name| {
            format!("[[remote_net.password]]\nname = \"{name}\"\nfile = \"secrets/{name}\"\n")
        };
        let (net, _) = NET.split_once("[[remote_net.password]]").unwrap();
        let [old, new] = ["section-1", "press"].map(password);
        let lost = under_load(&network, |wait_for_load| {
            for passwords in [[&new[..], &old], [&new[..], ""]] {
                wait_for_load();
                adapter.reload_to(&[SETTINGS, net, passwords[0], passwords[1]].concat());
            }
            wait_for_load();
            let (_, new_alone) = BOTH.rsplit_once("[[udp").unwrap();
            let new_alone = format!("[[udp{new_alone}");
            let alone = network.place(PUBLIC).configuration(&self::router(&new_alone));
            let line = router.reload_to(&alone);
            assert_eq!(line["credentials_withdrawn"], json!(["section-1: service"]), "{line}");
            wait_for_load();
        });
        assert_eq!(lost, [], "nothing is lost when the password changes");
        let accepted = |name| {
            let of = [("net", "plant-2"), ("credential", name)];
            at_the_adapter(&network, || adapter.at_rest())
                .sum("pnet_nat_accepted_requests_total", &of)
        };
        assert!(accepted("press") > 40);
        finish(&network, router, adapter);
        drop(nodes);
    });
}

/// What is under way when a side stops is still answered; only what is sent while it is away is lost.
#[test]
fn a_restart_of_either_side_loses_what_is_sent_meanwhile_and_no_more() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let nodes = start_nodes(&network);
        let mut sides = [start_router(&network), start_adapter(&network)].map(Some);
        let mut away = VecDeque::new();
        let lost = under_load(&network, |wait_for_load| {
            for (side, start) in [(0, start_router as fn(&Network) -> Relay), (1, start_adapter)] {
                wait_for_load();
                let old = sides[side].take().unwrap();
                let since = Instant::now();
                old.process.signal(Signal::SIGTERM);
                let mut old = old.process;
                assert_eq!(old.end(), Some(0), "{}", old.stderr());
                sides[side] = Some(start(&network));
                away.push_back(since..Instant::now());
                wait_for_load();
            }
        });
        for sent in lost {
            // A request that was on its way when the side stopped may find nobody any more.
            let was_away = |away: &std::ops::Range<Instant>| {
                away.start <= sent + Duration::from_secs(1) && sent < away.end
            };
            assert!(away.iter().any(was_away), "lost although both sides were there");
        }
        let [router, adapter] = sides.map(Option::unwrap);
        router.finish();
        at_the_adapter(&network, || adapter.finish());
        drop(nodes);
    });
}
