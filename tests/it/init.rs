//! From nothing to a request that is answered through the relay, as a newcomer types it: `pnet-nat init`, and
//! what it prints.

use std::fs;
use std::net::{TcpListener, UdpSocket};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::Command;

use nix::sys::signal::Signal;

use crate::harness::{Network, Process, Terminal, eventually, pnet_nat};

/// A shell in this folder that finds the program by its name.
fn shell(folder: &Path, line: &str) -> Command {
    let program = Path::new(env!("CARGO_BIN_EXE_pnet-nat")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let mut command = Command::new("sh");
    command.args(["-c", line]).current_dir(folder).env("PATH", path);
    // Nothing of the environment decides.
    for (name, _) in pnet_nat(&[]).get_envs() {
        command.env_remove(name);
    }
    command
}

/// What is typed to the end.
fn typed(folder: &Path, line: &str) -> Process {
    let mut process = Process::start(shell(folder, line));
    assert_eq!(process.end(), Some(0), "{line}: {}{}", process.stdout(), process.stderr());
    process
}

/// The command that a text has on a line of its own.
fn command(text: &str, beginning: &str) -> String {
    let commands = text.lines().filter_map(|line| line.strip_prefix("  "));
    let mut found = commands.filter(|line| line.starts_with(beginning));
    found.next().unwrap_or_else(|| panic!("no {beginning:?} in: {text}")).trim_end().to_owned()
}

/// Starts `pnet-nat run` as it was printed.
fn run(folder: &Path, line: &str) -> Process {
    let relay = Process::start(shell(folder, &format!("exec {line}")));
    eventually("the relay is ready", || relay.logged("relaying").pop());
    relay
}

fn stop(mut relay: Process) {
    relay.signal(Signal::SIGTERM);
    assert_eq!(relay.end(), Some(0), "{}", relay.stderr());
}

#[test]
fn three_commands_lead_from_nothing_to_an_answer() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let folder = tempfile::tempdir().unwrap();
        let said = typed(folder.path(), "pnet-nat init --try").stdout();
        let relay = run(folder.path(), &command(&said, "pnet-nat run "));
        let tested = typed(folder.path(), &command(&said, "(pnet-nat node ")).stdout();
        for node in 1..=4 {
            assert!(tested.contains(&format!("node {node} (127.0.0.1:2000{node}): ")), "{tested}");
        }
        stop(relay);
        // The command's exit code is the client's, and its nodes end with it.
        let test = command(&said, "(pnet-nat node ").replace(" --retries 5", "");
        let mut alone = Process::start(shell(folder.path(), &test));
        assert_eq!(alone.end(), Some(1), "{}", alone.stdout());
        eventually("the nodes have ended", || UdpSocket::bind("127.17.17.1:34379").ok());
    });
}

/// What others have is passed over: ports, the admin server's port, nodes.
#[test]
fn three_commands_work_beside_another_relay_too() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let _taken =
            ["127.0.0.1:20003", "127.17.17.1:34379"].map(|it| UdpSocket::bind(it).unwrap());
        let _admin = TcpListener::bind("127.0.0.1:9378").unwrap();
        let folder = tempfile::tempdir().unwrap();
        let said = typed(folder.path(), "pnet-nat init --try \"it's plant\"").stdout();
        let relay = run(folder.path(), &command(&said, "pnet-nat run "));
        let tested = typed(folder.path(), &command(&said, "(pnet-nat node ")).stdout();
        assert!(tested.contains("node 4 (127.0.0.1:20204): "), "{tested}");
        let status = typed(folder.path(), &command(&said.replace('`', "\n  "), "pnet-nat status"));
        assert!(status.stdout().contains("section-1"), "{}", status.stdout());
        stop(relay);
    });
}

/// Offers that fit the host, a relay between two networks, and a client on the Internet.
#[test]
fn a_plant_is_set_up_at_a_terminal() {
    let Some(network) = Network::build() else { return };
    network.edge.ip("route add default via 198.51.100.7");
    let folder = tempfile::tempdir().unwrap();
    let (said, relay) = network.edge.enter(|| {
        let mut init = Terminal::start(&mut shell(folder.path(), "exec pnet-nat init plant"));
        for (question, answer) in [
            ("clients send to [198.51.100.1]: ", ""),
            ("Subnet of the nodes [172.17.17.0]: ", ""),
            ("like 1-4, 33: ", "1-4 33"),
            ("like 198.51.100.0/24: ", "198.51.100.300"),
            ("like 198.51.100.0/24: ", "198.51.100.0/24"),
            ("at this port + 3 [20000]: ", ""),
            ("Name of the section [section-1]: ", "line-a"),
        ] {
            init.answer(question, answer);
        }
        assert_eq!(init.end(), Some(0), "{}", init.text());
        let said = init.text();
        assert!(said.contains("198.51.100.1 (eth0), ") && said.contains("172.17.17.254 (eth1)"));
        (said.clone(), run(folder.path(), &command(&said, "pnet-nat run ")))
    });
    let secret = folder.path().join("plant/secrets/line-a");
    let nodes = network.plant.enter(|| {
        let listen = ["--listen", "172.17.17.1-4,172.17.17.33", "--password-file"];
        let arguments = [&["node"][..], &listen, &[secret.to_str().unwrap()]].concat();
        Process::start(pnet_nat(&arguments))
    });
    eventually("the nodes are there", || (nodes.stdout().lines().count() == 5).then_some(()));
    // On 80 columns nothing breaks a command: it is one line.
    let test = command(&said, "pnet-nat request ");
    let tested = network.internet.enter(|| typed(folder.path(), &test));
    assert!(tested.stdout().contains("node 33 (198.51.100.1:20033): "), "{}", tested.stdout());
    stop(relay);

    let password = fs::read(&secret).unwrap();
    let sheet = fs::read_to_string(folder.path().join("plant/client-sheet.html")).unwrap();
    assert!(sheet.contains("198.51.100.1") && sheet.contains("line-a-service"), "{sheet}");
    let config = fs::read_to_string(folder.path().join("plant/pnet-nat.toml")).unwrap();
    for text in [said, sheet, config] {
        assert!(!text.contains(str::from_utf8(&password).unwrap()), "{text}");
    }
}

