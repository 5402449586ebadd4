//! What a running relay has given up, thread by thread, and that it does its work all the same.
//! `tests/violations.rs` shows that what is given up is gone.

use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::os::unix::process::ExitStatusExt;
use std::process::Command;
use std::time::Duration;

use nix::sys::signal::Signal;
use nix::unistd::geteuid;
use serde_json::{Value, json};
use tempfile::{NamedTempFile, TempDir};

use crate::harness::{
    Network, Place, Process, Relay, Settings, Site, eventually, exchange, folder, left_out,
    pnet_nat, request,
};

/// A line of each thread's status in /proc, with the thread's name.
fn of_each_thread(process: &Process, line: &str) -> Vec<(String, String)> {
    let threads = fs::read_dir(format!("/proc/{}/task", process.id())).unwrap();
    let status =
        threads.map(|thread| fs::read_to_string(thread.unwrap().path().join("status")).unwrap());
    let field = |status: &str, name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(&format!("{name}:")));
        line.unwrap().trim().to_owned()
    };
    status.map(|status| (field(&status, "Name"), field(&status, line))).collect()
}

fn states(relay: &Relay) -> Value {
    let (status, body) = relay.get("/api/v1/status").unwrap();
    assert_eq!(status, 200);
    let status: Value = serde_json::from_str(&body).unwrap();
    let layers = status["sandbox"].as_array().unwrap().iter();
    layers
        .map(|layer| (layer["layer"].as_str().unwrap().to_owned(), layer["state"].clone()))
        .collect()
}

