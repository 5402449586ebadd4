//! Landlock: restricts which files the process can read. The rest of the file system, new TCP
//! connections and other processes are out of its reach.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use landlock::{
    ABI, Access, AccessFs, AccessNet, BitFlags, LandlockStatus, PathBeneath, PathFd, Ruleset,
    RulesetAttr, RulesetCreatedAttr, RulesetError, RulesetStatus, Scope,
};

use super::State;

/// The Landlock version that is asked for. An older kernel gives what it has. Raise it only after a
/// test with the new version.
const KNOWN: ABI = ABI::V7;

/// The folder and the files that the `process_*` metrics are made from.
const OWN_FOLDER: &str = "/proc/self";
const OWN_FILES: [&str; 2] = ["/proc/stat", "/proc/sys/kernel/osrelease"];

/// Files in /proc that Landlock permits. They have to stay open: the kernel forgets a file in /proc
/// that nobody has open, and when it makes the file again, the permission is lost.
#[derive(Debug, Default)]
pub(super) struct OwnFigures(Vec<(PathFd, BitFlags<AccessFs>)>);

impl OwnFigures {
    /// Opens those that exist. A container may have no /proc.
    fn open() -> Self {
        let folder = [(OWN_FOLDER, AccessFs::ReadFile | AccessFs::ReadDir)];
        let files = OWN_FILES.map(|path| (path, AccessFs::ReadFile.into()));
        let open = |(path, access)| Some((PathFd::new(path).ok()?, access));
        Self(folder.into_iter().chain(files).filter_map(open).collect())
    }
}

/// Confines the calling thread, and all threads that it starts later, to what is [`Readable`].
pub(super) fn confine(readable: &Readable) -> (State, OwnFigures) {
    let own_figures = OwnFigures::open();
    let state = restrict(readable, &own_figures).unwrap_or_else(State::Missing);
    (state, own_figures)
}

fn restrict(readable: &Readable, own_figures: &OwnFigures) -> Result<State, String> {
    let open = |path| PathFd::new(path).map_err(|error| error.to_string());
    let readable = readable.folders.iter().chain(&readable.files);
    let readable: Vec<_> = readable.map(open).collect::<Result<_, _>>()?;
    let readable = readable.iter().map(|path| PathBeneath::new(path, AccessFs::ReadFile));
    let figures = own_figures.0.iter().map(|(figure, access)| PathBeneath::new(figure, *access));
    let status = Ruleset::default()
        .handle_access(AccessFs::from_all(KNOWN))
        .and_then(|rules| rules.handle_access(AccessNet::from_all(KNOWN)))
        .and_then(|rules| rules.scope(Scope::from_all(KNOWN)))
        .and_then(Ruleset::create)
        .and_then(|rules| rules.add_rules(readable.chain(figures).map(Ok::<_, RulesetError>)))
        .and_then(|rules| rules.restrict_self())
        .map_err(|error| error.to_string())?;
    Ok(match (status.ruleset, status.landlock) {
        (RulesetStatus::FullyEnforced, _) => State::On,
        (_, LandlockStatus::NotImplemented) => State::Missing("not in this kernel".into()),
        (_, LandlockStatus::NotEnabled) => {
            State::Missing("switched off in this kernel (lsm= of its command line)".into())
        }
        (RulesetStatus::NotEnforced, _) => State::Missing("the kernel refuses it".into()),
        (RulesetStatus::PartiallyEnforced, LandlockStatus::Available { effective_abi, .. }) => {
            State::Partly(format!("an older kernel: ABI {effective_abi:?} of {KNOWN:?}"))
        }
    })
}

/// The folders and files that the process may read.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Readable {
    /// Folders with all files that are or will be in them.
    folders: BTreeSet<PathBuf>,
    /// Files as they are now. A file that replaces one of them is not readable.
    files: BTreeSet<PathBuf>,
}

impl Readable {
    /// Finds the folders that contain the files, so that files which replace them are readable too.
    /// These are the folders in the files' paths, and the folders that links lead to if those are
    /// others. If such a folder is `/` or directly below `/`, like `/etc`, it contains files of the
    /// whole system. Then only the file itself is readable.
    pub(super) fn of(files: &[PathBuf]) -> Self {
        let mut readable = Self::default();
        let real = files.iter().filter_map(|file| fs::canonicalize(file).ok());
        for file in files.iter().cloned().chain(real) {
            let folder = file.parent().filter(|folder| *folder != Path::new(""));
            let folder = folder.unwrap_or(Path::new("."));
            let folder = fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
            if folder.ancestors().nth(2).is_some() {
                readable.folders.insert(folder);
            } else {
                readable.files.insert(fs::canonicalize(&file).unwrap_or(file));
            }
        }
        let all = readable.folders.clone();
        let is_within = |path: &Path| path.ancestors().skip(1).any(|above| all.contains(above));
        readable.folders.retain(|folder| !is_within(folder));
        readable.files.retain(|file| !is_within(file));
        readable
    }

    /// Whether everything that is or will be in this folder can be read. The folder has to be given
    /// by its real path.
    pub(super) fn has_all_of(&self, folder: &Path) -> bool {
        folder.ancestors().any(|folder| self.folders.contains(folder))
    }

    /// The files that cannot be replaced while the relay runs.
    pub(super) fn files(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(PathBuf::as_path)
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn folders_are_those_of_names_and_of_where_links_lead() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path().canonicalize().unwrap();
        let (etc, run) = (root.join("etc"), root.join("run"));
        for folder in ["etc/secrets/..1", "run/secrets"] {
            fs::create_dir_all(root.join(folder)).unwrap();
        }
        for file in ["etc/relay.toml", "etc/secrets/..1/a", "run/secrets/b"] {
            fs::write(root.join(file), "").unwrap();
        }
        symlink("..1", etc.join("secrets/..data")).unwrap();
        symlink("..data/a", etc.join("secrets/a")).unwrap();
        symlink(run.join("secrets/b"), etc.join("secrets/b")).unwrap();

        let secrets = [etc.join("secrets/a"), etc.join("secrets/b")];
        let folders = |files: &[PathBuf]| {
            let Readable { folders, files } = Readable::of(files);
            assert_eq!(files, BTreeSet::new());
            folders
        };
        let found = folders(&secrets);
        assert_eq!(found, BTreeSet::from([etc.join("secrets"), run.join("secrets")]));
        let found = folders(&[secrets.as_slice(), &[etc.join("relay.toml")]].concat());
        assert_eq!(found, BTreeSet::from([etc, run.join("secrets")]));
        assert_eq!(
            folders(&["relay.toml".into()]),
            BTreeSet::from([std::env::current_dir().unwrap()])
        );
    }

    #[test]
    fn a_folder_of_everybodys_is_not_opened_as_a_whole() {
        let root = tempfile::tempdir().unwrap();
        let linked = root.path().canonicalize().unwrap().join("relay.toml");
        symlink("/etc/hosts", &linked).unwrap();
        let files: Vec<_> = ["/relay.toml", "/etc/passwd", "/etc/pnet-nat/secrets/a"]
            .map(PathBuf::from)
            .into_iter()
            .chain([linked.clone()])
            .collect();
        let expected = Readable {
            folders: BTreeSet::from([
                "/etc/pnet-nat/secrets".into(),
                linked.parent().unwrap().into(),
            ]),
            files: ["/relay.toml", "/etc/passwd", "/etc/hosts"].map(PathBuf::from).into(),
        };
        assert_eq!(Readable::of(&files), expected);
    }
}
