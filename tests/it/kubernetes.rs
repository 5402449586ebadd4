//! The files of `deploy/kubernetes`: built by kustomize, held to the published schemas, and the
//! container's command run as the manifest has it, in a folder such as a kubelet makes.
//!
//! Needs kubectl and kubernetes-validate; running as the container's user needs root and setpriv, the
//! rules need promtool.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::path::Path;
use std::process::Command;

use nix::sys::signal::Signal;
use nix::unistd::geteuid;
use serde_json::{Value, json};

use crate::harness::{
    Metrics, PASSWORD, Process, Site, TOOLS, eventually, exchange, has_yaml, left_out, pnet_nat,
    yaml,
};

const FOLDER: &str = "deploy/kubernetes";
const README: &str = include_str!("../../deploy/kubernetes/README.md");
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
    let folder = tempfile::tempdir().unwrap();
    let copied = Command::new("cp").args(["-r", FOLDER]).arg(folder.path()).status().unwrap();
    assert!(copied.success());
    let folder = folder.path().join("kubernetes");
    let file = folder.join("kustomization.yaml");
    let text = fs::read_to_string(&file).unwrap();
    let none = "\n#components: [monitoring]\n";
    assert!(text.contains(none), "without the operator it is left out");
    fs::write(&file, text.replace(none, &format!("\ncomponents: [{component}]\n"))).unwrap();
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
    let made = include_str!("../../deploy/kubernetes/monitoring/rules.yaml");
    let folder = tempfile::tempdir().unwrap();
    let monitoring = folder.path().join("kubernetes/monitoring");
    fs::create_dir_all(&monitoring).unwrap();
    fs::create_dir(folder.path().join("prometheus")).unwrap();
    fs::write(monitoring.join("rules.yaml"), made).unwrap();
    let rules = include_str!("../../deploy/prometheus/pnet-nat.rules.yml");
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
    let rules = include_str!("../../deploy/prometheus/pnet-nat.rules.yml");
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

/// Lays out a projected volume: `..data` leads to a folder, and each entry to one in there.
fn mount(folder: &Path, volume: &Value, configuration: &str, group: u32) {
    let mode = volume["projected"]["defaultMode"].as_u64().unwrap() as u32;
    let data = folder.join("..2026_11_22");
    fs::create_dir_all(data.join("secrets")).unwrap();
    let write = |path: &str, content: &[u8]| {
        let path = data.join(path);
        fs::write(&path, content).unwrap();
        chown(&path, None, Some(group)).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(mode)).unwrap();
    };
    write("pnet-nat.toml", configuration.as_bytes());
    for item in volume["projected"]["sources"][1]["secret"]["items"].as_array().unwrap() {
        let content = match item["key"].as_str().unwrap() {
            "section-1" => PASSWORD.as_slice(),
            "admin" => TOKEN.as_bytes(),
            key => panic!("{key} is not in the secret of README.md"),
        };
        write(item["path"].as_str().unwrap(), content);
    }
    symlink("..2026_11_22", folder.join("..data")).unwrap();
    for entry in ["pnet-nat.toml", "secrets"] {
        symlink(format!("..data/{entry}"), folder.join(entry)).unwrap();
    }
    for path in [folder, &data, &data.join("secrets")] {
        fs::set_permissions(path, Permissions::from_mode(0o755)).unwrap();
    }
}

#[test]
fn the_container_relays_as_its_manifest_has_it() {
    let Some(manifests) = build() else { return };
    relays(&manifests);
}

/// As README.md has it. The container begins as root, with some capabilities of root's; the relay is the
/// same user as without, and nothing of this is left.
#[test]
fn the_container_with_flows_in_the_kernel_gives_its_rights_up() {
    let Some(manifests) = build_with("kernel-flows") else { return };
    for version in VERSIONS {
        assert_eq!(complaint(&manifests, version), None);
    }
    let deployment = manifest(&manifests, "Deployment");
    let rights = &deployment["spec"]["template"]["spec"]["containers"][0]["securityContext"];
    assert_eq!((&rights["runAsUser"], &rights["runAsNonRoot"]), (&json!(0), &json!(false)));
    assert_eq!(rights["capabilities"]["drop"], json!(["ALL"]));
    assert_eq!(rights["allowPrivilegeEscalation"], json!(false));
    relays(&manifests);
}

