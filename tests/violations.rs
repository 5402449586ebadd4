//! What a confined process cannot do any more: each attempt is made by a process of its own, which
//! confines itself as `pnet-nat run` does, and fails in the way it should. Each is made unconfined
//! too, where it succeeds: what fails, fails for the confinement.
//!
//! `violations` runs them all; `violations ATTEMPT on|off FOLDER` is one of those processes.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::os::unix::fs::symlink;
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Command, ExitCode, Output, Stdio};
use std::thread;

use nix::sched::{CloneFlags, unshare};
use nix::sys::signal::{Signal, kill};
use nix::unistd::{getppid, getuid, setuid};
use pnet_nat::sandbox::{self, Layer, State};

/// How an attempt ends in confinement.
#[derive(Debug, PartialEq, Eq)]
enum End {
    Done,
    Denied,
    Killed,
}

type Attempt = (&'static str, fn(&Path) -> io::Result<()>, End);

const ATTEMPTS: &[Attempt] = &[
    (
        "write beside the configuration",
        |folder| File::create(folder.join("new")).map(drop),
        End::Denied,
    ),
    ("write the configuration", |folder| append(&folder.join("etc/relay.toml")), End::Denied),
    (
        "delete the configuration",
        |folder| fs::remove_file(folder.join("etc/relay.toml")),
        End::Denied,
    ),
    ("read elsewhere", |folder| fs::read(folder.join("elsewhere")).map(drop), End::Denied),
    ("read the users of the host", |_| fs::read("/etc/passwd").map(drop), End::Denied),
    ("list a folder", |folder| fs::read_dir(folder).map(drop), End::Denied),
    ("connect over TCP", |_| TcpStream::connect(listening()).map(drop), End::Denied),
    ("listen on TCP", |_| TcpListener::bind("127.0.0.1:0").map(drop), End::Denied),
    ("connect to a local service", connect_local, End::Denied),
    ("signal another process", signal_parent, End::Denied),
    ("change the user", |_| Ok(setuid(getuid())?), End::Denied),
    ("start a program", |_| Command::new("true").status().map(drop), End::Denied),
    ("become a program", |_| Err(Command::new("true").exec()), End::Killed),
    ("leave a namespace", |_| Ok(unshare(CloneFlags::CLONE_FILES)?), End::Killed),
    (
        "read the configuration",
        |folder| fs::read(folder.join("etc/relay.toml")).map(drop),
        End::Done,
    ),
    ("read a new file beside it", |folder| fs::read(folder.join("etc/other")).map(drop), End::Done),
    ("bind UDP", |_| UdpSocket::bind("127.0.0.1:0").map(drop), End::Done),
    ("start a thread", |_| start_thread(), End::Done),
    ("read a secret that was exchanged", exchanged, End::Done),
];

/// What no other layer prevents.
const LANDLOCK_ALONE: &[&str] = &["read elsewhere", "read the users of the host", "list a folder"];
const NO_LANDLOCK: &str = "no Landlock";

fn start_thread() -> io::Result<()> {
    thread::Builder::new().spawn(|| ())?.join().map_err(|_| io::Error::other("it panicked"))
}

fn append(file: &Path) -> io::Result<()> {
    OpenOptions::new().append(true).open(file).map(drop)
}

/// Where the parent listens.
fn listening() -> String {
    std::env::var("LISTENING").unwrap()
}

fn connect_local(folder: &Path) -> io::Result<()> {
    UnixStream::connect(folder.join("socket")).map(drop)
}

fn signal_parent(_: &Path) -> io::Result<()> {
    Ok(kill(getppid(), Signal::SIGCONT)?)
}

/// As Kubernetes exchanges a secret: a link that is put in place of another.
fn exchanged(folder: &Path) -> io::Result<()> {
    println!("exchange");
    io::stdin().lock().read_line(&mut String::new())?;
    let read = fs::read(folder.join("etc/secrets/service"))?;
    assert_eq!(read, b"new-pass");
    Ok(())
}

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    if let [attempt, confinement @ ("on" | "off"), folder] =
        arguments.iter().map(String::as_str).collect::<Vec<_>>()[..]
    {
        return try_it(attempt, confinement == "on", Path::new(folder));
    }
    for (attempt, _, end) in ATTEMPTS {
        let confined = make(attempt, "on");
        if confined.stdout.starts_with(NO_LANDLOCK.as_bytes()) && LANDLOCK_ALONE.contains(attempt) {
            let all = std::env::var_os("PNET_NAT_TESTS").is_some_and(|tests| tests == "all");
            assert!(!all, "PNET_NAT_TESTS=all, and there is a want: Landlock in the kernel");
            println!("{attempt}: left out: Landlock in the kernel");
            continue;
        }
        assert_eq!(end_of(&confined), *end, "{attempt}: {confined:?}");
        let free = make(attempt, "off");
        assert_eq!(end_of(&free), End::Done, "{attempt}, unconfined: {free:?}");
        println!("{attempt}: {end:?}");
    }
    ExitCode::SUCCESS
}

/// Makes one attempt, in this process.
fn try_it(attempt: &str, confined: bool, folder: &Path) -> ExitCode {
    let (_, act, _) = ATTEMPTS.iter().find(|(name, _, _)| *name == attempt).unwrap();
    let files = [folder.join("etc/relay.toml"), folder.join("etc/secrets/service")];
    if confined {
        let sandbox = sandbox::prepare().confine(&files);
        for (layer, state) in sandbox.layers() {
            match (layer, state) {
                (_, State::On) => {}
                (Layer::Landlock, _) => println!("{NO_LANDLOCK}"),
                _ => panic!("{layer:?}: {state:?}"),
            }
        }
    }
    match act(folder) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            println!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// Has an attempt made by another process, in a folder of its own.
fn make(attempt: &str, confinement: &str) -> Output {
    let folder = tempfile::tempdir().unwrap();
    let etc = folder.path().join("etc");
    let secrets = etc.join("secrets");
    for (version, password) in [("..1", "old-pass"), ("..2", "new-pass")] {
        fs::create_dir_all(secrets.join(version)).unwrap();
        fs::write(secrets.join(version).join("service"), password).unwrap();
    }
    symlink("..1", secrets.join("..data")).unwrap();
    symlink("..data/service", secrets.join("service")).unwrap();
    for file in ["etc/relay.toml", "etc/other", "elsewhere"] {
        fs::write(folder.path().join(file), "").unwrap();
    }
    let _socket = UnixListener::bind(folder.path().join("socket")).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args([attempt, confinement, folder.path().to_str().unwrap()])
        .env("LISTENING", listener.local_addr().unwrap().to_string())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let mut stdout = io::BufReader::new(child.stdout.take().unwrap());
    let mut said = String::new();
    while stdout.read_line(&mut said).unwrap() > 0 {
        if said.ends_with("exchange\n") {
            symlink("..2", secrets.join("..new")).unwrap();
            fs::rename(secrets.join("..new"), secrets.join("..data")).unwrap();
            stdin.write_all(b"\n").unwrap();
        }
    }
    let output = child.wait_with_output().unwrap();
    Output { stdout: said.into_bytes(), ..output }
}

fn end_of(output: &Output) -> End {
    match (output.status.code(), output.status.signal()) {
        (Some(0), None) => End::Done,
        (Some(1), None) => End::Denied,
        (None, Some(libc::SIGSYS)) => End::Killed,
        _ => panic!("{output:?}"),
    }
}
