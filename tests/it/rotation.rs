//! A new password while clients ask: the steps of docs/operations.md are typed as they are written there, and
//! no request is lost.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use crate::harness::{
    FIGURE_10, Over, Peer, Process, Relay, Settings, Site, datagram, eventually, left_out, pnet_nat,
};

const OPERATIONS: &str = include_str!("../../docs/operations.md");

/// The blocks of "Change a password", in their order, without the indentation of the list.
fn blocks() -> Vec<String> {
    let (_, section) = OPERATIONS.split_once("\n## Change a password\n").unwrap();
    let (section, _) = section.split_once("\n## ").unwrap();
    let blocks = section.split("```").skip(1).step_by(2);
    let text = |block: &str| {
        let lines = block.lines().skip(1);
        lines.map(|line| line.strip_prefix("   ").unwrap_or(line).to_owned() + "\n").collect()
    };
    blocks.map(text).collect()
}

/// A shell on the router: the relay's folder stands for /etc/pnet-nat, and `systemctl reload` does what the unit
/// says.
struct Router<'a> {
    relay: &'a Relay,
    site: &'a Site,
}

impl Router<'_> {
    fn folder(&self) -> &str {
        self.relay.folder.path().to_str().unwrap()
    }

    fn types(&self, block: &str) -> String {
        let commands = block
            .replace("/etc/pnet-nat", self.folder())
            .replace("127.0.0.1:9378", &self.site.admin().to_string());
        let unit = format!(
            "set -eu\nsystemctl() {{ [ \"$*\" = 'reload pnet-nat' ]; pnet-nat reload --pid {} --config {}/pnet-nat.toml; }}\n",
            self.relay.process.id(),
            self.folder()
        );
        let program = Path::new(env!("CARGO_BIN_EXE_pnet-nat")).parent().unwrap();
        let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
        let mut shell = Command::new("sh");
        let config = format!("{}/pnet-nat.toml", self.folder());
        shell.args(["-c", &(unit + &commands)]).env("PATH", path).env("PNET_NAT_CONFIG", config);
        let mut shell = Process::start(shell);
        assert_eq!(shell.end(), Some(0), "{block}\n{}{}", shell.stdout(), shell.stderr());
        shell.stdout()
    }

    fn password(&self, name: &str) -> [u8; 8] {
        fs::read(format!("{}/secrets/{name}", self.folder())).unwrap().try_into().unwrap()
    }

    fn edits(&self, edit: impl FnOnce(String) -> String) {
        let path = format!("{}/pnet-nat.toml", self.folder());
        fs::write(&path, edit(fs::read_to_string(&path).unwrap())).unwrap();
    }
}

/// A client that asks the nodes in turn, with the password that it has been given.
struct Client {
    socket: Peer,
    password: Mutex<[u8; 8]>,
    answers: AtomicU64,
    lost: AtomicU64,
}

impl Client {
    fn ask(&self, site: &Site, node: u8, patience: Duration) -> bool {
        let password = *self.password.lock().unwrap();
        let mut route = FIGURE_10;
        route[1] = node;
        self.socket.send(site.public(node), &datagram(&route, &[], &password));
        let answer = self.socket.receive_within(patience);
        if let Some((answer, from)) = &answer {
            assert_eq!(*from, site.public(node), "who answers");
            assert!(answer.ends_with(&password), "the client's own password comes back");
        }
        answer.is_some()
    }

    fn poll(&self, site: &Site, over: &AtomicBool) {
        for node in (1..=4).cycle().take_while(|_| !over.load(Relaxed)) {
            // Late on a busy machine is not lost.
            let counter = if self.ask(site, node, Duration::from_secs(10)) {
                &self.answers
            } else {
                &self.lost
            };
            counter.fetch_add(1, Relaxed);
        }
    }
}

fn rotate(device_file: &str) {
    if Command::new("curl").arg("--version").output().is_err() {
        return left_out("curl");
    }
    let steps = blocks();
    let [make, block, reload, watch, withdraw] = &steps[..] else {
        panic!("other steps: {steps:?}")
    };
    let site = Site::claim();
    let old_block = format!(
        "[[udp_range_net.password]]\nname = \"service\"\nfile = \"secrets/section-1\"\n{device_file}"
    );
    let relay = site.relay(Settings {
        passwords: &old_block,
        runtime: "workers = 2",
        ..Settings::default()
    });
    let router = Router { relay: &relay, site: &site };

    router.types(make);
    let (old, new) = (router.password("section-1"), router.password("section-1-new"));
    // Without a device_file, the devices get the new password now, beside the old one.
    let names: &[&str] = match device_file {
        "" => &["section-1", "section-1-new"],
        _ => &["section-1-device"],
    };
    let files: Vec<_> =
        names.iter().map(|name| format!("{}/secrets/{name}", router.folder())).collect();
    let listen = format!("{}-4", site.address(1));
    let arguments = ["node", "--listen", &listen, "--password-file", &files.join(",")];
    let nodes = Process::start(pnet_nat(&arguments));
    eventually("the nodes are there", || (nodes.stdout().lines().count() == 4).then_some(()));

    let client = || Client {
        socket: site.client(),
        password: Mutex::new(old),
        answers: AtomicU64::new(0),
        lost: AtomicU64::new(0),
    };
    let clients: Vec<_> = (0..4).map(|_| client()).collect();
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        clients.iter().for_each(|client| drop(scope.spawn(|| client.poll(&site, &over))));
        let over = Over(&over);
        let all_ask = || {
            for client in &clients {
                let before = client.answers.load(Relaxed);
                eventually("it goes on", || {
                    (client.answers.load(Relaxed) > before + 8).then_some(())
                });
            }
        };
        all_ask();
        let block = if device_file.is_empty() {
            block.clone()
        } else {
            block.replace("#device_file", "device_file")
        };
        router.edits(|text| text + &block);
        router.types(reload);
        for client in &clients {
            all_ask();
            *client.password.lock().unwrap() = new;
        }
        all_ask();
        let watched = router.types(watch);
        let of_clients = watched.lines().filter(|line| line.contains("service-new")).count();
        assert_eq!(of_clients, clients.len() + 1, "and the sum of the password: {watched}");
        let is_used = |metrics: &crate::harness::Metrics| {
            metrics.sum("pnet_nat_accepted_requests_total", &[("credential", "service")])
        };
        let before = is_used(&relay.metrics());
        all_ask();
        assert_eq!(is_used(&relay.metrics()), before, "nobody uses the old one any more");
        router.edits(|text| text.replace(&old_block, ""));
        router.types(withdraw);
        all_ask();
        drop(over);
    });
    for client in &clients {
        assert_eq!(client.lost.load(Relaxed), 0, "of {} requests", client.answers.load(Relaxed));
    }
    relay.expect_drops(&[]);
    let late = client();
    assert!(!late.ask(&site, 1, Duration::from_millis(300)), "the old password opens nothing");
    relay.expect_drops(&[("request", "password_wrong", 1)]);
    drop(nodes);
    relay.finish();
}

#[test]
fn a_password_changes_without_a_lost_request_where_devices_have_their_own() {
    rotate("device_file = \"secrets/section-1-device\"\n");
}

#[test]
fn a_password_changes_without_a_lost_request_where_it_goes_through_to_the_devices() {
    rotate("");
}
