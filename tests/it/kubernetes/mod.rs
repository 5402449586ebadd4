//! The files of `deploy/kubernetes`: built by kustomize, held to the published schemas, and the
//! container's command run as the manifest has it, in a folder such as a kubelet makes.
//!
//! Needs kubectl and kubernetes-validate; running as the container's user needs root and setpriv, the
//! rules need promtool.

mod active_active;
mod container;
mod plants;

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use crate::harness::{PASSWORD, TOOLS, has_yaml, left_out, yaml};

const FOLDER: &str = "deploy/kubernetes";
const README: &str = include_str!("../../../deploy/kubernetes/README.md");
/// The oldest and the newest that are to take it.
const VERSIONS: [&str; 2] = ["1.29", "1.37"];

const TOKEN: &str = "s3cr3t-0123456789";

/// The manifests as text.
fn build() -> Option<String> {
    build_in(Path::new(FOLDER))
}

fn build_in(folder: &Path) -> Option<String> {
    let Ok(output) = Command::new("kubectl").arg("kustomize").arg(folder).output() else {
        left_out("kubectl, such as of the package kubernetes-client");
        return None;
    };
    assert!(output.status.success(), "{output:?}");
    has_yaml().then(|| String::from_utf8(output.stdout).unwrap())
}

/// The manifests with one of the components, which are left out as the files are.
fn build_with(component: &str) -> Option<String> {
    build_changed("", "\n#components: [monitoring]\n", &format!("\ncomponents: [{component}]\n"))
}

/// The manifests of a folder with something else in its kustomization.yaml.
fn build_changed(folder: &str, from: &str, to: &str) -> Option<String> {
    let copy = tempfile::tempdir().unwrap();
    let copied = Command::new("cp").args(["-r", FOLDER]).arg(copy.path()).status().unwrap();
    assert!(copied.success());
    let folder = copy.path().join("kubernetes").join(folder);
    let file = folder.join("kustomization.yaml");
    let text = fs::read_to_string(&file).unwrap();
    assert!(text.contains(from), "{from}");
    fs::write(&file, text.replace(from, to)).unwrap();
    build_in(&folder)
}

/// What the schemas have against manifests.
fn complaint(manifests: &str, version: &str) -> Option<String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("manifests.yaml");
    fs::write(&file, manifests).unwrap();
    let mut command = Command::new(format!("{TOOLS}/kubernetes-validate"));
    let output = command.args(["--strict", "-k", version]).arg(file).output().unwrap();
    (!output.status.success()).then(|| format!("{output:?}"))
}

/// The Deployment or the DaemonSet.
fn workload(manifests: &str) -> Value {
    let mut found = yaml(manifests).into_iter().filter(|manifest| {
        ["Deployment", "DaemonSet"].contains(&manifest["kind"].as_str().unwrap())
    });
    let workload = found.next().expect("a workload");
    assert!(found.next().is_none(), "one workload");
    workload
}

/// One node at a time, and none more before the relay there has been ready for a while.
fn assert_that_one_goes_after_the_other(workload: &Value) {
    let spec = &workload["spec"];
    let strategy = spec.get("strategy").unwrap_or(&spec["updateStrategy"]);
    assert_eq!(strategy["rollingUpdate"], json!({"maxSurge": 0, "maxUnavailable": 1}));
    assert!(spec["minReadySeconds"].as_u64() > Some(0));
    let probe = &spec["template"]["spec"]["containers"][0]["readinessProbe"];
    assert_eq!(probe["httpGet"]["path"], "/-/ready");
}

/// The manifest of this kind.
fn manifest(manifests: &str, kind: &str) -> Value {
    let mut found = yaml(manifests).into_iter().filter(|manifest| manifest["kind"] == kind);
    let manifest = found.next().expect(kind);
    assert!(found.next().is_none(), "one {kind}");
    manifest
}

#[test]
fn the_manifests_are_as_the_schemas_want_them() {
    let Some(manifests) = build() else { return };
    for version in VERSIONS {
        assert_eq!(complaint(&manifests, version), None);
        // Were one of them wrong, it would be told.
        for (right, wrong) in [("runAsNonRoot", "runAsNotRoot"), ("replicas: 2", "replicas: two")] {
            assert!(manifests.contains(right));
            let complaint = complaint(&manifests.replace(right, wrong), version);
            assert!(complaint.is_some(), "{wrong}");
        }
    }
    let deployment = manifest(&manifests, "Deployment");
    let labels = &deployment["spec"]["template"]["metadata"]["labels"];
    let budget = manifest(&manifests, "PodDisruptionBudget");
    for selector in [&deployment["spec"]["selector"], &budget["spec"]["selector"]] {
        assert_eq!(&selector["matchLabels"], labels);
    }
    let annotations = &deployment["spec"]["template"]["metadata"]["annotations"];
    let pod = &deployment["spec"]["template"]["spec"];
    let port = pod["containers"][0]["ports"][0]["containerPort"].to_string();
    assert_eq!(annotations["prometheus.io/port"], port);
    assert_that_one_goes_after_the_other(&deployment);
}

