//! Confinement: the process gives up rights for good, so that a fault in the relay does not let an
//! attacker into the host.
//!
//! The confinement has two steps: [`prepare`] before the first file is read, and
//! [`Prepared::confine`] once every socket is bound and the program for flows in the kernel, if
//! there is one, is loaded and attached. Both have to run on the main thread before
//! another thread exists. Most of these restrictions apply to a single thread and to the threads
//! that it starts later. If the kernel lacks a layer, the relay runs without it and says so.

mod files;
mod links;
mod privileges;
#[cfg(target_endian = "little")] // as seccompiler
mod system_calls;
mod user;

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nix::unistd::{Uid, geteuid};
use strum::VariantArray;
use tracing::field::display;

use crate::logging::list;

pub use links::{MovableLink, movable_links};
pub use user::{User, UserError};

/// One of the ways in which the process is confined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, VariantArray)]
pub enum Layer {
    /// The memory, which contains passwords, appears in no core dump. A debugger without privileges
    /// cannot read it either.
    Memory,
    /// No program that the process starts can gain a privilege.
    NoNewPrivs,
    /// No capability is left, not even if the process runs as root.
    Capabilities,
    /// Only the configuration, the password files and the process's own figures can be read.
    /// Nothing can be written. The process can open no TCP connection and no new TCP listener. It
    /// can send no signal to another process.
    Landlock,
    /// Only the system calls that a relay needs are left.
    Seccomp,
}

impl Layer {
    /// All layers, in the order in which they take effect.
    pub const ALL: [Self; Self::VARIANTS.len()] = *Self::VARIANTS.first_chunk().unwrap();

    /// The name of the layer in logs, metrics and the API.
    pub fn label(self) -> &'static str {
        match self {
            Self::Memory => "memory",
            Self::NoNewPrivs => "no_new_privs",
            Self::Capabilities => "capabilities",
            Self::Landlock => "landlock",
            Self::Seccomp => "seccomp",
        }
    }
}

/// How far a layer is in force.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// The whole layer is in force.
    On,
    /// Only the part that this kernel supports is in force, for this reason.
    Partly(String),
    /// The layer is not in force, for this reason.
    Missing(String),
    /// Nobody asked for this layer: where, or by what.
    Off(&'static str),
}

impl State {
    /// The name of the state in logs and the API.
    pub fn label(&self) -> &'static str {
        match self {
            Self::On => "on",
            Self::Partly(_) => "partly",
            Self::Missing(_) => "missing",
            Self::Off(_) => "off",
        }
    }

    /// Why the layer is not fully in force.
    pub fn why(&self) -> Option<&str> {
        match self {
            Self::Partly(why) | Self::Missing(why) => Some(why),
            Self::Off(why) => Some(why),
            Self::On => None,
        }
    }

    fn of<E: Display>(outcome: Result<(), E>) -> Self {
        outcome.map_or_else(|error| Self::Missing(error.to_string()), |()| Self::On)
    }
}

/// How the process is confined. Cloning is cheap.
#[derive(Clone, Debug)]
pub struct Sandbox {
    states: [State; Layer::ALL.len()],
    user: Uid,
    /// Files that can be read as they are now. A file that replaces one of them cannot be read.
    fixed: Arc<[PathBuf]>,
    /// Keeps open what Landlock lets the process read about itself: see [`files`].
    _own_figures: Arc<files::OwnFigures>,
}

impl Sandbox {
    /// A process without confinement: where, or by what.
    pub fn off(why: &'static str) -> Self {
        let states = std::array::from_fn(|_| State::Off(why));
        Self { states, user: geteuid(), fixed: Arc::default(), _own_figures: Arc::default() }
    }

    /// Every layer with its state.
    pub fn layers(&self) -> impl Iterator<Item = (Layer, &State)> {
        Layer::ALL.into_iter().zip(&self.states)
    }

    /// Writes one line into the log that says how the process is confined.
    pub fn announce(&self) {
        let [memory, no_new_privs, capabilities, landlock, seccomp] =
            self.states.each_ref().map(State::label);
        let asked_for = self.layers().filter(|(_, state)| !matches!(state, State::Off(_)));
        let whys = asked_for.filter_map(|(layer, state)| Some((layer.label(), state.why()?)));
        let whys: Vec<_> = whys.map(|(layer, why)| format!("{layer}: {why}")).collect();
        let why = if whys.is_empty() { None } else { Some(display(whys.join("; "))) };
        let user = self.user.as_raw();
        macro_rules! say {
            ($level:ident, $message:literal) => {
                tracing::$level!(
                    user,
                    memory,
                    no_new_privs,
                    capabilities,
                    landlock,
                    seccomp,
                    why,
                    $message
                )
            };
        }
        if self.states.iter().all(|state| matches!(state, State::Off(_))) {
            say!(warn, "not confined");
            return;
        }
        if !self.fixed.is_empty() {
            tracing::warn!(
                files = list(self.fixed.iter().map(|file| file.display())),
                "when one of these is replaced, restart; in a folder of its own, a reload would do"
            );
        }
        if self.user.is_root() {
            tracing::warn!("runs as root, who owns many files; name another in [runtime] user");
        }
        if self.states.iter().all(|state| *state == State::On) {
            say!(info, "confined");
        } else {
            say!(warn, "confined in part");
        }
    }
}

/// The result of [`prepare`].
#[derive(Debug)]
#[must_use = "this is half of the confinement"]
pub struct Prepared {
    memory: State,
    no_new_privs: State,
}

/// Gives up at once what is not necessary even for the start: debuggers, privileges of programs
/// that the process might start, and all capabilities except those for ports below 1024, for
/// becoming a [`User`], and for flows in the kernel. So a file that the confined process could not read on a reload cannot be
/// read at the start either.
pub fn prepare() -> Prepared {
    let memory = State::of(nix::sys::prctl::set_dumpable(false));
    let no_new_privs = State::of(nix::sys::prctl::set_no_new_privs());
    // `confine` reports the result.
    let _ = privileges::keep_for_the_start();
    Prepared { memory, no_new_privs }
}

impl Prepared {
    /// Gives up the rest. The process keeps its open sockets and its threads, and may open new UDP
    /// sockets and start new threads. It may read all files that are or will be in the folders of
    /// the `readable` files. Of folders like `/etc`, it may read only these files.
    ///
    /// With `kernel_flows`, the process may also change the entries of the BPF maps that it has open,
    /// attach the BPF programs that it has open to other interfaces, and ask the kernel for its
    /// interfaces and routes. It can load no program and make no map.
    pub fn confine(self, readable: &[PathBuf], kernel_flows: bool) -> Sandbox {
        let user = geteuid();
        // This is set again, because the kernel resets it when the user changes.
        let memory = match self.memory {
            State::On => State::of(nix::sys::prctl::set_dumpable(false)),
            other => other,
        };
        let capabilities = State::of(privileges::keep_none());
        let readable = files::Readable::of(readable);
        let (landlock, own_figures) = files::confine(&readable);
        let fixed = readable.files().map(Path::to_owned).collect();
        // Seccomp comes last: the other layers need system calls that it blocks.
        #[cfg(target_endian = "little")]
        let seccomp = State::of(system_calls::confine(kernel_flows));
        #[cfg(target_endian = "big")]
        let (seccomp, _) = (State::Missing("not for this processor".to_owned()), kernel_flows);
        let states = [memory, self.no_new_privs, capabilities, landlock, seccomp];
        Sandbox { states, user, fixed, _own_figures: Arc::new(own_figures) }
    }
}
