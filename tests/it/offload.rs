//! Flows in the kernel: a program there carries them past the relay, and what stops the relay, or a
//! datagram on its way through it, stops them too.
//!
//! Needs root. Where the kernel carries nothing, a scenario says so and is left out.

use std::net::SocketAddr;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use nix::sys::signal::Signal;
use serde_json::Value;

use crate::harness::{
    FIGURE_10, Network, Over, PASSWORD, Peer, Place, Process, Relay, SECOND, Settings, datagram,
    eventually, exchange, folder, has_nft, left_out, pause, pnet_nat, request, response,
};

const PUBLIC: &str = "198.51.100.1";
const LISTEN: &str = r#"["198.51.100.1"]"#;
/// Longer than a datagram takes, on a busy machine too.
const MOMENT: Duration = Duration::from_millis(300);
/// Longer than a lease.
const LEASE: Duration = Duration::from_millis(2500);

/// What `GET /api/v1/status` says of flows in the kernel.
fn offload(relay: &Relay) -> Value {
    let status: Value = serde_json::from_str(&relay.get("/api/v1/status").unwrap().1).unwrap();
    status["offload"].clone()
}

/// A relay whose flows the kernel carries.
fn start(place: &Place<'_>, settings: &Settings<'_>) -> Option<Relay> {
    let relay = place.relay(settings);
    if let Value::String(why) = &offload(&relay)["why"] {
        left_out(&format!("flows in the kernel: {why}"));
        return None;
    }
    Some(relay)
}

/// One client, one node, and the relay between them.
struct Scene<'a> {
    network: &'a Network,
    relay: Relay,
    client: Peer,
    node: Peer,
    public: SocketAddr,
}

impl<'a> Scene<'a> {
    fn start(network: &'a Network) -> Option<Self> {
        Self::start_with(network, &Settings::default())
    }

    fn start_with(network: &'a Network, settings: &Settings<'_>) -> Option<Self> {
        let relay = start(&network.place(LISTEN), settings)?;
        let (client, node) = (network.client("198.51.100.7"), network.node(4));
        Some(Self { network, relay, client, node, public: network.public(PUBLIC, 4) })
    }

    fn exchange(&self) {
        exchange(&self.client, self.public, &self.node, 4);
    }

    /// An exchange, if it comes about within a moment.
    fn try_to_exchange(&self) -> bool {
        self.client.send(self.public, &request(4));
        let Some((_, from)) = self.node.receive_within(MOMENT) else { return false };
        self.node.send(from, &response(4));
        self.client.receive_within(MOMENT).is_some()
    }

    /// Takes what is late, so that it is not taken for something else.
    fn forget(&self) {
        while let Some((_, from)) = self.node.receive_within(MOMENT) {
            self.node.send(from, &response(4));
        }
        while self.client.receive_within(MOMENT).is_some() {}
    }

    /// Waits until an exchange comes about while the relay stands still: then the kernel carries it.
    #[track_caller]
    fn expect_in_kernel(&self) {
        eventually("the kernel carries the flow", || {
            if !self.try_to_exchange() {
                self.forget();
                return None;
            }
            self.relay.process.hold();
            let passed = self.try_to_exchange();
            self.relay.process.go_on();
            if !passed {
                self.forget();
            }
            passed.then_some(())
        });
    }

    /// Waits until nothing passes any more.
    #[track_caller]
    fn expect_stopped(&self) {
        eventually("nothing passes", || (!self.try_to_exchange()).then_some(()));
        (0..3).for_each(|_| assert!(!self.try_to_exchange(), "it passes again"));
    }
}

#[test]
fn what_the_kernel_carries_is_counted_like_everything() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let Some(scene) = Scene::start(&network) else { return };
        scene.expect_in_kernel();
        let before = scene.relay.metrics();
        for _ in 0..50 {
            scene.exchange();
        }
        let after = scene.relay.metrics();
        let grown = |name: &str, labels: &[(&str, &str)]| {
            after.sum(name, labels) - before.sum(name, labels)
        };
        for direction in ["request", "response"] {
            let labels = [("node", "4"), ("direction", direction)];
            assert_eq!(grown("pnet_nat_received_datagrams_total", &labels), 50, "{direction}");
            assert_eq!(grown("pnet_nat_forwarded_datagrams_total", &labels), 50, "{direction}");
        }
        let octets = (50 * request(4).len()) as u64;
        assert_eq!(grown("pnet_nat_forwarded_bytes_total", &[("direction", "request")]), octets);
        assert_eq!(grown("pnet_nat_accepted_requests_total", &[]), 50);
        assert_eq!(grown("pnet_nat_response_seconds_count", &[("node", "4")]), 50);
        let flows: Value =
            serde_json::from_str(&scene.relay.get("/api/v1/flows").unwrap().1).unwrap();
        let flow = &flows["flows"][0];
        let requests = after.sum("pnet_nat_forwarded_datagrams_total", &[("direction", "request")]);
        assert_eq!(flow["requests"], requests, "{flow}");
        assert_eq!(flow["responses"], requests, "{flow}");
        assert!(flow["idle_seconds"].as_f64() < Some(5.0), "{flow}");
        assert_eq!(offload(&scene.relay)["flows"], 1);
        scene.relay.finish();
    });
}

