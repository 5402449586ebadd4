//! The queue of log lines on their way to stderr, and the thread that writes them.
//!
//! A thread that logs never waits. Each line is either written whole or counted as lost. When
//! stderr takes only a part of a line, the rest of it is written first as soon as there is room
//! again.

use std::collections::VecDeque;
use std::fs::File;
use std::io;
use std::mem;
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::park_timeout;
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::unistd::write;

use crate::thread::{self, ThreadError};

/// How many lines may wait for a slow stderr. Further lines are lost.
const WAITING_LINES: usize = 16 * 1024;
/// The shortest time between two reports of lost lines. A report that was itself lost is repeated
/// after this time.
const REPORT_INTERVAL: Duration = Duration::from_secs(5);
/// How soon the writer tries a non-blocking stderr again.
const RETRY: Duration = Duration::from_millis(20);

/// The target of the event that reports lost lines.
pub(super) const LOST: &str = "pnet_nat::logging::lost";

/// The log of the process.
pub(super) static LOG: Queue = Queue {
    state: Mutex::new(State {
        waiting: VecDeque::new(),
        is_writing: false,
        writer: Writer::WhoeverLogs,
    }),
    changed: Condvar::new(),
    lost: AtomicU64::new(0),
};

/// The waiting lines, and who writes them.
pub(super) struct Queue {
    state: Mutex<State>,
    changed: Condvar,
    lost: AtomicU64,
}

struct State {
    waiting: VecDeque<Line>,
    /// The thread has taken a line out of `waiting` and is writing it.
    is_writing: bool,
    writer: Writer,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Writer {
    /// The thread that logs a line also writes it.
    WhoeverLogs,
    /// Nobody writes yet. A thread will be started.
    Nobody,
    Thread,
}

impl Queue {
    /// Keeps all lines until a thread has been started that writes them.
    pub(super) fn wait_for_a_thread(&self) {
        self.lock().writer = Writer::Nobody;
    }

    /// Starts the thread that writes the lines.
    pub(super) fn start_thread(&'static self) -> Result<(), ThreadError> {
        thread::start("log", || self.write_all())?;
        self.lock().writer = Writer::Thread;
        Ok(())
    }

    pub(super) fn lost(&self) -> u64 {
        self.lost.load(Relaxed)
    }

    pub(super) fn push(&self, line: Line) {
        let mut state = self.lock();
        if state.writer == Writer::WhoeverLogs {
            drop(state);
            self.lose(!Stderr::default().write(&line.octets));
        } else if state.waiting.len() < WAITING_LINES {
            state.waiting.push_back(line);
            self.changed.notify_all();
        } else {
            self.lose(!line.is_report);
        }
    }

    /// Waits until all lines are written or lost, but no longer than `time`. Starts the thread if
    /// it does not run yet. If it cannot be started, the caller writes the lines.
    pub(super) fn flush(&'static self, time: Duration) {
        let mut state = self.lock();
        if state.writer == Writer::Nobody && !state.waiting.is_empty() {
            drop(state);
            let no_thread = self.start_thread().is_err();
            state = self.lock();
            if no_thread {
                state.writer = Writer::WhoeverLogs;
                let waiting = mem::take(&mut state.waiting);
                drop(state);
                return waiting.into_iter().for_each(|line| self.push(line));
            }
        }
        let is_busy = |state: &mut State| state.is_writing || !state.waiting.is_empty();
        let _ = self.changed.wait_timeout_while(state, time, is_busy);
    }

    fn write_all(&self) {
        let mut stderr = Stderr::default();
        let (mut told, mut telling) = (0, 0);
        let mut next_report = Instant::now();
        loop {
            let line = self.next((self.lost() > told).then_some(next_report));
            self.lose(stderr.gives_up());
            let Some(line) = line else {
                (telling, next_report) = (self.lost() - told, Instant::now() + REPORT_INTERVAL);
                tracing::error!(target: LOST, count = telling, "lines of the log were lost");
                continue;
            };
            let written = stderr.write(&line.octets);
            self.lose(!written && !line.is_report);
            if written && line.is_report {
                told += telling;
            }
        }
    }

    /// The next line. `None` when no line waits and a report of lost lines is due.
    fn next(&self, report: Option<Instant>) -> Option<Line> {
        let mut state = self.lock();
        loop {
            state.is_writing = !state.waiting.is_empty();
            if let Some(line) = state.waiting.pop_front() {
                return Some(line);
            }
            self.changed.notify_all();
            state = match report.map(|at| at.saturating_duration_since(Instant::now())) {
                None => self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
                Some(Duration::ZERO) => return None,
                Some(time) => {
                    let waited = self.changed.wait_timeout(state, time);
                    waited.unwrap_or_else(PoisonError::into_inner).0
                }
            };
        }
    }

    fn lose(&self, a_line: bool) {
        self.lost.fetch_add(u64::from(a_line), Relaxed);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Standard error, and the rest of a line of which it took only a part.
#[derive(Default)]
struct Stderr {
    rest: Vec<u8>,
    /// The length of the file after the last write.
    length: u64,
}

impl Stderr {
    /// Writes the rest of the last line, then this line. Returns false when no octet of this line
    /// was written.
    fn write(&mut self, line: &[u8]) -> bool {
        let written = write_what_can_be(&self.rest);
        self.rest.drain(..written);
        let is_next = self.rest.is_empty();
        let written = if is_next { write_what_can_be(line) } else { 0 };
        if written > 0 {
            self.rest.extend_from_slice(&line[written..]);
        }
        if !self.rest.is_empty() {
            self.length = length();
        }
        written > 0
    }

    /// Drops the rest of a line when somebody has emptied the log file since. The beginning of that
    /// line is gone, so the rest is of no use. Returns whether a rest was dropped.
    fn gives_up(&mut self) -> bool {
        let gives_up = !self.rest.is_empty() && length() < self.length;
        if gives_up {
            self.rest.clear();
        }
        gives_up
    }
}

/// The length of the file that stderr writes to, or 0 when stderr is not a file.
fn length() -> u64 {
    let file = io::stderr().as_fd().try_clone_to_owned().map(File::from);
    file.and_then(|file| file.metadata()).map_or(0, |file| file.len())
}

/// Writes until an error occurs and returns how many octets were written. It does not use the
/// standard library's stderr: the lock of that would be held as long as nobody reads.
fn write_what_can_be(octets: &[u8]) -> usize {
    let mut written = 0;
    while written < octets.len() {
        match write(io::stderr(), &octets[written..]) {
            Ok(0) => break,
            Ok(more) => written += more,
            Err(Errno::EINTR) => {}
            Err(Errno::EAGAIN) => park_timeout(RETRY),
            Err(_) => break,
        }
    }
    written
}

/// One log line, or a text of several lines.
pub(super) struct Line {
    octets: Vec<u8>,
    /// The line reports lost lines. If this line is lost itself, it is not counted: the report is
    /// repeated.
    is_report: bool,
}

impl Line {
    pub(super) fn of(text: String) -> Self {
        Self { octets: text.into_bytes(), is_report: false }
    }
}

/// Puts events into the log. Each event arrives in one write.
pub(super) struct Pen {
    pub(super) is_report: bool,
}

impl io::Write for Pen {
    fn write(&mut self, octets: &[u8]) -> io::Result<usize> {
        LOG.push(Line { octets: octets.to_vec(), is_report: self.is_report });
        Ok(octets.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
