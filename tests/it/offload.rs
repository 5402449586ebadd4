//! Flows in the kernel: what is carried there, and what ends it.
//!
//! Needs root and Linux 6.6. A relay that is held answers nobody, so what passes then went by the kernel.

use std::collections::BTreeSet;
use std::fs;
use std::net::SocketAddr;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use serde_json::Value;

use crate::fail2ban;
use crate::harness::{
    FIGURE_10, Network, Over, PASSWORD, Peer, Place, Process, Relay, SECOND, Settings, datagram,
    eventually, folder, has_nft, left_out, pause, pnet_nat,
};
use crate::reloading::{FIRST, FIRST_AND_SECOND};

const REQUIRED: &str = "[datapath]\nkernel = \"required\"";
/// Longer than any lease.
const LEASE: Duration = Duration::from_millis(2500);
/// What is not there by then counts as lost. A test that wants it to come tries again.
const SOON: Duration = Duration::from_millis(300);
const PUBLIC: &str = "198.51.100.1";
const WAY_BACK: [u8; 9] = [0x0B, 0x03, 0x06, 0x1F, 0x8B, 0x84, 0x82, 0xA1, 0x80];

fn settings() -> Settings<'static> {
    Settings { sections: REQUIRED, ..Settings::default() }
}

fn place(network: &Network) -> Place<'_> {
    network.place(r#"["198.51.100.1"]"#)
}

/// A client, and the node that answers it.
struct Ends {
    client: Peer,
    node: Peer,
    public: SocketAddr,
    node_address: u8,
    /// Each request has a number of its own, so that none is taken for another one that came late.
    asked: AtomicU32,
}

impl Ends {
    fn new(network: &Network) -> Self {
        Self::of(network, "198.51.100.7", 4, network.public(PUBLIC, 4))
    }

    fn of(network: &Network, client: &str, node_address: u8, public: SocketAddr) -> Self {
        let (client, node) = (network.client(client), network.node(node_address));
        Self { client, node, public, node_address, asked: AtomicU32::new(0) }
    }

    /// Asks once. Tells whether the answer came.
    fn passes(&self) -> bool {
        let number = self.asked.fetch_add(1, Relaxed).to_be_bytes();
        let mut route = FIGURE_10;
        route[1] = self.node_address;
        let request = datagram(&route, &number, PASSWORD);
        let response = datagram(&WAY_BACK, &number, PASSWORD);
        self.client.send(self.public, &request);
        let Some(relay) = wait_for(&self.node, &request) else { return false };
        self.node.send(relay, &response);
        let from = wait_for(&self.client, &response);
        assert!(from.is_none_or(|from| from == self.public), "{from:?} answers");
        from.is_some()
    }

    /// Waits until an exchange passes.
    fn expect_passage(&self) {
        eventually("an exchange passes", || self.passes().then_some(()));
    }

    /// Waits until an exchange passes while the relay is held.
    fn expect_carried(&self, relay: &Relay) {
        eventually("the kernel carries the flow", || {
            self.expect_passage();
            relay.process.hold();
            let carried = self.passes();
            relay.process.go_on();
            carried.then_some(())
        });
        self.expect_passage();
    }

    /// Nothing passes when a lease is over that may have been renewed a moment ago. Tells how long
    /// something passed.
    fn expect_end_within_lease(&self) -> Duration {
        let begun = Instant::now();
        let mut last = Duration::ZERO;
        while begun.elapsed() < LEASE {
            let asked = begun.elapsed();
            if self.passes() {
                last = asked;
            }
        }
        assert_eq!([(); 3].map(|()| self.passes()), [false; 3], "after the lease");
        last
    }
}

/// Who sent this datagram, if it comes soon. Others are left aside.
fn wait_for(peer: &Peer, datagram: &[u8]) -> Option<SocketAddr> {
    let end = Instant::now() + SOON;
    loop {
        let left = end.saturating_duration_since(Instant::now()).max(Duration::from_millis(1));
        let (octets, from) = peer.receive_within(left)?;
        if octets == datagram {
            return Some(from);
        }
    }
}

fn json(relay: &Relay, path: &str) -> Value {
    serde_json::from_str(&relay.get(path).unwrap().1).unwrap()
}

