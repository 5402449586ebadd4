//! Password files: exactly 8 octets of any value, in a file that only its owner can write and nobody
//! beyond owner and group can read. Token files are opened by the same rules.
//!
//! Only a few octets more than a password are read, buffers are wiped, and no error shows an octet.

use std::fs::File;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use nix::unistd::geteuid;
use zeroize::Zeroizing;

use crate::pnet::wire::Password;

use super::file::{self, FileError, is_read_only, shell_quoted};
use super::odd::oddities;
use super::toml_table::Entry;

const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";
/// One octet more than a password with a byte order mark and a line break.
const MOST_READ: usize = Password::LEN + 6;
/// Mode bits that are refused: others have access, or the group can write or execute. The group may
/// read: that is how Kubernetes gives a secret to a process that is not root.
const OPEN_TO_OTHERS: u32 = 0o027;

/// Why a password file is refused.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SecretError {
    #[error("{path:?} {source}")]
    File { path: PathBuf, source: FileError },
    #[error("{path:?} is open to others (mode {mode:03o})")]
    Exposed { path: PathBuf, mode: u32 },
    #[error("{path:?} has {octets} octets, and a password has 8")]
    TooShort { path: PathBuf, octets: usize },
    #[error("{0:?} has more than the 8 octets of a password")]
    TooLong(PathBuf),
    #[error("{0:?} begins with a byte order mark, three octets that an editor put there")]
    Marked(PathBuf),
    #[error("{path:?} has a line break ({kind}) after the 8 octets of the password")]
    LineBreak { path: PathBuf, kind: &'static str },
}

impl SecretError {
    pub(super) fn is_absent(&self) -> bool {
        matches!(self, Self::File { source, .. } if source.is_absent())
    }

    /// What the user can do; none when only a new file helps.
    fn remedy_for(&self) -> Option<String> {
        match self {
            Self::File { source, .. } if source.is_absent() => None,
            Self::File { path, source } => Some(source.remedy(path)),
            Self::Exposed { path, .. } if is_read_only(path) => {
                let user = geteuid();
                Some(format!(
                    "it is mounted read-only: have the secret mounted with mode=0400,uid={user}"
                ))
            }
            Self::Exposed { path, .. } => {
                Some(format!("run `chmod 600 -- {}`", shell_quoted(path)))
            }
            Self::LineBreak { path, .. } => {
                let file = shell_quoted(path);
                Some(format!("remove it: `truncate --size=8 {file}`"))
            }
            Self::TooShort { .. } | Self::TooLong(_) | Self::Marked(_) => None,
        }
    }

    /// What to do when the net's password is known, and only its file is wrong.
    pub(crate) fn remedy(&self) -> String {
        self.remedy_for().unwrap_or_else(|| match self {
            Self::File { .. } => "name the file that holds the net's password".into(),
            _ => "write the 8 octets of the net's password into it and nothing else".into(),
        })
    }
}

/// A command that writes a new, random password of 8 characters into a file.
pub(super) fn make_password(path: &Path) -> String {
    // What begins with a hyphen would be an option.
    let path = if path.as_os_str().as_encoded_bytes().starts_with(b"-") {
        &Path::new(".").join(path)
    } else {
        path
    };
    format!("`pnet-nat password {}`", shell_quoted(path))
}

/// A shell command that writes the output of another one into a file that only its owner can read. Makes
/// the folder if there is none.
pub(super) fn make(path: &Path, output: &str) -> String {
    let folder = path.parent().filter(|folder| *folder != Path::new("") && !folder.exists());
    let folder = folder.map(|folder| format!("mkdir -p -m 700 -- {} && ", shell_quoted(folder)));
    format!("`(umask 077; {}{output} > {})`", folder.unwrap_or_default(), shell_quoted(path))
}

/// The password of clients in the file that `entry` names, relative to the folder of the configuration.
pub(super) fn password_file(entry: &Entry<'_>) -> Option<Password> {
    read_entry(entry, |path| format!("make one of 8 random characters: {}", make_password(path)))
}

/// The password that the servers expect; it was set on the devices.
pub(super) fn device_password_file(entry: &Entry<'_>) -> Option<Password> {
    read_entry(entry, |path| {
        let command = make(path, "IFS= read -r password; printf %s \"$password\"");
        format!("run {command}, and type the 8 characters that the servers expect")
    })
}

fn read_entry(entry: &Entry<'_>, write_anew: impl Fn(&Path) -> String) -> Option<Password> {
    let path = path(entry)?;
    match read_password(path.clone()) {
        Ok(password) => {
            if let Some(oddities) = oddities(&password) {
                let remedy = format!("unless that is intended, {}", write_anew(&path));
                entry.warn(format!("a password that looks mistyped: {oddities}"), remedy);
            }
            Some(password)
        }
        Err(error) => {
            let remedy = error.remedy_for().unwrap_or_else(|| write_anew(&path));
            entry.fault(error.to_string(), remedy);
            None
        }
    }
}

/// The path that `entry` names.
pub(super) fn path_of(entry: &Entry<'_>) -> Option<PathBuf> {
    let folder = entry.report.file.parent().unwrap_or(Path::new(""));
    Some(folder.join(entry.text()?))
}

/// The same path; also remembers it as one of the configuration's files.
pub(super) fn path(entry: &Entry<'_>) -> Option<PathBuf> {
    let path = path_of(entry)?;
    entry.report.secrets.borrow_mut().push(path.clone());
    Some(path)
}

/// PAS 11, A11: a password is 8 octets, neither padded nor cut.
pub(crate) fn read_password(path: PathBuf) -> Result<Password, SecretError> {
    let mut octets = Zeroizing::new([0; MOST_READ]);
    let read = match file::fill(&mut open(&path)?, octets.as_mut_slice()) {
        Ok(read) => &octets[..read],
        Err(error) => return Err(SecretError::File { path, source: error.into() }),
    };
    let Some((password, rest)) = read.split_at_checked(Password::LEN) else {
        return Err(SecretError::TooShort { path, octets: read.len() });
    };
    match rest {
        [] => Ok(self::password(password)),
        b"\n" => Err(SecretError::LineBreak { path, kind: "LF" }),
        b"\r\n" => Err(SecretError::LineBreak { path, kind: "CR LF" }),
        b"\r" => Err(SecretError::LineBreak { path, kind: "CR" }),
        _ if password.starts_with(BYTE_ORDER_MARK) => Err(SecretError::Marked(path)),
        _ => Err(SecretError::TooLong(path)),
    }
}

/// Opens a file; refuses it when others have access.
pub(super) fn open(path: &Path) -> Result<File, SecretError> {
    let unreadable = |source| SecretError::File { path: path.to_owned(), source };
    let (file, metadata) = file::open(path).map_err(unreadable)?;
    let mode = metadata.mode() & 0o777;
    if mode & OPEN_TO_OTHERS != 0 {
        return Err(SecretError::Exposed { path: path.to_owned(), mode });
    }
    Ok(file)
}

fn password(octets: &[u8]) -> Password {
    let mut password = Zeroizing::new([0; Password::LEN]);
    password.copy_from_slice(octets);
    Password::new(*password)
}
