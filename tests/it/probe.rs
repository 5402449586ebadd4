//! `pnet-nat probe` on a router with a fault of each kind, and the same for one node through the admin
//! server of a confined relay. Needs root.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{
    FIGURE_10, Network, Process, Relay, Settings, WRONG, datagram, eventually, exchange, folder,
    has_nft, pnet_nat, request,
};

const LISTEN: &str = r#"["198.51.100.1"]"#;

/// A configuration for the edge, with further keys of `[admin]`.
pub(crate) fn configuration(network: &Network, admin: &str) -> String {
    let configuration = network.place(LISTEN).configuration(&Settings::default());
    configuration
        .replace(
            r#"allow = ["0.0.0.0/0", "::/0", "172.17.17.0/24"]"#,
            r#"allow = ["198.51.100.0/24"]"#,
        )
        .replace("[admin]", &format!("[admin]\n{admin}"))
}

/// A simulated node in the plant, with the password in a file of `secrets`.
pub(crate) fn node(network: &Network, node_address: u8, password: &str) -> (Process, TempDir) {
    let folder = folder("");
    let file = folder.path().join("secrets").join(password);
    let listen = format!("172.17.17.{node_address}");
    let arguments = ["node", "--listen", &listen, "--password-file", file.to_str().unwrap()];
    let node = network.plant.enter(|| Process::start(pnet_nat(&arguments)));
    eventually("the node is there", || (node.stdout().lines().count() == 1).then_some(()));
    (node, folder)
}

/// The exit code of a probe, and its checks.
pub(crate) struct Probed {
    pub(crate) code: Option<i32>,
    pub(crate) report: Value,
}

pub(crate) fn probe(folder: &Path, options: &[&str]) -> Probed {
    let config = folder.join("pnet-nat.toml");
    let arguments = ["probe", "--config", config.to_str().unwrap(), "--format", "json"];
    let mut probe = Process::start(pnet_nat(&[&arguments, options].concat()));
    let code = probe.end();
    let report = serde_json::from_str(&probe.stdout());
    let report =
        report.unwrap_or_else(|error| panic!("{error}: {} {}", probe.stdout(), probe.stderr()));
    Probed { code, report }
}

impl Probed {
    /// Checks the verdict, and a part of the text or of the remedy, of a check.
    #[track_caller]
    pub(crate) fn expect(&self, check: &str, subject: &str, verdict: &str, part: &str) {
        let checks = self.report["checks"].as_array().unwrap();
        let is_it = |found: &&Value| found["check"] == check && found["subject"] == subject;
        let found: Vec<_> = checks.iter().filter(is_it).collect();
        let says = |found: &&&Value| {
            found["verdict"] == verdict
                && format!("{} {}", found["text"], found["remedy"]).contains(part)
        };
        assert!(found.iter().any(|found| says(&found)), "{check} of {subject}: {found:#?}");
    }
}

#[test]
fn a_sound_router_has_nothing_bad() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let nodes = [1, 2, 3, 4, 33].map(|address| node(&network, address, "section-1"));
        let relay = Relay::start(&configuration(&network, ""), network.place("").admin, None);
        let probed = probe(relay.folder.path(), &[]);
        assert_eq!(probed.code, Some(0), "{:#}", probed.report);
        probed.expect("relay", "the relay", "good", "relays");
        probed.expect("interface", "section-1", "good", "eth1 has 172.17.17.254/24 and is up");
        probed.expect("route", "section-1", "good", "by eth1, from 172.17.17.254");
        probed.expect("allow", "section-1", "good", "198.51.100.0/24");
        probed.expect("ports", "section-1", "good", "the relay has UDP 20001-20004, 20033");
        probed.expect("port range", "section-1", "good", "lends none");
        probed.expect("clients", "section-1", "unknown", "no request has come");
        for address in [1, 2, 3, 4, 33] {
            probed.expect("answer", &format!("node {address} of section-1"), "good", "answers in ");
        }
        // One request each, and no client was refused for it.
        relay.expect_drops(&[]);
        for (node, _) in nodes {
            drop(node);
        }

        let one = probe(relay.folder.path(), &["--net", "section-1", "--node", "3"]);
        let answers = one.report["checks"].as_array().unwrap().iter();
        assert_eq!(answers.filter(|check| check["check"] == "answer").count(), 1);
        relay.finish();
    });
}

