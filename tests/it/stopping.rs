//! The end of a relay: what is due is delivered, what is new is refused, and the exit code is 0.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;

use crate::harness::{
    PASSWORD, Peer, Relay, Settings, Site, datagram, eventually, exchange, pause, request, response,
};

fn is_ready(relay: &Relay) -> Option<bool> {
    relay.get("/-/ready").map(|(status, _)| status == 200)
}

/// Both signals; answers that are due arrive while the relay already says that it is not ready.
#[test]
fn a_stopping_relay_delivers_the_answers_that_are_due() {
    for signal in [Signal::SIGTERM, Signal::SIGINT] {
        let site = Site::claim();
        let mut relay =
            site.relay(Settings { runtime: "workers = 2\ndrain = \"20s\"", ..Settings::default() });
        let node = site.node(4);
        let clients: Vec<_> = (0..6).map(|_| site.client()).collect();
        let ask = |client: &Peer| {
            client.send(site.public(4), &request(4));
            node.expect(&request(4))
        };
        let ways_back: Vec<_> = clients.iter().map(ask).collect();
        relay.process.signal(signal);
        eventually("it is not ready", || (is_ready(&relay) == Some(false)).then_some(()));

        let late = site.client();
        late.send(site.public(4), &request(4));
        for (client, way_back) in clients.iter().zip(ways_back) {
            assert!(!relay.process.has_ended(), "an answer is due");
            node.send(way_back, &response(4));
            assert_eq!(client.expect(&response(4)), site.public(4));
        }
        assert_eq!(relay.process.end(), Some(0));
        assert_eq!((node.waiting(), late.waiting()), (None, None), "a new request is refused");
        assert_eq!(relay.process.logged("flow closed").len(), 6);
    }
}

