//! A relay without a configuration file: environment variables and a secret, as docs/container.md shows it.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use pnet_nat::config::Environment;

use crate::harness::{
    Process, Relay, SECOND, Site, exchange, folder, has_yaml, pnet_nat, request, yaml,
};

const PAGE: &str = include_str!("../../docs/container.md");

/// The variables of the example, and the secret that it hands over.
fn example() -> (BTreeMap<String, String>, String) {
    let (_, section) = PAGE.split_once("## Without a configuration file\n").unwrap();
    let block = section.split("```yaml\n").nth(1).unwrap().split("```").next().unwrap();
    let compose = yaml(block).remove(0);
    let router = &compose["services"]["router"];
    let secret = router["secrets"][0].as_str().unwrap().to_owned();
    assert!(compose["secrets"][&secret]["file"].is_string(), "{compose}");
    (serde_json::from_value(router["environment"].clone()).unwrap(), secret)
}

/// The command with the variables of a relay at this site, whose secrets are in this folder.
fn with_variables(site: &Site, folder: &Path, arguments: &[&str]) -> Command {
    let (mut variables, secret) = example();
    let subnet = site.address(0);
    for (name, value) in [
        ("PNET_NAT_START_PORT", site.start_port().to_string()),
        ("PNET_NAT_SUBNET", subnet.to_string()),
        ("PNET_NAT_ALLOW", format!("{subnet}/24")),
    ] {
        assert!(variables.insert(name.to_owned(), value).is_some(), "the example has {name}");
    }
    let mut command = pnet_nat(arguments);
    command.envs(variables);
    command.env("PNET_NAT_LISTEN", site.public_address().to_string());
    command.env("PNET_NAT_ADMIN_LISTEN", site.admin().to_string());
    command.env("PNET_NAT_PASSWORD_FILE", folder.join("secrets").join(secret));
    command
}

#[test]
fn the_example_relays_and_a_reload_reads_its_secret_again() {
    if !has_yaml() {
        return;
    }
    let site = Site::claim();
    let relay = Relay::start_as("", site.admin(), |arguments| {
        with_variables(&site, Path::new(arguments[2]).parent().unwrap(), &["run"])
    });
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);

    relay.set_password("section-1", SECOND);
    let line = relay.reload();
    assert_eq!(line["credentials_changed"], serde_json::json!(["section-1: service"]), "{line}");
    client.send(site.public(4), &request(4));
    relay.expect_drops(&[("request", "password_wrong", 1)]);
    relay.finish();
}

#[test]
fn commands_ask_the_relay_where_the_variables_say() {
    if !has_yaml() {
        return;
    }
    let (site, folder) = (Site::claim(), folder(""));
    let relay =
        Relay::start_as("", site.admin(), |_| with_variables(&site, folder.path(), &["run"]));
    for command in ["healthcheck", "status"] {
        let mut asked = Process::start(with_variables(&site, folder.path(), &[command]));
        assert_eq!(asked.end(), Some(0), "{command}: {}", asked.stderr());
    }
    relay.finish();
}

#[test]
fn check_reads_the_variables_too() {
    if !has_yaml() {
        return;
    }
    let (site, folder) = (Site::claim(), folder(""));
    let mut checked = Process::start(with_variables(&site, folder.path(), &["check"]));
    assert_eq!((checked.end(), checked.stderr().as_str()), (Some(0), ""));
    assert!(checked.stdout().contains("20001-20004"), "{}", checked.stdout());
}

#[test]
fn probe_reads_the_variables_too() {
    if !has_yaml() {
        return;
    }
    let (site, folder) = (Site::claim(), folder(""));
    let mut probe = Process::start(with_variables(&site, folder.path(), &["probe"]));
    assert_eq!(probe.end(), Some(1), "no relay and no node is there: {}", probe.stderr());
    assert!(probe.stdout().contains("node 4 of section-1"), "{}", probe.stdout());
}

#[test]
fn a_fault_names_the_variable() {
    let folder = folder("");
    let mut command = pnet_nat(&["run", "--log-format", "text"]);
    command.env("PNET_NAT_SUBNET", "172.17.17.1").env("PNET_NAT_NODES", "1-4");
    command.env("PNET_NAT_PASSWORD_FILE", folder.path().join("secrets/section-1"));
    let mut run = Process::start(command);
    assert_eq!(run.end(), Some(2));
    for fault in [
        "PNET_NAT_START_PORT: missing; add `PNET_NAT_START_PORT=20000`",
        "PNET_NAT_ALLOW: missing; add `PNET_NAT_ALLOW=198.51.100.0/24`",
        "PNET_NAT_SUBNET: 172.17.17.1 is not a subnet: its mask is 255.255.255.0; write \"172.17.17.0\"",
    ] {
        assert!(run.stderr().contains(fault), "{}", run.stderr());
    }
}

#[test]
fn two_configurations_are_one_too_many() {
    let folder = folder("");
    for command in ["run", "check", "probe"] {
        let mut command = pnet_nat(&[command, "--config", "pnet-nat.toml"]);
        command.current_dir(folder.path()).env("PNET_NAT_SUBNET", "172.17.17.0");
        let mut told = Process::start(command);
        assert_eq!(told.end(), Some(2));
        let expected =
            "there are two configurations: pnet-nat.toml, and one of environment variables";
        assert!(told.stderr().contains(expected), "{}", told.stderr());
    }
}

#[test]
fn the_page_has_each_variable() {
    for name in Environment::names() {
        assert!(PAGE.contains(&format!("| `{name}` | ")), "{name}");
    }
}