/// How many flows the kernel has.
fn flows(relay: &Relay) -> u64 {
    json(relay, "/api/v1/status")["offload"]["flows"].as_u64().unwrap()
}

/// What the only flow, node 4 and its password have: datagrams and octets by the API, then by the metrics.
fn figures(relay: &Relay) -> Vec<u64> {
    let metrics = relay.at_rest();
    let list = json(relay, "/api/v1/flows");
    assert_eq!(list["flows"].as_array().unwrap().len(), 1, "{list}");
    let of_flow =
        ["requests", "responses", "octets"].map(|key| list["flows"][0][key].as_u64().unwrap());
    let mut figures = of_flow.to_vec();
    for direction in ["request", "response"] {
        let labels = [("node", "4"), ("direction", direction)];
        for family in ["received_datagrams", "forwarded_datagrams", "forwarded_bytes"] {
            figures.push(metrics.sum(&format!("pnet_nat_{family}_total"), &labels));
        }
    }
    figures.push(metrics.sum("pnet_nat_accepted_requests_total", &[("credential", "service")]));
    figures.push(metrics.sum("pnet_nat_response_seconds_count", &[("node", "4")]));
    figures
}

#[test]
fn what_the_kernel_carries_is_counted() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = place(&network).relay(&settings());
        let ends = Ends::new(&network);
        let (before, asked) = eventually("five exchanges pass while the relay is held", || {
            ends.expect_carried(&relay);
            let before = figures(&relay);
            relay.process.hold();
            let passed = [(); 5].map(|()| ends.passes());
            let asked = Instant::now();
            relay.process.go_on();
            (passed == [true; 5]).then_some((before, asked))
        });
        let idle = json(&relay, "/api/v1/flows")["flows"][0]["idle_seconds"].as_f64().unwrap();
        assert!(idle <= asked.elapsed().as_secs_f64() + SOON.as_secs_f64(), "{idle}");
        let after = figures(&relay);
        let more: Vec<_> = after.iter().zip(&before).map(|(is, was)| is - was).collect();
        let octets = |route: &[u8]| 5 * datagram(route, &[0; 4], PASSWORD).len() as u64;
        let (requests, responses) = (octets(&FIGURE_10), octets(&WAY_BACK));
        assert_eq!(more[..3], [5, 5, requests + responses], "of the flow");
        assert_eq!(more[3..], [5, 5, requests, 5, 5, responses, 5, 5], "of the node");
        assert_eq!(flows(&relay), 1);
        relay.expect_drops(&[]);
        relay.finish();
    });
}

#[test]
fn a_relay_that_hangs_carries_nothing_after_the_lease() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = place(&network).relay(&settings());
        let ends = Ends::new(&network);
        for _ in 0..2 {
            ends.expect_carried(&relay);
            relay.process.hold();
            ends.expect_end_within_lease();
            relay.process.go_on();
            ends.expect_carried(&relay);
        }
        relay.expect_drops(&[]);
        relay.finish();
    });
}

#[test]
fn after_kill_9_nothing_is_carried() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let mut relay = place(&network).relay(&settings());
        let ends = Ends::new(&network);
        ends.expect_carried(&relay);
        relay.process.signal(Signal::SIGKILL);
        assert_eq!(relay.process.end(), None);
        assert_eq!([(); 3].map(|()| ends.passes()), [false; 3]);
        let relay = place(&network).relay(&settings());
        ends.expect_carried(&relay);
        relay.expect_drops(&[]);
        relay.finish();
    });
}

/// Rules of nft at the edge, the second as fail2ban's action `nftables[type=allports]` writes them.
const RULES: [&str; 5] = [
    "table inet ban { chain input { type filter hook input priority 0
        ip saddr 198.51.100.7 drop
    }; }",
    "table inet ban { set addr-set-pnet-nat { type ipv4_addr
        elements = { 198.51.100.7 }
    }
    chain f2b-chain { type filter hook input priority -1
        meta l4proto { tcp, udp } ip saddr @addr-set-pnet-nat drop
    }; }",
    "table netdev ban { chain ingress { type filter hook ingress device eth0 priority 0
        ip saddr 198.51.100.7 drop
    }; }",
    "table inet ban { chain output { type filter hook output priority 0
        ip daddr 198.51.100.7 drop
    }; }",
    "table inet ban { chain output { type filter hook output priority 0
        ip daddr 172.17.17.4 drop
    }; }",
];

