//! `pnet-nat check` as a user meets it: exit codes, and what goes to stdout and to stderr.

use std::path::Path;

use crate::harness::{ANNOTATED, Process, folder, pnet_nat};

/// The command, where `folder` is the current one.
fn check(folder: &Path, options: &[&str]) -> Process {
    let mut command = pnet_nat(&["check"]);
    command.current_dir(folder).args(options);
    Process::start(command)
}

#[test]
fn a_sound_configuration_shows_its_tables() {
    let folder = folder(ANNOTATED);
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(checked.end(), Some(0));
    assert_eq!(checked.stderr(), "");
    insta::assert_snapshot!(checked.stdout());
}

#[test]
fn full_shows_a_line_for_each_node() {
    let folder = folder(ANNOTATED);
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml", "--full"]);
    assert_eq!(checked.end(), Some(0));
    let stdout = checked.stdout();
    for node in [1, 2, 3, 4, 33] {
        let server = format!("172.17.17.{node}:34379");
        let line = stdout.lines().find(|line| line.contains(&server)).unwrap();
        assert!(line.contains(&format!(" {} ", 40000 + node)), "{line}");
    }
}

#[test]
fn warnings_do_not_refuse_and_rows_that_cannot_be_are_left_out() {
    let configuration = ANNOTATED
        .replace("public_port = 40200", "public_port = 7")
        .replace("[\"0.0.0.0\"]", "[\"192.0.2.1\", \"2001:db8::1\"]")
        .replace("= \"5m\"", "= \"1m\"");
    let folder = folder(&configuration);
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(checked.end(), Some(0));
    insta::assert_snapshot!(checked.stderr() + "\n" + &checked.stdout());
}

#[test]
fn every_fault_is_shown_and_the_exit_code_is_2() {
    let configuration = ANNOTATED
        .replace("start_port = 40000", "start_port = 40199")
        .replace("file = \"secrets/section-1\"", "file = \"secrets/absent\"")
        .replace("node = 7", "node = 126\nnodes = 5")
        .replace("drain = \"5s\"", "drain = 5");
    let folder = folder(&configuration);
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(checked.end(), Some(2));
    assert_eq!(checked.stdout(), "");
    insta::assert_snapshot!(checked.stderr());
}

#[test]
fn the_configuration_can_be_named_by_the_environment() {
    let folder = folder(ANNOTATED);
    let mut command = pnet_nat(&["check"]);
    command.current_dir(folder.path()).env("PNET_NAT_CONFIG", "pnet-nat.toml");
    assert_eq!(Process::start(command).end(), Some(0));
}

#[test]
fn a_configuration_that_is_not_there_is_exit_code_2() {
    let folder = folder(ANNOTATED);
    let mut checked = check(folder.path(), &["--config", "absent.toml"]);
    assert_eq!(checked.end(), Some(2));
    let stderr = checked.stderr();
    assert!(stderr.starts_with("absent.toml: cannot be read: "), "{stderr}");
    assert_eq!(check(folder.path(), &[]).end(), Some(2));
}

#[test]
fn a_user_that_is_not_there_is_exit_code_2() {
    let folder =
        folder(&ANNOTATED.replace("#user = \"pnet-nat\"", "user = \"nobody-of-this-name\""));
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(checked.end(), Some(2));
    let stderr = checked.stderr();
    assert!(stderr.contains("\"nobody-of-this-name\"") && stderr.contains("useradd"), "{stderr}");
}
