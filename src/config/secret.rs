//! Password files: 8 opaque octets, closed to others than their owner and group. Token files are
//! opened by the same rules.
//!
//! At most 9 octets are read, buffers are wiped, and no error tells an octet.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use zeroize::Zeroizing;

use crate::wire::Password;

use super::section::Entry;

const NEWLINE: u8 = b'\n';
/// Others can do anything with it, or the group can write it. A group that reads is how Kubernetes
/// hands a secret to a process that is not root.
const OPEN_TO_OTHERS: u32 = 0o027;

/// Why a password file is refused.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SecretError {
    #[error("{path:?} cannot be read: {source}")]
    Unreadable { path: PathBuf, source: io::Error },
    #[error("{0:?} is not a regular file")]
    NotAFile(PathBuf),
    #[error("{path:?} is open to others (mode {mode:03o})")]
    Exposed { path: PathBuf, mode: u32 },
    #[error("{path:?} has {octets} octets, and a password has 8")]
    TooShort { path: PathBuf, octets: usize },
    #[error("{0:?} has more than the 8 octets of a password")]
    TooLong(PathBuf),
    #[error("{0:?} has a line break after the 8 octets of the password")]
    Newline(PathBuf),
}

impl SecretError {
    /// What the user can do.
    pub(crate) fn remedy(&self) -> String {
        match self {
            Self::Unreadable { path, source } if source.kind() == io::ErrorKind::NotFound => {
                format!("write its 8 octets: {}", write_command(path))
            }
            Self::Unreadable { .. } => {
                "let the user that runs pnet-nat own it; a running relay reads \
                only folders that its configuration named when it started"
                    .to_owned()
            }
            Self::NotAFile(_) => "name a file that holds nothing else".to_owned(),
            Self::Exposed { path, .. } => format!("run `chmod 600 {path:?}`"),
            Self::TooShort { path, .. } | Self::TooLong(path) => {
                format!("write exactly 8 octets: {}", write_command(path))
            }
            Self::Newline(path) => {
                format!("write it without the line break: {}", write_command(path))
            }
        }
    }
}

/// Paths are shown escaped: the configuration may hold any character in one.
fn write_command(path: &Path) -> String {
    format!("`(umask 077; printf %s 'PASSWORD' > {path:?})`")
}

/// The password in the file that `entry` names, relative to the folder of the configuration.
pub(super) fn password_file(entry: &Entry<'_>) -> Option<Password> {
    let path = path(entry)?;
    let fault = |err: SecretError| entry.fault(err.to_string(), err.remedy());
    read_password(path).map_err(fault).ok()
}

/// The path that `entry` names, which is remembered as one of the configuration's files.
pub(super) fn path(entry: &Entry<'_>) -> Option<PathBuf> {
    let folder = entry.report.file.parent().unwrap_or(Path::new(""));
    let path = folder.join(entry.text()?);
    entry.report.secrets.borrow_mut().push(path.clone());
    Some(path)
}

/// PAS 11, A11: a password is 8 octets, neither padded nor cut.
pub(crate) fn read_password(path: PathBuf) -> Result<Password, SecretError> {
    let mut octets = Zeroizing::new([0; Password::LEN + 1]);
    match fill(&mut open(&path)?, octets.as_mut_slice()) {
        Ok(Password::LEN) => Ok(password(&octets)),
        Ok(octets) if octets < Password::LEN => Err(SecretError::TooShort { path, octets }),
        Ok(_) if octets[Password::LEN] == NEWLINE => Err(SecretError::Newline(path)),
        Ok(_) => Err(SecretError::TooLong(path)),
        Err(source) => Err(SecretError::Unreadable { path, source }),
    }
}

/// Opens a file that is closed to others.
pub(super) fn open(path: &Path) -> Result<File, SecretError> {
    // Without O_NONBLOCK, opening a named pipe would wait for a writer.
    let file = OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path);
    let unreadable = |source| SecretError::Unreadable { path: path.to_owned(), source };
    let (metadata, file) =
        file.and_then(|file| Ok((file.metadata()?, file))).map_err(unreadable)?;
    let mode = metadata.mode() & 0o777;
    if !metadata.is_file() {
        return Err(SecretError::NotAFile(path.to_owned()));
    }
    if mode & OPEN_TO_OTHERS != 0 {
        return Err(SecretError::Exposed { path: path.to_owned(), mode });
    }
    Ok(file)
}

fn password(octets: &[u8; Password::LEN + 1]) -> Password {
    let mut password = Zeroizing::new([0; Password::LEN]);
    password.copy_from_slice(&octets[..Password::LEN]);
    Password::new(*password)
}

/// Reads until the buffer is full or the file at its end.
pub(super) fn fill(reader: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match reader.read(&mut buffer[filled..]) {
            Ok(0) => break,
            Ok(octets) => filled += octets,
            Err(err) if err.kind() == io::ErrorKind::Interrupted => {}
            Err(err) => return Err(err),
        }
    }
    Ok(filled)
}
