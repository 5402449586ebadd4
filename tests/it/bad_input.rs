//! What the relay does not start with: a message that names the thing and the remedy, and nothing
//! half started. Exit code 2 where only an edit mends it, 75 where it may pass by itself.

use std::fs;
use std::net::{TcpListener, UdpSocket};
use std::os::unix::fs::chown;
use std::path::Path;
use std::process::Command;

use nix::sys::signal::Signal;
use socket2::{Domain, Socket, Type};

use crate::harness::{
    Network, Place, Process, Settings, Site, close, eventually, folder, left_out, pnet_nat,
    pnet_nat_within,
};

/// What a relay that refuses to start writes to stderr.
fn refused(config: &Path, descriptors: Option<u64>) -> String {
    not_started(config, descriptors, 2)
}

/// What a relay that may start at another try writes to stderr.
fn put_off(config: &Path) -> String {
    not_started(config, None, 75)
}

fn not_started(config: &Path, descriptors: Option<u64>, code: i32) -> String {
    let arguments = ["run", "--config", config.to_str().unwrap(), "--log-format", "text"];
    let command = match descriptors {
        Some(limit) => pnet_nat_within(limit, &arguments),
        None => pnet_nat(&arguments),
    };
    let mut process = Process::start(command);
    assert_eq!(process.end(), Some(code), "{}", process.stderr());
    assert_eq!(process.stdout(), "");
    process.stderr()
}

/// Starts on this configuration of the site, which is refused; afterwards all its ports are free.
fn refused_whole(site: &Site, configuration: &str, descriptors: Option<u64>) -> String {
    let folder = folder(configuration);
    let stderr = refused(&folder.path().join("pnet-nat.toml"), descriptors);
    assert!(!stderr.contains(" relaying "), "{stderr}");
    site.relay(Settings::default()).finish();
    stderr
}

#[track_caller]
fn expect_all(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
}

#[test]
fn a_configuration_that_is_not_there_or_cannot_be_read() {
    let folder = folder("");
    let absent = folder.path().join("absent.toml");
    expect_all(&refused(&absent, None), &["absent.toml: cannot be read: No such file", "--config"]);
    expect_all(&refused(folder.path(), None), &["is a folder, not a regular file", "name a file"]);
    let text = folder.path().join("pnet-nat.toml");
    fs::write(&text, b"listen = \"\xFF\"").unwrap();
    expect_all(&refused(&text, None), &["pnet-nat.toml:1: is not UTF-8", "save the file as UTF-8"]);
    fs::write(&text, "[public\n").unwrap();
    expect_all(&refused(&text, None), &["pnet-nat.toml:1: ", "correct the TOML"]);
}

#[test]
fn a_password_of_7_or_9_octets() {
    let site = Site::claim();
    for (octets, problem, remedy) in [
        ("s3cr3t-", "has 7 octets, and a password has 8", "`pnet-nat password "),
        ("s3cr3t-AB", "has more than the 8 octets of a password", "`pnet-nat password "),
        ("s3cr3t-A\n", "has a line break (LF) after the 8 octets", "truncate --size=8 "),
    ] {
        let folder = folder(&site.configuration(&Settings::default()));
        fs::write(folder.path().join("secrets/section-1"), octets).unwrap();
        let stderr = refused(&folder.path().join("pnet-nat.toml"), None);
        let file = folder.path().join("secrets/section-1");
        let file = file.to_str().unwrap();
        let key = "udp_range_net[0].password[0].file";
        expect_all(&stderr, &["pnet-nat.toml:", key, file, problem, remedy]);
        assert!(!stderr.contains("s3cr3t"), "{stderr}");
    }
}

#[test]
fn a_public_port_in_use() {
    let site = Site::claim();
    let configuration = site.configuration(&Settings::default());
    // The last of the block, so that the others are bound before.
    let taken = site.public(33);
    let expected = [format!("UDP port {taken} is in use"), "ss -lunp".into()];
    let expected = expected.each_ref().map(String::as_str);

    let holder = UdpSocket::bind(taken).unwrap();
    let folder = folder(&configuration);
    let config = folder.path().join("pnet-nat.toml");
    expect_all(&put_off(&config), &expected);
    close(holder);

    // A program that is willing to share would get some of the clients' datagrams.
    let sharing = Socket::new(Domain::IPV4, Type::DGRAM, None).unwrap();
    sharing.set_reuse_port(true).unwrap();
    sharing.set_reuse_address(true).unwrap();
    sharing.bind(&taken.into()).unwrap();
    expect_all(&put_off(&config), &expected);
    close(sharing);

    // Another relay shares among its workers.
    let relay = site.relay(Settings { runtime: "workers = 2", ..Settings::default() });
    let elsewhere = configuration.replace(":9378", ":9379");
    fs::write(&config, elsewhere).unwrap();
    expect_all(&put_off(&config), &["is in use"]);
    relay.finish();
    site.relay(Settings::default()).finish();
}

#[test]
fn the_admin_port_in_use() {
    let site = Site::claim();
    let holder = TcpListener::bind(site.admin()).unwrap();
    let folder = folder(&site.configuration(&Settings::default()));
    let stderr = put_off(&folder.path().join("pnet-nat.toml"));
    expect_all(&stderr, &[&site.admin().to_string(), "[admin] listen", "in use", "ss -ltnp"]);
    close(holder);
    site.relay(Settings::default()).finish();
}

