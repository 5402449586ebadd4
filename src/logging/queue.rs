//! Lines on their way to stderr, and the thread that writes them.
//!
//! A thread that logs never waits. A line is either written whole or counted as lost. When stderr takes
//! only a part of a line, the rest is written first as soon as there is room again.

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

/// How many lines wait for a slow stderr; further ones are lost.
const WAITING_LINES: usize = 16 * 1024;
/// How often lost lines are reported at most, and when a report that was lost itself is repeated.
const REPORT_INTERVAL: Duration = Duration::from_secs(5);
/// How soon a non-blocking stderr is tried again.
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
    /// The thread is writing a line that it has taken out.
    is_writing: bool,
    writer: Writer,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Writer {
    /// The thread that logs.
    WhoeverLogs,
    /// Nobody yet: a thread will be started.
    Nobody,
    Thread,
}

impl Queue {
    /// Keeps lines until there is a thread that writes them.
    pub(super) fn wait_for_a_thread(&self) {
        self.lock().writer = Writer::Nobody;
    }

    /// Starts the thread.
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

    /// Waits until all lines are written or lost, but no longer than `time`. Starts the thread if there
    /// is none yet; if it cannot be started, the caller writes the lines.
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

    /// The next line; none when no line waits and a report is due.
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

/// Standard error, and the rest of a line that it took only in part.
#[derive(Default)]
struct Stderr {
    rest: Vec<u8>,
    /// The length of the file after the last write.
    length: u64,
}

impl Stderr {
    /// Writes the rest of the line before, then this line; false when nothing of this one was written.
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

    /// Drops the rest of a line when somebody has emptied the file since, so that the line has lost its
    /// beginning. Returns whether a rest was dropped.
    fn gives_up(&mut self) -> bool {
        let gives_up = !self.rest.is_empty() && length() < self.length;
        if gives_up {
            self.rest.clear();
        }
        gives_up
    }
}

/// The length of the file that standard error is; 0 when it is not a file.
fn length() -> u64 {
    let file = io::stderr().as_fd().try_clone_to_owned().map(File::from);
    file.and_then(|file| file.metadata()).map_or(0, |file| file.len())
}

/// Writes until an error and returns how many octets were written. Does not use the standard library's
/// stderr, whose lock would be held as long as nobody reads.
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

/// One line, or a text of several.
pub(super) struct Line {
    octets: Vec<u8>,
    /// It reports lost lines. When it is lost itself it is not counted: the report is repeated.
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
