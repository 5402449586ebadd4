//! What a sound configuration becomes, and that no text makes the reader panic.
//!
//! Tests start from [`SOUND`], which stands in a folder with password files. What is refused is in
//! `faults`; that the annotated configuration tells the truth, in `reference`.

mod changes;
mod faults;
mod hash;
mod host;
mod ip_net_table;
mod profinet_device;
mod reference;
mod remote_net;
mod schema;
mod size;
mod syntax;

use std::fs::{self, Permissions};
use std::net::SocketAddr;
use std::num::NonZeroUsize;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::time::Duration;

use proptest::prelude::*;
use tempfile::TempDir;

use super::*;
use crate::nat::{Limits, Net, NetKind, RequestRate};

/// Line numbers in the cases below count from the first line of this text.
const SOUND: &str = r#"[public]
listen = ["192.0.2.1"]

[[udp_range_net]]
name = "section-1"
start_port = 20000
subnet = "172.17.17.0"
nodes = ["1-4", 33]
allow = ["198.51.100.0/24"]
[[udp_range_net.password]]
name = "service"
file = "secrets/a"

[[server]]
name = "press"
public_port = 20200
address = "172.17.18.7:34379"
node = 7
allow = ["198.51.100.7"]
[[server.password]]
name = "service"
file = "secrets/a"
"#;

/// Reads a file, and what it names.
fn load(path: &Path) -> Result<(Config, Vec<Warning>), Faults> {
    Source::File(path.to_owned()).load()
}

/// A folder with the password files that the cases name.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let secrets = folder.path().join("secrets");
    fs::create_dir(&secrets).unwrap();
    let files: [(&str, &[u8], u32); 18] = [
        ("a", b"s3cr3t-A", 0o600),
        ("b", b"s3cr3t-B", 0o400),
        ("same-as-a", b"s3cr3t-A", 0o600),
        ("seven", b"s3cr3t-", 0o600),
        ("nine", b"s3cr3t-AB", 0o600),
        ("newline", b"s3cr3t-A\n", 0o600),
        ("crlf", b"s3cr3t-A\r\n", 0o600),
        ("mistyped", b"s3cr3t-\n", 0o600),
        ("marked", b"\xef\xbb\xbfs3cr3t-A", 0o600),
        ("token-with-crlf", b"s3cr3t-0123456789\r\n", 0o600),
        ("guessable", b"Pa55word", 0o600),
        ("for-group", b"s3cr3t-A", 0o620),
        ("for-others", b"s3cr3t-A", 0o604),
        ("token", b"s3cr3t-0123456789", 0o600),
        ("token-with-newline", b"s3cr3t-0123456789\n", 0o640),
        ("short-token", b"s3cr3t-01234567\n", 0o600),
        ("two-lines", b"s3cr3t-0123456789\ns3cr3t", 0o600),
        ("any-octets", b"\0\xff\n\r\x7f\0\0\0", 0o440),
    ];
    for (name, octets, mode) in files {
        let path = secrets.join(name);
        fs::write(&path, octets).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(mode)).unwrap();
    }
    symlink("a", secrets.join("link")).unwrap();
    nix::unistd::mkfifo(&secrets.join("pipe"), nix::sys::stat::Mode::S_IRUSR).unwrap();
    folder
}

fn read_in(folder: &Path, text: &str) -> Result<(Config, Vec<Warning>), Faults> {
    parse(text, &folder.join("pnet-nat.toml"))
}

fn read(text: &str) -> Result<(Config, Vec<Warning>), Faults> {
    read_in(folder().path(), text)
}

/// [`SOUND`] with one thing changed.
fn changed(from: &str, to: &str) -> String {
    changed_in(SOUND, from, to)
}

/// A text with one thing changed.
fn changed_in(sound: &str, from: &str, to: &str) -> String {
    assert!(sound.contains(from), "{from:?} is not in the text");
    sound.replacen(from, to, 1)
}

/// What is changed, and the fault to expect: line, key path, a part of the message.
type Case = (&'static str, &'static str, usize, &'static str, &'static str);

