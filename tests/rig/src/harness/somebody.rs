//! A user other than root. Only the scenario starts processes and threads of this user.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, chown};
use std::path::Path;
use std::process::{self, Command};
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use nix::unistd::geteuid;
use tempfile::TempDir;

use super::left_out;
use super::process::program;

/// A user who runs the binary, with a copy of the binary: this user may have no right to run the
/// original.
#[derive(Debug)]
pub struct Somebody {
    user: u32,
    folder: TempDir,
}

impl Somebody {
    /// Makes a user that no other scenario uses. Where that is not possible, says so and returns
    /// `None`.
    pub fn new() -> Option<Self> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        if !geteuid().is_root() || Command::new("setpriv").arg("--version").output().is_err() {
            left_out("root and setpriv, to become somebody else");
            return None;
        }
        let folder = tempfile::tempdir().unwrap();
        fs::set_permissions(folder.path(), Permissions::from_mode(0o755)).unwrap();
        fs::copy(program(), folder.path().join("pnet-nat")).unwrap();
        let user = 100_000 + process::id() * 100 + NEXT.fetch_add(1, Relaxed);
        Some(Self { user, folder })
    }

    /// Makes this user the owner of a folder with a configuration.
    pub fn owns(&self, folder: &Path) {
        for path in ["", "pnet-nat.toml", "secrets", "secrets/section-1", "secrets/press"] {
            chown(folder.join(path), Some(self.user), Some(self.user)).unwrap();
        }
    }

    /// The binary with these arguments. This user runs it, and may have at most this many threads
    /// in total.
    pub fn pnet_nat(&self, threads: Option<usize>, arguments: &[&str]) -> Command {
        let mut command = Command::new("prlimit");
        command.args(threads.map(|most| format!("--nproc={most}:{most}")));
        let (user, group) = (format!("--reuid={}", self.user), format!("--regid={}", self.user));
        command.args(["setpriv", &user, &group, "--clear-groups"]);
        command.arg(self.folder.path().join("pnet-nat")).args(arguments);
        command
    }
}