#[test]
fn the_fault_of_each_node_is_named() {
    let Some(network) = Network::build() else { return };
    network.plant.ip("address delete 172.17.17.3/24 dev eth0");
    network.at_the_edge(|| {
        let _good = node(&network, 1, "section-1");
        let _other = node(&network, 4, "press");
        let mute = network.node(33);
        let folder = folder(&configuration(&network, ""));
        let probed = probe(folder.path(), &[]);
        assert_eq!(probed.code, Some(1));
        probed.expect("answer", "node 1 of section-1", "good", "answers in ");
        probed.expect("answer", "node 2 of section-1", "bad", "UDP port 34379 is closed");
        probed.expect("neighbour", "node 3 of section-1", "bad", "does not answer ARP");
        probed.expect("answer", "node 3 of section-1", "bad", "nobody is at its address");
        for silent in [4, 33] {
            let silent = format!("node {silent} of section-1");
            probed.expect("neighbour", &silent, "good", "answers ARP");
            probed.expect(
                "answer",
                &silent,
                "doubtful",
                "there, but silent: the password or the port",
            );
        }
        let (octets, _) = mute.receive();
        assert_eq!(octets[10..12], [0, 0], "neither code nor data: {octets:02x?}");

        // Nobody runs a relay here.
        probed.expect("relay", "the relay", "bad", "is the relay running");
        probed.expect("ports", "section-1", "bad", "nothing listens on UDP 20001-20004, 20033");
    });
}

#[test]
fn an_interface_that_is_down_and_a_way_to_the_internet_are_named() {
    let Some(network) = Network::build() else { return };
    network.edge.ip("link set eth1 down");
    network.at_the_edge(|| {
        let folder = folder(&configuration(&network, ""));
        let probed = probe(folder.path(), &["--node", "4"]);
        assert_eq!(probed.code, Some(1));
        probed.expect(
            "interface",
            "section-1",
            "bad",
            "eth1 has 172.17.17.254/24, and is switched off",
        );
        probed.expect("route", "section-1", "bad", "no route leads to 172.17.17.4");
        network.edge.ip("route add default via 198.51.100.7");
        let probed = probe(folder.path(), &["--node", "4", "--timeout", "100ms"]);
        let text = "requests to 172.17.17.4 leave by eth0, from 198.51.100.1";
        probed.expect("route", "section-1", "bad", text);
    });
}

#[test]
fn a_firewall_that_drops_is_named() {
    let Some(network) = Network::build().filter(|_| has_nft()) else { return };
    network.at_the_edge(|| {
        let folder = folder(&configuration(&network, ""));
        let firewall = |rules: &str| {
            network.edge.nft(&format!(
                "table inet filter {{ chain input {{ type filter hook input priority 0; policy drop; \
                 ct state established accept; iifname lo accept\n{rules}\n}}\n}}\n"
            ));
            let probed = probe(folder.path(), &["--node", "4"]);
            network.edge.nft("delete table inet filter");
            probed
        };
        let text = "requests to UDP 20004 are dropped by chain input of table inet filter";
        firewall("").expect("firewall", "section-1", "bad", text);
        firewall("iifname eth1 udp dport 20004 accept").expect("firewall", "section-1", "bad", text);
        let good = "no rule of nft";
        let rule = "iifname eth0 udp dport 20001-20125 accept";
        firewall(rule).expect("firewall", "section-1", "good", good);
        let rule = "ip saddr 198.51.100.7 udp dport 20004 accept";
        firewall(rule).expect("firewall", "section-1", "unknown", "drops others");
    });
}

/// A client that goes on asking keeps the entry of a rule that is gone.
#[test]
fn an_old_address_translation_is_named() {
    let Some(network) = Network::build().filter(|_| has_nft()) else { return };
    network.at_the_edge(|| {
        network.edge.nft(
            "table ip old {\nchain before {\ntype nat hook prerouting priority -100\n\
             udp dport 20004 redirect to :9\n}\n}\n",
        );
        network.client("198.51.100.7").send(network.public("198.51.100.1", 4), &request(4));
        network.edge.nft("delete table ip old");
        let folder = folder(&configuration(&network, ""));
        let text = "takes requests to UDP 20004 past the relay";
        probe(folder.path(), &["--node", "4"]).expect("conntrack", "section-1", "bad", text);
        probe(folder.path(), &["--node", "3"]).expect("conntrack", "section-1", "good", "none");
    });
}

#[test]
fn ports_that_others_may_have_and_clients_that_nobody_hears_are_named() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let configuration = configuration(&network, "")
            .replace("start_port = 20000", "start_port = 40000")
            .replace(r#"allow = ["#, r#"allow = ["2001:db8::/32", "#);
        let folder = folder(&configuration);
        let probed = probe(folder.path(), &["--node", "4"]);
        probed.expect("port range", "section-1", "doubtful", "the kernel may lend UDP 40004");
        probed.expect("allow", "section-1", "doubtful", "nobody of 2001:db8::/32 can reach");
    });
}

#[test]
fn clients_that_are_refused_are_counted_with_the_reason() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let relay = Relay::start(&configuration(&network, ""), network.place("").admin, None);
        let (client, stranger) = (network.client("198.51.100.7"), network.client("203.0.113.7"));
        let public = network.public("198.51.100.1", 4);
        stranger.send(network.public("198.51.100.1", 4), &request(4));
        client.send(public, &request(3));
        client.send(public, &datagram(&FIGURE_10, &[], WRONG));
        client.send(public, &datagram(&FIGURE_10, &[], WRONG));
        let drops = [
            ("request", "source_not_allowed", 1),
            ("request", "node_mismatch", 1),
            ("request", "password_wrong", 2),
        ];
        relay.expect_drops(&drops);
        let probed = probe(relay.folder.path(), &["--node", "4"]);
        for (_, reason, _) in drops {
            probed.expect("clients", "node 4 of section-1", "doubtful", reason);
        }
        relay.finish();
    });
}

