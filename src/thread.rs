//! Threads. Every one is started before the relay says that it relays: from then on nothing it does
//! needs another one, so a system that has no more of them is not its concern.

use std::io;
use std::thread::Builder;

/// The system has no thread left.
#[derive(Debug, thiserror::Error)]
#[error(
    "cannot start the thread {name:?}; raise the limit of threads (ulimit -u, TasksMax=, \
     --pids-limit), or of memory"
)]
pub struct ThreadError {
    name: String,
    source: io::Error,
}

/// Starts a thread that ends with the process at the latest. It may do what the calling one may.
pub(crate) fn start(
    name: impl Into<String>,
    work: impl FnOnce() + Send + 'static,
) -> Result<(), ThreadError> {
    let name = name.into();
    match Builder::new().name(name.clone()).spawn(work) {
        Ok(_runs_on) => Ok(()),
        Err(source) => Err(ThreadError { name, source }),
    }
}
