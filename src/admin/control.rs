//! The control socket: a Unix socket with the admin server's API for the commands on this host.
//!
//! It needs no token. The mode of its file says who may connect: the user and the group of the relay.

use std::env;
use std::fs::{self, Permissions};
use std::io::{self, ErrorKind};
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};

use nix::unistd::geteuid;
use socket2::{Domain, SockAddr, Socket, Type};

/// The name of the socket in the folder that systemd makes for the service.
pub const FILE_NAME: &str = "control.sock";

/// Read and write, which connecting needs, for user and group.
const MODE: u32 = 0o660;
/// As many connections as may be open.
const BACKLOG: i32 = super::connections::MOST as i32;

/// Marks a request that came over the control socket.
#[derive(Clone, Copy, Debug)]
pub(super) struct FromControl;

/// Why there is no control socket.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// Somebody listens there.
    #[error(
        "another relay listens on the control socket {0:?}; stop it, or give each relay a socket of its \
         own with [admin] control"
    )]
    InUse(PathBuf),
    /// The file is no socket.
    #[error(
        "{0:?} is no socket, so the control socket does not replace it; remove it, or choose another path \
         in [admin] control"
    )]
    NotASocket(PathBuf),
    /// The system refuses it.
    #[error(
        "the control socket {path:?} cannot be made: {error}; let user {user} make files in that folder \
         (RuntimeDirectory= of the unit), or choose another path in [admin] control"
    )]
    System {
        /// The path of the socket.
        path: PathBuf,
        /// The user that the relay runs as.
        user: nix::unistd::Uid,
        /// What the system says.
        error: io::Error,
    },
}

impl ControlError {
    /// Whether another try may succeed.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::InUse(_) => true,
            Self::NotASocket(_) => false,
            Self::System { error, .. } => crate::listen::may_pass(error),
        }
    }
}

/// The control socket's path where the configuration names none: in the folder that systemd made for
/// this service (`RuntimeDirectory=`), if there is one.
pub fn of_the_service() -> Option<PathBuf> {
    let folders = env::var_os("RUNTIME_DIRECTORY")?;
    let folder = env::split_paths(&folders).find(|folder| folder.is_absolute())?;
    Some(folder.join(FILE_NAME))
}

/// The file of a control socket. When this is dropped after its listener, the file is removed, unless the
/// process is confined or another relay listens there. A file that stays is replaced by the next start.
#[derive(Debug)]
pub struct ControlFile(PathBuf);

impl ControlFile {
    /// Makes a control socket, in the place of one that nobody listens on any more.
    pub fn bind(path: &Path) -> Result<(UnixListener, Self), ControlError> {
        let refused = |error| {
            let path = path.to_owned();
            ControlError::System { path, user: geteuid(), error }
        };
        match fs::symlink_metadata(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(refused(error)),
            Ok(file) if !file.file_type().is_socket() => {
                return Err(ControlError::NotASocket(path.to_owned()));
            }
            Ok(_) if is_alive(path).map_err(refused)? => {
                return Err(ControlError::InUse(path.to_owned()));
            }
            Ok(_) => fs::remove_file(path).map_err(refused)?,
        }
        listen(path).map_err(refused)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for ControlFile {
    fn drop(&mut self) {
        if is_alive(&self.0).is_ok_and(|alive| !alive) {
            // What a confined process may not do, the next start does.
            let _ = fs::remove_file(&self.0);
        }
    }
}

/// Nobody can connect before the mode is set, since connecting needs `listen`.
fn listen(path: &Path) -> io::Result<(UnixListener, ControlFile)> {
    let socket = Socket::new(Domain::UNIX, Type::STREAM.nonblocking(), None)?;
    socket.bind(&SockAddr::unix(path)?)?;
    let file = ControlFile(path.to_owned());
    fs::set_permissions(path, Permissions::from_mode(MODE))?;
    socket.listen(BACKLOG)?;
    Ok((socket.into(), file))
}

/// Whether somebody listens on a socket.
fn is_alive(path: &Path) -> io::Result<bool> {
    let socket = Socket::new(Domain::UNIX, Type::STREAM.nonblocking(), None)?;
    match socket.connect(&SockAddr::unix(path)?) {
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => Ok(false),
        // It has as many connections as it takes at once.
        Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(true),
        outcome => outcome.map(|()| true),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dead_socket_is_replaced_and_a_living_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control.sock");
        drop(UnixListener::bind(&path).unwrap());
        let (listener, file) = ControlFile::bind(&path).unwrap();
        assert_eq!(file.path().metadata().unwrap().permissions().mode() & 0o7777, MODE);
        let error = ControlFile::bind(&path).unwrap_err();
        assert!(matches!(error, ControlError::InUse(_)) && error.may_pass(), "{error}");

        drop(listener);
        let second = ControlFile::bind(&path).unwrap();
        drop(file);
        assert!(path.exists(), "it is another's");
        drop(second);
        assert!(!path.exists());
    }

    #[test]
    fn what_is_no_socket_stays_and_the_remedy_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control.sock");
        fs::write(&path, "of the user").unwrap();
        let error = ControlFile::bind(&path).unwrap_err();
        assert!(matches!(error, ControlError::NotASocket(_)) && !error.may_pass(), "{error}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "of the user");
        let error = ControlFile::bind(&folder.path().join("absent/control.sock")).unwrap_err();
        let told = error.to_string();
        assert!(!error.may_pass() && told.contains("make files in that folder"), "{told}");
    }
}