/// As README.md has it: with `components` in force. The operator's kinds are in no schema here, so what
/// they have to fit is compared: the Service, the Secret, the container's port.
#[test]
fn what_the_operator_gets_fits_the_relays() {
    let Some(manifests) = build_with("monitoring") else { return };
    let (ours, known): (Vec<_>, Vec<_>) = manifests
        .split("\n---\n")
        .partition(|document| document.contains("apiVersion: monitoring.coreos.com/v1\n"));
    assert_eq!(ours.len(), 2);
    for version in VERSIONS {
        assert_eq!(complaint(&known.join("\n---\n"), version), None);
    }

    let [deployment, service, monitor] =
        ["Deployment", "Service", "ServiceMonitor"].map(|kind| manifest(&manifests, kind));
    let pod = &deployment["spec"]["template"]["spec"];
    let container = &pod["containers"][0];
    let (labels, port) = (&service["metadata"]["labels"], &service["spec"]["ports"][0]);
    let selected = &deployment["spec"]["template"]["metadata"]["labels"];
    assert_eq!(&service["spec"]["selector"], selected);
    assert_eq!(port["targetPort"], container["ports"][0]["name"]);
    assert_eq!(port["port"], container["ports"][0]["containerPort"]);
    let (spec, endpoint) = (&monitor["spec"], &monitor["spec"]["endpoints"][0]);
    assert_eq!(&spec["selector"]["matchLabels"], labels);
    assert_eq!(labels[spec["jobLabel"].as_str().unwrap()], "pnet-nat", "the job of the rules");
    assert_eq!(endpoint["port"], port["name"]);
    let source = &pod["volumes"][0]["projected"]["sources"][1]["secret"];
    let token = &endpoint["authorization"]["credentials"];
    assert_eq!(token["name"], source["name"]);
    let items = source["items"].as_array().unwrap();
    assert!(items.iter().any(|item| item["key"] == token["key"]), "{token}");
    for manifest in [&service, &monitor, &manifest(&manifests, "PrometheusRule")] {
        assert_eq!(manifest["metadata"]["namespace"], deployment["metadata"]["namespace"]);
    }
}

/// The rules are written once: the command in the file makes this one of the other.
#[test]
fn the_rules_of_the_operator_are_those_of_prometheus() {
    let made = include_str!("../../../deploy/kubernetes/monitoring/rules.yaml");
    let folder = tempfile::tempdir().unwrap();
    let monitoring = folder.path().join("kubernetes/monitoring");
    fs::create_dir_all(&monitoring).unwrap();
    fs::create_dir(folder.path().join("prometheus")).unwrap();
    fs::write(monitoring.join("rules.yaml"), made).unwrap();
    let rules = include_str!("../../../deploy/prometheus/pnet-nat.rules.yml");
    fs::write(folder.path().join("prometheus/pnet-nat.rules.yml"), rules).unwrap();
    for command in made.lines().filter_map(|line| line.strip_prefix("#   ")) {
        let mut shell = Command::new("sh");
        let status = shell.args(["-c", command]).current_dir(&monitoring).status().unwrap();
        assert!(status.success(), "{command}");
    }
    let anew = fs::read_to_string(monitoring.join("rules.yaml")).unwrap();
    assert_eq!(anew, made, "the commands in deploy/kubernetes/monitoring/rules.yaml make it anew");

    if !has_yaml() || Command::new("promtool").arg("--version").output().is_err() {
        return left_out("promtool, of the package prometheus, and a parser of YAML");
    }
    let spec = &manifest(made, "PrometheusRule")["spec"];
    assert_eq!(spec, &yaml(rules)[0], "as YAML, too");
    // The operator hands Prometheus the `spec`, which is YAML, as all JSON is.
    let file = folder.path().join("spec.yml");
    fs::write(&file, spec.to_string()).unwrap();
    let output = Command::new("promtool").args(["check", "rules"]).arg(&file).output().unwrap();
    assert!(output.status.success(), "{output:?}");
}

/// As README.md has it, without a cluster.
#[test]
fn the_secret_is_one_that_the_schema_takes() {
    if build().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("section-1"), PASSWORD).unwrap();
    fs::write(folder.path().join("admin"), TOKEN).unwrap();
    let mut command = Command::new("kubectl");
    command.args(["create", "secret", "generic", "pnet-nat", "--namespace=pnet-nat"]);
    command.args(["--dry-run=client", "--output=yaml"]);
    command.arg(format!("--from-file={}", folder.path().display()));
    let output = command.output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let secret = String::from_utf8(output.stdout).unwrap();
    let data = &manifest(&secret, "Secret")["data"];
    assert_eq!(data["section-1"], "czNjcjN0LUE=");
    assert_eq!(data["admin"], "czNjcjN0LTAxMjM0NTY3ODk=");
    for version in VERSIONS {
        assert_eq!(complaint(&secret, version), None);
        let wrong = secret.replace("  admin: czN", "  admin:\n  - czN");
        assert!(complaint(&wrong, version).is_some(), "a list is no secret: {wrong}");
    }
}

/// Rules and dashboard know the relays by the name of their job.
#[test]
fn the_scrape_job_of_readme_is_one_that_prometheus_takes() {
    if !has_yaml() || Command::new("promtool").arg("--version").output().is_err() {
        return left_out("promtool, of the package prometheus, and a parser of YAML");
    }
    let (_, job) = README.split_once("```yaml\n").unwrap();
    let job = job.split("```").next().unwrap();
    let jobs = &yaml(job)[0]["scrape_configs"];
    assert_eq!(jobs[0]["job_name"], "pnet-nat");
    let rules = include_str!("../../../deploy/prometheus/pnet-nat.rules.yml");
    assert!(rules.contains("up{job=\"pnet-nat\"}"));
    // Debian's Prometheus cannot look for pods.
    let (before, rest) = job.split_once("    kubernetes_sd_configs:\n").unwrap();
    let (_, relabelling) = rest.split_once("    relabel_configs:\n").unwrap();
    let targets = "    static_configs: [{ targets: [\"127.0.0.1:9378\"] }]\n    relabel_configs:\n";
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("prometheus.yml");
    fs::write(&file, [before, targets, relabelling].concat()).unwrap();
    let check = ["check", "config", "--syntax-only", file.to_str().unwrap()];
    let output = Command::new("promtool").args(check).output().unwrap();
    assert!(output.status.success(), "{output:?}");
}
