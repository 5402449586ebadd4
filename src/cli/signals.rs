//! The signals that end a command, and those that must not end it.

use std::io;

use nix::sys::signal::{SigSet, Signal as Name};
use tokio::signal::unix::{Signal, SignalKind, signal};

/// SIGTERM and SIGINT, from `new` on.
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

    /// Waits for the next signal and returns its name.
    pub(super) async fn next(&mut self) -> &'static str {
        tokio::select! {
            _ = self.terminate.recv() => "SIGTERM",
            _ = self.interrupt.recv() => "SIGINT",
        }
    }
}

/// Blocks SIGHUP until [`let_hangup_through`], and SIGXFSZ for good: a file at its size limit is then an
/// error of the write and does not end the process. Threads that are started later inherit this.
pub(super) fn hold_back() {
    let signals: SigSet = [Name::SIGHUP, Name::SIGXFSZ].into_iter().collect();
    // If this fails, the signals keep their default effect.
    let _ = signals.thread_block();
}

/// Unblocks SIGHUP; one that came in the meantime is delivered now.
pub(super) fn let_hangup_through() {
    let _ = SigSet::from(Name::SIGHUP).thread_unblock();
}
