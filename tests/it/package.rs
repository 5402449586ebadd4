//! The Debian package and its systemd unit, installed, run and removed on a copy of this machine.
//!
//! Needs root, systemd and cargo-deb.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::harness::{Machine, Metrics, PASSWORD, Process, eventually, left_out, pnet_nat};

const UNIT: &str = "deploy/systemd/pnet-nat.service";
const KERNEL_FLOWS: &str = "deploy/systemd/kernel-flows.conf";

/// The most that `systemd-analyze security` may find exposed, of 10.
const MOST_EXPOSED: f64 = 2.0;

/// Packs the binary of the tests as if it were that of the package's profile: nothing is compiled.
fn package(folder: &tempfile::TempDir) -> Option<PathBuf> {
    let file = folder.path().join("pnet-nat.deb");
    if Command::new(env!("CARGO")).args(["deb", "--version"]).output().unwrap().status.success() {
        let pages = Path::new("target/package");
        fs::create_dir_all(pages).unwrap();
        let made = pnet_nat(&["man", pages.to_str().unwrap()]).status().unwrap();
        assert!(made.success());
        let shells = [("bash", "pnet-nat.bash"), ("zsh", "_pnet-nat"), ("fish", "pnet-nat.fish")];
        for (shell, file) in shells {
            let completions = pnet_nat(&["completions", shell]).output().unwrap();
            fs::write(pages.join(file), completions.stdout).unwrap();
        }

        let target = folder.path().join("target");
        fs::create_dir_all(target.join(PROFILE)).unwrap();
        symlink(pnet_nat(&[]).get_program(), target.join(PROFILE).join("pnet-nat")).unwrap();
        let mut command = Command::new(env!("CARGO"));
        command.args(["deb", "--no-build", "--fast", "--locked", "--offline"]);
        command.env("CARGO_TARGET_DIR", target);
        let output = command.arg("--output").arg(&file).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        Some(file)
    } else {
        left_out("cargo-deb");
        None
    }
}

/// As README.md has the program built.
const PROFILE: &str = "dist";

/// The program is stripped by cargo, each page is there that a page links to, and the examples of
/// `sysctl.d` name settings that there are.
#[test]
fn the_package_has_what_its_pages_name() {
    let cargo: toml::Table = toml::from_str(include_str!("../../Cargo.toml")).unwrap();
    assert_eq!(cargo["profile"][PROFILE]["strip"].as_bool(), Some(true));
    let readme = include_str!("../../README.md");
    assert!(readme.contains(&format!("cargo build --profile {PROFILE}\n")));

    let folder = tempfile::tempdir().unwrap();
    let Some(package) = package(&folder) else { return };
    let root = folder.path().join("root");
    let mut command = Command::new("dpkg-deb");
    let status = command.arg("--extract").arg(&package).arg(&root).status().unwrap();
    assert!(status.success());
    let documentation = root.join("usr/share/doc/pnet-nat");
    let pages = markdown(&documentation);
    assert!(pages.len() > 20, "{pages:?}");
    for page in pages {
        let text = fs::read_to_string(&page).unwrap();
        for link in text.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next()) {
            let target = page.parent().unwrap().join(link);
            assert!(link.contains("://") || target.exists(), "{}: {link}", page.display());
        }
    }
    for example in [
        "prometheus/pnet-nat.rules.yml",
        "grafana/dashboards/pnet-nat.json",
        "grafana/dashboards/pnet-nat-fleet.json",
        "fail2ban/jail.d/pnet-nat.conf",
        "keepalived/keepalived.conf",
        "systemd/kernel-flows.conf",
    ] {
        assert!(documentation.join("examples").join(example).is_file(), "{example}");
    }
    let settings = documentation.join("examples/sysctl.d/60-pnet-nat.conf");
    let settings = fs::read_to_string(settings).unwrap();
    let lines = settings.lines().map(|line| line.trim_start_matches('#'));
    let keys: Vec<_> =
        lines.filter_map(|line| line.split_once(" = ")).map(|(key, _)| key).collect();
    assert_eq!(keys.len(), 4, "{keys:?}");
    for key in keys {
        assert!(Path::new("/proc/sys").join(key.replace('.', "/")).exists(), "{key}");
    }
}

/// The pages below a folder.
fn markdown(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    let pages = entries.flat_map(|entry| match entry.file_type().unwrap() {
        kind if kind.is_dir() => markdown(&entry.path()),
        _ => vec![entry.path()],
    });
    pages.filter(|path| path.extension().is_some_and(|extension| extension == "md")).collect()
}

