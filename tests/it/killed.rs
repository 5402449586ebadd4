//! A relay that is killed, as by the kernel when memory runs out, and started again.

use std::time::{Duration, Instant};

use nix::sys::signal::Signal;

use crate::harness::{Peer, Settings, Site, exchange, request, response};

/// What a client waits for an answer, at most, before it asks again: a second, as `pnet-nat request` does
/// unless told otherwise. The relay is away for as long as it takes to start, and no longer: there is no
/// state to recover, and the kernel holds back none of its ports. With a few of them that is far below a
/// second (docs/performance.md has 0.4 s for 8,000). A build for debugging is slow, and not what runs
/// in a plant; beside all other tests it has ten times as long, which still tells a start from a
/// time-out.
const REQUEST_TIME_OUT: Duration = Duration::from_secs(if cfg!(debug_assertions) { 10 } else { 1 });

/// Flows, sockets and ports are all gone: nothing has to be told to the clients, and nothing of the
/// old relay is in the way of the new one.
#[test]
fn after_kill_9_clients_go_on_within_one_request_time_out() {
    let site = Site::claim();
    let settings = || Settings { runtime: "workers = 2", ..Settings::default() };
    let mut relay = site.relay(settings());
    let (node, public) = (site.node(4), site.public(4));
    let clients: Vec<_> = (0..8).map(|_| site.client()).collect();
    for client in &clients {
        exchange(client, public, &node, 4);
    }
    let ask = |client: &Peer| {
        client.send(public, &request(4));
        node.expect(&request(4))
    };
    let under_way: Vec<_> = clients.iter().map(ask).collect();

    let killed = Instant::now();
    relay.process.signal(Signal::SIGKILL);
    assert_eq!(relay.process.end(), None);
    clients.iter().for_each(|client| client.send(public, &request(4)));
    let relay = site.relay(settings());
    assert!(killed.elapsed() < REQUEST_TIME_OUT, "away for {:?}", killed.elapsed());

    for way_back in under_way {
        node.send(way_back, &response(4));
    }
    for client in &clients {
        // The very next thing that comes, so no answer of before.
        exchange(client, public, &node, 4);
    }
    relay.expect_drops(&[]);
    relay.finish();
}