/// The admin server's address is another host's, or not here yet.
#[test]
fn an_admin_address_that_is_not_the_hosts() {
    let site = Site::claim();
    let configuration = site.configuration(&Settings::default());
    let elsewhere = format!(
        "[admin]\ntoken_file = \"secrets/admin\"\nlisten = \"192.0.2.77:{}\"",
        site.admin().port()
    );
    let here = format!("[admin]\nlisten = \"{}\"", site.admin());
    let folder = folder(&configuration.replace(&here, &elsewhere));
    let stderr = put_off(&folder.path().join("pnet-nat.toml"));
    expect_all(&stderr, &["192.0.2.77 is no address of this host", "[admin] listen"]);
}

/// An address of the documentation's (RFC 5737), which no host has.
#[test]
fn an_address_that_is_not_the_hosts() {
    let site = Site::claim();
    let ours = format!("[\"{}\"]", site.public_address());
    let both = format!("[\"{}\", \"192.0.2.77\"]", site.public_address());
    let configuration = site.configuration(&Settings::default()).replace(&ours, &both);
    let folder = folder(&configuration);
    let stderr = put_off(&folder.path().join("pnet-nat.toml"));
    expect_all(&stderr, &["192.0.2.77 is no address of this host", "[public] listen"]);
    site.relay(Settings::default()).finish();
}

/// The kernel asks for a second or two whether another machine has a new IPv6 address; until then
/// nobody can bind it. The relay waits for that, says so, and starts.
#[test]
fn an_address_that_is_tentative_is_waited_for() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let place = network.place(r#"["2001:db8:3::1"]"#);
        network.edge.ip("address add 2001:db8:3::1/64 dev eth0");
        let relay = place.relay(&Settings::default());
        let waited =
            relay.process.log().find(|line| line["message"].to_string().contains("waiting"));
        let waited = waited.expect("a line that says what is waited for")["message"].to_string();
        expect_all(&waited, &["2001:db8:3::1 is tentative"]);
        relay.finish();
    });
}

/// Another machine on the link has the address: the text says so, and it may be taken from there.
#[test]
fn an_address_that_another_machine_has_is_told_from_one_that_is_not_there() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        // The client's own, which answers for it.
        network.edge.ip("address add 2001:db8:1::7/64 dev eth0");
        eventually("the kernel has found out", || {
            let shown = network.edge.output(&["ip", "-6", "address", "show", "dadfailed"]);
            shown.contains("2001:db8:1::7").then_some(())
        });
        let place = network.place(r#"["2001:db8:1::7"]"#);
        let folder = folder(&place.configuration(&Settings::default()));
        let stderr = put_off(&folder.path().join("pnet-nat.toml"));
        expect_all(&stderr, &["2001:db8:1::7", "another machine on the link has it", "dadfailed"]);
    });
}

/// A user without privileges may have ports from this one on, as the host's `sysctl` has it.
#[test]
fn the_capability_is_asked_for_where_it_would_help() {
    let Some(network) = Network::build() else { return };
    if Command::new("setpriv").arg("--version").output().is_err() {
        return left_out("setpriv, to become somebody else");
    }
    network.at_the_edge(|| {
        fs::write("/proc/sys/net/ipv4/ip_unprivileged_port_start", "20002").unwrap();
        let place = Place {
            start_port: 20000,
            admin: ([127, 0, 0, 1], 29378).into(),
            ..network.place(r#"["198.51.100.1"]"#)
        };
        let folder = folder(&place.configuration(&Settings::default()));
        for path in ["", "pnet-nat.toml", "secrets", "secrets/section-1"] {
            chown(folder.path().join(path), Some(65534), Some(65534)).unwrap();
        }
        // Whoever it is can run the copy, and not the original.
        let program = folder.path().join("pnet-nat");
        fs::copy(env!("CARGO_BIN_EXE_pnet-nat"), &program).unwrap();
        let mut command = Command::new("setpriv");
        command.args(["--reuid=65534", "--regid=65534", "--clear-groups"]).arg(&program);
        command.args(["run", "--config"]).arg(folder.path().join("pnet-nat.toml"));
        let mut process = Process::start(command);
        assert_eq!(process.end(), Some(2), "{}", process.stderr());
        let expected = ["198.51.100.1:20001 needs CAP_NET_BIND_SERVICE", "below 20002"];
        expect_all(&process.stderr(), &expected);
    });
}

#[test]
fn too_few_file_descriptors() {
    let site = Site::claim();
    let configuration = site.configuration(&Settings::default());
    let stderr = refused_whole(&site, &configuration, Some(64));
    expect_all(&stderr, &["hard limit is 64", "167 file descriptors", "ulimit -Hn"]);
    // One fewer than are said to be needed, and as many.
    expect_all(&refused_whole(&site, &configuration, Some(166)), &["hard limit is 166"]);
    site.relay(Settings { descriptors: Some(167), ..Settings::default() }).finish();
}

/// A signal during the start is no reason to hang.
#[test]
fn a_signal_right_after_the_start() {
    let site = Site::claim();
    let folder = folder(&site.configuration(&Settings::default()));
    let config = folder.path().join("pnet-nat.toml");
    let mut process = Process::start(pnet_nat(&["run", "--config", config.to_str().unwrap()]));
    eventually("it says that it relays", || process.logged("relaying").pop());
    process.signal(Signal::SIGTERM);
    assert_eq!(process.end(), Some(0));
}