#[test]
fn the_unit_leaves_little_exposed() {
    leaves_little_exposed(Path::new(UNIT));
    let folder = tempfile::tempdir().unwrap();
    let unit = folder.path().join("pnet-nat.service");
    let drop_ins = folder.path().join("pnet-nat.service.d");
    fs::copy(UNIT, &unit).unwrap();
    fs::create_dir(&drop_ins).unwrap();
    fs::copy(KERNEL_FLOWS, drop_ins.join("kernel-flows.conf")).unwrap();
    leaves_little_exposed(&unit);
}

fn leaves_little_exposed(unit: &Path) {
    let analyze = |arguments: &[&str]| {
        Command::new("systemd-analyze").args(arguments).arg(unit).output().ok()
    };
    let Some(output) = analyze(&["security", "--offline=true", "--no-pager"]) else {
        return left_out("systemd-analyze, of the package systemd");
    };
    let text = String::from_utf8(output.stdout).unwrap();
    let (_, level) = text.split_once("Overall exposure level").expect("an overall level");
    let exposure = level.split_whitespace().find_map(|word| word.parse::<f64>().ok()).expect(level);
    assert!(exposure < MOST_EXPOSED, "{text}");

    // What it does not know, or cannot find, it says.
    let verified = String::from_utf8(analyze(&["verify"]).unwrap().stderr).unwrap();
    let expected = ["Command /usr/bin/pnet-nat is not executable"];
    let is_expected = |line: &&str| expected.iter().any(|expected| line.contains(expected));
    let complaints: Vec<_> = verified.lines().filter(|line| !is_expected(line)).collect();
    assert_eq!(complaints, [""; 0]);
}

/// The service on a machine that has the package.
struct Service(Machine);

impl Service {
    fn property(&self, name: &str) -> String {
        self.0.run(&["systemctl", "show", "--value", "--property", name, "pnet-nat"]).trim().into()
    }

    fn expect_state(&self, state: &str) {
        assert_eq!(self.property("ActiveState"), state, "{}", self.0.journal());
    }

    /// Whether a request to this node is answered.
    fn answers(&self, node: &str) -> bool {
        self.answers_at("20000", node)
    }

    fn answers_at(&self, start_port: &str, node: &str) -> bool {
        self.answers_with("/etc/pnet-nat/secrets/section-1", start_port, node)
    }

    /// The same with the password in this file.
    fn answers_with(&self, password: &str, start_port: &str, node: &str) -> bool {
        let to = "127.0.0.1";
        let request = ["pnet-nat", "request", "--to", to, "--start-port", start_port];
        let request = [&request[..], &["--node", node, "--timeout", "500ms"]];
        let request = [request.concat(), vec!["--password-file", password]].concat();
        self.0.output(&request).status.success()
    }

    fn metrics(&self) -> Metrics {
        Metrics::parse(&self.0.run(&["curl", "--silent", "http://127.0.0.1:9378/metrics"]))
    }

    /// Changes the configuration.
    fn edit(&self, expression: &str) {
        self.0.run(&["sed", "-i", expression, "/etc/pnet-nat/pnet-nat.toml"]);
    }

    /// The lines of the relay's own log with this message.
    fn logged(&self, message: &str) -> Vec<Value> {
        let journal = self.0.journal();
        let lines = journal.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        lines.filter(|line| line["message"] == message).collect()
    }
}

#[test]
fn the_package_is_installed_run_and_removed() {
    let folder = tempfile::tempdir().unwrap();
    let Some(package) = package(&folder) else { return };
    let machine = match Machine::start() {
        Ok(machine) => machine,
        Err(want) => return left_out(&want),
    };
    machine.run(&["mkdir", "/tmp/packages"]);
    let copy = format!("cp /dev/stdin {PACKAGE}");
    let mut command = machine.command(&["sh", "-c", &copy]);
    command.stdin(std::fs::File::open(package).unwrap());
    assert!(command.status().unwrap().success());

    machine.run(&["dpkg", "--install", PACKAGE]);
    let service = Service(machine);
    installed_and_not_started(&service);
    let _nodes = configured_and_started(&service);
    confined(&service);
    confined_with_flows_in_the_kernel(&service);
    reloaded(&service);
    passwords_changed(&service);
    passwords_changed_without_a_restart(&service);
    watched(&service);
    removed(&service);
}

