//! README.md and the pages keep up with the code: their tables, their configuration, their commands, their
//! links and pictures.

mod commands;
mod links;
mod page;
mod requirements;
mod vectors;

use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs::{self, Permissions};
use std::net::UdpSocket;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;
use std::sync::Arc;

use pnet_nat::config::{self, Config, Warning};
use pnet_nat::datapath::Router;
use pnet_nat::nat::{CloseReason, Direction, DropReason};
use pnet_nat::observe::metrics::Metrics;
use pnet_nat::sandbox::Sandbox;

const README: &str = include_str!("../../README.md");
const MONITORING: &str = include_str!("../../docs/monitoring.md");
const TROUBLESHOOTING: &str = include_str!("../../docs/troubleshooting.md");

#[test]
fn the_drop_reasons_are_those_of_the_code() {
    let right = drop_reasons();
    assert!(
        TROUBLESHOOTING.contains(&format!("\n\n{right}\n")),
        "the table under \"Drop reasons\" has to be:\n\n{right}"
    );
    let picture = include_str!("../../docs/pictures/checks.svg");
    for reason in DropReason::REQUEST {
        let shown = picture.matches(&format!(">{}<", reason.label())).count();
        assert_eq!(shown, 1, "{} in checks.svg, which diagrams.py draws", reason.label());
    }
}

#[test]
fn the_close_reasons_are_those_of_the_code() {
    let (_, table) = TROUBLESHOOTING.split_once("## Close reasons").unwrap();
    let (table, _) = table.split_once("\n## ").unwrap();
    let rows = table.lines().filter_map(|line| line.strip_prefix("| `"));
    let told: Vec<_> = rows.filter_map(|row| row.split('`').next()).collect();
    assert_eq!(told, CloseReason::ALL.map(CloseReason::label));
}

#[test]
fn every_metric_is_described_and_no_other() {
    let scrape: String =
        Metrics::new(Arc::new(router()), Sandbox::off("in a test")).chunks().collect();
    let exposed = scrape.lines().filter_map(|line| line.strip_prefix("# TYPE "));
    let exposed = exposed.filter_map(|line| line.split(' ').next());
    let exposed: BTreeSet<_> = exposed.filter(|name| name.starts_with("pnet_nat_")).collect();
    let rows = MONITORING.lines().filter_map(|line| line.strip_prefix("| `"));
    let described = rows.filter_map(|row| row.split('`').next());
    let described: BTreeSet<_> = described.filter(|name| name.starts_with("pnet_nat_")).collect();
    assert_eq!(described, exposed);

    for page in page::all() {
        let text = fs::read_to_string(&page.path).unwrap();
        let words = text.split(|c: char| c != '_' && !c.is_ascii_alphanumeric());
        for name in words.filter(|word| word.starts_with("pnet_nat_")) {
            let family = name.strip_suffix("_bucket").unwrap_or(name);
            let page = page.path.display();
            assert!(exposed.contains(family), "{page}: there is no metric {name}");
        }
    }
}

#[test]
fn the_alerts_are_those_of_the_rules() {
    let rules = include_str!("../../deploy/prometheus/pnet-nat.rules.yml");
    let alerts: Vec<_> =
        rules.split("- alert: ").skip(1).filter_map(|a| a.lines().next()).collect();
    let rows = MONITORING.lines().filter_map(|line| line.strip_prefix("| `Pnet"));
    let described: Vec<_> = rows.filter_map(|row| row.split('`').next()).collect();
    assert_eq!(described, alerts.iter().map(|alert| &alert["Pnet".len()..]).collect::<Vec<_>>());
}

#[test]
fn the_configuration_is_sound() {
    let (config, warnings) = read(configuration());
    assert_eq!(config.table.mappings().len(), 4);
    assert_eq!(warnings, []);
}

/// The steps for the package leave a configuration that needs no other password file than they make.
#[test]
fn the_steps_for_the_package_end_in_a_sound_configuration() {
    let steps = include_str!("../../deploy/systemd/README.md");
    let commands = |text: &'static str| {
        let lines = text.lines().filter(|line| line.contains("/etc/pnet-nat/"));
        lines.filter(|line| line.starts_with("sed ") || line.starts_with("pnet-nat password"))
    };
    assert!(commands(README).eq(commands(steps)), "both pages have the same steps");
    let folder = tempfile::tempdir().unwrap();
    let configuration = folder.path().join("pnet-nat.toml");
    fs::copy("config/pnet-nat.toml", &configuration).unwrap();
    fs::create_dir(folder.path().join("secrets")).unwrap();
    let mut made = 0;
    for command in commands(README) {
        let command = command.replace("/etc/pnet-nat", folder.path().to_str().unwrap());
        let command = command.replace("pnet-nat password", "\"$0\" password");
        let mut shell = Command::new("sh");
        shell.args(["-c", &command, env!("CARGO_BIN_EXE_pnet-nat")]);
        assert!(shell.output().unwrap().status.success(), "{command}");
        made += 1;
    }
    assert_eq!(made, 2);
    let text = fs::read_to_string(&configuration).unwrap();
    let read = config::parse(&text, &configuration);
    let (config, warnings) = read.unwrap_or_else(|faults| panic!("{faults}"));
    assert_eq!((config.table.nets().len(), config.table.mappings().len()), (1, 5));
    assert_eq!(warnings, []);
    assert!(text.contains("[limits]") && text.contains("[admin]"), "the rest stays");
}

fn drop_reasons() -> String {
    let mut table =
        "| reason | direction | what it means, what to do |\n|---|---|---|\n".to_owned();
    let of = |direction: Direction| direction.drop_reasons().collect::<Vec<_>>();
    let [requests, responses] = Direction::ALL.map(of);
    let of_responses_alone = responses.iter().filter(|reason| !requests.contains(reason));
    for reason in requests.iter().chain(of_responses_alone) {
        let direction = match (requests.contains(reason), responses.contains(reason)) {
            (true, true) => "both",
            (true, false) => "request",
            _ => "response",
        };
        let (label, explanation) = (reason.label(), reason.explanation());
        writeln!(table, "| `{label}` | {direction} | {explanation} |").unwrap();
    }
    table
}

/// README's configuration.
fn configuration() -> &'static str {
    let (_, rest) = README.split_once("```toml\n").unwrap();
    rest.split_once("```").unwrap().0
}

/// Reads a configuration as if it stood beside the password file that README has the reader make.
fn read(configuration: &str) -> (Config, Vec<Warning>) {
    let folder = tempfile::tempdir().unwrap();
    let password = folder.path().join("secrets/section-1");
    fs::create_dir(password.parent().unwrap()).unwrap();
    fs::write(&password, "k7Zq+4Lx").unwrap();
    fs::set_permissions(&password, Permissions::from_mode(0o600)).unwrap();
    config::parse(configuration, &folder.path().join("pnet-nat.toml"))
        .unwrap_or_else(|faults| panic!("{faults}"))
}

/// README's configuration, at work on a free port.
fn router() -> Router {
    let free = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let configuration = configuration()
        .replace("0.0.0.0", "127.0.0.1")
        .replace("start_port = 20000", &format!("start_port = {}", free - 1))
        .replace("\"1-4\"", "1");
    Router::start(read(&configuration).0).unwrap()
}
