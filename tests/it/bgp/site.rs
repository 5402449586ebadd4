//! An upstream router, three hosts with a relay each, and a plant behind all of them. The configuration of
//! BIRD and what drives it are the files of `deploy/bgp`.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::Command;

use nix::sys::signal::Signal;
use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{Namespace, Process, Relay, eventually, left_out, pnet_nat};

const RELAY: &str = include_str!("../../../deploy/bgp/relay.bird.conf");
const ROUTER: &str = include_str!("../../../deploy/bgp/router.bird.conf");
const ROUTE: &str = include_str!("../../../deploy/bgp/pnet-nat-route");
const SYSCTL: &str = "deploy/bgp/60-pnet-nat-bgp.conf";

pub(super) const PUBLIC: &str = "198.51.100.10";
pub(super) const START_PORT: u16 = 20000;
pub(super) const NODES: u8 = 20;
/// The relays' numbers: the last octet of each host's addresses is 10 or 250 more.
pub(super) const ALL: [u8; 3] = [1, 2, 3];

/// With the times that README.md names.
pub(super) const CONFIGURATION: &str = r#"
[public]
listen = ["198.51.100.10"]

[runtime]
workers = 2
pre_drain = "5s"

[[udp_range_net]]
name = "section-1"
start_port = 20000
subnet = "172.17.17.0"
nodes = ["1-20"]
allow = ["203.0.113.0/24"]

[[udp_range_net.password]]
name = "service"
file = "secrets/section-1"
"#;

pub(super) fn has_bird() -> bool {
    let has = Command::new("bird").arg("--version").output().is_ok();
    if !has {
        left_out("bird, of the package bird2");
    }
    has
}

/// The networks, and BIRD on the router.
pub(super) struct Site {
    pub(super) internet: Namespace,
    pub(super) router: Namespace,
    pub(super) plant: Namespace,
    pub(super) hosts: [Host; 3],
    _bird: Process,
    _folder: TempDir,
}

impl Site {
    /// Starts everything and waits until all relays are in the route.
    pub(super) fn build() -> Option<Self> {
        let made = Namespace::new("inet").and_then(|internet| {
            let (router, plant) = (Namespace::new("router")?, Namespace::new("plant")?);
            let hosts = [Namespace::new("host1")?, Namespace::new("host2")?];
            Ok((internet, router, plant, hosts, Namespace::new("host3")?))
        });
        let (internet, router, plant, [first, second], third) = match made {
            Ok(made) => made,
            Err(error) => {
                left_out(&format!("network namespaces, which need root and iproute2: {error}"));
                return None;
            }
        };
        let hosts = [first, second, third];
        cable(&internet, &router, &plant, &hosts);
        let folder = tempfile::tempdir().unwrap();
        let bird = start_bird(&router, folder.path(), ROUTER);
        let mut number = 0;
        let hosts = hosts.map(|namespace| {
            number += 1;
            Host::start(namespace, number)
        });
        let site = Self { internet, router, plant, hosts, _bird: bird, _folder: folder };
        site.expect_route(&ALL);
        Some(site)
    }

    /// The relays that the router's route leads to.
    pub(super) fn route(&self) -> Vec<u8> {
        let route = self.router.output(&["ip", "-4", "route", "show", PUBLIC]);
        let leads_to = |number: &u8| route.contains(&format!("via 192.0.2.{} ", 10 + number));
        ALL.into_iter().filter(leads_to).collect()
    }

    #[track_caller]
    pub(super) fn expect_route(&self, relays: &[u8]) {
        eventually("the route leads to these relays", || (self.route() == relays).then_some(()));
    }

    pub(super) fn host(&mut self, number: u8) -> &mut Host {
        &mut self.hosts[usize::from(number) - 1]
    }
}

