//! The control socket, and how the commands find a relay: over it, or where the configuration says.

use std::fs;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::path::Path;

use nix::sys::signal::Signal;
use nix::unistd::geteuid;
use serde_json::{Value, json};

use crate::harness::{
    Process, Relay, Settings, Site, Somebody, eventually, exchange, folder, pnet_nat,
};

/// Commands that ask a relay.
const ASKING: [&str; 4] = ["status", "flows", "healthcheck", "reload"];

/// A configuration whose `[admin]` has these keys too.
fn with_admin(site: &Site, keys: &str) -> String {
    site.configuration(&Settings::default()).replace("[admin]", &format!("[admin]\n{keys}"))
}

/// Exit code, stdout and stderr.
fn ask(arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut command = Process::start(pnet_nat(arguments));
    (command.end(), command.stdout(), command.stderr())
}

fn is_socket(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|file| file.file_type().is_socket())
}

/// Over the socket nobody needs the token, and a reload is always allowed: the mode says who may connect.
#[test]
fn the_socket_answers_its_user_and_group_without_a_token() {
    let site = Site::claim();
    let keys =
        "control = \"control.sock\"\ntoken_file = \"secrets/admin\"\nmetrics_without_token = true";
    let configuration = with_admin(&site, keys);
    let relay = Relay::start(&configuration, site.admin(), None);
    let socket = relay.folder.path().join("control.sock");
    let metadata = fs::metadata(&socket).unwrap();
    assert_eq!((metadata.mode() & 0o7777, metadata.uid()), (0o660, geteuid().as_raw()));
    let announced = relay.process.logged("relaying").pop().unwrap();
    assert_eq!(announced["control"], json!(socket));

    assert_eq!(relay.get("/api/v1/nets").unwrap().0, 401, "who comes by TCP needs the token");
    assert_eq!(relay.post_reload().0, 401);
    let file = relay.folder.path().join("pnet-nat.toml");
    let by_file = ["-c", file.to_str().unwrap()];
    let url = format!("unix:{}", socket.display());
    for command in ASKING {
        for place in [by_file, ["--url", &url]] {
            let (code, stdout, stderr) = ask(&[&[command][..], &place].concat());
            assert_eq!(code, Some(0), "{command} {place:?}: {stdout}{stderr}");
        }
    }
    let (_, status, _) = ask(&["status", by_file[0], by_file[1]]);
    assert!(status.contains(&format!(" at {url}, up for ")), "{status}");

    relay.configure(&configuration.replace("\"1-4\", 33", "\"1-4\", \"33-35\""));
    let (code, stdout, stderr) = ask(&["reload", by_file[0], by_file[1]]);
    assert_eq!(code, Some(0), "{stderr}");
    assert_eq!(stdout, "nodes added: section-1: 34-35\nall of the configuration is in force\n");

    if let Some(somebody) = Somebody::new() {
        fs::set_permissions(relay.folder.path(), fs::Permissions::from_mode(0o755)).unwrap();
        let mut command = Process::start(somebody.pnet_nat(None, &["status", "--url", &url]));
        assert_eq!(command.end(), Some(1));
        let stderr = command.stderr();
        assert!(stderr.contains("Permission denied") && stderr.contains("its group"), "{stderr}");
    }
    relay.finish();
}

#[test]
fn a_second_relay_is_refused_and_a_dead_ones_socket_is_replaced() {
    let place = tempfile::tempdir().unwrap();
    let socket = place.path().join("control.sock");
    let keys = format!("control = {socket:?}");
    let sites = [Site::claim(), Site::claim()];
    let mut first = Relay::start(&with_admin(&sites[0], &keys), sites[0].admin(), None);
    let other = folder(&with_admin(&sites[1], &keys));
    let other = other.path().join("pnet-nat.toml");
    let (code, _, stderr) = ask(&["run", "--config", other.to_str().unwrap()]);
    assert_eq!(code, Some(75), "{stderr}");
    assert!(stderr.contains("another relay listens on the control socket"), "{stderr}");
    assert_eq!(ask(&["healthcheck", "--url", &format!("unix:{}", socket.display())]).0, Some(0));

    first.process.signal(Signal::SIGKILL);
    first.process.status();
    assert!(is_socket(&socket));
    let (code, why, _) = ask(&["healthcheck", "--url", &format!("unix:{}", socket.display())]);
    assert!(code == Some(1) && why.contains("Connection refused"), "{why}");
    Relay::start(&with_admin(&sites[1], &keys), sites[1].admin(), None).finish();

    // Without confinement it takes the socket away itself.
    let command = pnet_nat(&["run", "--no-sandbox", "--config", other.to_str().unwrap()]);
    let mut process = Process::start(command);
    eventually("it relays", || process.logged("relaying").pop());
    assert!(is_socket(&socket));
    process.signal(Signal::SIGTERM);
    assert_eq!(process.end(), Some(0));
    assert!(!socket.exists());

    fs::write(&socket, "of the user").unwrap();
    let (code, _, stderr) = ask(&["run", "--config", other.to_str().unwrap()]);
    assert!(code == Some(2) && stderr.contains("is no socket"), "{stderr}");
}

