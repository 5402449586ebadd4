//! What happens to the relay: strangers, scrapers, new configurations, a node that loses power, and a
//! log whose disk is full from the start.

use std::fs;
use std::net::{Ipv4Addr, SocketAddr};
use std::ops::Range;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use serde_json::Value;

use crate::clients::{CLIENTS_OF_A_KIND, Clients};
use crate::harness::{
    FIGURE_10, Network, PASSWORD, Peer, Process, Relay, WRONG, datagram, eventually, on_the_path,
    pause, pnet_nat,
};

pub(crate) const PUBLIC: Ipv4Addr = Ipv4Addr::new(198, 51, 100, 1);
/// Start ports, as clients know them.
pub(crate) const SECTION: u16 = 20_000;
pub(crate) const PRESS: u16 = 20_200 - 3;
pub(crate) const MIXER: u16 = 40_300 - 33;
const ADMIN: (Ipv4Addr, u16) = (Ipv4Addr::LOCALHOST, 9378);

/// Strangers send so many at once, to each port; then they breathe.
const BURST: usize = 8;
const BREATH: Duration = Duration::from_millis(1);

/// A block of ports that moves with each reload over those that Linux lends, and takes some from the
/// relay's own sockets towards the plant. No node stands behind it.
const MOVING: Range<u16> = 41_000..60_000;
const BLOCK: usize = 128;

/// Puts the log on a file system that is full, in a mount namespace of the relay's own.
const FULL_DISK: &str = r#"
set -eu
mount -t tmpfs -o size=4k tmpfs /mnt
exec "$0" "$@" 2>/mnt/log
"#;

/// Of the two that the operator changes between, the one with everything, or the one without node 4
/// and without the second password. `round` says where the moving block is.
fn configuration(whole: bool, round: usize) -> String {
    let blocks = MOVING.len() / BLOCK;
    let moving = MOVING.start + (round % blocks * BLOCK) as u16;
    let nodes = if whole { "[1, 2, 4]" } else { "[1, 2]" };
    let team_2 = r#"
[[udp_range_net.password]]
name = "team-2"
file = "secrets/press"
"#;
    let team_2 = if whole { team_2 } else { "" };
    let server = |name: &str, public_port: u16, node_address: u8, idle_timeout: &str| {
        format!(
            r#"
[[server]]
name = "{name}"
public_port = {public_port}
address = "172.17.17.{node_address}:34379"
node = {node_address}
allow = ["198.51.100.0/24"]
idle_timeout = "{idle_timeout}"
[[server.password]]
name = "service"
file = "secrets/section-1"
"#
        )
    };
    let (press, mixer) = (server("press", 20_200, 3, "4s"), server("mixer", 40_300, 33, "5m"));
    on_the_path(&format!(
        r#"
[public]
listen = ["{PUBLIC}"]

[runtime]
workers = 2

# Clients whose password was withdrawn go on asking with it: they are not to be throttled for that.
[limits]
wrong_password_interval = "50ms"

[[udp_range_net]]
name = "section-1"
start_port = {SECTION}
subnet = "172.17.17.0"
nodes = {nodes}
allow = ["198.51.100.0/24"]
[[udp_range_net.password]]
name = "service"
file = "secrets/section-1"
{team_2}
{press}
{mixer}

[[udp_range_net]]
name = "moving"
start_port = {moving}
subnet = "172.17.18.0"
nodes = ["1-125"]
allow = ["198.51.100.0/24"]
[[udp_range_net.password]]
name = "service"
file = "secrets/section-1"
"#
    ))
}

pub(crate) fn start_relay() -> Relay {
    Relay::start_as(&configuration(true, 0), ADMIN.into(), |arguments| {
        let relay = pnet_nat(arguments);
        let mut command = Command::new("unshare");
        command.args(["--mount", "sh", "-c", FULL_DISK]);
        command.arg(relay.get_program()).args(relay.get_args());
        command
    })
}

/// Scrapes as fast as it is answered; tells how often.
pub(crate) fn scrape(relay: &Relay, over: &AtomicBool) -> u64 {
    let mut scrapes = 0;
    while !over.load(Relaxed) {
        let (status, _) = relay.get("/metrics").expect("an answer");
        assert_eq!(status, 200);
        scrapes += 1;
    }
    scrapes
}

/// Brings the two configurations into force by turns.
pub(crate) struct Operator<'a> {
    relay: &'a Relay,
    clients: &'a Clients,
    whole: bool,
    round: usize,
    /// Exchanges of those from whom something can be withdrawn, when the last reload was done.
    exchanges: [u64; 2],
    withdrawn_since: Option<Instant>,
    /// From when to when something was withdrawn, the reloads included.
    withdrawals: Vec<Range<Instant>>,
    /// The longest time from a signal to the last answer that a withdrawn password or port got.
    latest: Duration,
}

impl<'a> Operator<'a> {
    pub(crate) fn new(relay: &'a Relay, clients: &'a Clients) -> Self {
        let (withdrawn_since, withdrawals) = (None, Vec::new());
        let (whole, round, exchanges, latest) = (true, 0, [0; 2], Duration::ZERO);
        Self { relay, clients, whole, round, exchanges, withdrawn_since, withdrawals, latest }
    }

    /// The longest time that something withdrawn went on working.
    pub(crate) fn latest(&self) -> Duration {
        self.latest
    }

    /// From when to when something was withdrawn.
    pub(crate) fn withdrawals(mut self) -> Vec<Range<Instant>> {
        self.withdrawals.extend(self.withdrawn_since.map(|since| since..Instant::now()));
        self.withdrawals
    }

