//! SIGHUP before the relay is there: it is no end, and a reload as soon as there is something to
//! reload.

use std::fs;
use std::process::Command;

use nix::sys::signal::Signal;

use crate::harness::{Process, Settings, Site, eventually, folder, pnet_nat};

/// From its first instructions on, long before there is somebody to answer it, the program holds the
/// signal back.
#[test]
fn a_hangup_at_the_start_is_a_reload_right_after_it() {
    let mut before_its_answer = 0;
    for _ in 0..20 {
        let site = Site::claim();
        let folder = folder(&site.configuration(&Settings::default()));
        let path = folder.path().join("pnet-nat.toml");
        let mut process = Process::start(pnet_nat(&["run", "--config", path.to_str().unwrap()]));
        // What comes before `main` is the loader's.
        let caught = loop {
            let [blocked, caught] = ["SigBlk:", "SigCgt:"].map(|set| has_hangup(&process, set));
            if blocked || caught {
                break caught;
            }
            assert!(!process.has_ended(), "{}", process.stderr());
        };
        before_its_answer += i32::from(!caught);
        for _ in 0..50 {
            process.signal(Signal::SIGHUP);
        }
        eventually("it relays", || process.logged("relaying").pop());
        eventually("it has reloaded", || process.logged("reload").pop());
        process.signal(Signal::SIGTERM);
        assert_eq!(process.end(), Some(0), "{}", process.stderr());
    }
    assert!(before_its_answer > 0, "it was always answered already");
}

/// Whether SIGHUP is in a set of the main thread.
fn has_hangup(process: &Process, set: &str) -> bool {
    let status = fs::read_to_string(format!("/proc/{}/status", process.id())).unwrap();
    let signals = status.lines().find_map(|line| line.strip_prefix(set)).unwrap();
    let signals = u64::from_str_radix(signals.trim(), 16).unwrap();
    signals & (1 << (Signal::SIGHUP as u64 - 1)) != 0
}

/// Whoever closes the terminal of another command ends it. Whoever began it with `nohup` does not.
#[test]
fn a_hangup_ends_other_commands() {
    for (how, ends) in [("--default-signal=HUP", true), ("--ignore-signal=HUP", false)] {
        // These tests may themselves have been started so that they, and what they start, ignore it.
        let mut nodes = Site::claim().simulated_nodes_as("0s", |arguments| {
            let nodes = pnet_nat(arguments);
            let mut command = Command::new("env");
            command.arg(how).arg(nodes.get_program()).args(nodes.get_args());
            command
        });
        nodes.signal(Signal::SIGHUP);
        if !ends {
            nodes.signal(Signal::SIGTERM);
        }
        assert_eq!(nodes.end(), (!ends).then_some(0), "{how}");
    }
}
