//! The real binary as a process. A test starts it, reads its output and sends signals. It ends when
//! it is dropped.

use std::env;
use std::fs::{self, DirEntry};
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, LazyLock, Mutex};
use std::thread::{self, JoinHandle};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;

use super::eventually;

/// The binary that is tested. Cargo builds it with the tests, and puts it one folder above them.
pub(super) fn program() -> &'static Path {
    static PROGRAM: LazyLock<PathBuf> = LazyLock::new(|| {
        let test = env::current_exe().unwrap();
        let program = test.ancestors().nth(2).unwrap().join("pnet-nat");
        assert!(program.exists(), "no {}: only a test of pnet-nat can run it", program.display());
        program
    });
    &PROGRAM
}

/// The binary with these arguments. No option comes from the environment.
pub fn pnet_nat(arguments: &[&str]) -> Command {
    let mut command = Command::new(program());
    command.args(arguments);
    scrubbed(command)
}

/// The binary with these arguments and with a hard limit of file descriptors.
pub fn pnet_nat_within(descriptors: u64, arguments: &[&str]) -> Command {
    let mut command = Command::new("sh");
    command.args(["-c", "ulimit -n \"$0\" && exec \"$@\"", &descriptors.to_string()]);
    command.arg(program()).args(arguments);
    scrubbed(command)
}

fn scrubbed(mut command: Command) -> Command {
    for (name, _) in env::vars_os() {
        if name.to_string_lossy().starts_with("PNET_NAT_") {
            command.env_remove(name);
        }
    }
    command
}

/// A process, and its output so far.
#[derive(Debug)]
pub struct Process {
    child: Child,
    stdout: Output,
    stderr: Output,
}

/// One output stream. A thread of its own reads it, so that the process never waits for the test.
#[derive(Debug)]
struct Output {
    text: Arc<Mutex<String>>,
    reader: Option<JoinHandle<()>>,
}

impl Process {
    /// Starts the command in the calling thread's network namespace.
    pub fn start(mut command: Command) -> Self {
        let command = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let stdout = Output::of(child.stdout.take().unwrap());
        let stderr = Output::of(child.stderr.take().unwrap());
        Self { child, stdout, stderr }
    }

    /// The process ID.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// The memory that the process has now, in octets.
    pub fn resident(&self) -> u64 {
        resident(self.id())
    }

    /// Sends a signal to the process.
    pub fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.id() as i32), signal).unwrap();
    }

    /// Stops every thread of the process until [`go_on`](Self::go_on).
    pub fn hold(&self) {
        self.signal(Signal::SIGSTOP);
        let threads = format!("/proc/{}/task", self.id());
        let is_held = |thread: io::Result<DirEntry>| {
            let status = fs::read_to_string(thread.unwrap().path().join("status")).unwrap();
            status.contains("State:\tT")
        };
        eventually("all threads are held", || {
            fs::read_dir(&threads).unwrap().all(is_held).then_some(())
        });
    }

    /// Lets the threads that [`hold`](Self::hold) stopped go on.
    pub fn go_on(&self) {
        self.signal(Signal::SIGCONT);
    }

    /// Waits until the process has ended and returns its exit code. `None` when a signal killed it.
    pub fn end(&mut self) -> Option<i32> {
        self.status().code()
    }

    /// Waits until the process has ended and returns its status.
    pub fn status(&mut self) -> ExitStatus {
        let status = eventually("the process ends", || self.child.try_wait().unwrap());
        for output in [&mut self.stdout, &mut self.stderr] {
            if let Some(reader) = output.reader.take() {
                reader.join().unwrap();
            }
        }
        status
    }

    /// Whether the process has ended. Does not wait.
    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
    }

    /// What it wrote to stdout so far, in whole lines.
    pub fn stdout(&self) -> String {
        self.stdout.text.lock().unwrap().clone()
    }

    /// What it wrote to stderr so far, in whole lines.
    pub fn stderr(&self) -> String {
        self.stderr.text.lock().unwrap().clone()
    }

    /// The log lines, oldest first.
    pub fn log(&self) -> impl Iterator<Item = Value> {
        let stderr = self.stderr();
        let complete = &stderr[..stderr.rfind('\n').map_or(0, |end| end + 1)];
        let lines = complete.lines().map(|line| serde_json::from_str(line).expect(line));
        lines.collect::<Vec<_>>().into_iter()
    }

    /// The log lines with this message, oldest first.
    pub fn logged(&self, message: &str) -> Vec<Value> {
        self.log().filter(|line| line["message"] == message).collect()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if thread::panicking() {
            println!("stderr of the process {}:\n{}", self.id(), self.stderr());
        }
    }
}

impl Output {
    fn of(stream: impl Read + Send + 'static) -> Self {
        let text = Arc::new(Mutex::new(String::new()));
        let shared = Arc::clone(&text);
        let reader = thread::spawn(move || {
            let mut stream = BufReader::new(stream);
            let mut line = String::new();
            while stream.read_line(&mut line).unwrap() > 0 {
                shared.lock().unwrap().push_str(&line);
                line.clear();
            }
        });
        Self { text, reader: Some(reader) }
    }
}

/// The memory that the process with this ID has now, in octets.
pub fn resident(id: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{id}/status")).unwrap();
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    resident.trim().trim_end_matches(" kB").parse::<u64>().unwrap() << 10
}