/// Checks that each change of a text leads to exactly one fault, in the right place, with a remedy.
fn each_is_refused<T>(
    sound: &str,
    cases: &[Case],
    read_in: impl Fn(&Path, &str) -> Result<T, Faults>,
) {
    let folder = folder();
    for &(from, to, line, key, part) in cases {
        let read = read_in(folder.path(), &changed_in(sound, from, to));
        let Err(Faults(faults)) = read else { panic!("{to:?} is taken") };
        let [fault] = faults.as_slice() else { panic!("{to:?}: {faults:#?}") };
        assert_eq!((fault.line, fault.key.as_str()), (Some(line), key), "{to:?}: {fault}");
        let message = fault.to_string();
        assert!(message.contains(part), "{to:?}: {message}");
        assert!(!fault.remedy.is_empty() && !message.contains('\n'), "{to:?}: {message:?}");
        assert!(!message.contains("s3cr3t"), "{message}");
    }
}

#[test]
fn the_sound_configuration_is_sound_and_complete() {
    let (config, warnings) = read(SOUND).unwrap();
    assert_eq!(warnings, []);
    assert_eq!(config.listen, ["192.0.2.1".parse::<IpAddr>().unwrap()]);
    assert_eq!(config.table.header, Header([2, 0, 0, 0]));
    assert_eq!(config.runtime.workers, None);
    assert_eq!(config.datapath.receive_buffer, 1_048_576);
    assert_eq!(config.runtime.pre_drain, Duration::ZERO);
    assert_eq!(config.runtime.drain, Duration::from_secs(5));
    assert_eq!(config.admin.unwrap().listen, "127.0.0.1:9378".parse().unwrap());
    let limits = Limits {
        max_flows: 65_536,
        wrong_password_burst: 10,
        wrong_password_address_burst: 5120,
        wrong_password_interval: Duration::from_secs(6),
    };
    assert_eq!(config.limits, limits);

    let [section, press] = config.table.nets() else { panic!("two nets") };
    assert_eq!((section.name.as_str(), press.name.as_str()), ("section-1", "press"));
    assert_eq!(section.kind, NetKind::UdpRange { start_port: 20000 });
    assert_eq!(press.kind, NetKind::Server);
    assert_eq!(press.allow, ["198.51.100.7/32".parse().unwrap()]);
    assert_eq!(section.idle_timeout, Duration::from_secs(300));
    assert_eq!(section.max_flows, 4096);
    assert!(!section.require_response_password && !section.allow_without_password);
    assert!(bool::from(section.credentials[0].password.matches(b"s3cr3t-A")));
    assert!(section.credentials[0].device_password.is_none());
}

#[test]
fn r9_r10_r12_a_node_has_a_public_port_and_a_server() {
    let (config, _) = read(SOUND).unwrap();
    let mappings = config.table.mappings().iter();
    let rows: Vec<_> =
        mappings.map(|m| (m.net.0, m.node_address, m.public_port, m.server.to_string())).collect();
    let expected = [
        (0, 1, 20001, "172.17.17.1:34379".to_owned()),
        (0, 2, 20002, "172.17.17.2:34379".to_owned()),
        (0, 3, 20003, "172.17.17.3:34379".to_owned()),
        (0, 4, 20004, "172.17.17.4:34379".to_owned()),
        (0, 33, 20033, "172.17.17.33:34379".to_owned()),
        (1, 7, 20200, "172.17.18.7:34379".to_owned()),
    ];
    assert_eq!(rows, expected);
}