#[test]
fn every_thread_is_confined_and_every_exchange_works() {
    let site = Site::claim();
    let relay = site.relay(Settings { runtime: "workers = 2", ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);
    assert_eq!(relay.get("/api/v1/flows").unwrap().0, 200);

    let names: Vec<_> = of_each_thread(&relay.process, "Pid").into_iter().map(|t| t.0).collect();
    assert!(names.iter().filter(|name| name.starts_with("worker-")).count() == 2, "{names:?}");
    let others = names.iter().filter(|name| *name != "interfaces").count(); // for flows in the kernel
    assert_eq!(others, 5, "main thread, log, reloads and workers: {names:?}");
    let sets = ["CapInh", "CapPrm", "CapEff", "CapAmb"].into_iter();
    // Who is not root cannot shrink this one, and gains nothing by it.
    for set in sets.chain(geteuid().is_root().then_some("CapBnd")) {
        for (thread, left) in of_each_thread(&relay.process, set) {
            assert_eq!(left.trim_start_matches('0'), "", "{set} of {thread}");
        }
    }
    for (thread, set) in of_each_thread(&relay.process, "NoNewPrivs") {
        assert_eq!(set, "1", "{thread}");
    }
    for (thread, mode) in of_each_thread(&relay.process, "Seccomp") {
        assert_eq!(mode, "2", "{thread} has no filter");
    }

    let states = states(&relay);
    let line = relay.process.logged("confined").pop();
    for layer in ["memory", "no_new_privs", "capabilities", "seccomp"] {
        assert_eq!(states[layer], "on", "{states}");
    }
    if states["landlock"] == "on" {
        let line = line.expect("a line in the log");
        for (layer, state) in states.as_object().unwrap() {
            assert_eq!(&line[layer], state, "{line}");
        }
    } else {
        left_out("Landlock in the kernel");
        assert_eq!(relay.process.logged("confined in part").len(), 1);
    }
    let metrics = relay.metrics();
    for (layer, state) in states.as_object().unwrap() {
        let on = metrics.sum("pnet_nat_sandbox_layer", &[("layer", layer)]);
        assert_eq!(on == 1, state == "on", "{layer}");
    }
    assert!(metrics.sum("process_open_fds", &[]) > 5, "it can still count what is its own");
    assert!(metrics.sum("process_threads", &[]) >= 4);
    relay.finish();
}

/// Who does not look at the outcome of a call would not notice that the filter refuses it.
#[test]
fn a_relay_makes_no_call_that_is_refused() {
    if Command::new("strace").arg("--version").output().is_err() {
        return left_out("strace");
    }
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let place = |start_port| Place { start_port, ..network.place(r#"["198.51.100.1"]"#) };
        let [usual, other] =
            [20_000, 21_000].map(|at| place(at).configuration(&Settings::default()));
        let trace = NamedTempFile::new().unwrap();
        let relay = Relay::start_as(&usual, place(20_000).admin, |arguments| {
            let relay = pnet_nat(arguments);
            let mut command = Command::new("strace");
            // The relay is the child of this process, and strace watches it from beside.
            command.args(["--daemonize", "--follow-forks", "--failed-only", "--output"]);
            command.arg(trace.path()).arg(relay.get_program()).args(relay.get_args());
            command
        });
        let (client, node) = (network.client("198.51.100.7"), network.node(4));
        let stranger = network.client("198.51.100.8");
        let public = network.public("198.51.100.1", 4);
        for _ in 0..3 {
            exchange(&client, public, &node, 4);
        }
        stranger.send(public, b"no password");
        network.edge.ip("route add 203.0.113.1/32 dev eth1
             link set eth1 down
             link set eth1 up");
        relay.reload_to(&other);
        relay.reload_to(&usual);
        eventually("the way is found again", || {
            client.send(public, &request(4));
            node.receive_within(Duration::from_millis(300))
        });
        relay.at_rest();
        let ended = format!("{:<5} +++ exited with 0 +++", relay.process.id());
        relay.finish();
        let calls = eventually("strace has written all", || {
            fs::read_to_string(trace.path()).ok().filter(|calls| calls.contains(&ended))
        });
        let refused: Vec<_> = calls.lines().filter(|call| call.contains(" EPERM ")).collect();
        assert_eq!(refused, [""; 0]);
    });
}

/// The kernel writes a core of a relay that keeps its privileges, and none of one that does not.
#[test]
fn no_core_is_dumped() {
    let site = Site::claim();
    let dumps_core = |option: &[&str]| {
        let folder = folder(&site.configuration(&Settings::default()));
        let config = folder.path().join("pnet-nat.toml");
        let relay = pnet_nat(&[&["run", "--config", config.to_str().unwrap()], option].concat());
        let mut command = Command::new("sh");
        command.args(["-c", "ulimit -c unlimited && exec \"$0\" \"$@\""]);
        command.arg(relay.get_program()).args(relay.get_args()).current_dir(folder.path());
        let mut process = Process::start(command);
        eventually("it relays", || process.logged("relaying").pop());
        // Not SIGQUIT: what runs in the background of a shell ignores it.
        process.signal(Signal::SIGABRT);
        let status = process.status();
        assert_eq!(status.signal(), Some(Signal::SIGABRT as i32));
        status.core_dumped()
    };
    assert!(!dumps_core(&[]));
    if !dumps_core(&["--no-sandbox"]) {
        left_out("core dumps on this machine");
    }
}

#[test]
fn on_request_nothing_is_given_up() {
    let site = Site::claim();
    let folder = folder(&site.configuration(&Settings::default()));
    let config = folder.path().join("pnet-nat.toml");
    let command = pnet_nat(&["run", "--no-sandbox", "--config", config.to_str().unwrap()]);
    let process = Process::start(command);
    let line = eventually("it says so", || process.logged("not confined").pop());
    assert_eq!((&line["level"], &line["seccomp"]), (&json!("WARN"), &json!("off")));
    eventually("it relays", || process.logged("relaying").pop());
    for (thread, mode) in of_each_thread(&process, "Seccomp") {
        assert_eq!(mode, of_this_process("Seccomp"), "{thread}");
    }
    for (thread, left) in of_each_thread(&process, "CapEff") {
        assert_eq!(left, of_this_process("CapEff"), "{thread}");
    }
}

fn of_this_process(line: &str) -> String {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|found| found.strip_prefix(&format!("{line}:")));
    line.unwrap().trim().to_owned()
}

/// Root without its capabilities is told at the start what it would be told at a reload.
#[test]
fn a_password_of_somebody_elses_is_refused_from_the_start() {
    if !geteuid().is_root() {
        return left_out("root, to give a file away");
    }
    let site = Site::claim();
    let folder = folder(&site.configuration(&Settings::default()));
    let password = folder.path().join("secrets/section-1");
    chown(&password, Some(65534), Some(65534)).unwrap();
    let config = folder.path().join("pnet-nat.toml");
    let mut process = Process::start(pnet_nat(&["run", "--config", config.to_str().unwrap()]));
    assert_eq!(process.end(), Some(2));
    assert!(process.stderr().contains("who reads it, and let that user enter"));
}

/// A relay whose folders everybody can look into, and whose files are this user's.
fn owned(site: &Site, user: u32, runtime: &str) -> (TempDir, Process) {
    let settings = Settings { runtime, ..Settings::default() };
    let configuration = site.configuration(&settings);
    let start_port = format!("start_port = {}", site.start_port());
    let folder = folder(&configuration.replace(&start_port, "start_port = 600"));
    for path in ["", "secrets", "secrets/section-1"] {
        chown(folder.path().join(path), Some(user), Some(user)).unwrap();
    }
    for path in ["", "secrets"] {
        let everybody = fs::Permissions::from_mode(0o755);
        fs::set_permissions(folder.path().join(path), everybody).unwrap();
    }
    let config = folder.path().join("pnet-nat.toml");
    let process = Process::start(pnet_nat(&["run", "--config", config.to_str().unwrap()]));
    (folder, process)
}

/// Root starts it, and after that nobody in it is root: neither a thread, nor who reads a file.
#[test]
fn root_becomes_the_user_that_is_configured() {
    if !geteuid().is_root() {
        return left_out("root, to become somebody else");
    }
    let site = Site::claim();
    let (folder, mut process) = owned(&site, 65534, "user = 65534\nworkers = 2\ndrain = \"0s\"");
    eventually("it relays", || {
        assert!(!process.has_ended(), "{}", process.stderr());
        process.logged("relaying").pop()
    });
    for (line, expected) in [
        ("Uid", "65534\t65534\t65534\t65534"),
        ("Gid", "65534\t65534\t65534\t65534"),
        ("Groups", ""),
    ] {
        let threads = of_each_thread(&process, line);
        assert!(threads.len() >= 4, "{threads:?}");
        threads.iter().for_each(|(thread, ids)| assert_eq!(ids, expected, "{line} of {thread}"));
    }
    let own_memory = format!("/proc/{}/mem", process.id());
    assert_eq!(fs::metadata(own_memory).unwrap().uid(), 0, "the memory is not its user's");
    let line = process.logged("confined").pop();
    let line = line.or_else(|| process.logged("confined in part").pop()).unwrap();
    assert_eq!((&line["user"], &line["memory"]), (&json!(65534), &json!("on")), "{line}");
    assert!(!process.stderr().contains("runs as root"));
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, (site.public_address(), 604).into(), &node, 4);

    let reload = |expected: &str| {
        let before = process.logged(expected).len();
        process.signal(Signal::SIGHUP);
        eventually("it has reloaded", || process.logged(expected).into_iter().nth(before))
    };
    reload("reload");
    let password = folder.path().join("secrets/section-1");
    chown(&password, Some(0), Some(0)).unwrap();
    reload("reload failed");
    let fault = process.logged("configuration fault").pop().unwrap();
    assert!(fault["problem"].as_str().unwrap().contains("Permission denied"), "{fault}");
    chown(&password, Some(65534), Some(65534)).unwrap();
    let file = folder.path().join("pnet-nat.toml");
    let other = fs::read_to_string(&file).unwrap().replace("user = 65534", "user = 65533");
    fs::write(&file, other).unwrap();
    let line = reload("reload");
    assert!(line["not_in_force"].to_string().contains("[runtime] user"), "{line}");
    exchange(&client, (site.public_address(), 604).into(), &node, 4);
}

