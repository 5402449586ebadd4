//! The configuration as the rest of the program uses it: complete, validated, with defaults filled
//! in and password files read.

use std::net::{IpAddr, SocketAddr};
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use crate::nat::{Limits, Mapping, NetId, Table};

use super::token::Token;

/// A sound configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// Local addresses on the Internet side; each public port listens on every one of them. None when
    /// all nets are remote.
    pub listen: Vec<IpAddr>,
    /// The NAT table.
    pub table: Arc<Table>,
    /// The nets whose servers may be reached by a gateway.
    pub beyond_gateway: Vec<NetId>,
    /// Limits of the relay as a whole.
    pub limits: Limits,
    /// How datagrams are taken from the kernel.
    pub datapath: Datapath,
    /// What the log may hold.
    pub log: Log,
    /// How the process runs.
    pub runtime: Runtime,
    /// The admin server; none when it is disabled.
    pub admin: Option<Admin>,
    /// Where the control socket is, also when the admin server is disabled; none: where the service
    /// manager has a folder for it, if it has one.
    pub control: Option<PathBuf>,
    /// The files that it was read from: the configuration file, and the files with passwords and tokens.
    pub files: Vec<PathBuf>,
}

impl Config {
    /// The addresses at which clients reach a mapping.
    pub fn addresses_of<'a>(&'a self, mapping: &'a Mapping) -> &'a [IpAddr] {
        mapping.local_address.as_ref().map_or(&self.listen, std::slice::from_ref)
    }
}

/// How the process runs.
#[derive(Clone, Debug)]
pub struct Runtime {
    /// The user, by name or number, that a relay started by root becomes once its sockets are bound;
    /// none: it stays root.
    pub user: Option<String>,
    /// Worker threads; none: one for each two cores, since the kernel's own work takes the other one.
    pub workers: Option<NonZeroUsize>,
    /// How long a stopping relay goes on as before, but for saying that it is not ready.
    pub pre_drain: Duration,
    /// How long a stopping relay waits for answers that are still due.
    pub drain: Duration,
}

/// How datagrams are taken from the kernel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Datapath {
    /// Octets of receive buffer to ask the kernel for, for each socket.
    pub receive_buffer: usize,
    /// When the kernel drops on the public sockets what cannot pass.
    pub prefilter: Prefilter,
    /// Whether the kernel carries the datagrams of open flows by itself.
    pub kernel: KernelFlows,
    /// How long a worker looks for the next datagram before it sleeps; zero: not at all.
    pub busy_poll: Duration,
}

/// What the log may hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Log {
    /// Lines that each kind of audit event may write in a window of the log.
    pub audit_lines: u32,
}

/// When the kernel, instead of the worker, drops on the public sockets what cannot pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Prefilter {
    /// On a socket while it is flooded.
    Auto,
    /// From the start on.
    Always,
    /// Never.
    Off,
}

/// A text that is not a value of `prefilter`.
#[derive(Debug, thiserror::Error)]
#[error("choose \"auto\", \"always\" or \"off\"")]
pub struct NotAPrefilter;

impl FromStr for Prefilter {
    type Err = NotAPrefilter;

    fn from_str(text: &str) -> Result<Self, NotAPrefilter> {
        let named = Self::ALL.into_iter().find(|prefilter| prefilter.label() == text);
        named.ok_or(NotAPrefilter)
    }
}

impl Prefilter {
    /// All that there are.
    pub const ALL: [Self; 3] = [Self::Auto, Self::Always, Self::Off];

    /// The name that the configuration has for it.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Always => "always",
            Self::Off => "off",
        }
    }
}

/// Whether the kernel carries the datagrams of open flows by itself, past the sockets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KernelFlows {
    /// Where privilege and kernel allow it.
    Auto,
    /// Never.
    Off,
    /// The relay does not start without it.
    Required,
}

/// A text that is not a value of `kernel`.
#[derive(Debug, thiserror::Error)]
#[error("choose \"auto\", \"off\" or \"required\"")]
pub struct NotKernelFlows;

impl FromStr for KernelFlows {
    type Err = NotKernelFlows;

    fn from_str(text: &str) -> Result<Self, NotKernelFlows> {
        let named = Self::ALL.into_iter().find(|kernel| kernel.label() == text);
        named.ok_or(NotKernelFlows)
    }
}

impl KernelFlows {
    /// All that there are.
    pub const ALL: [Self; 3] = [Self::Auto, Self::Off, Self::Required];

    /// The name that the configuration has for it.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Off => "off",
            Self::Required => "required",
        }
    }
}

/// The admin server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Admin {
    /// Where it listens.
    pub listen: SocketAddr,
    /// The token that requests other than probes must carry.
    pub token: Option<Token>,
    /// Whether the metrics are served without the token.
    pub metrics_without_token: bool,
    /// Whether `POST /-/reload` brings the configuration file into force.
    pub reload: bool,
    /// Whether `POST /api/v1/probe` asks a node.
    pub probe: bool,
    /// What the status page is called: the plant, the router.
    pub title: Option<String>,
}
