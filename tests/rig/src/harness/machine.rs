//! A running copy of this machine. Its files are copied when they are written. It has its own
//! network, processes and control groups, and systemd as process 1.
//!
//! Nothing that a test does in the copy leaves a trace outside. None of the many services of
//! systemd is started.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use tempfile::TempDir;

use super::{Process, eventually};

/// This script runs in its own mount and network namespace, in an empty folder.
const BUILD: &str = r#"
set -eu
ip link set lo up
mount -t tmpfs tmpfs "$0"
cd "$0"
mkdir upper work root cgroup
mount -t overlay overlay -o lowerdir=/,upperdir=upper,workdir=work root
rm -rf root/etc/fstab root/etc/systemd/system/*.wants root/lib/systemd/system/*.wants
# Images for containers have this one: packages neither start nor stop a service.
rm -f root/usr/sbin/policy-rc.d
# A group of its own, to be forgotten with it.
mount -t cgroup2 cgroup2 cgroup
own=cgroup/pnet-nat-$$
mkdir $own
echo $$ > $own/cgroup.procs
unshare --pid --fork --kill-child --mount --cgroup --uts --ipc sh -c "$1" || true
echo $$ > cgroup/cgroup.procs
find $own -depth -type d -exec rmdir {} +
"#;

/// This script runs as process 1 of the copy.
const BOOT: &str = r#"
set -eu
cd root
mount -t proc proc proc
# systemd sets some of what belongs to the kernel as a whole.
mount --bind proc/sys proc/sys
mount -o remount,bind,ro proc/sys
mount -t sysfs -o ro sysfs sys
mount -t cgroup2 cgroup2 sys/fs/cgroup
mount -t tmpfs tmpfs run
mount -t tmpfs tmpfs tmp
mount -t tmpfs tmpfs dev
mkdir dev/pts dev/shm
for device in null zero full random urandom tty; do
    touch dev/$device
    mount --bind /dev/$device dev/$device
done
mount -t devpts -o newinstance,ptmxmode=666 devpts dev/pts
ln -s pts/ptmx dev/ptmx
mount -t tmpfs tmpfs dev/shm
cat > run/booted.target <<END
[Unit]
DefaultDependencies=no
END
mkdir -p run/systemd/system
mv run/booted.target run/systemd/system/
mkdir outside
pivot_root . outside
umount -l outside
mount --make-rshared /
exec env -i container=test PATH=/usr/sbin:/usr/bin:/sbin:/bin \
    /lib/systemd/systemd --system --unit=booted.target
"#;

/// A copy of this machine.
#[derive(Debug)]
pub struct Machine {
    builder: Process,
    first_process: i32,
    _folder: TempDir,
}

impl Machine {
    /// Starts a copy. Returns the reason if that is not possible.
    pub fn start() -> Result<Self, String> {
        if !Path::new("/lib/systemd/systemd").exists() {
            return Err("systemd, of the package of that name".to_owned());
        }
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new("unshare");
        command.args(["--mount", "--net", "sh", "-c", BUILD]).arg(folder.path()).arg(BOOT);
        let mut builder = Process::start(command);
        let first_process = eventually("the machine has started", || {
            if builder.has_ended() {
                return Some(Err(format!("root, for a machine to test on: {}", builder.stderr())));
            }
            // The builder runs `unshare`, which runs the copy's first process.
            let first = child_of(child_of(builder.id() as i32)?)?;
            let name = fs::read_to_string(format!("/proc/{first}/comm")).ok()?;
            (name.trim() == "systemd").then_some(Ok(first))
        })?;
        let machine = Self { builder, first_process, _folder: folder };
        eventually("systemd takes orders", || {
            let state = machine.output(&["systemctl", "is-active", "booted.target"]);
            state.status.success().then_some(())
        });
        machine.run(&["systemctl", "start", "systemd-journald"]);
        Ok(machine)
    }

    /// A command that runs in the copy.
    pub fn command(&self, command: &[&str]) -> Command {
        let mut inside = Command::new("nsenter");
        inside.args(["--target", &self.first_process.to_string(), "--all", "--"]).args(command);
        inside.current_dir("/");
        inside
    }

    /// Runs a command in the copy and returns its output and status.
    pub fn output(&self, command: &[&str]) -> Output {
        self.command(command).output().unwrap()
    }

    /// Runs a command in the copy and returns what it prints. The command has to succeed.
    #[track_caller]
    pub fn run(&self, command: &[&str]) -> String {
        let output = self.output(command);
        assert!(output.status.success(), "{command:?}: {output:?}\n{}", self.journal());
        String::from_utf8(output.stdout).unwrap()
    }

    /// Runs a line of the shell in the copy.
    #[track_caller]
    pub fn shell(&self, line: &str) -> String {
        self.run(&["sh", "-c", line])
    }

    /// The log lines of the copy's services.
    pub fn journal(&self) -> String {
        let output = self.output(&["journalctl", "--output=cat", "--no-pager"]);
        String::from_utf8_lossy(&output.stdout).into_owned()
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        // All other processes of the copy end with this one. Then the builder cleans up.
        let _ = kill(Pid::from_raw(self.first_process), Signal::SIGKILL);
        self.builder.status();
    }
}

fn child_of(process: i32) -> Option<i32> {
    let children = fs::read_to_string(format!("/proc/{process}/task/{process}/children")).ok()?;
    children.split_whitespace().next()?.parse().ok()
}
