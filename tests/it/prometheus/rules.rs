//! The files of `deploy/prometheus`, as Prometheus' own tool judges them.

use std::collections::BTreeMap;
use std::process::Command;

use super::server::has_prometheus;

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/deploy/prometheus");
const RULES: &str = include_str!("../../../deploy/prometheus/pnet-nat.rules.yml");
const CASES: &str = include_str!("../../../deploy/prometheus/pnet-nat.test.yml");

#[test]
fn the_files_are_sound_and_their_cases_hold() {
    if !has_prometheus() {
        return;
    }
    for arguments in [
        ["check", "config", "prometheus.yml"],
        ["check", "rules", "pnet-nat.rules.yml"],
        ["test", "rules", "pnet-nat.test.yml"],
    ] {
        let output = Command::new("promtool").args(arguments).current_dir(FOLDER).output().unwrap();
        assert!(output.status.success(), "promtool {arguments:?}: {output:?}");
    }
}

/// Neither can be forgotten when an alert is added.
#[test]
fn each_alert_has_cases_and_says_what_to_do() {
    let mut cases: BTreeMap<_, (u32, u32)> = BTreeMap::new();
    let mut lines = CASES.lines().map(str::trim);
    while let Some(line) = lines.next() {
        let Some(alert) = line.strip_prefix("- alertname: ") else { continue };
        let (quiet, firing) = cases.entry(alert).or_default();
        match lines.find_map(|line| line.strip_prefix("exp_alerts:")) {
            Some(" []") => *quiet += 1,
            Some("") => *firing += 1,
            other => panic!("{alert}: {other:?}"),
        }
    }
    let alerts: Vec<_> = RULES.split("- alert: ").skip(1).collect();
    for rule in &alerts {
        let alert = rule.lines().next().unwrap();
        let (quiet, firing) = cases.get(alert).copied().unwrap_or_default();
        assert!(quiet > 0 && firing > 0, "{alert} has {quiet} quiet cases, {firing} firing ones");
        for part in ["severity: ", "summary: ", "description: >-"] {
            assert!(rule.contains(part), "{alert} has no {part}");
        }
    }
    assert_eq!(cases.len(), alerts.len(), "cases of alerts that there are");
}