/// As under systemd, and with the admin server switched off.
#[test]
fn the_folder_of_the_service_has_the_socket_by_default() {
    let site = Site::claim();
    let run = tempfile::tempdir().unwrap();
    let folder = folder(&with_admin(&site, "enabled = false"));
    let file = folder.path().join("pnet-nat.toml");
    let file = file.to_str().unwrap();
    let in_service = |arguments: &[&str]| {
        let mut command = pnet_nat(arguments);
        command.env("RUNTIME_DIRECTORY", run.path());
        Process::start(command)
    };
    let mut process = in_service(&["run", "-c", file]);
    eventually("it is ready", || {
        assert!(!process.has_ended(), "{}", process.stderr());
        (in_service(&["healthcheck", "-c", file]).end() == Some(0)).then_some(())
    });
    assert!(is_socket(&run.path().join("control.sock")));
    assert!(site.admin().port() != 0 && std::net::TcpStream::connect(site.admin()).is_err());
    let (code, _, stderr) = ask(&["status", "-c", file]);
    assert!(code == Some(1) && stderr.contains("cannot be asked"), "{stderr}");

    // Its path needs a restart, like all of [admin] that is bound at the start.
    let moved = with_admin(&site, "enabled = false\ncontrol = \"elsewhere.sock\"");
    fs::write(file, moved).unwrap();
    let url = format!("unix:{}", run.path().join("control.sock").display());
    let mut reload = in_service(&["reload", "--url", &url]);
    assert_eq!(reload.end(), Some(1));
    let told = reload.stdout();
    assert!(told.contains("not in force: [admin] control: "), "{told}");
    process.signal(Signal::SIGTERM);
    assert_eq!(process.end(), Some(0));
}

/// A changed `[admin] listen` is found, with the token that it needs.
#[test]
fn the_configuration_says_where_the_admin_server_is() {
    let site = Site::claim();
    let keys = "reload = true\ntoken_file = \"secrets/admin\"\nmetrics_without_token = true";
    let relay = Relay::start(&with_admin(&site, keys), site.admin(), None);
    let file = relay.folder.path().join("pnet-nat.toml");
    for command in ASKING {
        let (code, stdout, stderr) = ask(&[command, "--config", file.to_str().unwrap()]);
        assert_eq!(code, Some(0), "{command}: {stdout}{stderr}");
    }
    relay.finish();
}

#[test]
fn a_file_with_faults_is_not_given_to_the_relay() {
    let site = Site::claim();
    let sound = with_admin(&site, "control = \"control.sock\"");
    let relay = Relay::start(&sound, site.admin(), None);
    let file = relay.folder.path().join("pnet-nat.toml");
    let reload = || ask(&["reload", "-c", file.to_str().unwrap()]);
    let wrong = sound.replace("allow =", "alow =").replace("\"1-4\", 33", "\"1-500\"");
    relay.configure(&wrong);
    let (code, stdout, stderr) = reload();
    assert_eq!((code, stdout.as_str()), (Some(2), ""));
    for part in ["alow", "did you mean", "1-500", "the relay was not asked"] {
        assert!(stderr.contains(part), "{stderr}");
    }
    assert_eq!(relay.process.logged("reload failed").len(), 0);

    // What is wrong with a password file is the relay's to say, since it may be the only one to read it.
    relay.configure(&sound.replace("secrets/section-1", "secrets/absent"));
    let (code, stdout, _) = reload();
    assert!(code == Some(1) && stdout.contains("secrets/absent"), "{stdout}");

    relay.configure(&sound);
    let (code, stdout, _) = reload();
    assert_eq!(code, Some(0), "{stdout}");
    assert_eq!(stdout, "nothing changed\nall of the configuration is in force\n");
    let log = relay.finish();
    assert_eq!(log.logged("reload failed").len(), 1, "the relay was asked to read one of the two");
}

