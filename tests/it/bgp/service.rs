//! The unit of `deploy/bgp` beside those of relay and BIRD, set up by the commands of its README.md.
//!
//! Needs root, systemd and BIRD.

use std::fs::File;
use std::process::Command;

use crate::harness::{Machine, PASSWORD, eventually, left_out, pnet_nat};

use super::site::has_bird;

const README: &str = include_str!("../../../deploy/bgp/README.md");

/// Puts the files of the package that matter here into the machine.
fn install(machine: &Machine) {
    let folder = tempfile::tempdir().unwrap();
    let script = "mkdir -p usr/bin usr/lib/systemd/system usr/share/doc/pnet-nat etc/pnet-nat/secrets
        cp \"$1\" usr/bin/pnet-nat
        cp \"$2/deploy/systemd/pnet-nat.service\" usr/lib/systemd/system
        cp -r \"$2/deploy\" usr/share/doc/pnet-nat/examples
        sed '/^\\[\\[server\\]\\]/,/^# ── Bounds/{/^# ── Bounds/!d}' \"$2/config/pnet-nat.toml\" > etc/pnet-nat/pnet-nat.toml
        tar -cf files usr etc";
    let mut shell = Command::new("sh");
    shell.args(["-ec", script, "sh"]).arg(pnet_nat(&[]).get_program());
    shell.arg(env!("CARGO_MANIFEST_DIR")).current_dir(folder.path());
    assert!(shell.status().unwrap().success());
    let mut unpack = machine.command(&["tar", "-xC", "/", "--no-overwrite-dir"]);
    unpack.stdin(File::open(folder.path().join("files")).unwrap());
    assert!(unpack.status().unwrap().success());
    let password = str::from_utf8(PASSWORD).unwrap();
    machine.shell(&format!("umask 077; printf %s '{password}' > /etc/pnet-nat/secrets/section-1"));
}

/// The commands of README.md for a host. A machine of the tests may not change settings of the kernel; the
/// scenario beside this one reads their file.
fn commands() -> String {
    let (_, rest) = README.split_once("## A relay's host\n").unwrap();
    let (_, block) = rest.split_once("```sh\n").unwrap();
    let (block, _) = block.split_once("```").unwrap();
    let lines = block.lines().filter(|line| !line.starts_with("sysctl "));
    lines.fold("set -eu\n".to_owned(), |commands, line| commands + line + "\n")
}

struct Host(Machine);

impl Host {
    fn expect_route(&self, announced: bool) {
        eventually(if announced { "the route is announced" } else { "it is withdrawn" }, || {
            let output = self.0.output(&["birdc", "show", "protocols", "pnet_nat"]);
            let shown = String::from_utf8_lossy(&output.stdout).into_owned();
            let state = shown.lines().find(|line| line.starts_with("pnet_nat "))?.to_owned();
            state.contains(if announced { " up " } else { " down " }).then_some(())
        });
    }

    fn property(&self, property: &str) -> String {
        let show = ["systemctl", "show", "--value", "--property", property, "pnet-nat"];
        self.0.run(&show).trim_end().to_owned()
    }
}

#[test]
fn the_unit_announces_the_route_while_the_relay_is_ready() {
    if !has_bird() {
        return;
    }
    let machine = match Machine::start() {
        Ok(machine) => machine,
        Err(want) => return left_out(&want),
    };
    for (interface, address) in [("eth0", "192.0.2.11/24"), ("eth1", "172.17.17.251/24")] {
        machine.shell(&format!(
            "ip link add {interface} type veth peer name far-{interface}
             ip link set {interface} up
             ip link set far-{interface} up
             ip address add {address} dev {interface}"
        ));
    }
    install(&machine);
    machine.run(&["systemctl", "start", "pnet-nat"]);
    machine.shell(&commands());
    let host = Host(machine);
    host.expect_route(true);

    // Stopped by systemd, it withdraws the route first, and then goes on for a while.
    host.0.run(&["systemctl", "stop", "--no-block", "pnet-nat"]);
    host.expect_route(false);
    assert_eq!(host.property("ActiveState"), "deactivating");
    eventually("it has stopped", || (host.property("ActiveState") == "inactive").then_some(()));
    assert_eq!(host.property("Result"), "success");

    host.0.run(&["systemctl", "start", "pnet-nat"]);
    host.expect_route(true);
    // What asks the relay is started again when it was killed, and BIRD need not be told who was there.
    let asking =
        || host.0.run(&["systemctl", "show", "--value", "-p", "MainPID", "pnet-nat-route"]);
    let killed = asking();
    host.0.run(&["systemctl", "kill", "--signal=SIGKILL", "pnet-nat-route"]);
    eventually("it asks again", || {
        let now = asking();
        (now != killed && now.trim() != "0").then_some(())
    });
    host.0.run(&["systemctl", "restart", "bird"]);
    host.expect_route(true);
    host.0.run(&["systemctl", "stop", "pnet-nat-route"]);
    host.expect_route(false);
    assert_eq!(host.property("ActiveState"), "active");
}