    /// What was withdrawn last time has stopped at once, and works again now; or the other way
    /// round.
    pub(crate) fn reload(&mut self) {
        let exchanges = self.exchanges();
        for (now, before) in exchanges.into_iter().zip(self.exchanges) {
            // When it was withdrawn, each client may have had an answer in its socket.
            let limit = if self.whole { u64::MAX } else { before + CLIENTS_OF_A_KIND };
            assert!(now <= limit, "{} exchanges after it was withdrawn", now - before);
        }
        if let Some(since) = self.withdrawn_since {
            let Clients { withdrawn_password, withdrawn_mapping, .. } = self.clients;
            for last in [withdrawn_password, withdrawn_mapping].map(|tally| tally.last_answer()) {
                let late =
                    last.map_or(Duration::ZERO, |last| last.saturating_duration_since(since));
                self.latest = self.latest.max(late);
            }
        }
        (self.whole, self.round) = (!self.whole, self.round + 1);
        if !self.whole {
            self.withdrawn_since = Some(Instant::now());
        }
        let file = self.relay.folder.path().join("pnet-nat.toml");
        replace(&file, configuration(self.whole, self.round).as_bytes());
        self.relay.process.signal(Signal::SIGHUP);
        eventually("the configuration is in force", || {
            let (_, status) = self.relay.get("/api/v1/status")?;
            let state = &serde_json::from_str::<Value>(&status).unwrap()["reload"];
            assert_eq!(state["error"], Value::Null, "a reload failed");
            for item in state["not_in_force"].as_array().unwrap() {
                assert!(item["why"].as_str().unwrap().contains("waits for an answer"), "{item}");
            }
            (state["number"] == self.round).then_some(())
        });
        self.exchanges = self.exchanges();
        if self.whole {
            eventually("what was withdrawn works again", || {
                let again = self.exchanges().into_iter().zip(self.exchanges);
                again.into_iter().all(|(now, before)| now > before).then_some(())
            });
            let since = self.withdrawn_since.take();
            self.withdrawals.extend(since.map(|since| since..Instant::now()));
        }
    }

    fn exchanges(&self) -> [u64; 2] {
        let Clients { withdrawn_password, withdrawn_mapping, .. } = self.clients;
        [withdrawn_password.answered(), withdrawn_mapping.answered()]
    }
}

/// As editors do: whoever reads the file finds the old octets or the new ones, never half of them.
fn replace(path: &Path, octets: &[u8]) {
    let beside = path.with_extension("new");
    fs::write(&beside, octets).unwrap();
    fs::rename(beside, path).unwrap();
}

/// The nodes: those that stay up, and number 33.
pub(crate) struct Plant<'a> {
    network: &'a Network,
    passwords: String,
    _steady: Process,
    node_33: Process,
    /// From when to when node 33 was down.
    pub(crate) downtimes: Vec<Range<Instant>>,
}

impl<'a> Plant<'a> {
    pub(crate) fn start(network: &'a Network, folder: &Path) -> Self {
        let secrets = folder.join("secrets");
        let passwords = ["section-1", "press"].map(|file| secrets.join(file).display().to_string());
        let passwords = passwords.join(",");
        let steady = start_nodes(network, "172.17.17.1-4", 4, &passwords);
        let node_33 = start_nodes(network, "172.17.17.33", 1, &passwords);
        Self { network, passwords, _steady: steady, node_33, downtimes: Vec::new() }
    }

    /// Node 33 loses power and comes back.
    pub(crate) fn restart(&mut self) {
        let from = Instant::now();
        self.node_33.signal(Signal::SIGKILL);
        self.node_33.end();
        self.node_33 = start_nodes(self.network, "172.17.17.33", 1, &self.passwords);
        self.downtimes.push(from..Instant::now());
    }
}

fn start_nodes(network: &Network, listen: &str, count: usize, passwords: &str) -> Process {
    let arguments = ["node", "--listen", listen, "--password-file", passwords];
    let nodes = network.plant.enter(|| Process::start(pnet_nat(&arguments)));
    eventually("the nodes are there", || (nodes.stdout().lines().count() == count).then_some(()));
    nodes
}

/// Wrong passwords and garbage to every port, good passwords from where nobody is allowed; tells
/// how many.
pub(crate) fn flood(over: &AtomicBool) -> u64 {
    let bind = |address: &str| Peer::bind(address.parse().unwrap());
    let near = [(); 4].map(|()| bind("198.51.100.8:0"));
    let far = bind("203.0.113.7:0");
    let wrong = datagram(&FIGURE_10, &[1, 2, 3], WRONG);
    let good = datagram(&FIGURE_10, &[1, 2, 3], PASSWORD);
    let garbage = [&[0xFF; 40][..], &[2, 0, 0, 0], &[0x41; 300], &good[..24]];
    let ports = [20_001, 20_002, 20_004, 20_200, 40_300];
    let mut sent = 0;
    while !over.load(Relaxed) {
        for public in ports.map(|port| SocketAddr::from((PUBLIC, port))) {
            for stranger in near.iter().cycle().take(BURST) {
                stranger.send(public, &wrong);
            }
            for octets in garbage {
                near[0].send(public, octets);
            }
            far.send(public, &good);
            sent += (BURST + garbage.len() + 1) as u64;
        }
        pause(BREATH);
    }
    for stranger in near.iter().chain([&far]) {
        assert_eq!(stranger.waiting(), None, "a stranger was answered");
    }
    sent
}