#[test]
fn a_ban_takes_hold_on_an_open_flow_within_the_lease() {
    let Some(network) = Network::build() else { return };
    if !has_nft() {
        return;
    }
    network.at_the_edge(|| {
        let relay = place(&network).relay(&settings());
        let ends = Ends::new(&network);
        for rule in RULES {
            ends.expect_carried(&relay);
            network.edge.nft(&format!("{rule}\n"));
            ends.expect_end_within_lease();
            let family = rule.split(' ').nth(1).unwrap();
            network.edge.nft(&format!("delete table {family} ban"));
        }
        ends.expect_carried(&relay);
        relay.finish();
    });
}

/// A client that asks all the time, and a node that answers and writes down what came.
#[derive(Default)]
struct Traffic {
    sent: AtomicU32,
    answered: AtomicU32,
    came: Mutex<BTreeSet<u32>>,
    over: AtomicBool,
}

impl Traffic {
    fn ask(&self, client: &Peer, public: SocketAddr, password: &[u8; 8]) {
        while !self.over.load(Relaxed) {
            let number = self.sent.fetch_add(1, Relaxed) + 1;
            client.send(public, &datagram(&FIGURE_10, &number.to_be_bytes(), password));
            if client.receive_within(Duration::from_millis(2)).is_some() {
                self.answered.fetch_add(1, Relaxed);
            }
        }
    }

    fn answer(&self, node: &Peer, password: &[u8; 8]) {
        while !self.over.load(Relaxed) {
            let Some((octets, from)) = node.receive_within(SOON) else { continue };
            let data = 4 + FIGURE_10.len() + 2;
            let number = u32::from_be_bytes(*octets[data..].first_chunk().unwrap());
            assert!(self.came.lock().unwrap().insert(number), "{number} came twice");
            node.send(from, &datagram(&WAY_BACK, &number.to_be_bytes(), password));
        }
    }

    /// Waits until this many more were counted.
    fn wait(what: &AtomicU32, more: u32) {
        let before = what.load(Relaxed);
        eventually("traffic goes on", || (what.load(Relaxed) >= before + more).then_some(()));
    }

    /// Waits until traffic goes by the kernel.
    fn expect_carried(&self, relay: &Relay) {
        eventually("the kernel carries the flow", || {
            Self::wait(&self.answered, 5);
            relay.process.hold();
            let before = self.answered.load(Relaxed);
            pause(Duration::from_millis(50));
            let carried = self.answered.load(Relaxed) > before + 1;
            relay.process.go_on();
            carried.then_some(())
        });
        Self::wait(&self.answered, 5);
    }
}

