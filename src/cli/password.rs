//! `pnet-nat password`: makes a password file, or puts a new password into one.
//!
//! Invariant: whoever reads the file finds the old password or the new one, whole, also after a crash. The
//! password is printed with `--show` alone.

use std::ffi::OsStr;
use std::fs::{self, DirBuilder, File, Metadata, OpenOptions, Permissions};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt, fchown};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};
use clap::builder::BoolishValueParser;
use zeroize::Zeroizing;

use super::complain;
use super::output::out;
use crate::config::{new_password, shell_quoted};
use crate::pnet::wire::Password;

/// Make a password: 8 random characters, in a file that only its owner may read.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat password /etc/pnet-nat/secrets/section-1\n\
    The folder is made if it is not there. A password that is there is replaced at once and whole. To change \
    a password and lose no request, make a second one: docs/operations.md has the steps.")]
pub(super) struct Args {
    /// The file; what is in it is lost.
    #[arg(value_name = "FILE")]
    file: PathBuf,

    /// Print the password, alone on the standard output; what there is to say then goes to stderr.
    #[arg(long, env = "PNET_NAT_SHOW", value_parser = BoolishValueParser::new())]
    show: bool,
}

/// Makes the password and says what to do next.
pub(super) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let path = &args.file;
    let octets = make(path).with_context(|| format!("{path:?} gets no password"))?;
    let file = shell_quoted(path);
    let said = format!(
        "{file} has a new password of 8 random characters. Its owner sees it with `cat {file}`.\n\
         A relay that is at work takes it with `pnet-nat reload`. Under systemd, where it reads copies of its \
         start, that takes `systemctl restart pnet-nat`."
    );
    if args.show {
        complain(format_args!("{said}"));
        out().write_all(octets.as_slice())?;
        writeln!(out())?;
    } else {
        writeln!(out(), "{said}")?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Puts a new password into a file and returns it. A file that is there keeps its owner and its group, and
/// with the group its right to read, by which a relay that is not root may read it.
pub(super) fn make(path: &Path) -> anyhow::Result<Zeroizing<[u8; Password::LEN]>> {
    let path = &target(path)?;
    let old = match fs::metadata(path) {
        Ok(old) if !old.is_file() => bail!("it is not a regular file"),
        Ok(old) => Some(old),
        Err(error) if error.kind() == ErrorKind::NotFound => None,
        Err(error) => return Err(error.into()),
    };
    let folder = path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    make_folder(folder)?;
    let name = path.file_name().and_then(OsStr::to_str).unwrap_or("password");
    let beside = folder.join(format!(".{name}.{:08x}", getrandom::u32()?));
    let octets = new_password()?;
    let done = write(&beside, octets.as_slice(), old.as_ref()).and_then(|()| {
        fs::rename(&beside, path)?;
        // The new name is on the disk, too.
        File::open(folder)?.sync_all()
    });
    if let Err(error) = done {
        // It may not be there.
        let _ = fs::remove_file(&beside);
        return Err(error.into());
    }
    Ok(octets)
}

/// Makes a folder, and those around it, for its owner alone. One that is there stays as it is.
pub(super) fn make_folder(folder: &Path) -> anyhow::Result<()> {
    let made = DirBuilder::new().recursive(true).mode(0o700).create(folder);
    made.with_context(|| format!("the folder {folder:?} cannot be made"))
}

/// The file itself where the path is a link, which stays one.
fn target(path: &Path) -> anyhow::Result<PathBuf> {
    if fs::symlink_metadata(path).is_ok_and(|found| found.is_symlink()) {
        return fs::canonicalize(path).context("it is a link that leads nowhere");
    }
    Ok(path.to_owned())
}

/// Writes a password into a new file, with the rights of the old one.
fn write(path: &Path, octets: &[u8], old: Option<&Metadata>) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?;
    let group_reads = old.map(|old| group_reads(&file, old)).transpose()?.unwrap_or(0);
    file.set_permissions(Permissions::from_mode(0o600 | group_reads))?;
    file.write_all(octets)?;
    file.sync_all()
}

/// Gives the file the owner and the group of the old one, as far as that may be, and returns the mode bit by
/// which its group reads it. Another group than the old one gets no right.
fn group_reads(file: &File, old: &Metadata) -> io::Result<u32> {
    let theirs = (old.uid(), old.gid());
    if fchown(file, Some(old.uid()), Some(old.gid())).is_err() {
        // Whoever owns a file may give it to a group of his own; that it did not go is seen below.
        let _ = fchown(file, None, Some(old.gid()));
    }
    let new = file.metadata()?;
    let ours = (new.uid(), new.gid());
    if ours != theirs {
        complain(format_args!(
            "warning: only root gives files away: the file was of user {} and group {}, and is now of user {} \
             and group {}",
            theirs.0, theirs.1, ours.0, ours.1
        ));
    }
    Ok(if ours.1 == theirs.1 { old.mode() & 0o040 } else { 0 })
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{chown, symlink};

    use nix::unistd::geteuid;

    use super::*;
    use crate::config::read_password;

    fn octets(path: &Path) -> Vec<u8> {
        let octets = fs::read(path).unwrap();
        assert!(read_password(path.to_owned()).is_ok(), "the relay would take it");
        octets
    }

    #[test]
    fn a_password_is_made_with_its_folder_and_replaced_whole() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("plant/secrets/section-1");
        make(&file).unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().mode() & 0o777;
        assert_eq!((mode(&file), mode(file.parent().unwrap())), (0o600, 0o700));
        let (first, held) = (octets(&file), File::open(&file).unwrap());
        make(&file).unwrap();
        assert_ne!(octets(&file), first);
        assert_eq!(held.metadata().unwrap().nlink(), 0, "the old file was not written to");
        let left: Vec<_> = fs::read_dir(file.parent().unwrap()).unwrap().collect();
        assert_eq!(left.len(), 1, "nothing stays beside it: {left:?}");
    }

    #[test]
    fn rights_stay_as_far_as_the_relay_takes_them() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("section-1");
        for (before, after) in [(0o640, 0o640), (0o666, 0o640), (0o400, 0o600), (0o604, 0o600)] {
            fs::write(&file, "k7Zq+4Lx").unwrap();
            fs::set_permissions(&file, Permissions::from_mode(before)).unwrap();
            if geteuid().is_root() {
                chown(&file, Some(65533), Some(65534)).unwrap();
            }
            make(&file).unwrap();
            let found = fs::metadata(&file).unwrap();
            assert_eq!(found.mode() & 0o777, after, "{before:o}");
            if geteuid().is_root() {
                assert_eq!((found.uid(), found.gid()), (65533, 65534));
            }
            octets(&file);
        }
    }

    #[test]
    fn a_link_stays_a_link_and_what_is_no_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("real"), "").unwrap();
        symlink("real", at("link")).unwrap();
        symlink("nowhere", at("dangling")).unwrap();
        make(&at("link")).unwrap();
        assert!(fs::symlink_metadata(at("link")).unwrap().is_symlink());
        octets(&at("real"));
        for refused in [at("dangling"), folder.path().to_owned(), "/dev/null".into()] {
            assert!(make(&refused).is_err(), "{refused:?}");
        }
        assert!(make(&at("real/secrets/section-1")).is_err(), "beyond a file");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
    }
}