#[test]
fn a_relay_that_hangs_carries_nothing_for_long() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let Some(scene) = Scene::start(&network) else { return };
        scene.expect_in_kernel();
        scene.relay.process.hold();
        pause(LEASE);
        assert!(!scene.try_to_exchange());
        scene.relay.process.go_on();
        scene.forget();
        scene.expect_in_kernel();
        scene.relay.finish();
    });
}

#[test]
fn a_relay_that_is_killed_leaves_nothing_behind() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let Some(mut scene) = Scene::start(&network) else { return };
        scene.expect_in_kernel();
        scene.relay.process.signal(Signal::SIGKILL);
        scene.relay.process.end();
        (0..5).for_each(|_| assert!(!scene.try_to_exchange()));
    });
}

/// Also for those who are connected already.
#[test]
fn a_ban_takes_hold() {
    let Some(network) = Network::build().filter(|_| has_nft()) else { return };
    network.at_the_edge(|| {
        let Some(scene) = Scene::start(&network) else { return };
        for (hook, rule) in [
            ("input", "ip saddr 198.51.100.7 udp dport 20004 drop"),
            ("output", "ip daddr 198.51.100.7 udp sport 20004 drop"),
            ("output", "ip daddr 172.17.17.4 udp dport 34379 drop"),
        ] {
            scene.expect_in_kernel();
            network.edge.nft(&format!(
                "table inet ban {{ chain those {{ type filter hook {hook} priority 0; {rule}; }} }}\n"
            ));
            scene.expect_stopped();
            network.edge.nft("delete table inet ban");
            scene.forget();
        }
        scene.expect_in_kernel();
        scene.relay.finish();
    });
}

/// While somebody goes on asking with it.
#[test]
fn a_password_that_is_withdrawn_reaches_no_node_after_the_report() {
    let Some(network) = Network::build() else { return };
    let first = "[[udp_range_net.password]]\nname = \"first\"\nfile = \"secrets/section-1\"\n";
    let both =
        format!("{first}[[udp_range_net.password]]\nname = \"second\"\nfile = \"secrets/press\"");
    let place = network.place(LISTEN);
    let of = |passwords| place.configuration(&Settings { passwords, ..Settings::default() });
    network.at_the_edge(|| {
        let settings = Settings { passwords: &both, ..Settings::default() };
        let Some(relay) = start(&place, &settings) else { return };
        let (node, over) = (network.node(4), AtomicBool::new(false));
        let (client, public) = (network.client("198.51.100.7"), network.public(PUBLIC, 4));
        thread::scope(|scope| {
            let _at_the_end = Over(&over);
            scope.spawn(|| {
                while !over.load(Relaxed) {
                    client.send(public, &datagram(&FIGURE_10, &[], SECOND));
                    pause(Duration::from_micros(200));
                }
            });
            for _ in 0..20 {
                // The kernel carries it once an answer has shown the way back.
                eventually("the kernel carries the flow", || {
                    let (asked, from) = node.receive_within(MOMENT)?;
                    node.send(from, &asked);
                    (offload(&relay)["flows"] == 1).then_some(())
                });
                (0..20).for_each(|_| _ = node.receive());
                relay.reload_to(&of(first));
                while node.waiting().is_some() {}
                assert_eq!(node.receive_within(MOMENT), None, "with a password that is withdrawn");
                relay.reload_to(&of(&both));
            }
        });
        relay.finish();
    });
}

#[test]
fn without_the_privileges_everything_goes_by_sockets() {
    let Some(network) = Network::build() else { return };
    let without = |arguments: &[&str]| {
        let relay = pnet_nat(arguments);
        let mut command = Command::new("setpriv");
        command.args(["--bounding-set", "-bpf,-perfmon,-net_admin,-sys_admin"]);
        command.arg(relay.get_program()).args(relay.get_args());
        command
    };
    network.at_the_edge(|| {
        let place = network.place(LISTEN);
        let configuration = place.configuration(&Settings::default());
        let relay = Relay::start_as(&configuration, place.admin, without);
        let (client, node) = (network.client("198.51.100.7"), network.node(4));
        (0..3).for_each(|_| _ = exchange(&client, network.public(PUBLIC, 4), &node, 4));
        assert_eq!(offload(&relay)["state"], "off");
        assert_eq!(offload(&relay)["flows"], 0);
        let log = relay.finish();
        let why = log.logged("open flows stay on the sockets").pop().unwrap();
        assert!(why["why"].as_str().unwrap().contains("CAP_BPF"), "{why}");

        let folder = folder(&(configuration + "\n[datapath]\nkernel = \"required\"\n"));
        let config = folder.path().join("pnet-nat.toml");
        let mut relay = Process::start(without(&["run", "--config", config.to_str().unwrap()]));
        assert_eq!(relay.end(), Some(2));
        assert!(relay.stderr().contains("CAP_BPF"), "{}", relay.stderr());
    });
}

