//! Threads. The relay starts all of its threads before it reports that it is ready. After that it
//! needs no further thread, so a system that has run out of threads does not affect it.

use std::io;
use std::thread::Builder;

/// The system cannot start another thread.
#[derive(Debug, thiserror::Error)]
#[error(
    "cannot start the thread {name:?}; raise the limit of threads (ulimit -u, TasksMax=, \
     --pids-limit), or of memory"
)]
pub struct ThreadError {
    name: String,
    source: io::Error,
}

/// Starts a thread that ends with the process at the latest. The thread has the same privileges as
/// the thread that starts it.
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