#[test]
fn nothing_that_was_withdrawn_is_carried_after_the_reload() {
    let Some(network) = Network::build() else { return };
    let place = place(&network);
    // Who goes on asking with what is withdrawn is not to be throttled for it.
    let limits = "[limits]\nwrong_password_burst = 65535\nwrong_password_interval = \"50ms\"";
    let sections = format!("{REQUIRED}\n{limits}");
    let (two, one) = (FIRST_AND_SECOND, FIRST);
    let settings = Settings { passwords: two, sections: &sections, ..Settings::default() };
    let with = place.configuration(&settings);
    let all = r#"["0.0.0.0/0", "::/0", "172.17.17.0/24"]"#;
    for (what, is) in [(two, one), ("\"1-4\", 33", "\"1-3\", 33"), (all, r#"["198.51.100.8/32"]"#)]
    {
        let without = with.replace(what, is);
        assert_ne!(with, without);
        network.at_the_edge(|| withdraw(&network, &with, &without));
    }
}

fn withdraw(network: &Network, with: &str, without: &str) {
    let relay = Relay::start(with, network.place("").admin, None);
    let (client, node) = (network.client("198.51.100.7"), network.node(4));
    let traffic = Traffic::default();
    let mut forbidden = Vec::new();
    thread::scope(|scope| {
        scope.spawn(|| traffic.ask(&client, network.public(PUBLIC, 4), SECOND));
        scope.spawn(|| traffic.answer(&node, SECOND));
        let over = Over(&traffic.over);
        for _ in 0..20 {
            traffic.expect_carried(&relay);
            relay.reload_to(without);
            // The one that is being sent just now may have been sent before.
            let first = traffic.sent.load(Relaxed) + 1;
            Traffic::wait(&traffic.sent, 20);
            forbidden.push(first..traffic.sent.load(Relaxed));
            assert_eq!(flows(&relay), 0);
            // The relay has had all of them when it gets its password again.
            Traffic::wait(&traffic.sent, 50);
            let list = json(&relay, "/api/v1/flows");
            assert_eq!(list["flows"].as_array().unwrap().len(), 0, "{list}");
            relay.reload_to(with);
        }
        traffic.expect_carried(&relay);
        drop(over);
    });
    let came = traffic.came.into_inner().unwrap();
    let wrong: Vec<_> = forbidden.into_iter().flat_map(|range| came.range(range)).collect();
    assert!(wrong.is_empty(), "{wrong:?} came after the reload");
    relay.finish();
}

/// The command of a relay that lacks these capabilities.
fn without(capabilities: &str, command: &Command) -> Command {
    let mut setpriv = Command::new("setpriv");
    setpriv.args(["--bounding-set", capabilities]).arg(command.get_program());
    setpriv.args(command.get_args());
    for (name, _) in command.get_envs().filter(|(_, value)| value.is_none()) {
        setpriv.env_remove(name);
    }
    setpriv
}

#[test]
fn without_the_capabilities_flows_stay_on_the_sockets_or_the_start_fails() {
    let Some(network) = Network::build() else { return };
    if Command::new("setpriv").arg("--version").output().is_err() {
        return left_out("setpriv, of util-linux");
    }
    network.at_the_edge(|| {
        let place = place(&network);
        for capabilities in ["-bpf,-perfmon,-net_admin", "-bpf", "-perfmon", "-net_admin"] {
            // CAP_SYS_ADMIN stands for both of them where they are missing.
            let capabilities = &format!("-sys_admin,{capabilities}");
            let auto = place.configuration(&Settings::default());
            let relay = Relay::start_as(&auto, place.admin, |arguments| {
                without(capabilities, &pnet_nat(arguments))
            });
            let ends = Ends::new(&network);
            (0..4).for_each(|_| ends.expect_passage());
            let offload = json(&relay, "/api/v1/status")["offload"].clone();
            assert_eq!((&offload["state"], &offload["flows"]), (&"off".into(), &0.into()));
            let why = offload["why"].as_str().unwrap();
            assert!(why.contains("CAP_BPF, CAP_NET_ADMIN and CAP_PERFMON"), "{why}");
            relay.expect_drops(&[]);
            let log = relay.finish();
            let told = log.logged("open flows stay on the sockets");
            assert_eq!(told.len(), 1, "{capabilities}");
            assert_eq!(told[0]["why"], why);

            let folder = folder(&place.configuration(&settings()));
            let config = folder.path().join("pnet-nat.toml");
            let command = pnet_nat(&["run", "--config", config.to_str().unwrap()]);
            let mut refused = Process::start(without(capabilities, &command));
            assert_eq!(refused.end(), Some(2), "{}", refused.stderr());
            assert!(refused.stderr().contains("CAP_BPF"), "{}", refused.stderr());
        }
    });
}

/// Attaches another program at the public interface. What passes in the kernel does not come to it. Counts
/// the datagrams that do.
fn long_way(network: &Network) -> impl Fn() -> u64 {
    // It matches nothing. The kernel counts what comes to it.
    let foreign = "qdisc add dev eth0 clsact
        filter add dev eth0 ingress protocol ip pref 7 u32 match u8 0 0 at 0 flowid 1:1";
    network.edge.tc(foreign);
    || {
        let text = network.edge.output(&["tc", "-s", "qdisc", "show", "dev", "eth0", "clsact"]);
        let (_, rest) = text.split_once(" bytes ").expect(&text);
        rest.split(' ').next().unwrap().parse::<u64>().expect(&text)
    }
}

#[test]
fn two_relays_and_another_program_do_not_disturb_each_other() {
    let Some(network) = Network::build() else { return };
    let counted = long_way(&network);
    network.at_the_edge(|| {
        let first = place(&network);
        let admin = "127.0.0.1:9379".parse().unwrap();
        let second = Place { admin, start_port: 21_000, ..place(&network) };
        let ends = Ends::new(&network);
        let others = Ends::of(&network, "198.51.100.8", 3, "198.51.100.1:21003".parse().unwrap());
        let relay = first.relay(&settings());
        let mut other = second.relay(&settings());
        ends.expect_carried(&relay);
        others.expect_carried(&other);
        ends.expect_carried(&relay);
        eventually("few of many come to the other program", || {
            let before = counted();
            let passed = (0..50).filter(|_| ends.passes()).count();
            let more = counted() - before;
            (passed == 50 && more < 25).then_some(())
        });
        let before = counted();
        eventually("the long way leads by the other program", || {
            ends.expect_passage();
            (counted() > before).then_some(())
        });
        other.process.signal(Signal::SIGKILL);
        other.process.end();
        ends.expect_carried(&relay);
        let other = second.relay(&settings());
        others.expect_carried(&other);
        relay.expect_drops(&[]);
        relay.finish();
        others.expect_carried(&other);
        other.expect_drops(&[]);
        other.finish();
        let filters = network.edge.output(&["tc", "filter", "show", "dev", "eth0", "ingress"]);
        assert!(filters.contains("pref 7 u32"), "{filters}");
    });
}

/// fail2ban with the files of `deploy`. By itself it bans nobody whose password was right lately.
#[test]
fn a_ban_of_fail2ban_takes_hold() {
    if !fail2ban::is_there("fail2ban-server") || !has_nft() {
        return;
    }
    let Some(network) = Network::build() else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let copied = Command::new("cp").args(["-r", "/etc/fail2ban/."]).arg(folder.path()).status();
    assert!(copied.unwrap().success());
    let jail = fs::read_to_string(fail2ban::JAIL).unwrap();
    let jail = jail
        .replace(
            "backend  = systemd",
            &format!("backend = polling\nlogpath = {}", at("log").display()),
        )
        .replace(" 198.51.100.0/24", "")
        .replace("iptables-multiport[blocktype=DROP]", "nftables-multiport[blocktype=drop]");
    fs::copy(fail2ban::FILTER, at("filter.d/pnet-nat.conf")).unwrap();
    fs::read_dir(at("jail.d"))
        .unwrap()
        .for_each(|file| fs::remove_file(file.unwrap().path()).unwrap());
    fs::write(at("jail.d/pnet-nat.conf"), jail).unwrap();
    fs::write(at("fail2ban.local"), "[Definition]\ndbfile = None\n").unwrap();
    fs::write(at("log"), "").unwrap();
    network.at_the_edge(|| {
        let relay = place(&network).relay(&settings());
        let ends = Ends::new(&network);
        let mut server = Command::new("fail2ban-server");
        server.arg("-f").arg("-c").arg(folder.path()).arg("-s").arg(at("socket"));
        server.arg("-p").arg(at("pid")).args([
            "--loglevel",
            "INFO",
            "--logtarget",
            "STDOUT",
            "start",
        ]);
        let server = Process::start(server);
        eventually("the jail is there", || {
            server.stdout().contains("Jail 'pnet-nat' started").then_some(())
        });
        ends.expect_carried(&relay);

        let mut ban = Command::new("fail2ban-client");
        ban.arg("-s").arg(at("socket")).args(["set", "pnet-nat", "banip", "198.51.100.7"]);
        assert!(ban.status().unwrap().success());
        eventually("it is banned", || server.stdout().contains("Ban 198.51.100.7").then_some(()));
        ends.expect_end_within_lease();
        server.signal(Signal::SIGTERM);
        relay.finish();
    });
}

#[test]
fn what_changes_on_the_way_is_found() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = place(&network).relay(&settings());
        let ends = Ends::new(&network);
        let (edge, plant) = (&network.edge, &network.plant);
        let steps: [(&str, &dyn Fn()); 5] = [
            ("the line to the plant was down", &|| {
                edge.ip("link set eth1 down");
                assert!(!ends.passes());
                edge.ip("link set eth1 up");
            }),
            ("the address in the plant was away", &|| {
                edge.ip("address delete 172.17.17.254/24 dev eth1");
                edge.ip("address add 172.17.17.254/24 dev eth1");
            }),
            ("the public address was away", &|| {
                edge.ip("address delete 198.51.100.1/24 dev eth0");
                ends.expect_end_within_lease(); // the relay hears of changes that follow each other in groups
                edge.ip("address add 198.51.100.1/24 dev eth0");
            }),
            ("the node has another hardware address", &|| {
                plant.ip("link set eth0 address 02:00:00:00:00:99");
                edge.ip("neighbour flush dev eth1"); // or it takes the kernel a minute to ask again
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
            ends.expect_carried(&relay);
            step();
            println!("{what}");
            ends.expect_carried(&relay);
        }
        relay.finish();
    });
}

#[test]
fn what_the_kernel_does_not_carry_goes_by_sockets() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let exchanged = "[[udp_range_net.password]]\nname = \"service\"\nfile = \"secrets/section-1\"\n\
                         device_file = \"secrets/section-1-device\"";
        let usual = Settings::default().passwords;
        for (net, passwords) in [("max_requests_per_second = 10000", usual), ("", exchanged)] {
            let relay = place(&network).relay(&Settings { net, passwords, ..settings() });
            let ends = Ends::new(&network);
            for _ in 0..4 {
                ends.client.send(ends.public, &datagram(&FIGURE_10, &[], PASSWORD));
                ends.node.receive();
            }
            assert_eq!(flows(&relay), 0);
            relay.finish();
        }
        let both = Place { listen: r#"["198.51.100.1", "2001:db8:1::1"]"#, ..place(&network) };
        let relay = both.relay(&settings());
        let public = network.public("2001:db8:1::1", 4);
        let ends = Ends::of(&network, "2001:db8:1::7", 4, public);
        (0..4).for_each(|_| ends.expect_passage());
        assert_eq!(flows(&relay), 0);
        relay.finish();
    });
}

