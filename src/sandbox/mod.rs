//! Confinement: what the process gives up for good, so that a fault in it cannot become a way into
//! the host.
//!
//! It comes in two steps, [`prepare`] before the first file is read and [`Prepared::confine`] once
//! every socket is bound. Both belong on the main thread before another one runs: most of this is
//! a matter of single threads, and of what they inherit. A layer that the kernel lacks is left out
//! and said so.

mod files;
mod links;
mod privileges;
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

/// A way in which the process is confined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, VariantArray)]
pub enum Layer {
    /// No core dump shows the memory, in which passwords are, nor does a debugger without
    /// privileges.
    Memory,
    /// No program that is started gains a privilege.
    NoNewPrivs,
    /// No capability is left, not even to root.
    Capabilities,
    /// Only the configuration, the passwords and the process's own figures can be read, nothing can
    /// be written; TCP neither connects nor listens anew; no signal leaves the process.
    Landlock,
    /// Only the system calls of a relay are left.
    Seccomp,
}

impl Layer {
    /// All layers, in the order of their effect.
    pub const ALL: [Self; Self::VARIANTS.len()] = *Self::VARIANTS.first_chunk().unwrap();

    /// Its name in logs, metrics and the API.
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
    /// As a whole.
    On,
    /// What this kernel can do of it.
    Partly(String),
    /// Not at all, for this reason.
    Missing(String),
    /// Not asked for.
    Off,
}

impl State {
    /// Its name in logs and the API.
    pub fn label(&self) -> &'static str {
        match self {
            Self::On => "on",
            Self::Partly(_) => "partly",
            Self::Missing(_) => "missing",
            Self::Off => "off",
        }
    }

    /// Why it is not on as a whole.
    pub fn why(&self) -> Option<&str> {
        match self {
            Self::Partly(why) | Self::Missing(why) => Some(why),
            Self::On | Self::Off => None,
        }
    }

    fn of<E: Display>(outcome: Result<(), E>) -> Self {
        outcome.map_or_else(|error| Self::Missing(error.to_string()), |()| Self::On)
    }
}

/// How the process is confined. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Sandbox {
    states: [State; Layer::ALL.len()],
    user: Uid,
    /// Files that are readable as they are now, and not when others take their place.
    fixed: Arc<[PathBuf]>,
    /// Keeps what Landlock lets the process read of itself: see [`files`].
    _own_figures: Arc<files::OwnFigures>,
}

impl Sandbox {
    /// No confinement.
    pub fn off() -> Self {
        let states = [const { State::Off }; _];
        Self { states, user: geteuid(), fixed: Arc::default(), _own_figures: Arc::default() }
    }

    /// Every layer with its state.
    pub fn layers(&self) -> impl Iterator<Item = (Layer, &State)> {
        Layer::ALL.into_iter().zip(&self.states)
    }

    /// Says in the log how the process is confined: one line.
    pub fn announce(&self) {
        let [memory, no_new_privs, capabilities, landlock, seccomp] =
            self.states.each_ref().map(State::label);
        let whys = self.layers().filter_map(|(layer, state)| Some((layer.label(), state.why()?)));
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
        if self.states.iter().all(|state| *state == State::Off) {
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

/// What [`prepare`] has done.
#[derive(Debug)]
#[must_use = "this is half of the confinement"]
pub struct Prepared {
    memory: State,
    no_new_privs: State,
}

/// Gives up at once what not even the start needs: debuggers, privileges of programs that it might
/// start, and all capabilities but those for ports below 1024 and for becoming a [`User`]. So a file
/// that could not be read again later, confined, is not read now either.
pub fn prepare() -> Prepared {
    let memory = State::of(nix::sys::prctl::set_dumpable(false));
    let no_new_privs = State::of(nix::sys::prctl::set_no_new_privs());
    // `confine` tells how it went.
    let _ = privileges::keep_for_the_start();
    Prepared { memory, no_new_privs }
}

impl Prepared {
    /// Gives up the rest. What stays: the sockets that are there, reading whatever is or will be in
    /// the folders of the `readable` files (of folders like `/etc`, these files alone), new UDP
    /// sockets, threads.
    pub fn confine(self, readable: &[PathBuf]) -> Sandbox {
        let user = geteuid();
        // Anew, for the kernel forgets it with a change of user.
        let memory = match self.memory {
            State::On => State::of(nix::sys::prctl::set_dumpable(false)),
            other => other,
        };
        let capabilities = State::of(privileges::keep_none());
        let readable = files::Readable::of(readable);
        let (landlock, own_figures) = files::confine(&readable);
        let fixed = readable.files().map(Path::to_owned).collect();
        // Last, for the others need system calls that are gone then.
        let seccomp = State::of(system_calls::confine());
        let states = [memory, self.no_new_privs, capabilities, landlock, seccomp];
        Sandbox { states, user, fixed, _own_figures: Arc::new(own_figures) }
    }
}