const PACKAGE: &str = "/tmp/packages/pnet-nat.deb";

fn installed_and_not_started(service: &Service) {
    let Service(machine) = service;
    service.expect_state("inactive");
    assert_eq!(service.property("UnitFileState"), "disabled");
    let modes = machine.shell("cd /etc/pnet-nat && stat --format '%n %a %U' pnet-nat.toml secrets");
    assert_eq!(modes, "pnet-nat.toml 644 root\nsecrets 700 root\n");
    let listed = machine.run(&["dpkg-query", "--listfiles", "pnet-nat"]);
    let page = "/usr/share/man/man1/pnet-nat-run.1.gz";
    for file in [
        "/usr/bin/pnet-nat",
        page,
        "/usr/share/bash-completion/completions/pnet-nat",
        "/usr/share/zsh/vendor-completions/_pnet-nat",
        "/usr/share/fish/vendor_completions.d/pnet-nat.fish",
        "/etc/fail2ban/filter.d/pnet-nat.conf",
        "/etc/pnet-nat/pnet-nat.schema.json",
    ] {
        assert!(listed.lines().any(|line| line == file), "{listed}");
    }
}

/// As the README has it: passwords, configuration, check, start. Then simulated nodes, and a request.
fn configured_and_started(service: &Service) -> Process {
    let Service(machine) = service;
    let password = str::from_utf8(PASSWORD).unwrap();
    machine.shell(&format!("umask 077; printf %s '{password}' > /etc/pnet-nat/secrets/section-1"));
    // Of the annotated configuration, the first section alone.
    service.edit(r#"/^\[\[server\]\]/,/^# ── Bounds/d"#);
    service
        .edit(r#"s/^subnet = .*/subnet = "127.17.17.0"/; s/^allow = .*/allow = ["127.0.0.0\/8"]/"#);
    machine.run(&["pnet-nat", "check", "--config", "/etc/pnet-nat/pnet-nat.toml"]);
    machine.run(&["systemctl", "enable", "--now", "pnet-nat"]);

    service.expect_state("active");
    assert!(service.property("StatusText").starts_with("relaying"));
    let nodes = Process::start(machine.command(&[
        "pnet-nat",
        "node",
        "--listen=127.17.17.1-5",
        "--password-file=/etc/pnet-nat/secrets/section-1",
    ]));
    eventually("the nodes are there", || (nodes.stdout().lines().count() == 5).then_some(()));
    assert!(service.answers("1-4"));
    // The commands find the control socket in the folder that systemd makes for it.
    let mode = machine.run(&["stat", "--format=%a", "/run/pnet-nat", "/run/pnet-nat/control.sock"]);
    assert_eq!(mode, "750\n660\n");
    let status = machine.run(&["pnet-nat", "status"]);
    assert!(status.contains(" at unix:/run/pnet-nat/control.sock, "), "{status}");
    nodes
}

fn confined(service: &Service) {
    let Service(machine) = service;
    let id = service.property("MainPID");
    let status = machine.run(&["cat", &format!("/proc/{id}/status")]);
    let field = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name));
        line.unwrap().split_whitespace().next().unwrap().to_owned()
    };
    assert_ne!(field("Uid:"), "0");
    assert_eq!(field("CapBnd:").trim_start_matches('0'), "");
    // Its own confinement is not in the way of the unit's, nor the other way round.
    let confined = service.logged("confined").len() + service.logged("confined in part").len();
    assert_eq!(confined, 1);
    let line = service.logged("confined").pop();
    let line = line.or_else(|| service.logged("confined in part").pop()).unwrap();
    for layer in ["memory", "no_new_privs", "capabilities", "seccomp"] {
        assert_eq!(line[layer], "on", "{line}");
    }
    assert!(service.metrics().sum("process_open_fds", &[]) > 5, "it can count what is its own");
}