/// What the user cannot read is told before anything is started, even what root could.
#[test]
fn a_user_that_cannot_be_or_cannot_read_is_refused_at_the_start() {
    if !geteuid().is_root() {
        return left_out("root, to become somebody else");
    }
    let site = Site::claim();
    for (user, why) in [
        ("65534", "who reads it, and let that user enter"),
        ("\"nobody-of-this-name\"", "useradd"),
        ("\"root\"", "root is what is to be given up"),
    ] {
        let (_folder, mut process) = owned(&site, 0, &format!("user = {user}"));
        assert_eq!(process.end(), Some(2));
        assert!(process.stderr().contains(why), "{user}: {}", process.stderr());
    }
}

/// In a folder right below the root folder, the relay reads its own files and no other, not even one
/// that takes the place of its own.
#[test]
fn a_folder_like_etc_is_not_opened_as_a_whole() {
    let Ok(folder) = tempfile::tempdir_in("/") else {
        return left_out("root, for a folder right below the root folder");
    };
    let site = Site::claim();
    let configuration = site.configuration(&Settings::default());
    let usual = crate::harness::folder(&configuration);
    let (file, secrets) = (folder.path().join("pnet-nat.toml"), folder.path().join("secrets"));
    fs::write(&file, &configuration).unwrap();
    fs::create_dir(&secrets).unwrap();
    for name in ["section-1", "press"] {
        fs::copy(usual.path().join("secrets").join(name), secrets.join(name)).unwrap();
    }
    fs::copy(secrets.join("press"), folder.path().join("elsewhere")).unwrap();
    let process = Process::start(pnet_nat(&["run", "--config", file.to_str().unwrap()]));
    eventually("it relays", || process.logged("relaying").pop());
    if process.logged("confined").is_empty() {
        return left_out("Landlock in the kernel");
    }
    let told = "when one of these is replaced, restart; in a folder of its own, a reload would do";
    assert_eq!(process.logged(told).len(), 1);
    let reload = |expected: &str| {
        let before = process.logged(expected).len();
        process.signal(Signal::SIGHUP);
        eventually("it has reloaded", || process.logged(expected).into_iter().nth(before));
    };

    fs::write(&file, configuration.replace("secrets/section-1", "secrets/press")).unwrap();
    reload("reload");
    fs::write(&file, configuration.replace("secrets/section-1", "elsewhere")).unwrap();
    reload("reload failed");
    let fault = process.logged("configuration fault").pop().unwrap();
    assert!(fault["problem"].as_str().unwrap().contains("the relay's confinement"), "{fault}");

    let replaced = folder.path().join("new");
    fs::write(&replaced, &configuration).unwrap();
    fs::rename(&replaced, &file).unwrap();
    reload("reload failed");
    let fault = process.logged("configuration fault").pop().unwrap();
    assert_eq!(fault["file"], json!(file), "{fault}");
}