/// A second relay, and the tc program of somebody else.
#[test]
fn others_at_the_same_interface_are_left_alone() {
    let Some(network) = Network::build() else { return };
    network.edge.tc("qdisc add dev eth0 clsact\nfilter add dev eth0 ingress matchall action pass");
    network.at_the_edge(|| {
        let Some(scene) = Scene::start(&network) else { return };
        let place = Place {
            admin: ([127, 0, 0, 1], 9379).into(),
            start_port: 21_000,
            ..network.place(LISTEN)
        };
        let Some(relay) = start(&place, &Settings::default()) else { return };
        let (client, public) = (network.client("198.51.100.8"), (PUBLIC.parse().unwrap(), 21_003));
        let other = Scene {
            network: &network,
            relay,
            client,
            node: network.node(3),
            public: public.into(),
        };
        let ask_the_other = || exchange(&other.client, other.public, &other.node, 3);
        (0..3).for_each(|_| _ = ask_the_other());
        scene.expect_in_kernel();
        (0..3).for_each(|_| _ = ask_the_other());
        assert_eq!(offload(&other.relay)["flows"], 1);
        assert_eq!(other.network.edge.name(), network.edge.name());
        other.relay.finish();
        scene.expect_in_kernel();
        let filters = network.edge.output(&["tc", "filter", "show", "dev", "eth0", "ingress"]);
        assert!(filters.contains("matchall"), "{filters}");
        scene.relay.finish();
    });
}

#[test]
fn what_changes_on_the_way_is_found() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let Some(scene) = Scene::start(&network) else { return };
        let (edge, plant, internet) = (&network.edge, &network.plant, &network.internet);
        let steps: [(&str, &dyn Fn()); 6] = [
            ("the line to the plant was down", &|| {
                edge.ip("link set eth1 down");
                assert!(!scene.try_to_exchange());
                edge.ip("link set eth1 up");
            }),
            ("the address in the plant was away", &|| {
                edge.ip("address delete 172.17.17.254/24 dev eth1");
                edge.ip("address add 172.17.17.254/24 dev eth1");
            }),
            ("the public address was away", &|| {
                edge.ip("address delete 198.51.100.1/24 dev eth0");
                assert!(!scene.try_to_exchange());
                edge.ip("address add 198.51.100.1/24 dev eth0");
            }),
            ("the node has another hardware address", &|| {
                plant.ip("link set eth0 address 02:00:00:00:00:99");
            }),
            ("the client has another hardware address", &|| {
                internet.ip("link set eth0 address 02:00:00:00:00:98");
            }),
            ("the interface is another one", &|| {
                edge.ip("link delete eth1");
                plant.ip(&format!("link add eth0 type veth peer name eth1 netns {}", edge.name()));
                plant.ip("link set eth0 up
                     address add 172.17.17.4/24 dev eth0");
                edge.ip("link set eth1 up
                     address add 172.17.17.254/24 dev eth1");
            }),
        ];
        for (what, step) in steps {
            scene.expect_in_kernel();
            step();
            scene.forget();
            println!("{what}");
            scene.expect_in_kernel();
        }
        scene.relay.finish();
    });
}

#[test]
fn what_the_kernel_does_not_carry_goes_by_sockets() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let exchanged = "[[udp_range_net.password]]\nname = \"service\"\nfile = \"secrets/press\"\n\
                         device_file = \"secrets/section-1\"";
        for (net, passwords, password) in [
            ("max_requests_per_second = 10000", Settings::default().passwords, PASSWORD),
            ("", exchanged, SECOND),
        ] {
            let settings = Settings { net, passwords, ..Settings::default() };
            let Some(scene) = Scene::start_with(&network, &settings) else { return };
            let asked = datagram(&FIGURE_10, &[], password);
            for _ in 0..3 {
                scene.client.send(scene.public, &asked);
                scene.node.receive();
            }
            assert_eq!(offload(&scene.relay)["flows"], 0);
            scene.relay.finish();
        }
        let place = network.place(r#"["198.51.100.1", "2001:db8:1::1"]"#);
        let Some(relay) = start(&place, &Settings::default()) else { return };
        let (client, node) = (network.client("2001:db8:1::7"), network.node(4));
        for _ in 0..3 {
            exchange(&client, network.public("2001:db8:1::1", 4), &node, 4);
        }
        assert_eq!(offload(&relay)["flows"], 0);
        relay.finish();
    });
}
