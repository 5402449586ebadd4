//! A running relay: its configuration, and how it looks from outside.

use std::collections::BTreeMap;
use std::env;
use std::fs::{self, Permissions};
use std::net::{Ipv4Addr, SocketAddr};
use std::os::unix::fs::PermissionsExt;
use std::process::Command;

use nix::sys::signal::Signal;
use serde_json::Value;
use tempfile::TempDir;

use super::{
    DEVICE, Metrics, PASSWORD, PASSWORDS, Process, SECOND, Site, eventually, pnet_nat,
    pnet_nat_within,
};

/// The configuration from which users start.
pub const ANNOTATED: &str = include_str!("../../../../config/pnet-nat.toml");

const ADMIN_PORT: u16 = 9378;

/// What a scenario adds to the usual configuration, in TOML.
#[derive(Clone, Debug)]
pub struct Settings<'a> {
    /// Further keys of the net.
    pub net: &'a str,
    /// The net's passwords.
    pub passwords: &'a str,
    /// The keys of `[runtime]`.
    pub runtime: &'a str,
    /// Further sections.
    pub sections: &'a str,
    /// The hard limit of file descriptors.
    pub descriptors: Option<u64>,
}

impl Default for Settings<'_> {
    /// One password and one worker, so that datagrams of two clients are handled in the order in
    /// which they were sent. When the relay stops, it waits only briefly for answers that a
    /// scenario held back.
    fn default() -> Self {
        Self {
            net: "",
            passwords: "[[udp_range_net.password]]\nname = \"service\"\nfile = \"secrets/section-1\"",
            runtime: "workers = 1\ndrain = \"100ms\"",
            sections: "",
            descriptors: None,
        }
    }
}

/// The configuration with flows in the kernel switched off, if it does not say otherwise: with
/// `PNET_NAT_TESTS_KERNEL=off` all relays carry datagrams on sockets alone. Without it, they have the kernel
/// carry flows where it can.
pub fn on_the_path(configuration: &str) -> String {
    let is_off = env::var("PNET_NAT_TESTS_KERNEL").is_ok_and(|path| path == "off");
    if !is_off || configuration.contains("\nkernel = ") {
        return configuration.to_owned();
    }
    match configuration.split_once("[datapath]\n") {
        Some((before, after)) => format!("{before}[datapath]\nkernel = \"off\"\n{after}"),
        None => format!("{configuration}\n[datapath]\nkernel = \"off\"\n"),
    }
}

/// A folder with this configuration in `pnet-nat.toml`, and with all password files that the
/// annotated configuration names.
pub fn folder(configuration: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("pnet-nat.toml"), configuration).unwrap();
    fs::create_dir(folder.path().join("secrets")).unwrap();
    let secrets: [(&str, &[u8]); 4] = [
        ("section-1", PASSWORD),
        ("press", SECOND),
        ("section-1-device", DEVICE),
        ("admin", b"s3cr3t-0123456789"),
    ];
    for (name, password) in secrets {
        let path = folder.path().join("secrets").join(name);
        fs::write(&path, password).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o600)).unwrap();
    }
    folder
}

/// The surroundings of a relay: the addresses that it listens on, and the subnet of its nodes 1 to
/// 4 and 33.
#[derive(Debug)]
pub struct Place<'a> {
    /// A list, in TOML.
    pub listen: &'a str,
    /// The address and port of the admin server.
    pub admin: SocketAddr,
    /// The public port of a node is this one plus its node address (R-10).
    pub start_port: u16,
    /// The nodes' subnet, a /24.
    pub subnet: Ipv4Addr,
    /// A list, in TOML.
    pub allow: &'a str,
}

impl Place<'_> {
    /// The configuration of a relay in this place.
    pub fn configuration(&self, settings: &Settings<'_>) -> String {
        let Self { listen, admin, start_port, subnet, allow } = self;
        let Settings { net, passwords, runtime, sections, .. } = settings;
        format!(
            r#"
[public]
listen = {listen}

[runtime]
{runtime}

[admin]
listen = "{admin}"

[[udp_range_net]]
name = "section-1"
start_port = {start_port}
subnet = "{subnet}"
nodes = ["1-4", 33]
allow = {allow}
{net}
{passwords}

{sections}
"#
        )
    }

    /// Starts a relay with the usual configuration and these settings, and waits until it is ready.
    pub fn relay(&self, settings: &Settings<'_>) -> Relay {
        Relay::start(&self.configuration(settings), self.admin, settings.descriptors)
    }
}

impl Site {
    /// The configuration of a relay in front of this site's nodes, for its clients.
    pub fn configuration(&self, settings: &Settings<'_>) -> String {
        let (public, subnet) = (self.public_address(), self.address(0));
        Place {
            listen: &format!("[\"{public}\"]"),
            admin: self.admin(),
            start_port: self.start_port(),
            subnet,
            allow: &format!("[\"{subnet}/24\"]"),
        }
        .configuration(settings)
    }

    /// The address of the admin server of this site's relay.
    pub fn admin(&self) -> SocketAddr {
        (self.public_address(), ADMIN_PORT).into()
    }

    /// Starts a relay with the usual configuration and these settings, and waits until it is ready.
    pub fn relay(&self, settings: Settings<'_>) -> Relay {
        Relay::start(&self.configuration(&settings), self.admin(), settings.descriptors)
    }
}

/// A relay that has become ready.
#[derive(Debug)]
pub struct Relay {
    /// `pnet-nat run`.
    pub process: Process,
    admin: SocketAddr,
    /// The folder with the relay's configuration.
    pub folder: TempDir,
}

