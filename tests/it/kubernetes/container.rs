//! The container's command as the manifests have it: on its configuration, with the files laid out as a
//! kubelet does it, as the user and group of the manifest.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::path::Path;
use std::process::Command;

use nix::sys::signal::Signal;
use nix::unistd::geteuid;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::{TOKEN, VERSIONS, build, build_with, complaint, manifest, workload};
use crate::harness::{Metrics, PASSWORD, Process, Site, eventually, exchange, left_out, pnet_nat};

/// What stands behind `key = ` where the configuration has it for the first time.
pub(super) fn value<'a>(configuration: &'a str, key: &str) -> &'a str {
    let mut lines = configuration.lines();
    lines.find_map(|line| line.strip_prefix(key)?.strip_prefix(" = ")).expect(key)
}

/// An edge node, whose networks are a site of the tests.
pub(super) struct EdgeNode {
    pub(super) site: Site,
    pub(super) configuration: String,
    pod: Value,
    /// Whoever it is can run this copy of the program, and not the original.
    program: TempDir,
}

/// A container on an edge node, with what is mounted there.
pub(super) struct Container {
    pub(super) process: Process,
    _mounted: TempDir,
}

impl EdgeNode {
    /// `None` where the container's user cannot be had.
    pub(super) fn new(manifests: &str) -> Option<Self> {
        if !geteuid().is_root() || Command::new("setpriv").arg("--version").output().is_err() {
            left_out("root and setpriv, to become the container's user");
            return None;
        }
        let pod = workload(manifests)["spec"]["template"]["spec"].clone();
        let site = Site::claim();
        let mut configuration =
            manifest(manifests, "ConfigMap")["data"]["pnet-nat.toml"].as_str().unwrap().to_owned();
        let port = pod["containers"][0]["ports"][0]["containerPort"].to_string();
        let (public, subnet) = (site.public_address(), site.address(0));
        for (from, to) in [
            (
                format!("listen = {}", value(&configuration, "listen")),
                format!(r#"listen = ["{public}"]"#),
            ),
            (format!("0.0.0.0:{port}"), site.admin().to_string()),
            (value(&configuration, "start_port").to_owned(), site.start_port().to_string()),
            (value(&configuration, "subnet").to_owned(), format!(r#""{subnet}""#)),
            (value(&configuration, "allow").to_owned(), format!(r#"["{subnet}/24"]"#)),
        ] {
            assert!(configuration.contains(&from), "{from}");
            configuration = configuration.replace(&from, &to);
        }
        let program = tempfile::tempdir().unwrap();
        fs::set_permissions(program.path(), Permissions::from_mode(0o755)).unwrap();
        let copy = program.path().join("pnet-nat");
        // By another process: a program that another test starts meanwhile would hold for a moment what this
        // process writes, and a file that is open for writing cannot be run ("Text file busy").
        let original = pnet_nat(&[]);
        let copied = Command::new("cp").arg(original.get_program()).arg(&copy).status().unwrap();
        assert!(copied.success());
        fs::set_permissions(&copy, Permissions::from_mode(0o755)).unwrap();
        Some(Self { site, configuration, pod, program })
    }

    /// Runs the container with this configuration.
    pub(super) fn start(&self, configuration: &str) -> Container {
        let arguments = self.pod["containers"][0]["args"].as_array().unwrap();
        self.run(arguments.iter().map(|argument| argument.as_str().unwrap()), configuration)
    }

    /// Runs the container with other arguments.
    pub(super) fn run<'a>(
        &self,
        arguments: impl Iterator<Item = &'a str>,
        configuration: &str,
    ) -> Container {
        let container = &self.pod["containers"][0];
        // What a container says of itself goes before what is said of the pod.
        let id = |name: &str| {
            let id = container["securityContext"].get(name);
            id.unwrap_or(&self.pod["securityContext"][name]).as_u64().unwrap()
        };
        let mounted = tempfile::tempdir().unwrap();
        mount(mounted.path(), &self.pod["volumes"][0], configuration, id("fsGroup") as u32);
        let mut command = Command::new("setpriv");
        command.arg(format!("--reuid={}", id("runAsUser")));
        command.arg(format!("--regid={}", id("runAsGroup")));
        command.arg(format!("--groups={}", id("fsGroup")));
        let added = container["securityContext"]["capabilities"]["add"].as_array();
        let added = added.into_iter().flatten().map(|name| name.as_str().unwrap().to_lowercase());
        let bounds: String = added.map(|name| format!(",+{name}")).collect();
        command.arg(format!("--bounding-set=-all{bounds}"));
        command.args(["--no-new-privs", "--inh-caps=-all"]);
        command.arg(self.program.path().join("pnet-nat"));
        let place = container["volumeMounts"][0]["mountPath"].as_str().unwrap();
        for argument in arguments {
            command.arg(argument.replace(place, mounted.path().to_str().unwrap()));
        }
        Container { process: Process::start(command), _mounted: mounted }
    }

    /// What the admin server answers.
    pub(super) fn ask(&self, path: &str) -> Option<u16> {
        Some(agent().get(self.url(path)).call().ok()?.status().as_u16())
    }

    /// What the kubelet's probe gets.
    pub(super) fn probe(&self, name: &str) -> Option<u16> {
        self.ask(self.pod["containers"][0][name]["httpGet"]["path"].as_str().unwrap())
    }

    pub(super) fn wait_until_ready(&self, container: &mut Container) {
        for probe in ["readinessProbe", "livenessProbe"] {
            eventually("the probe is content", || {
                let relay = &mut container.process;
                assert!(!relay.has_ended(), "{}", relay.stderr());
                (self.probe(probe) == Some(200)).then_some(())
            });
        }
    }

    pub(super) fn exchange(&self) {
        exchange(&self.site.client(), self.site.public(4), &self.site.node(4), 4);
    }

    fn metrics(&self) -> Metrics {
        let scrape = agent().get(self.url("/metrics"));
        let scrape = scrape.header("Authorization", format!("Bearer {TOKEN}"));
        Metrics::parse(&scrape.call().unwrap().body_mut().read_to_string().unwrap())
    }

    fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.site.admin())
    }
}

fn agent() -> ureq::Agent {
    ureq::Agent::config_builder().http_status_as_error(false).build().into()
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
            "section-1" | "section-2" => PASSWORD.as_slice(),
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
    let rights =
        &workload(&manifests)["spec"]["template"]["spec"]["containers"][0]["securityContext"];
    assert_eq!((&rights["runAsUser"], &rights["runAsNonRoot"]), (&json!(0), &json!(false)));
    assert_eq!(rights["capabilities"]["drop"], json!(["ALL"]));
    assert_eq!(rights["allowPrivilegeEscalation"], json!(false));
    relays(&manifests);
}

/// Runs it from start to end.
pub(super) fn relays(manifests: &str) {
    let Some(node) = EdgeNode::new(manifests) else { return };
    let mut container = node.start(&node.configuration);
    node.wait_until_ready(&mut container);
    let mut relay = container.process;
    let status = fs::read_to_string(format!("/proc/{}/status", relay.id())).unwrap();
    assert!(status.contains("\nUid:\t65532\t65532\t65532\t65532\n"), "{status}");
    assert!(status.contains("\nGid:\t65532\t65532\t65532\t65532\n"), "{status}");
    for set in ["CapInh", "CapPrm", "CapEff", "CapAmb"] {
        assert!(status.contains(&format!("\n{set}:\t0000000000000000\n")), "{status}");
    }
    assert_eq!(node.ask("/metrics"), Some(401), "the network sees nothing without the token");
    node.exchange();
    eventually("the counters are at rest", || node.metrics().breaches().is_empty().then_some(()));
    relay.signal(Signal::SIGTERM);
    assert_eq!(relay.end(), Some(0), "{}", relay.stderr());
    assert!(!relay.stderr().contains(str::from_utf8(PASSWORD).unwrap()));
}

/// The manifests as they are rolled out on two edge nodes. What is left to the controllers is in README.md:
/// with one relay away and not ready, they touch no other.
#[test]
fn a_configuration_that_is_refused_never_gets_ready() {
    let Some(manifests) = build() else { return };
    let (Some(one), Some(other)) = (EdgeNode::new(&manifests), EdgeNode::new(&manifests)) else {
        return;
    };
    let [mut first, mut second] = [&one, &other].map(|node| node.start(&node.configuration));
    one.wait_until_ready(&mut first);
    other.wait_until_ready(&mut second);

    // The controller ends the first, and the kubelet starts the next, again and again.
    first.process.signal(Signal::SIGTERM);
    assert_eq!(first.process.end(), Some(0), "{}", first.process.stderr());
    let right = format!("start_port = {}", one.site.start_port());
    let refused = one.configuration.replace(&right, "start_port = 70000");
    assert_ne!(refused, one.configuration);
    for _ in 0..3 {
        let mut container = one.start(&refused);
        while !container.process.has_ended() {
            assert_eq!(one.probe("readinessProbe"), None, "nothing listens");
        }
        assert_eq!(container.process.end(), Some(2));
        let told = container.process.logged("configuration fault");
        assert_eq!(told[0]["key"], "udp_range_net[0].start_port", "{told:?}");
        assert_eq!(other.probe("readinessProbe"), Some(200));
        other.exchange();
    }

    // What is right again is rolled out again.
    let mut mended = one.start(&one.configuration);
    one.wait_until_ready(&mut mended);
    one.exchange();
}
