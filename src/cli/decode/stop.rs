//! SIGINT and SIGTERM end the input, and so the command ends with its summary. A second one ends the
//! process as if nothing had been arranged: its output may stand still for good.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;

use nix::sys::signal::{SigSet, Signal};

/// Whether one of the signals has come.
#[derive(Clone, Debug, Default)]
pub(super) struct Stop(Arc<AtomicBool>);

impl Stop {
    /// From now on, the signals no longer end the process. The calling thread must be the only one.
    pub(super) fn at_signals() -> io::Result<Self> {
        let signals: SigSet = [Signal::SIGINT, Signal::SIGTERM].into_iter().collect();
        signals.thread_block()?;
        let stop = Self::default();
        let told = stop.clone();
        thread::Builder::new().name("signals".to_owned()).spawn(move || {
            let waited = signals.wait();
            told.0.store(true, Relaxed);
            // Where this fails, nothing but SIGKILL ends a process whose output stands still.
            let _ = waited.and_then(|_| signals.thread_unblock());
            loop {
                thread::park();
            }
        })?;
        Ok(stop)
    }

    pub(super) fn has_come(&self) -> bool {
        self.0.load(Relaxed)
    }
}