impl Relay {
    /// Starts a relay, possibly with a hard limit of file descriptors, and waits until it is ready.
    pub fn start(configuration: &str, admin: SocketAddr, descriptors: Option<u64>) -> Self {
        let start = |arguments: &[&str]| match descriptors {
            Some(limit) => pnet_nat_within(limit, arguments),
            None => pnet_nat(arguments),
        };
        let relay = Self::start_as(configuration, admin, start);
        // Lines reach us on another way than answers, and later on a busy machine.
        eventually("the log says so too", || relay.process.logged("relaying").pop());
        relay
    }

    /// Starts the relay with a command that contains these arguments, and possibly more.
    pub fn start_as(
        configuration: &str,
        admin: SocketAddr,
        command: impl FnOnce(&[&str]) -> Command,
    ) -> Self {
        let folder = folder(&on_the_path(configuration));
        let config = folder.path().join("pnet-nat.toml");
        let command = command(&["run", "--config", config.to_str().unwrap()]);
        let mut relay = Self { process: Process::start(command), admin, folder };
        eventually("the relay is ready", || {
            assert!(!relay.process.has_ended(), "{}", relay.process.stderr());
            (relay.get("/-/ready")?.0 == 200).then_some(())
        });
        relay
    }

    /// Writes another configuration into the relay's file, for the next reload.
    pub fn configure(&self, configuration: &str) {
        let configuration = on_the_path(configuration);
        fs::write(self.folder.path().join("pnet-nat.toml"), configuration).unwrap();
    }

    /// Writes another password into a file of `secrets`.
    pub fn set_password(&self, file: &str, password: &[u8; 8]) {
        fs::write(self.folder.path().join("secrets").join(file), password).unwrap();
    }

    /// Reloads by SIGHUP, and returns the log line with the result.
    #[track_caller]
    pub fn reload(&self) -> Value {
        let done = || {
            let is_it =
                |line: &Value| line["message"] == "reload" || line["message"] == "reload failed";
            self.process.log().filter(is_it).collect::<Vec<_>>()
        };
        let before = done().len();
        self.process.signal(Signal::SIGHUP);
        eventually("the reload is over", || done().into_iter().nth(before))
    }

    /// Brings another configuration into force, and returns the log line with the differences.
    #[track_caller]
    pub fn reload_to(&self, configuration: &str) -> Value {
        self.configure(configuration);
        let line = self.reload();
        assert_eq!(line["message"], "reload", "{}", self.process.stderr());
        line
    }

    /// Sends `POST /-/reload` and returns the status and the body.
    pub fn post_reload(&self) -> (u16, String) {
        let mut answer = self.agent().post(format!("http://{}/-/reload", self.admin)).send_empty();
        let answer = answer.as_mut().unwrap();
        (answer.status().as_u16(), answer.body_mut().read_to_string().unwrap())
    }

    /// The status and the body of the admin server's answer, if there is an answer.
    pub fn get(&self, path: &str) -> Option<(u16, String)> {
        let mut answer = self.agent().get(format!("http://{}{path}", self.admin)).call().ok()?;
        let body = answer.body_mut().with_config().limit(1 << 30).read_to_string().ok()?;
        Some((answer.status().as_u16(), body))
    }

    fn agent(&self) -> ureq::Agent {
        ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(super::PATIENCE))
            .build()
            .into()
    }

    /// One scrape of `/metrics`.
    pub fn metrics(&self) -> Metrics {
        let (status, text) = self.get("/metrics").expect("an answer");
        assert_eq!(status, 200);
        Metrics::parse(&text)
    }

    /// Waits until exactly these datagrams were dropped: direction, drop reason, number.
    #[track_caller]
    pub fn expect_drops(&self, expected: &[(&str, &str, u64)]) {
        let expected: BTreeMap<_, _> = expected
            .iter()
            .map(|&(direction, reason, count)| ((direction.into(), reason.into()), count))
            .collect();
        let total = |drops: &BTreeMap<_, u64>| drops.values().sum::<u64>();
        let drops = eventually("as many are dropped", || {
            let drops = self.metrics().drops();
            (total(&drops) >= total(&expected)).then_some(drops)
        });
        assert_eq!(drops, expected);
    }

    /// The metrics once no datagram is on its way: received = forwarded + dropped, the law of the
    /// counters. An answer may reach a client before the relay has counted it as forwarded.
    #[track_caller]
    pub fn at_rest(&self) -> Metrics {
        let mut breaches = Vec::new();
        for _ in 0..100 {
            let metrics = self.metrics();
            breaches = metrics.breaches();
            if breaches.is_empty() {
                return metrics;
            }
            super::pause(std::time::Duration::from_millis(10));
        }
        panic!("the law of the counters does not hold: {breaches:#?}");
    }

    /// Ends a scenario. Every scenario has to end in this way: the law of the counters holds,
    /// SIGTERM ends the relay with exit code 0, and no password was shown. Returns the ended
    /// process, for its log.
    #[track_caller]
    pub fn finish(mut self) -> Process {
        self.at_rest();
        let (_, metrics) = self.get("/metrics").expect("an answer");
        let (_, config) = self.get("/api/v1/config").expect("an answer");
        self.process.signal(Signal::SIGTERM);
        assert_eq!(self.process.end(), Some(0), "{}", self.process.stderr());
        for password in PASSWORDS {
            let password = str::from_utf8(password).unwrap();
            for shown in [&metrics, &config, &self.process.stderr(), &self.process.stdout()] {
                assert!(!shown.contains(password), "a password in: {shown}");
            }
        }
        self.process
    }
}