#[test]
fn every_setting_arrives() {
    let text = changed("[[server]]", "[[udp_range_net.password]]\nname = \"team-2\"\nfile = \"secrets/b\"\ndevice_file = \"secrets/any-octets\"\n[[server]]")
        .replace("node = 7", "node = 7\nidle_timeout = \"2m\"\nmax_flows = 9\nmax_requests_per_second = 70\nrequire_response_password = true")
        .replace("nodes =", "server_port = 5000\nmax_flow_requests_per_second = 8\nnodes =")
        + r#"
[protocol]
header = "0a000001"
[limits]
max_flows = 100
wrong_password_burst = 3
wrong_password_address_burst = 50
wrong_password_interval = "1m"
[datapath]
receive_buffer = 65536
prefilter = "always"
kernel = "required"
busy_poll = "20us"
[log]
audit_lines = 7
[runtime]
user = 990
workers = 3
pre_drain = "3s"
drain = "0s"
[admin]
enabled = false
listen = "[::1]:0"
"#;
    let (config, _) = read(&text).unwrap();
    assert_eq!(config.table.header, Header([0x0a, 0, 0, 1]));
    assert_eq!(config.limits.wrong_password_address_burst, 50);
    let limits = config.limits;
    assert_eq!((limits.max_flows, limits.wrong_password_burst), (100, 3));
    assert_eq!(limits.wrong_password_interval, Duration::from_secs(60));
    let datapath = Datapath {
        receive_buffer: 65_536,
        prefilter: Prefilter::Always,
        kernel: KernelFlows::Required,
        busy_poll: Duration::from_micros(20),
    };
    assert_eq!((config.datapath, config.log), (datapath, Log { audit_lines: 7 }));
    assert_eq!(config.runtime.user.as_deref(), Some("990"));
    assert_eq!(config.runtime.workers, NonZeroUsize::new(3));
    assert_eq!(config.runtime.pre_drain, Duration::from_secs(3));
    assert_eq!(config.runtime.drain, Duration::ZERO);
    assert!(config.admin.is_none());
    let [section, press] = config.table.nets() else { panic!("two nets") };
    assert_eq!((press.idle_timeout, press.max_flows), (Duration::from_secs(120), 9));
    assert!(press.require_response_password && !section.require_response_password);
    let rates = |net: &Net| {
        [net.max_requests, net.max_flow_requests].map(|rate| rate.map(RequestRate::per_second))
    };
    assert_eq!([section, press].map(rates), [[None, Some(8)], [Some(70), None]]);
    assert_eq!(config.table.mappings()[0].server.port(), 5000);
    let second = &section.credentials[1];
    assert_eq!(second.name, "team-2");
    assert!(bool::from(second.password.matches(b"s3cr3t-B")));
    let device_password = second.device_password.as_ref().unwrap();
    assert!(bool::from(device_password.matches(b"\0\xff\n\r\x7f\0\0\0")));
}

#[test]
fn warns_of_a_password_that_is_easily_guessed_and_does_not_show_it() {
    let text = changed("secrets/a", "secrets/guessable");
    let (_, warnings) = read(&text).unwrap();
    let [warning] = &warnings[..] else { panic!("{warnings:?}") };
    let warning = warning.to_string();
    assert!(warning.contains("pnet-nat.toml:12: udp_range_net[0].password[0].file: "), "{warning}");
    assert!(
        warning.contains("easily guessed") && warning.contains("`pnet-nat password "),
        "{warning}"
    );
    assert!(!warning.contains("Pa55word"), "{warning}");
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// No text near a valid one, and no text at all, makes the reader panic or forget a remedy.
    #[test]
    fn any_text_is_read_or_refused(
        edits in prop::collection::vec((0..SOUND.len(), 0..12_usize, piece()), 0..6),
        tail in "\\PC{0,20}",
    ) {
        let mut text = SOUND.to_owned();
        for (at, removed, piece) in edits {
            let at = at.min(text.len());
            let end = (at + removed).min(text.len());
            if text.is_char_boundary(at) && text.is_char_boundary(end) {
                text.replace_range(at..end, &piece);
            }
        }
        for text in [text.clone() + &tail, text, tail] {
            if let Err(Faults(faults)) = parse(&text, Path::new("pnet-nat.toml")) {
                prop_assert!(!faults.is_empty());
                for fault in faults {
                    prop_assert!(!fault.remedy.is_empty());
                    prop_assert!(!fault.to_string().contains('\n'), "{}", fault);
                    prop_assert!(fault.line.is_some());
                }
            }
        }
    }
}

/// Something that may well stand in a configuration, or not at all.
fn piece() -> impl Strategy<Value = String> {
    let plausible = prop::sample::select(vec![
        "",
        "[",
        "]",
        "[[",
        "\"",
        "\n",
        "=",
        "#",
        "-1",
        "65535",
        "99999999999999999999",
        "1e400",
        "0x7f",
        "true",
        "[[server]]\n",
        "[limits]\n",
        "[udp_range_net.password]\n",
        "[server]\n",
        "server = 1\n",
        "nodes = [1, 1]\n",
        "{ a = 1 }",
        "\"1-125\"",
        "\"0.0.0.0/0\"",
        "\"none\"",
        "1979-05-27",
        "\"9999999999y\"",
        "[[udp_range_net]]\n",
        "public.listen = []\n",
    ]);
    prop_oneof![plausible.prop_map(str::to_owned), "\\PC{0,6}"]
}