const PLANT: &str = "pnet-nat init --listen 192.0.2.1 --subnet 127.17.17.0 --nodes 1-4,33 --allow 198.51.100.0/24 plant";

#[test]
fn options_are_enough_for_a_script_and_secrets_are_the_owners_alone() {
    let folder = tempfile::tempdir().unwrap();
    let made = typed(folder.path(), PLANT);
    assert_eq!(made.stderr(), "");
    let at = |path: &str| folder.path().join("plant").join(path);
    let mode = |path: &str| fs::metadata(at(path)).unwrap().mode() & 0o777;
    assert_eq!((mode("secrets"), mode("secrets/section-1")), (0o700, 0o600));
    assert_eq!(fs::read(at("secrets/section-1")).unwrap().len(), 8);
    let config = fs::read_to_string(at("pnet-nat.toml")).unwrap();
    assert!(config.lines().count() < 35, "it is short: {config}");
    assert!(config.contains("nodes = [\"1-4\", \"33\"]"), "{config}");
    let mut checked =
        Process::start(pnet_nat(&["check", "--config", at("pnet-nat.toml").to_str().unwrap()]));
    assert_eq!((checked.end(), checked.stderr().as_str()), (Some(0), ""));
}

#[test]
fn nothing_that_is_there_is_changed() {
    for there in ["pnet-nat.toml", "secrets/section-1", "client-sheet.html"] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plant").join(there);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, "mine").unwrap();
        let mut refused = Process::start(shell(folder.path(), PLANT));
        assert_eq!(refused.end(), Some(2));
        assert!(
            refused.stderr().contains(&format!("plant/{there} is there already")),
            "{}",
            refused.stderr()
        );
        assert_eq!(fs::read_to_string(&path).unwrap(), "mine");
        let files = fs::read_dir(folder.path().join("plant")).unwrap().count();
        assert_eq!(files, 1, "nothing was written");
    }
}

#[test]
fn what_a_script_forgets_is_named_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut refused =
        Process::start(shell(folder.path(), "pnet-nat init --subnet 172.17.17.0 plant"));
    assert_eq!(refused.end(), Some(2));
    assert!(refused.stderr().contains("--listen, --nodes, --allow."), "{}", refused.stderr());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// As for a script at a terminal: what a person would be offered is taken, and nothing is asked.
#[test]
fn yes_takes_what_would_be_offered() {
    let Some(network) = Network::build() else { return };
    network.edge.ip("route add default via 198.51.100.7");
    network.at_the_edge(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut refused = Terminal::start(&mut shell(
            folder.path(),
            "exec pnet-nat init --yes --nodes 1-4 plant",
        ));
        assert_eq!(refused.end(), Some(2));
        assert!(refused.text().contains("--allow."), "{}", refused.text());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        let line = "exec pnet-nat init --yes --nodes 1-4 --allow 198.51.100.0/24 plant";
        let mut init = Terminal::start(&mut shell(folder.path(), line));
        assert_eq!(init.end(), Some(0), "{}", init.text());
        assert!(!init.text().contains("Enter takes"), "{}", init.text());
        let config = fs::read_to_string(folder.path().join("plant/pnet-nat.toml")).unwrap();
        for key in ["listen = [\"198.51.100.1\"]", "subnet = \"172.17.17.0\"", "start_port = 20000"]
        {
            assert!(config.contains(key), "{config}");
        }
    });
}

/// The host decides whether it can be: here the plant's interface is missing.
#[test]
fn what_check_finds_is_told_with_the_way_on() {
    let Some(network) = Network::build() else { return };
    network.edge.ip("route add default via 198.51.100.7");
    network.at_the_edge(|| {
        let folder = tempfile::tempdir().unwrap();
        let line = PLANT.replace("192.0.2.1", "198.51.100.1").replace("127.17.17.0", "172.71.17.0");
        let mut init = Process::start(shell(folder.path(), &line));
        assert_eq!(init.end(), Some(75), "{}", init.stderr());
        let said = init.stderr();
        assert!(said.contains("leaves by the Internet side"), "{said}");
        assert!(said.contains("then run: pnet-nat check --config "), "{said}");
        assert!(!init.stdout().contains("pnet-nat run"), "{}", init.stdout());
    });
}
