//! The signals that end a command, and those that must not.

use std::io;

use nix::sys::signal::{SigSet, Signal as Name};
use tokio::signal::unix::{Signal, SignalKind, signal};

/// SIGTERM and SIGINT, from its making on.
pub(super) struct Signals {
    terminate: Signal,
    interrupt: Signal,
}

impl Signals {
    pub(super) fn new() -> io::Result<Self> {
        let terminate = signal(SignalKind::terminate())?;
        let interrupt = signal(SignalKind::interrupt())?;
        Ok(Self { terminate, interrupt })
    }

    /// Waits for the next one and tells its name.
    pub(super) async fn next(&mut self) -> &'static str {
        tokio::select! {
            _ = self.terminate.recv() => "SIGTERM",
            _ = self.interrupt.recv() => "SIGINT",
        }
    }
}

/// Holds SIGHUP back until [`let_hangup_through`], and SIGXFSZ for good: a file that may not grow any
/// more is an error of who writes it, and not the end. Threads that are started later inherit it.
pub(super) fn hold_back() {
    let signals: SigSet = [Name::SIGHUP, Name::SIGXFSZ].into_iter().collect();
    // Without it, the signals do what they do by themselves.
    let _ = signals.thread_block();
}

/// One that came meanwhile comes now.
pub(super) fn let_hangup_through() {
    let _ = SigSet::from(Name::SIGHUP).thread_unblock();
}
