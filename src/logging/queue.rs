//! Lines on their way to stderr, and the thread that writes them.
//!
//! Whoever logs waits for nobody. A line is written whole, or counted as lost; of one that was broken
//! off, the rest comes first as soon as there is room again.

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

/// Lines that wait for a slow stderr; more are lost.
const WAITING_LINES: usize = 16 * 1024;
/// How often it is told at most that lines were lost, and how long until it is tried again.
const REPORT_INTERVAL: Duration = Duration::from_secs(5);
/// How soon a stderr that does not wait by itself is tried again.
const RETRY: Duration = Duration::from_millis(20);

/// The target of the event that tells of lost lines.
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

/// Lines that wait, and who writes them.
pub(super) struct Queue {
    state: Mutex<State>,
    changed: Condvar,
    lost: AtomicU64,
}

struct State {
    waiting: VecDeque<Line>,
    /// The thread has one in its hands.
    is_writing: bool,
    writer: Writer,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Writer {
    WhoeverLogs,
    /// There will be a thread.
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

    /// Waits until all lines are written or lost, for so long at most. Where there is no thread yet,
    /// one is started; where none can be had, the caller writes.
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

    /// The next line; none when nothing waits and it is time for a report.
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

/// Standard error, and what is still to be written of a line that was broken off.
#[derive(Default)]
struct Stderr {
    rest: Vec<u8>,
    /// How long the file was then.
    length: u64,
}

impl Stderr {
    /// Writes a line, after what is left of the one before it; false when nothing of it is written.
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

    /// Gives up a line that was broken off when somebody has emptied the file since, with its
    /// beginning; tells whether there is one.
    fn gives_up(&mut self) -> bool {
        let gives_up = !self.rest.is_empty() && length() < self.length;
        if gives_up {
            self.rest.clear();
        }
        gives_up
    }
}

/// How long the file is that standard error is; 0 where it is another thing.
fn length() -> u64 {
    let file = io::stderr().as_fd().try_clone_to_owned().map(File::from);
    file.and_then(|file| file.metadata()).map_or(0, |file| file.len())
}

/// Tells how much was written before an error. Not through the standard library's stderr: its lock
/// would be held for as long as nobody reads.
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
    /// It tells of lost lines, and is no loss itself: they will be told of again.
    is_report: bool,
}

impl Line {
    pub(super) fn of(text: String) -> Self {
        Self { octets: text.into_bytes(), is_report: false }
    }
}

/// Puts events, each of which comes as a whole, into the log.
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
