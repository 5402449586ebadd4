//! The files in `deploy/fail2ban`, on log lines that the relay wrote just now: text and JSON, from a
//! file and as the journal hands them on.

use std::fs;
use std::net::SocketAddr;
use std::path::Path;
use std::process::Command;

use nix::sys::signal::Signal;

use crate::harness::{
    FIGURE_10, Network, Process, WRONG, datagram, eventually, exchange, folder, left_out, pnet_nat,
};

pub(crate) const FILTER: &str = "deploy/fail2ban/filter.d/pnet-nat.conf";
pub(crate) const JAIL: &str = "deploy/fail2ban/jail.d/pnet-nat.conf";

pub(crate) fn is_there(program: &str) -> bool {
    let there = Command::new(program).arg("--version").output().is_ok();
    if !there {
        left_out(&format!("{program}, of the package fail2ban"));
    }
    there
}

/// Whom the filter finds in a log: one entry a line that it takes.
fn found(log: &Path, mode: &str) -> Vec<String> {
    let filter = format!("{FILTER}[mode={mode}]");
    let mut command = Command::new("fail2ban-regex");
    let output = command.args(["--raw", "--out", "id"]).arg(log).arg(filter).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    text.lines().map(str::to_owned).collect()
}

const CONFIGURATION: &str = r#"
[public]
listen = ["198.51.100.1", "2001:db8:1::1"]

[[udp_range_net]]
name = "section-1"
start_port = 20000
subnet = "172.17.17.0"
nodes = [4]
allow = ["0.0.0.0/0", "::/0"]

[[udp_range_net.password]]
name = "service"
file = "secrets/section-1"

[limits]
wrong_password_burst = 2
wrong_password_interval = "1s"

[datapath]
prefilter = "off"

[runtime]
drain = "0s"
"#;

/// A relay's log in which ports of two addresses are throttled, then the addresses as a whole, and
/// which holds all the other lines too. Tells what is to be banned.
fn log_of_guessers(network: &Network, format: &str) -> (String, [&'static str; 2]) {
    let folder = folder(CONFIGURATION);
    let config = folder.path().join("pnet-nat.toml");
    let arguments = ["run", "--config", config.to_str().unwrap(), "--log-format", format];
    let mut relay = Process::start(pnet_nat(&arguments));
    eventually("it relays", || relay.stderr().contains("relaying").then_some(()));

    let public = |address: &str| SocketAddr::new(address.parse().unwrap(), 20004);
    let client = network.client("198.51.100.8");
    exchange(&client, public("198.51.100.1"), &network.node(4), 4);
    let wrong = datagram(&FIGURE_10, &[], WRONG);
    for (address, to) in [("198.51.100.7", "198.51.100.1"), ("2001:db8:1::7", "2001:db8:1::1")] {
        let already = of_addresses(&relay.stderr());
        eventually("the address is throttled", || {
            for _ in 0..100 {
                let port = network.client(address);
                (0..4).for_each(|_| port.send(public(to), &wrong));
            }
            (of_addresses(&relay.stderr()) > already).then_some(())
        });
    }
    // It takes 2 s after the last wrong password.
    eventually("somebody is forgiven", || {
        relay.stderr().contains("throttling ended").then_some(())
    });
    relay.signal(Signal::SIGTERM);
    assert_eq!(relay.end(), Some(0));
    (relay.stderr(), ["198.51.100.7", "2001:db8:1::/64"])
}

/// How often a log tells that an address is throttled as a whole.
fn of_addresses(log: &str) -> usize {
    let scopes = ["begun scope=\"address\"", "begun\",\"scope\":\"address\""];
    log.lines().filter(|line| scopes.iter().any(|scope| line.contains(scope))).count()
}

#[test]
fn the_filter_finds_who_is_throttled_and_nobody_else() {
    if !is_there("fail2ban-regex") {
        return;
    }
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        for format in ["text", "json"] {
            expect_found(&log_of_guessers(&network, format));
        }
    });
}

fn expect_found((log, addresses): &(String, [&str; 2])) {
    let begun = |line: &&str| line.contains("throttling begun") && !line.contains("left out");
    let begun = log.lines().filter(begun).count();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("log");
    let from_journal = |line| format!("router pnet-nat[1234]: {line}\n");
    for log in [log.clone(), log.lines().map(from_journal).collect()] {
        fs::write(&file, &log).unwrap();
        let first = log.lines().next().unwrap();
        assert_eq!(found(&file, "normal"), *addresses, "{first}");
        let found = found(&file, "aggressive");
        assert_eq!(found.len(), begun, "{first}");
        assert!(found.iter().all(|found| addresses.contains(&found.as_str())), "{found:?}");
    }
}

/// With fail2ban's own configuration around it.
#[test]
fn the_jail_is_sound() {
    if !is_there("fail2ban-client") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let copied = Command::new("cp").args(["-r", "/etc/fail2ban/."]).arg(folder.path()).status();
    assert!(copied.unwrap().success());
    fs::copy(FILTER, folder.path().join("filter.d/pnet-nat.conf")).unwrap();
    fs::copy(JAIL, folder.path().join("jail.d/pnet-nat.conf")).unwrap();
    let dump = Command::new("fail2ban-client").arg("-c").arg(folder.path()).arg("-d").output();
    let dump = dump.unwrap();
    let text = String::from_utf8_lossy(&dump.stdout);
    assert!(dump.status.success(), "{text}{}", String::from_utf8_lossy(&dump.stderr));
    for command in [
        "['add', 'pnet-nat', 'systemd']",
        "['set', 'pnet-nat', 'maxretry', 1]",
        "throttling begun",
        "['blocktype', 'DROP']",
        "['start', 'pnet-nat']",
    ] {
        assert!(text.contains(command), "{command} is not in: {text}");
    }
}