/// With this prefilter the kernel drops at any time what it otherwise drops in a flood.
#[test]
fn what_the_kernel_drops_in_a_flood_is_told() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let always = configuration(&network, "") + "\n[datapath]\nprefilter = \"always\"\n";
        let relay = Relay::start(&always, network.place("").admin, None);
        let client = network.client("198.51.100.7");
        for _ in 0..3 {
            client.send(network.public("198.51.100.1", 4), &datagram(&FIGURE_10, &[], WRONG));
        }
        let dropped = ("pnet_nat_kernel_dropped_datagrams_total", [("cause", "prefilter")]);
        eventually("the kernel has dropped them", || {
            (relay.metrics().sum(dropped.0, &dropped.1) == 3).then_some(())
        });
        let probed = probe(relay.folder.path(), &["--node", "4"]);
        probed.expect("flood", "section-1", "doubtful", "as in a flood: 3 (prefilter)");
        relay.finish();
    });
}

/// The relay stays confined, and asks on request.
#[test]
fn the_admin_server_asks_one_node_where_it_may() {
    let Some(network) = Network::build() else { return };
    network.plant.ip("address delete 172.17.17.3/24 dev eth0");
    network.at_the_edge(|| {
        let _good = node(&network, 1, "section-1");
        let admin = network.place("").admin;
        let relay = Relay::start(&configuration(&network, "probe = true"), admin, None);
        let post = |path: &str, origin: &str| {
            let agent: ureq::Agent =
                ureq::Agent::config_builder().http_status_as_error(false).build().into();
            let url = format!("http://{admin}/api/v1/probe{path}");
            let mut answer = agent.post(url).header("origin", origin).send_empty().unwrap();
            (answer.status().as_u16(), answer.body_mut().read_to_string().unwrap())
        };
        let own = format!("http://{admin}");
        let patient = |path: &str| {
            eventually("it is our turn", || Some(post(path, &own)).filter(|(code, _)| *code != 429))
        };
        let probed = |node: u8| {
            let (code, body) = patient(&format!("?net=section-1&node={node}"));
            Probed { code: Some(code.into()), report: serde_json::from_str(&body).expect(&body) }
        };
        probed(1).expect("answer", "node 1 of section-1", "good", "answers in ");
        assert_eq!(post("?net=section-1&node=1", &own).0, 429, "one a second");
        probed(2).expect("answer", "node 2 of section-1", "bad", "UDP port 34379 is closed");
        let off = probed(3);
        assert_eq!(off.code, Some(200));
        assert_eq!(off.report["verdict"], "bad");
        off.expect("neighbour", "node 3 of section-1", "bad", "does not answer ARP");

        for (path, code) in [
            ("?net=section-1&node=9", 404),
            ("?net=none&node=1", 404),
            ("?net=section-1", 400),
            ("", 400),
        ] {
            assert_eq!(patient(path).0, code, "{path}");
        }
        assert_eq!(post("?net=section-1&node=1", "http://elsewhere.example").0, 403);
        assert_eq!(relay.get("/api/v1/probe?net=section-1&node=1").unwrap().0, 405);
        let status = |relay: &Relay| -> Value {
            serde_json::from_str(&relay.get("/api/v1/status").unwrap().1).unwrap()
        };
        assert_eq!(status(&relay)["probe"], true);
        relay.reload_to(&configuration(&network, "probe = false"));
        assert_eq!(status(&relay)["probe"], false);
        assert_eq!(patient("?net=section-1&node=1").0, 404);

        let client = network.client("198.51.100.7");
        exchange(&client, network.public("198.51.100.1", 4), &network.node(4), 4);
        relay.finish();
    });
}

#[test]
fn a_configuration_with_a_fault_or_without_the_node_is_exit_code_2() {
    let folder = folder("");
    let config = folder.path().join("pnet-nat.toml");
    let code = |options: &[&str]| {
        let arguments = ["probe", "--config", config.to_str().unwrap()];
        Process::start(pnet_nat(&[&arguments, options].concat())).end()
    };
    assert_eq!(code(&[]), Some(2));
    fs::write(
        &config,
        "[public]\nlisten = [\"127.0.0.1\"]\n[[server]]\nname = \"press\"\npublic_port = 20200\n\
         node = 7\naddress = \"127.9.9.7:34379\"\nallow = [\"127.0.0.1\"]\nallow_without_password = true",
    )
    .unwrap();
    assert_eq!(code(&["--net", "section-1"]), Some(2));
    assert_eq!(code(&["--node", "8"]), Some(2));
    assert_eq!(code(&["--node", "7"]), Some(1), "nobody relays");
}