/// So it is where a routing daemon learns routes: each of them could be another way for a flow.
#[test]
fn routes_that_change_without_end_leave_most_to_the_kernel() {
    let Some(network) = Network::build() else { return };
    let counted = long_way(&network);
    network.at_the_edge(|| {
        let relay = place(&network).relay(&settings());
        let ends = Ends::new(&network);
        ends.expect_carried(&relay);
        eventually("few requests of many take the long way", || {
            let before = counted();
            let passed = (0..100).filter(|_| {
                network.edge.ip("route add 203.0.113.1/32 dev eth1
                     route delete 203.0.113.1/32 dev eth1");
                ends.passes()
            });
            (passed.count() == 100 && counted() - before < 50).then_some(())
        });
        relay.finish();
    });
}

/// The route to the client leads by another interface for a while, where the kernel carries nothing.
#[test]
fn another_route_is_taken() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = place(&network).relay(&settings());
        let ends = Ends::new(&network);
        let (edge, internet) = (&network.edge, &network.internet);
        ends.expect_carried(&relay);
        internet.ip(&format!("link add wan1 type veth peer name wan1 netns {}", edge.name()));
        for namespace in [internet, edge] {
            for interface in ["all", "eth0", "wan1"] {
                let switch = format!("net.ipv4.conf.{interface}.rp_filter=0");
                namespace.output(&["sysctl", "-w", &switch]);
            }
            // What it says of its own accord would be counted, too.
            namespace.output(&["sysctl", "-w", "net.ipv6.conf.wan1.disable_ipv6=1"]);
            namespace.ip("link set wan1 up");
        }
        let sent = || {
            let text = edge.output(&["cat", "/sys/class/net/wan1/statistics/tx_packets"]);
            text.trim().parse::<u64>().expect(&text)
        };
        assert_eq!(sent(), 0);
        edge.ip("route add 198.51.100.7/32 dev wan1 src 198.51.100.1");
        eventually("an answer goes by the other interface", || {
            (ends.passes() && sent() > 0).then_some(())
        });
        edge.ip("route delete 198.51.100.7/32 dev wan1");
        ends.expect_carried(&relay);
        relay.finish();
    });
}

/// The public address stands on lo, as where several relays announce it: requests come in by another interface.
#[test]
fn a_public_address_on_lo_is_carried() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        network.edge.ip("address add 192.0.2.5/32 dev lo");
        network.internet.ip("route add 192.0.2.5/32 via 198.51.100.1");
        let place = Place { listen: r#"["192.0.2.5"]"#, ..place(&network) };
        let relay = place.relay(&settings());
        let ends = Ends::of(&network, "198.51.100.7", 4, network.public("192.0.2.5", 4));
        ends.expect_carried(&relay);
        relay.finish();
    });
}
