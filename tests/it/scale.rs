//! 64 plant sections of 125 nodes: 8,000 public ports, within 20,000 file descriptors.

use std::fmt::Write;
use std::fs;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::resource::{Resource, getrlimit, rlim_t};

use crate::harness::{Over, Peer, Relay, Site, eventually, exchange, left_out, pause};

const SECTIONS: u16 = 64;
const DESCRIPTORS: u64 = 20_000;
/// A build for debugging is slow, and not what runs in a plant.
const START_TIME: Duration =
    if cfg!(debug_assertions) { Duration::from_secs(10) } else { Duration::from_secs(3) };

/// A relay with 8,000 public ports; none, and says so, where there are too few file descriptors.
pub(crate) fn large_relay(site: &Site) -> Option<Relay> {
    let (_, hard) = getrlimit(Resource::RLIMIT_NOFILE).unwrap();
    if hard < DESCRIPTORS as rlim_t {
        left_out(&format!("a hard limit of {DESCRIPTORS} file descriptors (it is {hard})"));
        return None;
    }
    Some(Relay::start(&configuration(site, SECTIONS), site.admin(), Some(DESCRIPTORS)))
}

#[test]
fn eight_thousand_public_ports() {
    let site = Site::claim();
    let start = Instant::now();
    let Some(relay) = large_relay(&site) else { return };
    let started = start.elapsed();
    assert!(started < START_TIME, "ready after {started:?}");

    // The first node of all, and the last.
    let client = site.client();
    for (section, node_address) in [(0, 1), (SECTIONS - 1, 125)] {
        let public = (site.public_address(), start_port(section) + u16::from(node_address)).into();
        let server = (server_address(&site, section, node_address), 34379).into();
        exchange(&client, public, &Peer::bind(server), node_address);
    }

    let (before, from) = (processor_time(&relay), Instant::now());
    pause(Duration::from_secs(3));
    let (used, elapsed) = (processor_time(&relay) - before, from.elapsed());
    assert!(used <= elapsed / 100, "{used:?} of processor time in {elapsed:?} of idling");

    let kib = relay.process.resident() >> 10;
    println!(
        "8,000 public ports: ready after {started:?}, {kib} KiB resident, idling {used:?} of {elapsed:?}"
    );
    reload_beside_a_client(&site, &relay);
    relay.finish();
}

/// A client polls the first node while the last section goes and comes back.
fn reload_beside_a_client(site: &Site, relay: &Relay) {
    let (client, node) = (site.client(), Peer::bind((site.address(1), 34379).into()));
    let public = (site.public_address(), start_port(0) + 1).into();
    let (answers, over) = (AtomicU64::new(0), AtomicBool::new(false));
    let longest = AtomicU64::new(0);
    let (all, less) = (configuration(site, SECTIONS), configuration(site, SECTIONS - 1));
    thread::scope(|scope| {
        let polling = scope.spawn(|| {
            while !over.load(Relaxed) {
                let asked = Instant::now();
                exchange(&client, public, &node, 1);
                longest.fetch_max(asked.elapsed().as_millis() as u64, Relaxed);
                answers.fetch_add(1, Relaxed);
            }
        });
        let over = Over(&over);
        // The last section has the flow of the exchange above.
        for (configuration, closed) in [(&less, 1), (&all, 0), (&less, 0), (&all, 0)] {
            let asked = answers.load(Relaxed);
            let start = Instant::now();
            let line = relay.reload_to(configuration);
            let took = start.elapsed();
            assert!(took < START_TIME, "{took:?}");
            println!("8,000 public ports, 125 of them changed: reload in {took:?}");
            assert_eq!(line["flows_closed"], closed, "{line}");
            eventually("the client goes on", || {
                (answers.load(Relaxed) > asked + 5 || polling.is_finished()).then_some(())
            });
        }
        drop(over);
    });
    println!("meanwhile, the longest of {answers:?} exchanges took {longest:?} ms");
    relay.expect_drops(&[]);
}

pub(crate) fn start_port(section: u16) -> u16 {
    10_000 + 128 * section
}

/// The first and the last section stand in the site, apart by their node addresses; nobody asks
/// for the others.
fn server_address(site: &Site, section: u16, node_address: u8) -> std::net::Ipv4Addr {
    match section {
        0 => site.address(node_address),
        _ => [127, 1, section as u8, node_address].into(),
    }
}

pub(crate) fn configuration(site: &Site, sections: u16) -> String {
    let (public, subnet, admin) = (site.public_address(), site.address(0), site.admin());
    let mut configuration = format!(
        "[public]\nlisten = [\"{public}\"]\n[runtime]\nworkers = 2\n[admin]\nlisten = \"{admin}\"\n"
    );
    for section in 0..sections {
        write!(
            configuration,
            "[[udp_range_net]]\nname = \"section-{section}\"\nstart_port = {}\nsubnet = \"{}\"\n\
             nodes = [\"1-125\"]\nallow = [\"{subnet}/24\"]\n\
             [[udp_range_net.password]]\nname = \"service\"\nfile = \"secrets/section-1\"\n",
            start_port(section),
            server_address(site, section, 0),
        )
        .unwrap();
    }
    configuration
}

/// User and system time so far. The kernel counts in hundredths of a second.
fn processor_time(relay: &Relay) -> Duration {
    let stat = fs::read_to_string(format!("/proc/{}/stat", relay.process.id())).unwrap();
    let (_, behind_name) = stat.rsplit_once(')').unwrap();
    let fields: Vec<_> = behind_name.split_whitespace().collect();
    let ticks = |field: usize| fields[field].parse::<u32>().unwrap();
    Duration::from_millis(10) * (ticks(11) + ticks(12))
}