/// the last source of an unconfirmed request is 0.
#[test]
fn no_answer_is_due_to_a_request_that_wants_none() {
    let site = Site::claim();
    let mut relay =
        site.relay(Settings { runtime: "workers = 1\ndrain = \"5s\"", ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    let unconfirmed =
        datagram(&[0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x80], &[1, 2, 3], PASSWORD);
    client.send(site.public(4), &unconfirmed);
    node.expect(&unconfirmed);
    let asked = Instant::now();
    relay.process.signal(Signal::SIGTERM);
    assert_eq!(relay.process.end(), Some(0));
    assert!(asked.elapsed() < Duration::from_secs(4), "it waited: {:?}", asked.elapsed());
}

/// Answers that were asked for on one flow, several at a time, are due each.
#[test]
fn every_answer_of_a_flow_is_due() {
    let site = Site::claim();
    let mut relay =
        site.relay(Settings { runtime: "workers = 1\ndrain = \"20s\"", ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    for _ in 0..3 {
        client.send(site.public(4), &request(4));
    }
    let ways_back = [(); 3].map(|()| node.expect(&request(4)));
    relay.process.signal(Signal::SIGTERM);
    eventually("it is not ready", || (is_ready(&relay) == Some(false)).then_some(()));
    for way_back in ways_back {
        pause(Duration::from_millis(100));
        node.send(way_back, &response(4));
        client.expect(&response(4));
    }
    assert_eq!(relay.process.end(), Some(0));
}

/// A node that never answers does not hold the relay beyond its drain time.
#[test]
fn the_drain_time_is_a_limit() {
    let site = Site::claim();
    let mut relay =
        site.relay(Settings { runtime: "workers = 2\ndrain = \"1s\"", ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    client.send(site.public(4), &request(4));
    node.expect(&request(4));
    let start = Instant::now();
    relay.process.signal(Signal::SIGTERM);
    assert_eq!(relay.process.end(), Some(0));
    let took = start.elapsed();
    assert!((900..4000).contains(&took.as_millis()), "{took:?}");
}

#[test]
fn without_an_answer_due_it_ends_at_once() {
    let site = Site::claim();
    let mut relay =
        site.relay(Settings { runtime: "workers = 2\ndrain = \"1h\"", ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);
    relay.process.signal(Signal::SIGTERM);
    assert_eq!(relay.process.end(), Some(0));
}

#[test]
fn a_second_signal_ends_it_at_once() {
    let site = Site::claim();
    let mut relay =
        site.relay(Settings { runtime: "workers = 2\ndrain = \"1h\"", ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    client.send(site.public(4), &request(4));
    node.expect(&request(4));
    relay.process.signal(Signal::SIGTERM);
    eventually("it is not ready", || (is_ready(&relay) == Some(false)).then_some(()));
    let start = Instant::now();
    relay.process.signal(Signal::SIGTERM);
    assert_eq!(relay.process.end(), Some(1));
    assert!(start.elapsed() < Duration::from_secs(3), "{:?}", start.elapsed());
    assert_eq!(relay.process.logged("stopping at once").len(), 1);
}

/// Eight clients ask four simulated nodes as fast as the answers come: what reached a node comes
/// back to who asked.
#[test]
fn a_relay_under_load_ends_within_its_drain_time() {
    let site = Site::claim();
    let mut relay =
        site.relay(Settings { runtime: "workers = 2\ndrain = \"10s\"", ..Settings::default() });
    let mut nodes = site.simulated_nodes("20ms");
    let clients: Vec<_> = (0..8).map(|_| site.client()).collect();
    let (answers, over) = (AtomicU64::new(0), AtomicBool::new(false));
    thread::scope(|scope| {
        for (index, client) in clients.iter().enumerate() {
            let (site, answers, over) = (&site, &answers, &over);
            scope.spawn(move || {
                keep_asking(client, site.public(1 + index as u8 % 4), answers, over)
            });
        }
        eventually("there is load", || (answers.load(Relaxed) > 100).then_some(()));
        let start = Instant::now();
        relay.process.signal(Signal::SIGTERM);
        assert_eq!(relay.process.end(), Some(0));
        assert!(start.elapsed() < Duration::from_secs(10), "{:?}", start.elapsed());
        over.store(true, Relaxed);
    });
    nodes.signal(Signal::SIGTERM);
    assert_eq!(nodes.end(), Some(0));
    assert_eq!(answered_by(&nodes.stdout()), answers.load(Relaxed), "{}", nodes.stdout());
}

/// The sum of what the nodes say they answered: "node 1: received 5, answered 5, refused 0".
fn answered_by(stdout: &str) -> u64 {
    let answered = stdout.lines().filter_map(|line| line.split_once(", answered "));
    answered.map(|(_, rest)| rest.split(',').next().unwrap().parse::<u64>().unwrap()).sum()
}

fn keep_asking(client: &Peer, public: SocketAddr, answers: &AtomicU64, over: &AtomicBool) {
    let node_address = (public.port() % 1000) as u8;
    while !over.load(Relaxed) {
        client.send(public, &request(node_address));
        let end = Instant::now() + Duration::from_secs(1);
        while !over.load(Relaxed) && Instant::now() < end {
            if client.waiting().is_some() {
                answers.fetch_add(1, Relaxed);
                break;
            }
            pause(Duration::from_millis(1));
        }
    }
    // What came while the relay ended.
    while client.waiting().is_some() {
        answers.fetch_add(1, Relaxed);
    }
}

/// Who leads clients here by `/-/ready` has time to lead them elsewhere, and those that still come are served.
#[test]
fn before_it_drains_it_goes_on_and_says_that_it_is_not_ready() {
    let site = Site::claim();
    let runtime = "workers = 2\npre_drain = \"1h\"\ndrain = \"1h\"";
    let mut relay = site.relay(Settings { runtime, ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);
    relay.process.signal(Signal::SIGTERM);
    eventually("it is not ready", || (is_ready(&relay) == Some(false)).then_some(()));
    for client in [client, site.client()] {
        exchange(&client, site.public(4), &node, 4);
    }
    relay.at_rest();
    relay.process.signal(Signal::SIGTERM);
    assert_eq!(relay.process.end(), Some(1));
    assert_eq!(relay.process.logged("stopping at once").len(), 1);
}

/// After that time it takes no more requests, and ends as it does without.
#[test]
fn the_time_before_it_drains_ends() {
    let site = Site::claim();
    let runtime = "workers = 2\npre_drain = \"1s\"\ndrain = \"1h\"";
    let mut relay = site.relay(Settings { runtime, ..Settings::default() });
    let start = Instant::now();
    relay.process.signal(Signal::SIGTERM);
    assert_eq!(relay.process.end(), Some(0));
    assert!(start.elapsed() >= Duration::from_secs(1), "{:?}", start.elapsed());
}
