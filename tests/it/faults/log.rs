//! The log cannot be written: the relay goes on without, counts every line that is lost, and says so
//! as soon as it can. What could be written is whole lines.

use std::fs::{self, File};
use std::path::Path;
use std::process::Command;
use std::thread;

use nix::sched::{CloneFlags, unshare};
use nix::sys::signal::Signal;
use nix::sys::stat::Mode;
use nix::unistd::mkfifo;
use serde_json::Value;

use crate::harness::{Relay, Settings, Site, eventually, exchange, left_out, pnet_nat};

/// A relay whose stderr a line of the shell opens: `$0` is a path, and `$@` the relay.
fn relay(site: &Site, line: &str, path: &Path) -> Relay {
    let configuration = site.configuration(&Settings::default());
    Relay::start_as(&configuration, site.admin(), |arguments| through_shell(line, path, arguments))
}

fn through_shell(line: &str, path: &Path, arguments: &[&str]) -> Command {
    let relay = pnet_nat(arguments);
    let mut command = Command::new("sh");
    command.args(["-c", line]).arg(path).arg(relay.get_program()).args(relay.get_args());
    command
}

fn lost(relay: &Relay) -> u64 {
    relay.metrics().sum("pnet_nat_log_lines_lost_total", &[])
}

/// A new client is a line of the log.
fn lines_are_lost(site: &Site, relay: &Relay) {
    let (node, before) = (site.node(4), lost(relay));
    exchange(&site.client(), site.public(4), &node, 4);
    eventually("a line is lost", || (lost(relay) > before).then_some(()));
}

/// Not one line can be written, from the first one on.
#[test]
fn a_log_that_takes_nothing() {
    let nothing = "exec \"$@\" 2>\"$0\"";
    let nobody_reads = "exec 3<>\"$0\" 2>\"$0\" 3>&-; exec \"$@\"";
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    mkfifo(&pipe, Mode::S_IRUSR | Mode::S_IWUSR).unwrap();
    for (line, path) in [(nothing, Path::new("/dev/full")), (nobody_reads, &pipe)] {
        let site = Site::claim();
        let relay = relay(&site, line, path);
        eventually("the lines of the start are lost", || (lost(&relay) >= 2).then_some(()));
        lines_are_lost(&site, &relay);
        let before = lost(&relay);
        relay.process.signal(Signal::SIGHUP);
        eventually("the line of the reload is lost", || (lost(&relay) > before).then_some(()));
        lines_are_lost(&site, &relay);
        relay.finish();
    }
}

/// Who reads the log goes while it runs.
#[test]
fn a_log_whose_reader_goes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pipe");
    mkfifo(&path, Mode::S_IRUSR | Mode::S_IWUSR).unwrap();
    let reader = File::options().read(true).write(true).open(&path).unwrap();
    let site = Site::claim();
    let relay = relay(&site, "exec \"$@\" 2>\"$0\"", &path);
    assert_eq!(lost(&relay), 0);
    drop(reader);
    for _ in 0..3 {
        lines_are_lost(&site, &relay);
    }
    relay.finish();
}

/// The file may not grow any more (`ulimit -f`), until somebody empties it.
#[test]
fn a_log_that_has_reached_its_limit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log");
    let site = Site::claim();
    let relay = relay(&site, "ulimit -f 8; exec \"$@\" 2>>\"$0\"", &path);
    is_lost_and_told_of(&site, relay, &path, || File::create(&path).map(drop).unwrap());
}

/// The disk is full, until somebody makes room.
#[test]
fn a_disk_that_is_full() {
    let full = || {
        let folder = tempfile::tempdir().unwrap();
        let mounted = unshare(CloneFlags::CLONE_NEWNS).is_ok()
            && succeeds(Command::new("mount").args(["--make-rprivate", "/"]))
            && succeeds(
                Command::new("mount")
                    .args(["-t", "tmpfs", "-o", "size=12k", "tmpfs"])
                    .arg(folder.path()),
            );
        if !mounted {
            return left_out("root, for a small disk");
        }
        let (path, other) = (folder.path().join("log"), folder.path().join("other"));
        fs::write(&other, [0; 8192]).unwrap();
        let site = Site::claim();
        let relay = relay(&site, "exec \"$@\" 2>>\"$0\"", &path);
        is_lost_and_told_of(&site, relay, &path, || fs::remove_file(&other).unwrap());
        assert!(succeeds(Command::new("umount").arg(folder.path())));
    };
    thread::spawn(full).join().unwrap();
}

fn succeeds(command: &mut Command) -> bool {
    command.status().is_ok_and(|status| status.success())
}

fn is_lost_and_told_of(site: &Site, relay: Relay, path: &Path, make_room: impl FnOnce()) {
    eventually("lines are lost", || {
        relay.process.signal(Signal::SIGHUP);
        (lost(&relay) >= 3).then_some(())
    });
    // Reloads that are still on their way, if any, are before this one's line.
    relay.configure("[public");
    relay.process.signal(Signal::SIGHUP);
    eventually("the last one is over", || {
        (relay.metrics().sum("pnet_nat_config_last_reload_successful", &[]) == 0).then_some(())
    });
    let before = whole_lines(path, false);
    assert!(before.iter().any(|line| line["message"] == "relaying"), "{before:?}");
    lines_are_lost(site, &relay);
    let lost_so_far = lost(&relay);
    make_room();
    let report = eventually("it says how many", || {
        let told = |line: &Value| line["message"] == "lines of the log were lost";
        whole_lines(path, false).into_iter().find(told)
    });
    // With a line that was broken off, if its beginning is gone with the rest of the file.
    let told = report["count"].as_u64().unwrap();
    assert!([lost_so_far, lost_so_far + 1].contains(&told), "{report}: {lost_so_far}");
    exchange(&site.client(), site.public(4), &site.node(4), 4);
    assert_eq!(lost(&relay), told);
    relay.finish();
    let after = whole_lines(path, true);
    assert_eq!(after.last().unwrap()["message"], "stopped");
    let reports = after.iter().filter(|line| line["message"] == "lines of the log were lost");
    assert_eq!(reports.count(), 1, "{after:?}");
}

/// Every line of a file, which has to be JSON. While it is full, the last one may be half.
fn whole_lines(path: &Path, to_the_end: bool) -> Vec<Value> {
    let text = fs::read_to_string(path).unwrap();
    let whole = text.rfind('\n').map_or(0, |end| end + 1);
    assert!(!to_the_end || whole == text.len(), "{text}");
    let lines = text[..whole].lines();
    lines
        .filter(|line| line.starts_with('{') || to_the_end)
        .map(|line| serde_json::from_str(line).expect(line))
        .collect()
}
