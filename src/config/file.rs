//! Opens the files of the configuration: only regular ones, and without waiting.
//!
//! A path may lead to anything, also at a reload. Opening a pipe that nobody writes to must not delay the
//! withdrawal of a password.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::Path;

use nix::sys::statvfs::{FsFlags, statvfs};
use nix::unistd::{getegid, geteuid};

/// Why a file is not read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FileError {
    #[error("cannot be read: {0}")]
    Io(#[from] io::Error),
    #[error("is {0}, not a regular file")]
    NotRegular(&'static str),
    #[error(
        "is an old file that is in no folder any more: it was replaced at its source, but the file \
         mounted here is still the old one; nothing has changed"
    )]
    Replaced,
    #[error("cannot be read: its mode allows it, but the relay's confinement does not")]
    Confined,
}

impl FileError {
    pub(crate) fn is_absent(&self) -> bool {
        matches!(self, Self::Io(error) if error.kind() == io::ErrorKind::NotFound)
    }

    /// What the user can do about this file.
    pub(crate) fn remedy(&self, path: &Path) -> String {
        match self {
            Self::Io(error) if error.kind() == io::ErrorKind::PermissionDenied => owner(path),
            Self::Io(_) => "name a file that is there and can be read".into(),
            Self::NotRegular(_) => "name a file".into(),
            Self::Replaced => {
                "mount the folder that the file is in instead of the file itself; for now, restart"
                    .into()
            }
            Self::Confined => "restart the relay; it can read only the folders that its files were in \
                               when it started, and links lead elsewhere now. To replace files without a \
                               restart, keep the files in one real folder and rename new ones into it"
                .into(),
        }
    }
}

/// The remedy when another user owns the file.
fn owner(path: &Path) -> String {
    let (user, file) = (geteuid(), shell_quoted(path));
    if is_read_only(path) {
        return format!("mount it for the user who reads it: mode=0400,uid={user}");
    }
    format!(
        "give it to user {user}, who reads it, and let that user enter its folders: \
         `chown {user} -- {file} && chmod 600 -- {file}`"
    )
}

/// Whether the path is on a read-only mount, so that its mode cannot be changed.
pub(super) fn is_read_only(path: &Path) -> bool {
    statvfs(path).is_ok_and(|mount| mount.flags().contains(FsFlags::ST_RDONLY))
}

/// Opens a regular file.
pub(super) fn open(path: &Path) -> Result<(File, Metadata), FileError> {
    let (file, metadata) = open_once(path)?;
    if metadata.nlink() > 0 {
        return Ok((file, metadata));
    }
    // It may have been replaced between the two calls.
    let again = open_once(path)?;
    if again.1.nlink() == 0 { Err(FileError::Replaced) } else { Ok(again) }
}

fn open_once(path: &Path) -> Result<(File, Metadata), FileError> {
    // Checked before, since opening some devices has effects; and after, since it may be another file.
    let before = fs::metadata(path)?;
    regular(&before)?;
    // Without O_NONBLOCK, opening a named pipe would wait for a writer.
    let file = OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path);
    let file = file.map_err(|error| match error.kind() {
        io::ErrorKind::PermissionDenied if may_read(&before) => FileError::Confined,
        _ => error.into(),
    })?;
    let metadata = file.metadata()?;
    regular(&metadata)?;
    Ok((file, metadata))
}

fn regular(metadata: &Metadata) -> Result<(), FileError> {
    let kind = metadata.file_type();
    let what = match kind {
        kind if kind.is_file() => return Ok(()),
        kind if kind.is_dir() => "a folder",
        kind if kind.is_fifo() => "a named pipe",
        kind if kind.is_socket() => "a socket",
        _ => "a device",
    };
    Err(FileError::NotRegular(what))
}

/// Whether the mode lets this process read.
fn may_read(metadata: &Metadata) -> bool {
    let (user, group) = (geteuid().as_raw(), getegid().as_raw());
    let bit = match () {
        () if metadata.uid() == user => 0o400,
        () if metadata.gid() == group => 0o040,
        () => 0o004,
    };
    metadata.mode() & bit != 0
}

/// Reads until the buffer is full or the file ends.
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

/// A path quoted for a shell. A path with control characters needs the `$'…'` of bash and others.
pub(crate) fn shell_quoted(path: &Path) -> String {
    let text = path.to_string_lossy();
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+,:@%".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        text.into_owned()
    } else if text.chars().any(char::is_control) {
        format!("$'{}'", text.escape_default())
    } else {
        format!("'{}'", text.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use std::os::fd::AsRawFd;
    use std::os::unix::net::UnixListener;

    use nix::sys::stat::Mode;
    use nix::unistd::mkfifo;

    use super::*;

    #[test]
    fn only_regular_files_are_opened_and_none_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let [pipe, socket, file] = ["pipe", "socket", "file"].map(|name| folder.path().join(name));
        mkfifo(&pipe, Mode::S_IRWXU).unwrap();
        let _listener = UnixListener::bind(&socket).unwrap();
        fs::write(&file, "octets").unwrap();
        assert!(open(&file).is_ok());
        for (path, what) in [
            (pipe.as_path(), "a named pipe"),
            (&socket, "a socket"),
            (folder.path(), "a folder"),
            (Path::new("/dev/null"), "a device"),
        ] {
            let error = open(path).unwrap_err();
            assert_eq!(error.to_string(), format!("is {what}, not a regular file"));
        }
        assert!(open(&folder.path().join("absent")).unwrap_err().is_absent());
    }

    /// As a file that is mounted by itself is, once another has taken its place on the host.
    #[test]
    fn a_file_that_is_in_no_folder_is_told_from_the_new_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, "old").unwrap();
        let held = File::open(&path).unwrap();
        let held_path = format!("/proc/self/fd/{}", held.as_raw_fd());
        assert!(open(Path::new(&held_path)).is_ok());
        fs::write(folder.path().join("new"), "new").unwrap();
        fs::rename(folder.path().join("new"), &path).unwrap();
        assert!(matches!(open(Path::new(&held_path)), Err(FileError::Replaced)));
        assert!(open(&path).is_ok());
    }

    #[test]
    fn a_path_is_quoted_as_a_shell_takes_it() {
        let quoted = |path: &str| shell_quoted(Path::new(path));
        assert_eq!(quoted("/etc/pnet-nat/secrets/a.1"), "/etc/pnet-nat/secrets/a.1");
        for path in ["a b", "it's", "$HOME`id`", "~/x", "", "a\nb\t'c'\\"] {
            let command = format!("printf %s {}", quoted(path));
            let output = std::process::Command::new("bash").args(["-c", &command]).output();
            assert_eq!(output.unwrap().stdout, path.as_bytes(), "{command}");
        }
    }
}