/// The router's eth0 is a switch: it has its link even when a cable behind it is pulled.
fn cable(internet: &Namespace, router: &Namespace, plant: &Namespace, hosts: &[Namespace]) {
    let switch = "link set lo up\nlink add eth0 type bridge\nlink set eth0 up";
    router.ip(&format!(
        "{switch}
         address add 192.0.2.1/24 dev eth0
         link add eth1 type veth peer name eth0 netns {}
         address add 203.0.113.1/24 dev eth1
         link set eth1 up",
        internet.name()
    ));
    for setting in ["ip_forward=1", "fib_multipath_hash_policy=1"] {
        router.output(&["sysctl", "-qw", &format!("net.ipv4.{setting}")]);
    }
    internet.ip("link set lo up\nlink set eth0 up");
    for last in 10..30 {
        internet.ip(&format!("address add 203.0.113.{last}/24 dev eth0"));
    }
    internet.ip("route add default via 203.0.113.1");
    plant.ip(switch);
    for node in 1..=NODES {
        plant.ip(&format!("address add 172.17.17.{node}/24 dev eth0"));
    }
    for (number, host) in (1..).zip(hosts) {
        let name = host.name();
        for (switch, far) in [(router, "eth0"), (plant, "eth1")] {
            switch.ip(&format!(
                "link add port{number} type veth peer name {far} netns {name}
                 link set port{number} master eth0
                 link set port{number} up"
            ));
        }
        host.output(&["sysctl", "-qp", SYSCTL]);
        // Each datagram travels alone, as on a real line.
        host.ip(&format!(
            "link set lo up
             link set eth0 up gso_max_segs 1
             link set eth1 up gso_max_segs 1
             address add {PUBLIC}/32 dev lo
             address add 192.0.2.{}/24 dev eth0
             address add 172.17.17.{}/24 dev eth1
             route add default via 192.0.2.1",
            10 + number,
            250 + number
        ));
    }
}

/// BIRD, with its files in this folder.
fn start_bird(namespace: &Namespace, folder: &Path, configuration: &str) -> Process {
    let file = |name: &str| folder.join(name);
    fs::write(file("bird.conf"), configuration).unwrap();
    let _ = fs::remove_file(file("socket")); // of one that was killed
    let mut command = Command::new("bird");
    command.arg("-d").arg("-c").arg(file("bird.conf"));
    command.arg("-s").arg(file("socket")).arg("-P").arg(file("pid"));
    let bird = namespace.enter(|| Process::start(command));
    eventually("BIRD takes commands", || file("socket").exists().then_some(()));
    bird
}

/// A host with BIRD, a relay, and what drives the one by the other.
pub(super) struct Host {
    namespace: Namespace,
    number: u8,
    bird: Process,
    relay: Option<Relay>,
    _route: Process,
    folder: TempDir,
}

impl Host {
    fn start(namespace: Namespace, number: u8) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let bird = start_bird(&namespace, folder.path(), &configuration_of(number));
        let place = |name: &str| folder.path().join(name);
        symlink(pnet_nat(&[]).get_program(), place("pnet-nat")).unwrap();
        write_program(&place("pnet-nat-route"), ROUTE);
        let birdc =
            format!("#!/bin/sh\nexec /usr/sbin/birdc -s {} \"$@\"\n", place("socket").display());
        write_program(&place("birdc"), &birdc);
        // By `ip`, so that /sys shows the namespace's interfaces.
        let mut route = Command::new("/usr/sbin/ip");
        route.args(["netns", "exec", namespace.name()]).arg(place("pnet-nat-route"));
        route.env("PATH", format!("{}:/usr/bin:/bin", folder.path().display()));
        let route = Process::start(route);
        let mut host = Self { namespace, number, bird, relay: None, _route: route, folder };
        host.start_relay();
        host
    }

    pub(super) fn start_relay(&mut self) {
        let admin = "127.0.0.1:9378".parse().unwrap();
        let relay = self.namespace.enter(|| Relay::start(CONFIGURATION, admin, None));
        self.relay = Some(relay);
    }

    pub(super) fn relay(&mut self) -> &mut Relay {
        self.relay.as_mut().unwrap()
    }

    /// How many flows the kernel carries for the relay.
    pub(super) fn flows_in_the_kernel(&self) -> u64 {
        let (_, status) =
            self.namespace.enter(|| self.relay.as_ref().unwrap().get("/api/v1/status")).unwrap();
        let status: Value = serde_json::from_str(&status).unwrap();
        status["offload"]["flows"].as_u64().unwrap()
    }

    /// The law of the counters holds.
    pub(super) fn expect_rest(&self) {
        self.namespace.enter(|| self.relay.as_ref().unwrap().at_rest());
    }

    pub(super) fn finish(&mut self) {
        let relay = self.relay.take().unwrap();
        self.namespace.enter(|| relay.finish());
    }

    pub(super) fn kill_bird(&mut self) {
        self.bird.signal(Signal::SIGKILL);
        self.bird.status();
    }

    pub(super) fn restart_bird(&mut self) {
        self.bird = start_bird(&self.namespace, self.folder.path(), &configuration_of(self.number));
    }
}

/// The file for a relay's host, with what each has of its own.
fn configuration_of(number: u8) -> String {
    let (from, to) = ("router id 192.0.2.11;", format!("router id 192.0.2.{};", 10 + number));
    assert!(RELAY.contains(from));
    RELAY.replace(from, &to)
}

fn write_program(path: &Path, text: &str) {
    fs::write(path, text).unwrap();
    fs::set_permissions(path, Permissions::from_mode(0o755)).unwrap();
}