/// The step of deploy/systemd, which is typed as it is written there, hands over what is needed, and none
/// of it is left.
fn confined_with_flows_in_the_kernel(service: &Service) {
    let Service(machine) = service;
    let page = include_str!("../../deploy/systemd/README.md");
    let (_, step) = page.split_once("\n**Flows in the kernel**").unwrap();
    let step = step.split("```").nth(1).unwrap().strip_prefix("sh\n").unwrap();
    // What the service begins with is in the journal.
    machine.shell(&format!(
        "mkdir -p {DROP_INS} && printf '{SHOWS_ITS_RIGHTS}' > {DROP_INS}/shows.conf"
    ));
    machine.shell(step);
    service.expect_state("active");
    let journal = machine.journal();
    assert!(journal.contains("CapEff:\t000000c000001000"), "{journal}");
    let system_calls = service.property("SystemCallFilter");
    assert!(system_calls.split_whitespace().any(|call| call == "bpf"), "{system_calls}");
    let families = service.property("RestrictAddressFamilies");
    assert!(families.contains("AF_NETLINK") && families.contains("AF_INET6"), "{families}");

    let id = service.property("MainPID");
    let status = machine.run(&["cat", &format!("/proc/{id}/status")]);
    for set in ["CapInh", "CapPrm", "CapEff", "CapAmb"] {
        assert!(status.contains(&format!("{set}:\t0000000000000000")), "{status}");
    }
    assert!(service.answers("1-4"));
    machine.shell(&format!("rm -r {DROP_INS}"));
    machine.run(&["systemctl", "daemon-reload"]);
    machine.run(&["systemctl", "restart", "pnet-nat"]);
}

const SHOWS_ITS_RIGHTS: &str = "[Service]\nExecStartPre=grep Cap /proc/self/status\n";

