//! The configuration as the rest of the program uses it: complete, validated, with defaults filled
//! in and password files read.

use std::net::{IpAddr, SocketAddr};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Duration;

use crate::relay::{Limits, Table};

/// A sound configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// Local addresses on the Internet side; each public port listens on every one of them.
    pub listen: Vec<IpAddr>,
    /// The NAT table.
    pub table: Arc<Table>,
    /// Bounds of the router as a whole.
    pub limits: Limits,
    /// How the process runs.
    pub runtime: Runtime,
    /// The admin server; none when it is switched off.
    pub admin: Option<Admin>,
}

/// How the process runs.
#[derive(Clone, Debug)]
pub struct Runtime {
    /// Worker threads; none: one a core.
    pub workers: Option<NonZeroUsize>,
    /// Octets of receive buffer to ask the kernel for, for each socket.
    pub receive_buffer: usize,
    /// How long a stopping router waits for answers that are still due.
    pub drain: Duration,
}

impl Default for Runtime {
    fn default() -> Self {
        Self { workers: None, receive_buffer: 1 << 20, drain: Duration::from_secs(5) }
    }
}

/// The admin server.
#[derive(Clone, Debug)]
pub struct Admin {
    /// Where it listens.
    pub listen: SocketAddr,
}
