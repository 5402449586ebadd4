//! Soak: a relay under everything at once, for as long as one likes.
//!
//! `PNET_NAT_SOAK=10m cargo test --release --test soak -- --nocapture` takes ten minutes and tells how
//! it goes; with `PNET_NAT_TESTS=all` alone, a short run is one of the tests. Needs root, for it
//! stands in network namespaces: clients ask as fast as they are answered, strangers flood, scrapers
//! scrape, the operator brings a new configuration every second, a node loses power every five, and
//! the disk of the log is full. No port is reserved: Linux lends those of the blocks to anybody.
//!
//! In the end no exchange was lost that need not be, not even of those whose password or public port
//! comes and goes, while it stood; what was withdrawn stopped within a second; the law of the
//! counters holds, and memory and file descriptors stayed as they were.

mod clients;
mod disturbances;
mod usage;

use std::env;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use pnet_nat_rig::harness;

use clients::Clients;
use disturbances::{Operator, Plant, flood, scrape};
use harness::{Network, Over, Relay, pause};
use usage::{Overflows, Usage};

const SHORT: Duration = Duration::from_secs(25);
const RELOAD_INTERVAL: Duration = Duration::from_secs(1);
/// What is withdrawn stops within this time.
const LATEST: Duration = Duration::from_secs(1);
const SCRAPERS: usize = 2;
/// Of so many exchanges one may be lost for a full queue; and a few more, at one moment in which the
/// machine had no time for the relay. All clients together wait in vain 64 times in 20 s, if it is dead.
const EXCHANGES_FOR_A_LOSS: u64 = 100_000;
const MOMENT_OF_LOSS: u64 = 8;
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
    let (seen, flooded, scrapes) = thread::scope(|scope| {
        let _at_the_end = Over(&over); // also when a thread panics
        scope.spawn(|| network.internet.enter(|| clients.ask(&over)));
        let stranger = scope.spawn(|| network.internet.enter(|| flood(&over)));
        let scrapers = [(); SCRAPERS].map(|()| scope.spawn(|| scrape(&relay, &over)));
        let seen = go_on(time, &relay, &mut plant, &clients);
        over.store(true, Relaxed);
        let scrapes: u64 = scrapers.into_iter().map(|scraper| scraper.join().unwrap()).sum();
        (seen, stranger.join().unwrap(), scrapes)
    });
    let Seen { usage, withdrawals, latest } = seen;

    let overflows = Overflows::now(network).since(&overflows);
    let lost = clients.lost(&plant.downtimes, &withdrawals);
    println!("\nafter {}:", humantime::format_duration(time));
    clients.tell();
    println!("strangers: {flooded} datagrams, none answered");
    println!("scrapers: {scrapes} scrapes");
    println!("what was withdrawn worked for {latest:?} at most");
    println!("log lines lost: {}", lines_lost(&relay));
    println!("node 33: restarted {} times", plant.downtimes.len());
    println!("{usage}");
    println!("full queues: {overflows}; the relay counts {}", kernel_drops(&relay));
    println!("lost without another reason: {lost}");
    // A full queue takes exchanges along. But strangers fill it, so of what it took next to nothing may
    // have been anybody's exchange.
    assert!(lost <= overflows.total(), "exchanges were lost, and not for a full queue");
    let bearable = MOMENT_OF_LOSS + clients.answered() / EXCHANGES_FOR_A_LOSS;
    assert!(lost <= bearable, "more than {bearable} exchanges were lost");
    // A short run may share the machine with other tests.
    if time > SHORT {
        assert!(latest <= LATEST, "a withdrawal came into force after {latest:?}");
    }
    assert!(lines_lost(&relay) > 0, "the disk of the log is full");
    usage.assert_flat();
    relay.finish();
}

/// What was seen while it went on.
struct Seen {
    usage: Usage,
    /// From when to when something was withdrawn.
    withdrawals: Vec<Range<Instant>>,
    /// The longest time that something withdrawn went on working.
    latest: Duration,
}

/// Disturbs until the time is over; tells what the relay took, and when something was withdrawn.
fn go_on(time: Duration, relay: &Relay, plant: &mut Plant<'_>, clients: &Clients) -> Seen {
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
        usage.sample(&relay.process);
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
    let latest = operator.latest();
    Seen { usage, withdrawals: operator.withdrawals(), latest }
}

/// Lines of the log that went nowhere.
fn lines_lost(relay: &Relay) -> u64 {
    relay.metrics().sum("pnet_nat_log_lines_lost_total", &[])
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
