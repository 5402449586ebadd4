//! What the relay refuses to start with: exit code 2, a message that names the thing and the
//! remedy, and nothing half started.

use std::fs;
use std::net::{TcpListener, UdpSocket};
use std::path::Path;

use nix::sys::signal::Signal;
use socket2::{Domain, Socket, Type};

use crate::harness::{
    Process, Settings, Site, close, eventually, folder, pnet_nat, pnet_nat_within,
};

/// What a relay that refuses to start writes to stderr.
fn refused(config: &Path, descriptors: Option<u64>) -> String {
    let arguments = ["run", "--config", config.to_str().unwrap()];
    let command = match descriptors {
        Some(limit) => pnet_nat_within(limit, &arguments),
        None => pnet_nat(&arguments),
    };
    let mut process = Process::start(command);
    assert_eq!(process.end(), Some(2), "{}", process.stderr());
    assert_eq!(process.stdout(), "");
    process.stderr()
}

/// Starts on this configuration of the site, which is refused; afterwards all its ports are free.
fn refused_whole(site: &Site, configuration: &str, descriptors: Option<u64>) -> String {
    let folder = folder(configuration);
    let stderr = refused(&folder.path().join("pnet-nat.toml"), descriptors);
    assert!(!stderr.contains("\"relaying\""), "{stderr}");
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
    expect_all(&refused(&text, None), &["pnet-nat.toml:1: not UTF-8", "save the file as UTF-8"]);
    fs::write(&text, "[public\n").unwrap();
    expect_all(&refused(&text, None), &["pnet-nat.toml:1: ", "correct the TOML"]);
}

#[test]
fn a_password_of_7_or_9_octets() {
    let site = Site::claim();
    for (octets, problem, remedy) in [
        ("s3cr3t-", "has 7 octets, and a password has 8", "head -c 6 /dev/urandom"),
        ("s3cr3t-AB", "has more than the 8 octets of a password", "head -c 6 /dev/urandom"),
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
    expect_all(&refused(&config, None), &expected);
    close(holder);

    // A program that is willing to share would get some of the clients' datagrams.
    let sharing = Socket::new(Domain::IPV4, Type::DGRAM, None).unwrap();
    sharing.set_reuse_port(true).unwrap();
    sharing.set_reuse_address(true).unwrap();
    sharing.bind(&taken.into()).unwrap();
    expect_all(&refused(&config, None), &expected);
    close(sharing);

    // Another relay shares among its workers.
    let relay = site.relay(Settings { runtime: "workers = 2", ..Settings::default() });
    let elsewhere = configuration.replace(":9378", ":9379");
    fs::write(&config, elsewhere).unwrap();
    expect_all(&refused(&config, None), &["is in use"]);
    relay.finish();
    site.relay(Settings::default()).finish();
}

#[test]
fn the_admin_port_in_use() {
    let site = Site::claim();
    let holder = TcpListener::bind(site.admin()).unwrap();
    let folder = folder(&site.configuration(&Settings::default()));
    let stderr = refused(&folder.path().join("pnet-nat.toml"), None);
    expect_all(&stderr, &[&site.admin().to_string(), "[admin] listen", "in use"]);
    close(holder);
    site.relay(Settings::default()).finish();
}

/// An address of the documentation's (RFC 5737), which no host has.
#[test]
fn an_address_that_is_not_the_hosts() {
    let site = Site::claim();
    let ours = format!("[\"{}\"]", site.public_address());
    let both = format!("[\"{}\", \"192.0.2.77\"]", site.public_address());
    let configuration = site.configuration(&Settings::default()).replace(&ours, &both);
    let stderr = refused_whole(&site, &configuration, None);
    expect_all(&stderr, &["192.0.2.77 is no address of this host", "[public] listen"]);
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
