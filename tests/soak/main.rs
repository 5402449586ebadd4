//! Soak: a relay under everything at once, for as long as one likes.
//!
//! `PNET_NAT_SOAK=10m cargo test --release --test soak -- --nocapture` takes ten minutes and tells how
//! it goes; with `PNET_NAT_TESTS=all` alone, a short run is one of the tests. Needs root, for it
//! stands in network namespaces: clients ask as fast as they are answered, strangers flood, the
//! operator brings a new configuration every second, and a node loses power every five.
//!
//! In the end no exchange was lost that need not be, the law of the counters holds, and memory and
//! file descriptors stayed as they were.

mod clients;
mod disturbances;
#[allow(dead_code, unused_imports)] // the scenarios of `it` use the rest
#[path = "../it/harness/mod.rs"]
mod harness;
mod usage;

use std::env;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use clients::Clients;
use disturbances::{Operator, Plant, flood};
use harness::{Network, Over, Relay, pause};
use usage::{Overflows, Usage};

const SHORT: Duration = Duration::from_secs(25);
const RELOAD_INTERVAL: Duration = Duration::from_secs(1);
/// In reloads.
const RESTART_INTERVAL: u64 = 5;
const PROGRESS_INTERVAL: u64 = 5;

#[test]
fn nothing_is_lost_and_nothing_grows() {
    let Some(time) = time() else {
        return println!("left out: it takes a while; PNET_NAT_SOAK=10m says how long");
    };
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| soak(&network, time));
}

fn time() -> Option<Duration> {
    let time = env::var("PNET_NAT_SOAK").ok();
    let time = time.map(|time| humantime::parse_duration(&time).expect("PNET_NAT_SOAK is a time"));
    time.or_else(|| env::var_os("PNET_NAT_TESTS").map(|_| SHORT))
}

fn soak(network: &Network, time: Duration) {
    let relay = disturbances::start_relay();
    let mut plant = Plant::start(network, relay.folder.path());
    let (clients, overflows) = (Clients::default(), Overflows::now(network));
    let over = Arc::new(AtomicBool::new(false));
    let (usage, flooded) = thread::scope(|scope| {
        let _at_the_end = Over(&over); // also when a thread panics
        scope.spawn(|| network.internet.enter(|| clients.ask(&over)));
        let stranger = scope.spawn(|| network.internet.enter(|| flood(&over)));
        let usage = go_on(time, &relay, &mut plant, &clients);
        over.store(true, Relaxed);
        (usage, stranger.join().unwrap())
    });

    let overflows = Overflows::now(network).since(&overflows);
    let lost = clients.lost(&plant.downtimes);
    println!("\nafter {}:", humantime::format_duration(time));
    clients.tell();
    println!("strangers: {flooded} datagrams, none answered");
    println!("node 33: restarted {} times", plant.downtimes.len());
    println!("{usage}");
    println!("full queues: {overflows}; the relay counts {}", kernel_drops(&relay));
    println!("lost without another reason: {lost}");
    assert!(lost <= overflows.total(), "exchanges were lost, and not for a full queue");
    usage.assert_flat();
    relay.finish();
}

fn go_on(time: Duration, relay: &Relay, plant: &mut Plant<'_>, clients: &Clients) -> Usage {
    let (start, mut usage) = (Instant::now(), Usage::default());
    let (mut operator, mut at_last_restart) = (Operator::new(relay, clients), 0);
    for round in 1.. {
        pause(RELOAD_INTERVAL);
        operator.reload();
        if round % RESTART_INTERVAL == 0 {
            let answered = clients.restarted.answered();
            assert!(answered > at_last_restart, "the restarted node does not answer again");
            plant.restart();
            at_last_restart = clients.restarted.answered();
        }
        usage.sample(relay.process.id());
        if round % PROGRESS_INTERVAL == 0 {
            println!(
                "{:>6} s: {} exchanges, {usage}",
                start.elapsed().as_secs(),
                clients.answered()
            );
        }
        if start.elapsed() >= time {
            break;
        }
    }
    usage
}

/// By cause.
fn kernel_drops(relay: &Relay) -> String {
    let metrics = relay.metrics();
    let dropped = |cause| {
        let count = metrics.sum("pnet_nat_kernel_dropped_datagrams_total", &[("cause", cause)]);
        format!("{count} as {cause}")
    };
    [dropped("overflow"), dropped("prefilter")].join(", ")
}
