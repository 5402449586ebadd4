//! What a confined process cannot do any more: each attempt is made by a process of its own, which
//! confines itself as `pnet-nat run` does, and fails in the way it should. Each is made unconfined
//! too, where it succeeds: what fails, fails for the confinement. What only a relay with flows in the
//! kernel may do is made in its confinement, in that of other relays, and unconfined.
//!
//! `violations` runs them all; `violations ATTEMPT on|kernel-flows|off FOLDER` is one of those processes.

// Nobody lends bpf(2) as a safe call.
#![allow(unsafe_code)]

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::os::fd::RawFd;
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
use pnet_nat_rig::harness::left_out;
use socket2::{Domain, Protocol, Socket, Type};

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

/// What is tried where there are flows in the kernel: how it ends there, and in a relay without them.
const WITH_KERNEL_FLOWS: &[(Attempt, End)] = &[
    (("change an entry of a map", |_| on_nothing(BPF_MAP_UPDATE_ELEM), End::Done), End::Killed),
    (("delete an entry of a map", |_| on_nothing(BPF_MAP_DELETE_ELEM), End::Done), End::Killed),
    (("attach a program", |_| on_nothing(BPF_LINK_CREATE), End::Done), End::Killed),
    (("make a map", |_| at_all(BPF_MAP_CREATE), End::Killed), End::Killed),
    (("look an entry of a map up", |_| at_all(BPF_MAP_LOOKUP_ELEM), End::Killed), End::Killed),
    (("load a program", |_| at_all(BPF_PROG_LOAD), End::Killed), End::Killed),
    (("ask for interfaces", |_| netlink(libc::NETLINK_ROUTE), End::Done), End::Denied),
    (("ask for more over netlink", |_| netlink(libc::NETLINK_GENERIC), End::Denied), End::Denied),
];

/// What no other layer prevents.
const LANDLOCK_ALONE: &[&str] = &["read elsewhere", "read the users of the host", "list a folder"];
const NO_LANDLOCK: &str = "no Landlock";
const NO_BPF: &str = "no bpf(2)";

fn start_thread() -> io::Result<()> {
    thread::Builder::new().spawn(|| ())?.join().map_err(|_| io::Error::other("it panicked"))
}

fn append(file: &Path) -> io::Result<()> {
    OpenOptions::new().append(true).open(file).map(drop)
}

fn netlink(protocol: libc::c_int) -> io::Result<()> {
    let protocol = Protocol::from(protocol);
    Socket::new(Domain::from(libc::AF_NETLINK), Type::RAW.nonblocking(), Some(protocol)).map(drop)
}

const BPF_MAP_CREATE: libc::c_int = 0;
const BPF_MAP_LOOKUP_ELEM: libc::c_int = 1;
const BPF_MAP_UPDATE_ELEM: libc::c_int = 2;
const BPF_MAP_DELETE_ELEM: libc::c_int = 3;
const BPF_PROG_LOAD: libc::c_int = 5;
const BPF_LINK_CREATE: libc::c_int = 28;

/// Calls bpf(2) with a descriptor that is not open.
fn bpf(command: libc::c_int) -> io::Result<()> {
    let none: RawFd = -1;
    // Each command has its descriptor, or its type of map or program, in the first of these.
    let mut attributes = [0; 32];
    attributes[0] = none;
    let size = size_of_val(&attributes);
    let command = libc::c_long::from(command);
    // SAFETY: The array has as many octets as the kernel is told. It has no address of other memory.
    let done = unsafe { libc::syscall(libc::SYS_bpf, command, &raw mut attributes, size) };
    if done < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}

/// Has a command of bpf(2) reach the kernel, which finds that the descriptor is not open.
fn on_nothing(command: libc::c_int) -> io::Result<()> {
    let error = bpf(command).unwrap_err();
    if error.raw_os_error() == Some(libc::EBADF) {
        return Ok(());
    }
    println!("{NO_BPF}");
    Err(error)
}

/// Has a command of bpf(2) reach the kernel, whatever the kernel makes of it.
fn at_all(command: libc::c_int) -> io::Result<()> {
    let _ = bpf(command);
    Ok(())
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
    if let [attempt, confinement @ ("on" | "kernel-flows" | "off"), folder] =
        arguments.iter().map(String::as_str).collect::<Vec<_>>()[..]
    {
        return try_it(attempt, confinement, Path::new(folder));
    }
    for (attempt, _, end) in ATTEMPTS {
        ends(attempt, &[("on", end)]);
    }
    for ((attempt, _, end), without) in WITH_KERNEL_FLOWS {
        ends(attempt, &[("kernel-flows", end), ("on", without)]);
    }
    ExitCode::SUCCESS
}

/// Makes one attempt in each of these confinements, and unconfined.
fn ends(attempt: &str, confinements: &[(&str, &End)]) {
    let free = make(attempt, "off");
    if free.stdout.starts_with(NO_BPF.as_bytes()) {
        return left_out(&format!("bpf(2) without a capability, to {attempt}"));
    }
    assert_eq!(end_of(&free), End::Done, "{attempt}, unconfined: {free:?}");
    for (confinement, end) in confinements {
        let confined = make(attempt, confinement);
        if confined.stdout.starts_with(NO_LANDLOCK.as_bytes()) && LANDLOCK_ALONE.contains(&attempt)
        {
            return left_out(&format!("Landlock in the kernel, to {attempt}"));
        }
        assert_eq!(end_of(&confined), **end, "{attempt}, {confinement}: {confined:?}");
        println!("{attempt}, {confinement}: {end:?}");
    }
}

/// Makes one attempt, in this process.
fn try_it(attempt: &str, confinement: &str, folder: &Path) -> ExitCode {
    let with_kernel_flows = WITH_KERNEL_FLOWS.iter().map(|(attempt, _)| attempt);
    let mut attempts = ATTEMPTS.iter().chain(with_kernel_flows);
    let (_, act, _) = attempts.find(|(name, _, _)| *name == attempt).unwrap();
    let files = [folder.join("etc/relay.toml"), folder.join("etc/secrets/service")];
    if confinement != "off" {
        let sandbox = sandbox::prepare().confine(&files, confinement == "kernel-flows");
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