/// Ports below 1024 take the one capability that is kept until the sockets are bound.
#[test]
fn low_ports_are_bound_before_the_capability_goes() {
    if !geteuid().is_root() {
        return left_out("root, for ports below 1024");
    }
    let site = Site::claim();
    let configuration = site.configuration(&Settings::default());
    let start_port = format!("start_port = {}", site.start_port());
    let low = configuration.replace(&start_port, "start_port = 600");
    assert_ne!(low, configuration);
    let relay = Relay::start(&low, site.admin(), None);
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, (site.public_address(), 604).into(), &node, 4);
    relay.finish();
}

/// As a service manager or a container starts it: a user of its own, no capability. That this is who it
/// is to become is no hindrance; it cannot become anybody else.
#[test]
fn a_user_without_any_privilege_is_confined_as_well() {
    if !geteuid().is_root() || Command::new("setpriv").arg("--version").output().is_err() {
        return left_out("root and setpriv, to become somebody else");
    }
    let site = Site::claim();
    let settings = Settings { runtime: "user = 65534", ..Settings::default() };
    let configuration = site.configuration(&settings);
    let folder = folder(&configuration);
    let own = |path: &std::path::Path| {
        chown(path, Some(65534), Some(65534)).unwrap();
    };
    for path in ["", "pnet-nat.toml", "secrets", "secrets/section-1"] {
        own(&folder.path().join(path));
    }
    // Whoever it is can run the copy, and not the original.
    let program = folder.path().join("pnet-nat");
    fs::copy(env!("CARGO_BIN_EXE_pnet-nat"), &program).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    let start = || {
        let mut command = Command::new("setpriv");
        command.args(["--reuid=65534", "--regid=65534", "--clear-groups"]).arg(&program);
        command.args(["run", "--config"]).arg(folder.path().join("pnet-nat.toml"));
        Process::start(command)
    };
    let process = start();
    let own_memory = format!("/proc/{}/mem", process.id());
    let line = eventually("it is confined", || {
        process.logged("confined").pop().or_else(|| process.logged("confined in part").pop())
    });
    eventually("it relays", || process.logged("relaying").pop());
    assert_eq!(line["user"], 65534);
    assert_eq!(fs::metadata(own_memory).unwrap().uid(), 0, "the memory is not its user's");
    for layer in ["memory", "no_new_privs", "capabilities", "seccomp"] {
        assert_eq!(line[layer], "on", "{line}");
    }
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);

    let other = configuration.replace("user = 65534", "user = 65533");
    fs::write(folder.path().join("pnet-nat.toml"), other).unwrap();
    let mut refused = start();
    assert_eq!(refused.end(), Some(2));
    let why = refused.logged("failed").pop().unwrap();
    assert!(why["error"].as_str().unwrap().contains("only root becomes \"65533\""), "{why}");
}