fn relays(manifests: &str) {
    if !geteuid().is_root() || Command::new("setpriv").arg("--version").output().is_err() {
        return left_out("root and setpriv, to become the container's user");
    }
    let deployment = manifest(manifests, "Deployment");
    let pod = &deployment["spec"]["template"]["spec"];
    let container = &pod["containers"][0];
    // What a container says of itself goes before what is said of the pod.
    let id = |name: &str| {
        let id = container["securityContext"].get(name);
        id.unwrap_or(&pod["securityContext"][name]).as_u64().unwrap()
    };

    let site = Site::claim();
    let mut configuration =
        manifest(manifests, "ConfigMap")["data"]["pnet-nat.toml"].as_str().unwrap().to_owned();
    let (public, subnet) = (site.public_address(), site.address(0));
    for (from, to) in [
        (r#"listen = ["0.0.0.0"]"#, format!(r#"listen = ["{public}"]"#)),
        ("0.0.0.0:9378", site.admin().to_string()),
        ("start_port = 20000", format!("start_port = {}", site.start_port())),
        ("172.17.17.0", subnet.to_string()),
        ("198.51.100.0/24", format!("{subnet}/24")),
    ] {
        assert!(configuration.contains(from), "{from}");
        configuration = configuration.replace(from, &to);
    }
    let files = tempfile::tempdir().unwrap();
    mount(files.path(), &pod["volumes"][0], &configuration, id("fsGroup") as u32);
    // Whoever it is can run the copy, and not the original.
    let program = files.path().join("pnet-nat");
    fs::copy(pnet_nat(&[]).get_program(), &program).unwrap();
    fs::set_permissions(&program, Permissions::from_mode(0o755)).unwrap();

    let mut command = Command::new("setpriv");
    command.arg(format!("--reuid={}", id("runAsUser")));
    command.arg(format!("--regid={}", id("runAsGroup")));
    command.arg(format!("--groups={}", id("fsGroup")));
    let added = container["securityContext"]["capabilities"]["add"].as_array();
    let added = added.into_iter().flatten().map(|name| name.as_str().unwrap().to_lowercase());
    let bounds: String = added.map(|name| format!(",+{name}")).collect();
    command.arg(format!("--bounding-set=-all{bounds}"));
    command.args(["--no-new-privs", "--inh-caps=-all"]).arg(program);
    let mounted = container["volumeMounts"][0]["mountPath"].as_str().unwrap();
    for argument in container["args"].as_array().unwrap() {
        let argument = argument.as_str().unwrap();
        command.arg(argument.replace(mounted, files.path().to_str().unwrap()));
    }
    let mut relay = Process::start(command);
    let agent: ureq::Agent =
        ureq::Agent::config_builder().http_status_as_error(false).build().into();
    let get = |path: &str| agent.get(format!("http://{}{path}", site.admin()));
    let ask = |path: &str| Some(get(path).call().ok()?.status().as_u16());
    for probe in ["readinessProbe", "livenessProbe"] {
        let path = container[probe]["httpGet"]["path"].as_str().unwrap();
        eventually("the probe is content", || {
            assert!(!relay.has_ended(), "{}", relay.stderr());
            (ask(path) == Some(200)).then_some(())
        });
    }
    let status = fs::read_to_string(format!("/proc/{}/status", relay.id())).unwrap();
    assert!(status.contains("\nUid:\t65532\t65532\t65532\t65532\n"), "{status}");
    assert!(status.contains("\nGid:\t65532\t65532\t65532\t65532\n"), "{status}");
    for set in ["CapInh", "CapPrm", "CapEff", "CapAmb"] {
        assert!(status.contains(&format!("\n{set}:\t0000000000000000\n")), "{status}");
    }
    assert_eq!(ask("/metrics"), Some(401), "the network sees nothing without the token");
    exchange(&site.client(), site.public(4), &site.node(4), 4);
    eventually("the counters are at rest", || {
        let scrape = get("/metrics").header("Authorization", format!("Bearer {TOKEN}"));
        let text = scrape.call().unwrap().body_mut().read_to_string().unwrap();
        Metrics::parse(&text).breaches().is_empty().then_some(())
    });
    relay.signal(Signal::SIGTERM);
    assert_eq!(relay.end(), Some(0), "{}", relay.stderr());
    assert!(!relay.stderr().contains(str::from_utf8(PASSWORD).unwrap()));
}