#[test]
fn a_reload_tells_which_flows_it_closed() {
    let site = Site::claim();
    let sound = with_admin(&site, "control = \"control.sock\"");
    let relay = Relay::start(&sound, site.admin(), None);
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);
    relay.configure(&sound.replace("\"1-4\", 33", "\"1-3\""));
    let file = relay.folder.path().join("pnet-nat.toml");
    let (code, stdout, stderr) = ask(&["reload", "-c", file.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{stderr}");
    let expected = "nodes removed: section-1: 4, 33\n1 flow closed\n\
                    all of the configuration is in force\n";
    assert_eq!(stdout, expected);
    relay.finish();
}

/// Who is connected, as the engineer asks: a client with its nodes, what passes, and which password is used.
#[test]
fn flows_are_shown_with_their_traffic_and_the_use_of_passwords() {
    let site = Site::claim();
    let second = "[[udp_range_net.password]]\nname = \"old\"\nfile = \"secrets/press\"";
    let passwords = [Settings::default().passwords, second].join("\n");
    let configuration =
        site.configuration(&Settings { passwords: &passwords, ..Settings::default() });
    let configuration = configuration.replace("[admin]", "[admin]\ncontrol = \"control.sock\"");
    let relay = Relay::start(&configuration, site.admin(), None);
    let file = relay.folder.path().join("pnet-nat.toml");
    let file = file.to_str().unwrap();
    let (code, none, _) = ask(&["flows", "-c", file]);
    assert!(code == Some(0) && none.starts_with("No client is connected.\n"), "{none}");

    let client = site.client();
    for node in [3, 4] {
        let server = site.node(node);
        for _ in 0..node {
            exchange(&client, site.public(node), &server, node);
        }
    }
    let (_, table, _) = ask(&["flows", "-c", file]);
    let row = |begin: &str| -> Vec<String> {
        let line = table.lines().find(|line| line.starts_with(begin)).expect(&table);
        line.split('|').map(|cell| cell.trim().to_owned()).collect()
    };
    let client_row = row(&format!("| section-1 | {}", client.address().ip()));
    assert_eq!(client_row[3..6], ["3-4", "service", "2"], "{table}");
    assert_eq!(client_row[8..10], ["7", "7"], "requests and answers: {table}");
    assert_eq!(row("| section-1 | service ")[3..5], ["7", "2"], "{table}");
    assert_eq!(row("| section-1 | old ")[3..5], ["0", "0"], "{table}");

    let (_, full, _) = ask(&["flows", "-c", file, "--full"]);
    assert!(full.contains(&format!("| {} | ", client.address())), "{full}");
    let (_, line, _) = ask(&["flows", "-c", file, "--format", "json", "--net", "section-1"]);
    let flows: Value = serde_json::from_str(&line).unwrap();
    let of_3 = flows["flows"].as_array().unwrap().iter().find(|flow| flow["node"] == 3).unwrap();
    assert_eq!((&of_3["requests"], &of_3["responses"]), (&json!(3), &json!(3)));
    assert_eq!(flows["complete"], true);
    let (_, cut, _) = ask(&["flows", "-c", file, "--limit", "1"]);
    assert!(cut.contains("More flows are open than these 1"), "{cut}");
    let (code, _, stderr) = ask(&["flows", "-c", file, "--net", "absent"]);
    assert!(code == Some(1) && stderr.contains("no net has this name"), "{stderr}");

    let mut watch = Process::start(pnet_nat(&["flows", "-c", file, "--watch", "50ms"]));
    eventually("it is shown again", || {
        (watch.stdout().matches("| section-1 | service ").count() > 1).then_some(())
    });
    watch.signal(Signal::SIGINT);
    assert_eq!(watch.end(), Some(0));
    relay.finish();
}

/// The file of the package is the default of all commands; where it is absent, they say so.
#[test]
fn without_a_configuration_the_default_is_named() {
    const DEFAULT: &str = "/etc/pnet-nat/pnet-nat.toml";
    if Path::new(DEFAULT).exists() {
        return; // a relay is installed here
    }
    for command in ["run", "check"] {
        let (code, _, stderr) = ask(&[command]);
        assert_eq!(code, Some(2), "{command}: {stderr}");
        assert!(stderr.contains(DEFAULT) && stderr.contains("--config"), "{stderr}");
    }
}
