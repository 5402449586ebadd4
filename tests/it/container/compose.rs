//! `deploy/compose.yaml`, with images made here: no other can be had without a registry. Grafana's
//! cannot be made; that its files are where its service looks for them is all that is seen of it.

use std::cell::OnceCell;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

use nix::fcntl::{Flock, FlockArg};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::engine::{Image, docker, output};
use crate::harness::{eventually, left_out};

const DEPLOY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/deploy");
const FILE: &str = include_str!("../../../deploy/compose.yaml");
const PROJECT: &str = "pnet-nat-test";

#[test]
fn the_try_out_comes_up_and_is_watched() {
    let Some(pnet_nat) = Image::prebuilt() else { return };
    let Some(prometheus) = prometheus() else { return };
    if !has_compose() {
        return;
    }
    let project = Project::new(&pnet_nat, &prometheus);
    // With all that they depend on.
    project.compose(&["up", "--detach", "--no-build", "prometheus", "client"]);

    let responses = "pnet_nat_forwarded_datagrams_total{direction=\"response\"} > 2";
    eventually("both nodes answer", || (project.query(responses).len() == 2).then_some(()));
    eventually("the sums of the rules are there", || {
        let sum =
            project.query("net:pnet_nat_forwarded_datagrams:rate5m{direction=\"request\"} > 0");
        (sum.len() == 1).then_some(())
    });
    assert_eq!(project.query("ALERTS"), [] as [Value; 0]);
    let dropped = project.query("pnet_nat_dropped_datagrams_total > 0");
    assert_eq!(dropped, [] as [Value; 0]);

    // What docs/container.md has people try.
    project.compose(&["stop", "node-3"]);
    eventually("node 3 is silent", || (project.silent_nodes() == json!([3])).then_some(()));
    project.compose(&["start", "node-3"]);
    eventually("it answers again", || (project.silent_nodes() == json!([])).then_some(()));

    project.compose(&["stop", "router"]);
    let router = project.compose(&["ps", "--quiet", "--all", "router"]);
    assert_eq!(docker(&["inspect", "--format", "{{.State.ExitCode}}", &router]), "0");
    eventually("Prometheus sees that", || {
        (project.query("up{job=\"pnet-nat\"} == 0").len() == 1).then_some(())
    });
    project.compose(&["start", "router"]);
    eventually("both nodes answer again", || (project.query(responses).len() == 2).then_some(()));
}

#[test]
fn every_file_that_is_mounted_is_there() {
    let mounted = FILE.lines().filter_map(|line| line.trim().strip_prefix("- ./"));
    let mounted: Vec<_> = mounted.map(|mount| mount.split_once(':').unwrap()).collect();
    assert!(mounted.len() >= 5, "{mounted:?}");
    for (source, _) in &mounted {
        assert!(Path::new(DEPLOY).join(source).exists(), "{source}");
    }
    let home = FILE.split_once("HOME_DASHBOARD_PATH: ").unwrap().1.lines().next().unwrap();
    let (source, rest) = mounted
        .iter()
        .find_map(|(source, target)| {
            Some((source, home.strip_prefix(target.trim_end_matches(":ro"))?))
        })
        .expect("the dashboard is mounted");
    assert!(Path::new(DEPLOY).join(format!("{source}{rest}")).exists(), "{home}");
}

/// The tool: what stands before its arguments.
fn tool() -> Option<&'static [&'static str]> {
    let tools: [&[&str]; 2] = [&["docker", "compose"], &["docker-compose"]];
    tools.into_iter().find(|tool| {
        let version = Command::new(tool[0]).args(&tool[1..]).arg("version").output();
        version.is_ok_and(|output| output.status.success())
    })
}

fn has_compose() -> bool {
    let has = tool().is_some();
    if !has {
        left_out("docker compose, of the package docker-compose");
    }
    has
}

/// The try-out, taken down when dropped.
struct Project {
    overrides: TempDir,
    /// Where Prometheus' port is published.
    prometheus: OnceCell<String>,
    _alone: Flock<File>,
}

impl Project {
    fn new(pnet_nat: &Image, prometheus: &Image) -> Self {
        // Its networks can be there once.
        let lock = File::create(std::env::temp_dir().join("pnet-nat-compose.lock")).unwrap();
        let alone = Flock::lock(lock, FlockArg::LockExclusive).map_err(|(_, error)| error).unwrap();
        let overrides = tempfile::tempdir().unwrap();
        let images = [("router", pnet_nat), ("node-3", pnet_nat), ("node-4", pnet_nat)];
        let images = images.into_iter().chain([("client", pnet_nat)]);
        let images = images.chain([("prometheus", prometheus), ("secrets", prometheus)]);
        let images =
            images.map(|(service, image)| format!("  {service}: {{ image: {} }}\n", image.0));
        let text = format!("services:\n{}", images.collect::<String>());
        fs::write(overrides.path().join("images.yaml"), text).unwrap();
        let project = Self { overrides, prometheus: OnceCell::new(), _alone: alone };
        project.down();
        project
    }

