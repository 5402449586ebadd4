//! `pnet-nat check` as a user meets it: exit codes, and what goes to stdout and to stderr.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Output;

use assert_cmd::Command;
use tempfile::TempDir;

const CONFIGURATION: &str = include_str!("../config/pnet-nat.toml");

/// A folder with this configuration and the password files of the annotated one.
fn folder(configuration: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("pnet-nat.toml"), configuration).unwrap();
    fs::create_dir(folder.path().join("secrets")).unwrap();
    for (name, password) in [("section-1", "s3cr3t-A"), ("press", "s3cr3t-B")] {
        let path = folder.path().join("secrets").join(name);
        fs::write(&path, password).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o600)).unwrap();
    }
    folder
}

fn check(folder: &Path, options: &[&str]) -> Output {
    let mut command = Command::cargo_bin("pnet-nat").unwrap();
    command.env_remove("PNET_NAT_CONFIG").env_remove("PNET_NAT_FULL");
    command.current_dir(folder).arg("check").args(options).output().unwrap()
}

fn text(octets: Vec<u8>) -> String {
    String::from_utf8(octets).unwrap()
}

#[test]
fn a_sound_configuration_shows_its_tables() {
    let folder = folder(CONFIGURATION);
    let output = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(text(output.stderr), "");
    insta::assert_snapshot!(text(output.stdout));
}

#[test]
fn full_shows_a_line_for_each_node() {
    let folder = folder(CONFIGURATION);
    let output = check(folder.path(), &["--config", "pnet-nat.toml", "--full"]);
    let stdout = text(output.stdout);
    for node in [1, 2, 3, 4, 33] {
        let server = format!("172.17.17.{node}:34379");
        let line = stdout.lines().find(|line| line.contains(&server)).unwrap();
        assert!(line.contains(&format!(" {} ", 40000 + node)), "{line}");
    }
}

#[test]
fn warnings_do_not_refuse_and_rows_that_cannot_be_are_left_out() {
    let configuration = CONFIGURATION
        .replace("public_port = 40200", "public_port = 7")
        .replace("[\"0.0.0.0\"]", "[\"192.0.2.1\", \"2001:db8::1\"]")
        .replace("= \"5m\"", "= \"1m\"");
    let folder = folder(&configuration);
    let output = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(output.status.code(), Some(0));
    insta::assert_snapshot!(text(output.stderr) + "\n" + &text(output.stdout));
}

#[test]
fn every_fault_is_shown_and_the_exit_code_is_2() {
    let configuration = CONFIGURATION
        .replace("start_port = 40000", "start_port = 40199")
        .replace("file = \"secrets/section-1\"", "file = \"secrets/absent\"")
        .replace("node = 7", "node = 126\nnodes = 5")
        .replace("drain = \"5s\"", "drain = 5");
    let folder = folder(&configuration);
    let output = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(text(output.stdout), "");
    insta::assert_snapshot!(text(output.stderr));
}

#[test]
fn the_configuration_can_be_named_by_the_environment() {
    let folder = folder(CONFIGURATION);
    let mut command = Command::cargo_bin("pnet-nat").unwrap();
    command.current_dir(folder.path()).env("PNET_NAT_CONFIG", "pnet-nat.toml").arg("check");
    command.assert().code(0);
}

#[test]
fn a_configuration_that_is_not_there_is_exit_code_2() {
    let folder = folder(CONFIGURATION);
    let output = check(folder.path(), &["--config", "absent.toml"]);
    assert_eq!(output.status.code(), Some(2));
    let stderr = text(output.stderr);
    assert!(stderr.starts_with("absent.toml: cannot be read: "), "{stderr}");
    assert_eq!(check(folder.path(), &[]).status.code(), Some(2));
}