/// A sound configuration comes into force; what does not makes the job fail.
fn reloaded(service: &Service) {
    let Service(machine) = service;
    assert!(!service.answers("5"));
    service.edit(r#"s/^nodes = .*/nodes = ["1-5"]/"#);
    machine.run(&["systemctl", "reload", "pnet-nat"]);
    eventually("node 5 is answered for", || service.answers("5").then_some(()));
    let reloads = service.logged("reload").len();

    service.edit(r#"s/^nodes = .*/nodes = ["1-500"]/"#);
    let reload = machine.output(&["systemctl", "reload", "pnet-nat"]);
    assert!(!reload.status.success());
    assert!(machine.journal().contains("1-500"), "the fault is in the journal");
    service.expect_state("active");
    assert!(service.answers("1-5"));
    assert_eq!(service.logged("reload failed").len(), 0, "the relay was not asked");
    assert_eq!(service.logged("reload").len(), reloads);
    service.edit(r#"s/^nodes = .*/nodes = ["1-5"]/"#);

    // What needs a restart fails the job, and says so.
    service.edit("s/^#workers = .*/workers = 7/");
    let reload = machine.output(&["systemctl", "reload", "pnet-nat"]);
    assert!(!reload.status.success(), "{}", machine.journal());
    assert!(machine.journal().contains("not in force: [runtime] workers"), "{}", machine.journal());
    service.edit("s/^workers = 7/#workers = 2/");
    machine.run(&["systemctl", "reload", "pnet-nat"]);
    eventually("the counters are at rest", || {
        service.metrics().breaches().is_empty().then_some(())
    });
}

/// The service reads copies of the password files. Whether a reload finds other octets in them is up to
/// systemd's version; a restart does, and a block that is taken out of the configuration is withdrawn
/// by a reload.
fn passwords_changed(service: &Service) {
    let Service(machine) = service;
    let write = |file: &str, password: &str| {
        machine.shell(&format!("umask 077; printf %s '{password}' > {file}"));
    };
    let (second, old, new) = ("/etc/pnet-nat/secrets/second", "/tmp/old", "/tmp/new");
    write(second, "t3am-Two");
    write(old, "t3am-Two");
    write(new, "t3am-2.1");
    machine
        .shell(&format!("mkdir -p {DROP_INS} && printf '{CREDENTIAL}' > {DROP_INS}/second.conf"));
    machine.shell(&format!("printf '{SECOND_PASSWORD}' >> /etc/pnet-nat/pnet-nat.toml"));
    machine.run(&["systemctl", "daemon-reload"]);
    machine.run(&["systemctl", "restart", "pnet-nat"]);
    let answers = |password| service.answers_with(password, "20000", "1");
    assert!(answers(old) && service.answers("1"));

    write(second, "t3am-2.1");
    machine.run(&["systemctl", "reload", "pnet-nat"]);
    let fresh = answers(new);
    assert_eq!(answers(old), !fresh, "one of the two is in force");
    machine.run(&["systemctl", "restart", "pnet-nat"]);
    assert!(answers(new) && !answers(old));

    service.edit("/^# second/,$d");
    machine.run(&["systemctl", "reload", "pnet-nat"]);
    eventually("it is withdrawn", || {
        let withdrawn = service.logged("reload").pop()?["credentials_withdrawn"].clone();
        (withdrawn == serde_json::json!(["section-1: second"])).then_some(())
    });
    assert!(!answers(new) && service.answers("1-5"));
}

/// After the step of deploy/systemd, which is typed as it is written there, a reload reads the files themselves.
fn passwords_changed_without_a_restart(service: &Service) {
    let Service(machine) = service;
    let page = include_str!("../../deploy/systemd/README.md");
    let (_, step) = page.split_once("## Passwords without a restart\n").unwrap();
    let step = step.split("```").nth(1).unwrap().strip_prefix("sh\n").unwrap();
    machine.shell(step);
    let (id, second) = (service.property("MainPID"), "/etc/pnet-nat/secrets/second");
    assert!(service.answers("1-5"));

    let answers = |password| service.answers_with(password, "20000", "1");
    machine.shell(&format!("printf '{SECOND_PASSWORD}' >> /etc/pnet-nat/pnet-nat.toml"));
    machine.run(&["systemctl", "reload", "pnet-nat"]);
    assert!(answers("/tmp/new"));
    machine.run(&["pnet-nat", "password", second]);
    machine.run(&["install", "-m", "600", second, "/tmp/newest"]);
    machine.run(&["systemctl", "reload", "pnet-nat"]);
    assert!(answers("/tmp/newest") && !answers("/tmp/new"));
    assert_eq!(service.property("MainPID"), id, "it was not restarted");
    service.edit("/^# second/,$d");
    machine.run(&["systemctl", "reload", "pnet-nat"]);
}

const CREDENTIAL: &str = "[Service]\nLoadCredential=second:/etc/pnet-nat/secrets/second\n";

/// Of the last section, which is the only one.
const SECOND_PASSWORD: &str = "
# second
[[udp_range_net.password]]
name = \"second\"
file = \"secrets/second\"
device_file = \"secrets/section-1\"
";

/// What deploy/systemd has for ports below 1024; and a watchdog that need not be waited for.
const DROP_IN: &str = "[Service]
PrivateUsers=no
CapabilityBoundingSet=CAP_NET_BIND_SERVICE
AmbientCapabilities=CAP_NET_BIND_SERVICE
WatchdogSec=2s
";

/// A relay that hangs is ended and started anew, one that dies as well, and one that refuses its
/// configuration is left alone.
fn watched(service: &Service) {
    let Service(machine) = service;
    machine
        .shell(&format!("mkdir -p {DROP_INS} && printf '%s' '{DROP_IN}' > {DROP_INS}/test.conf"));
    machine.run(&["systemctl", "daemon-reload"]);
    service.edit("s/^start_port = .*/start_port = 600/");
    machine.run(&["systemctl", "restart", "pnet-nat"]);
    assert!(service.answers_at("600", "1-5"));
    for (signal, count) in [("STOP", "1"), ("KILL", "2")] {
        machine.run(&["systemctl", "kill", "--signal", signal, "--kill-who=main", "pnet-nat"]);
        eventually("it is started anew", || {
            let anew = service.property("NRestarts") == count;
            (anew && service.property("ActiveState") == "active").then_some(())
        });
        assert!(service.answers_at("600", "1-5"));
    }

    service.edit("s/^start_port = .*/start_port = 0/");
    assert!(!machine.output(&["systemctl", "restart", "pnet-nat"]).status.success());
    service.expect_state("failed");
    service.edit("s/^start_port = .*/start_port = 20000/");
    machine.run(&["systemctl", "restart", "pnet-nat"]);
    assert!(service.answers("1-5"));
}

const DROP_INS: &str = "/etc/systemd/system/pnet-nat.service.d";

fn removed(service: &Service) {
    let Service(machine) = service;
    machine.run(&["dpkg", "--remove", "pnet-nat"]);
    service.expect_state("inactive");
    assert!(!machine.output(&["which", "pnet-nat"]).status.success());
    machine.run(&["ls", "/etc/pnet-nat/pnet-nat.toml", "/etc/pnet-nat/secrets/section-1"]);
    machine.run(&["dpkg", "--purge", "pnet-nat"]);
    let left = machine.shell(
        "cd / && find etc usr/bin usr/lib/systemd usr/share var/lib/systemd var/lib/dpkg/info \
         -path '*pnet-nat*'",
    );
    let left: Vec<_> = left.lines().filter(|file| !file.contains("pnet-nat.service.d")).collect();
    assert_eq!(left, [""; 0]);
}