    #[track_caller]
    fn compose(&self, arguments: &[&str]) -> String {
        output(self.command().args(arguments))
    }

    fn command(&self) -> Command {
        let tool = tool().unwrap();
        let mut command = Command::new(tool[0]);
        command.args(&tool[1..]).args(["--project-name", PROJECT]);
        command.args(["--file", &format!("{DEPLOY}/compose.yaml"), "--file"]);
        command.arg(self.overrides.path().join("images.yaml"));
        // Any free ports.
        command.envs([("PROMETHEUS_PORT", ""), ("GRAFANA_PORT", "")]);
        command
    }

    /// Those of the one net, as `pnet-nat status` in the router tells.
    fn silent_nodes(&self) -> Value {
        let status =
            ["pnet-nat", "status", "--url", "http://10.17.18.250:9378", "--format", "json"];
        let token = ["--token-file", "/run/secrets/admin"];
        let told = self.compose(&[&["exec", "-T", "router"], &status[..], &token].concat());
        let mut told: Value = serde_json::from_str(&told).unwrap();
        told["nets"][0]["silent_nodes"].take()
    }

    /// What a query of Prometheus finds now.
    fn query(&self, query: &str) -> Vec<Value> {
        let address = self.prometheus.get_or_init(|| self.compose(&["port", "prometheus", "9090"]));
        let agent: ureq::Agent =
            ureq::Agent::config_builder().http_status_as_error(false).build().into();
        let asked =
            agent.get(format!("http://{address}/api/v1/query")).query("query", query).call();
        let Ok(mut answer) = asked else { return Vec::new() };
        let answer = answer.body_mut().read_to_string().unwrap();
        let answer: Value = serde_json::from_str(&answer).unwrap();
        assert_eq!(answer["status"], "success", "{answer}");
        answer["data"]["result"].as_array().unwrap().clone()
    }

    fn down(&self) {
        let down = ["down", "--volumes", "--remove-orphans", "--timeout", "1"];
        let _ = self.command().args(down).output();
    }
}

impl Drop for Project {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let logs =
                self.command().args(["logs", "--no-color", "--tail", "20"]).output().unwrap();
            println!("{}", String::from_utf8_lossy(&logs.stdout));
        }
        self.down();
    }
}

/// Debian's Prometheus in an image that is laid out as the project's own: the same user, entry point,
/// folders, and busybox around it. Says so where it cannot be made.
fn prometheus() -> Option<Image> {
    let find = |program: &str| {
        let found = Command::new("sh").args(["-c", &format!("command -v {program}")]).output();
        let path = String::from_utf8(found.unwrap().stdout).unwrap();
        (!path.is_empty()).then(|| PathBuf::from(path.trim_end()))
    };
    let (Some(prometheus), Some(busybox)) = (find("prometheus"), find("busybox")) else {
        left_out("prometheus and busybox, of the packages prometheus and busybox-static");
        return None;
    };
    let context = tempfile::tempdir().unwrap();
    let root = context.path().join("root");
    for folder in ["bin", "etc/prometheus", "prometheus"] {
        fs::create_dir_all(root.join(folder)).unwrap();
    }
    let copy = |from: &Path, to: &str| fs::copy(from, root.join(to)).map(|_| ()).unwrap();
    copy(&prometheus, "bin/prometheus");
    copy(&busybox, "bin/busybox");
    for program in ["sh", "tr", "head", "chown", "chmod", "test"] {
        std::os::unix::fs::symlink("busybox", root.join("bin").join(program)).unwrap();
    }
    // The C library and its loader.
    let libraries = output(Command::new("ldd").arg(&prometheus));
    let paths = libraries.split_whitespace().filter(|word| word.starts_with('/'));
    for library in paths {
        let to = library.trim_start_matches('/');
        fs::create_dir_all(root.join(to).parent().unwrap()).unwrap();
        copy(Path::new(library), to);
    }
    fs::write(
        context.path().join("Dockerfile"),
        "FROM scratch\n\
         COPY root /\n\
         RUN [\"/bin/chown\", \"65534:65534\", \"/prometheus\"]\n\
         USER 65534:65534\n\
         WORKDIR /prometheus\n\
         VOLUME /prometheus\n\
         ENTRYPOINT [\"/bin/prometheus\"]\n\
         CMD [\"--config.file=/etc/prometheus/prometheus.yml\", \"--storage.tsdb.path=/prometheus\"]\n",
    )
    .unwrap();
    Some(Image::build(&context.path().join("Dockerfile"), context.path()))
}
