//! `pnet-nat password`, and the remedies that name it, pasted as they are printed.

use std::env;
use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::path::Path;
use std::process::Command;

use nix::unistd::geteuid;

use crate::harness::{ANNOTATED, Process, folder, left_out, pnet_nat};

#[test]
fn it_says_what_to_do_next_and_not_the_password() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plant/secrets/section-1");
    let mut last = Vec::new();
    for _ in 0..3 {
        let mut made = Process::start(pnet_nat(&["password", path.to_str().unwrap()]));
        assert_eq!((made.end(), made.stderr().as_str()), (Some(0), ""));
        let octets = fs::read(&path).unwrap();
        assert_eq!((octets.len(), fs::metadata(&path).unwrap().mode() & 0o777), (8, 0o600));
        assert_ne!(octets, last);
        let said = made.stdout();
        assert!(said.contains("`pnet-nat reload`") && said.contains(path.to_str().unwrap()));
        assert!(!said.contains(str::from_utf8(&octets).unwrap()), "{said}");
        last = octets;
    }
}

#[test]
fn it_shows_the_password_to_whoever_asks_and_nothing_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("section-1");
    let mut made = Process::start(pnet_nat(&["password", "--show", path.to_str().unwrap()]));
    assert_eq!(made.end(), Some(0));
    let shown = fs::read_to_string(&path).unwrap();
    assert_eq!(made.stdout(), format!("{shown}\n"));
    assert!(made.stderr().contains("`pnet-nat reload`"), "{}", made.stderr());
    assert!(!made.stderr().contains(&shown));
}

/// Who is not root may give a file to groups of his own alone, and no other group gets to read it.
#[test]
fn another_group_than_before_never_reads_the_password() {
    if !geteuid().is_root() {
        return left_out("root, which becomes another user");
    }
    for (groups, (group, mode)) in
        [("--clear-groups", (65530, 0o600)), ("--groups=65532", (65532, 0o640))]
    {
        let folder = tempfile::tempdir().unwrap();
        fs::set_permissions(folder.path(), Permissions::from_mode(0o777)).unwrap();
        let path = folder.path().join("section-1");
        fs::write(&path, "k7Zq+4Lx").unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o640)).unwrap();
        chown(&path, Some(65533), Some(65532)).unwrap();
        let mut other = Command::new("setpriv");
        other.args(["--reuid=65531", "--regid=65530", groups]);
        other.args([env!("CARGO_BIN_EXE_pnet-nat"), "password"]).arg(&path);
        let mut other = Process::start(other);
        assert_eq!(other.end(), Some(0), "{}", other.stderr());
        assert!(other.stderr().contains("is now of user 65531"), "{}", other.stderr());
        let found = fs::metadata(&path).unwrap();
        assert_eq!((found.gid(), found.mode() & 0o777), (group, mode), "{groups}");
    }
}

#[test]
fn what_gets_no_password_is_named_with_the_reason() {
    let folder = folder("");
    for (path, reason) in
        [("secrets", "not a regular file"), ("pnet-nat.toml/a", "Not a directory")]
    {
        let mut refused = Process::start({
            let mut command = pnet_nat(&["password", path]);
            command.current_dir(folder.path());
            command
        });
        assert_eq!(refused.end(), Some(1));
        let said = refused.stderr();
        assert!(said.contains(path) && said.contains(reason), "{said}");
    }
}

/// What `check` has to say of a configuration in this folder, with its exit code.
fn checked(folder: &Path) -> (Option<i32>, String) {
    let mut command = pnet_nat(&["check", "--config", "pnet-nat.toml"]);
    command.current_dir(folder);
    let mut checked = Process::start(command);
    (checked.end(), checked.stderr())
}

/// Also where the folder is missing, and where the name has to be quoted.
#[test]
fn the_commands_of_the_remedies_work_when_they_are_pasted() {
    let program = Path::new(env!("CARGO_BIN_EXE_pnet-nat")).parent().unwrap();
    let path = format!("{}:{}", program.display(), env::var("PATH").unwrap());
    for (file, octets) in [
        ("secrets/absent", None),
        ("two/folders/absent", None),
        ("it's $HOME/absent", None),
        ("-absent", None),
        ("secrets/seven", Some(&b"s3cr3t-"[..])),
        ("secrets/nine", Some(b"s3cr3t-AB")),
        ("secrets/marked", Some(b"\xef\xbb\xbfs3cr3t-A")),
        ("secrets/guessable", Some(b"Pa55word")),
        ("secrets/mistyped", Some(b"k7Zq+4L ")),
    ] {
        let configuration = ANNOTATED.replace("\"172.17.", "\"127.17.");
        let folder = folder(&configuration.replace("secrets/section-1\"", &format!("{file}\"")));
        if let Some(octets) = octets {
            let from = folder.path().join("secrets/section-1"); // with the right mode
            fs::write(&from, octets).unwrap();
            fs::rename(from, folder.path().join(file)).unwrap();
        }
        let (_, told) = checked(folder.path());
        let pasted = told.split('`').find(|part| part.starts_with("pnet-nat password "));
        let pasted = pasted.unwrap_or_else(|| panic!("{file}: {told}"));
        let mut shell = Command::new("sh");
        shell.args(["-c", pasted]).current_dir(folder.path()).env("PATH", &path);
        let output = shell.output().unwrap();
        assert!(output.status.success(), "{pasted}: {output:?}");
        assert_eq!(checked(folder.path()), (Some(0), String::new()), "{pasted}");
    }
}
