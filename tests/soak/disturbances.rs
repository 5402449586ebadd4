//! What happens to the relay: strangers, new configurations, a node that loses power.

use std::fs;
use std::net::{Ipv4Addr, SocketAddr};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;

use crate::clients::Clients;
use crate::harness::{
    FIGURE_10, Network, PASSWORD, Peer, Process, Relay, WRONG, datagram, eventually, pause,
    pnet_nat,
};

pub(crate) const PUBLIC: Ipv4Addr = Ipv4Addr::new(198, 51, 100, 1);
/// Start ports, as clients know them.
pub(crate) const SECTION: u16 = 40_000;
pub(crate) const PRESS: u16 = 40_200 - 3;
pub(crate) const MIXER: u16 = 40_300 - 33;
const ADMIN: (Ipv4Addr, u16) = (Ipv4Addr::LOCALHOST, 9378);

/// Strangers send so many at once, to each port; then they breathe.
const BURST: usize = 8;
const BREATH: Duration = Duration::from_millis(1);

/// Of the two that the operator changes between, the one with everything, or the one without node 4
/// and without the second password.
fn configuration(whole: bool) -> String {
    let nodes = if whole { "[1, 2, 4]" } else { "[1, 2]" };
    let team_2 = r#"
[[udp_range_net.password]]
name = "team-2"
file = "secrets/press"
device_file = "secrets/section-1"
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
    let (press, mixer) = (server("press", 40_200, 3, "4s"), server("mixer", 40_300, 33, "5m"));
    format!(
        r#"
[public]
listen = ["{PUBLIC}"]

[runtime]
workers = 2

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
"#
    )
}

pub(crate) fn start_relay() -> Relay {
    Relay::start(&configuration(true), ADMIN.into(), None)
}

/// Brings the two configurations into force by turns.
pub(crate) struct Operator<'a> {
    relay: &'a Relay,
    whole: bool,
}

impl<'a> Operator<'a> {
    pub(crate) fn new(relay: &'a Relay) -> Self {
        Self { relay, whole: true }
    }

    /// Everyone whom the new configuration knows is served again soon.
    pub(crate) fn reload(&mut self, clients: &Clients) {
        self.whole = !self.whole;
        let folder = self.relay.folder.path();
        replace(&folder.join("pnet-nat.toml"), configuration(self.whole).as_bytes());
        self.relay.process.signal(Signal::SIGHUP);
        if self.whole {
            let again = [&clients.withdrawn_password, &clients.withdrawn_mapping];
            let before = again.map(|tally| tally.answered());
            eventually("what was withdrawn works again", || {
                let now = again.map(|tally| tally.answered());
                (now[0] > before[0] && now[1] > before[1]).then_some(())
            });
        }
    }
}

/// In one step: whoever reads the file finds the old octets or the new ones.
fn replace(path: &Path, octets: &[u8]) {
    let beside = path.with_extension("new");
    fs::write(&beside, octets).unwrap();
    fs::rename(beside, path).unwrap();
}

/// The nodes: those that stay up, and number 33.
pub(crate) struct Plant<'a> {
    network: &'a Network,
    password: PathBuf,
    _steady: Process,
    node_33: Process,
    /// From when to when node 33 was down.
    pub(crate) downtimes: Vec<Range<Instant>>,
}

impl<'a> Plant<'a> {
    pub(crate) fn start(network: &'a Network, folder: &Path) -> Self {
        let password = folder.join("secrets/section-1");
        let steady = start_nodes(network, "172.17.17.1-4", 4, &password);
        let node_33 = start_nodes(network, "172.17.17.33", 1, &password);
        Self { network, password, _steady: steady, node_33, downtimes: Vec::new() }
    }

    /// Node 33 loses power and comes back.
    pub(crate) fn restart(&mut self) {
        let from = Instant::now();
        self.node_33.signal(Signal::SIGKILL);
        self.node_33.end();
        self.node_33 = start_nodes(self.network, "172.17.17.33", 1, &self.password);
        self.downtimes.push(from..Instant::now());
    }
}

fn start_nodes(network: &Network, listen: &str, count: usize, password: &Path) -> Process {
    let password = password.to_str().unwrap();
    let arguments = ["node", "--listen", listen, "--password-file", password];
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
    let ports = [40_001, 40_002, 40_004, 40_200, 40_300];
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
