//! Finds links to folders in the paths of the files that a relay reads. When such a link is changed
//! later, it may lead out of the folders to which the relay was confined at its start.

use std::collections::{BTreeSet, VecDeque};
use std::fmt;
use std::fs;
use std::path::{Component, Path, PathBuf};

use super::files::Readable;

/// The kernel follows at most this many links in one path.
const MOST_LINKS: usize = 40;
/// Links in these folders belong to the system, like `/var/run`. Nobody changes them.
const SYSTEM: [&str; 2] = ["/", "/var"];

/// A file, and a link to a folder in the path of this file.
#[derive(Debug, PartialEq, Eq)]
pub struct MovableLink {
    file: PathBuf,
    link: PathBuf,
    folder: PathBuf,
}

impl fmt::Display for MovableLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, link, folder } = self;
        let [file, link, folder] = [file, link, folder].map(|path| path.display());
        write!(
            f,
            "{file}: is reached by the link {link} to the folder {folder}: once the link leads \
             elsewhere, a relay that runs cannot read it, for it is confined to the folders of its \
             start; keep the files in one real folder and replace them there by renaming, or restart \
             the relay each time"
        )
    }
}

/// The links to folders that may lead a relay out of the folders that it may read, once they are
/// changed. Each link is in the list once.
pub fn movable_links(files: &[PathBuf]) -> Vec<MovableLink> {
    let readable = Readable::of(files);
    let mut known = BTreeSet::new();
    let mut found = Vec::new();
    for file in files {
        for (link, folder) in folder_links(file) {
            // The next version is expected to stand next to this one, as the kubelet arranges them.
            let beside = folder.parent().unwrap_or(&folder);
            if !readable.has_all_of(beside) && known.insert(link.clone()) {
                found.push(MovableLink { file: file.clone(), link, folder });
            }
        }
    }
    found
}

/// The links to folders in the path of a file, and where they lead now.
fn folder_links(file: &Path) -> Vec<(PathBuf, PathBuf)> {
    let mut found = Vec::new();
    let mut followed = 0;
    let Ok(mut reached) = std::env::current_dir().and_then(fs::canonicalize) else { return found };
    let mut rest: VecDeque<_> = file.components().map(|part| part.as_os_str().to_owned()).collect();
    while let Some(part) = rest.pop_front() {
        match Path::new(&part).components().next() {
            Some(Component::RootDir) => reached = "/".into(),
            Some(Component::ParentDir) => drop(reached.pop()),
            Some(Component::Normal(name)) => {
                let path = reached.join(name);
                let Ok(target) = fs::read_link(&path) else {
                    reached = path;
                    continue;
                };
                followed += 1;
                if followed > MOST_LINKS {
                    break;
                }
                let leads_to = fs::canonicalize(&path).ok().filter(|folder| folder.is_dir());
                if let Some(folder) = leads_to
                    && !SYSTEM.iter().any(|system| reached == Path::new(system))
                {
                    found.push((path, folder));
                }
                for part in target.components().rev() {
                    rest.push_front(part.as_os_str().to_owned());
                }
            }
            _ => {}
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    fn links(files: &[&Path]) -> Vec<PathBuf> {
        let files: Vec<_> = files.iter().map(|file| file.to_path_buf()).collect();
        movable_links(&files).into_iter().map(|found| found.link).collect()
    }

    #[test]
    fn a_link_to_a_release_is_told_once() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path().canonicalize().unwrap();
        fs::create_dir_all(root.join("releases/1/secrets")).unwrap();
        let real = root.join("releases/1/relay.toml");
        for file in ["releases/1/relay.toml", "releases/1/secrets/a"] {
            fs::write(root.join(file), "").unwrap();
        }
        let current = root.join("current");
        symlink("releases/1", &current).unwrap();
        let by_link = current.join("relay.toml");
        assert_eq!(links(&[&by_link, &current.join("secrets/a")]), [current.as_path()]);
        assert_eq!(links(&[&real]), [""; 0].map(PathBuf::from));

        // The file is reached through a link to the file, or through a link to the link.
        let (file, again) = (root.join("relay.toml"), root.join("again"));
        symlink("current/relay.toml", &file).unwrap();
        symlink("current", &again).unwrap();
        let outside = tempfile::tempdir().unwrap();
        let outside = outside.path().canonicalize().unwrap().join("relay.toml");
        symlink(&file, &outside).unwrap();
        assert_eq!(links(&[&outside]), [current.as_path()]);
        assert_eq!(links(&[&again.join("relay.toml")]), [again, current]);
        // When the file is in the folder that contains all releases, no link leads out.
        assert_eq!(links(&[&file]), [""; 0].map(PathBuf::from));

        let ring = root.join("ring");
        symlink("ring", &ring).unwrap();
        assert_eq!(links(&[&ring.join("relay.toml")]), [""; 0].map(PathBuf::from));
    }

    /// A Kubernetes volume: `..data` is changed, but within a folder that the relay may read.
    #[test]
    fn links_that_stay_within_the_folder_are_left_alone() {
        let root = tempfile::tempdir().unwrap();
        fs::create_dir_all(root.path().join("..1/secrets")).unwrap();
        for file in ["..1/relay.toml", "..1/secrets/a"] {
            fs::write(root.path().join(file), "").unwrap();
        }
        for (to, link) in
            [("..1", "..data"), ("..data/relay.toml", "relay.toml"), ("..data/secrets", "secrets")]
        {
            symlink(to, root.path().join(link)).unwrap();
        }
        let files = ["relay.toml", "secrets/a"].map(|file| root.path().join(file));
        assert_eq!(links(&[&files[0], &files[1]]), [""; 0].map(PathBuf::from));
    }
}
