//! Sockets on which the kernel may refuse datagrams before it queues them, and what it dropped there.

use std::io;
use std::mem;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

use socket2::Socket;

use super::bpf::Program;
use super::socket;

/// A socket, with a filter in the kernel or without.
#[derive(Debug)]
pub(super) struct FilteredSocket {
    socket: Socket,
    filtered: AtomicBool,
    /// What the kernel's figure was when it was last looked at. Locked while it is read, for who
    /// reads it first has to account for it first.
    seen: Mutex<u32>,
}

/// What the kernel dropped on a net's public sockets, or on all upstream sockets, also on those that
/// were closed since.
#[derive(Debug, Default)]
pub(super) struct NetDrops {
    overflow: AtomicU64,
    prefilter: AtomicU64,
}

/// Datagrams that the kernel dropped on sockets of ours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KernelDrops {
    /// While no filter was on: a buffer was full, or memory short.
    pub overflow: u64,
    /// While a filter was on, the prefilter or the one against strays: refused by it, or a buffer was
    /// full. The kernel tells one figure for both.
    pub prefilter: u64,
}

impl FilteredSocket {
    /// A socket without a filter.
    pub(super) fn new(socket: Socket) -> Self {
        Self { socket, filtered: AtomicBool::new(false), seen: Mutex::new(0) }
    }

    pub(super) fn socket(&self) -> &Socket {
        &self.socket
    }

    /// Whether a filter is on.
    pub(super) fn is_filtered(&self) -> bool {
        self.filtered.load(Relaxed)
    }

    /// Has the kernel refuse what the program refuses, or let everything through. A program takes
    /// the place of another at once.
    pub(super) fn filter(&self, program: Option<&Program>, drops: &NetDrops) -> io::Result<()> {
        self.account(drops); // what was dropped so far belongs to the way it was so far
        match program {
            Some(program) => program.attach(&self.socket)?,
            None if self.is_filtered() => self.socket.detach_filter()?,
            None => {}
        }
        self.filtered.store(program.is_some(), Relaxed);
        Ok(())
    }

    /// Adds to `drops` what the kernel dropped since the last call, and returns all that it has
    /// dropped on the socket, whatever the cause: a figure that starts again from 0 after 2³².
    pub(super) fn account(&self, drops: &NetDrops) -> Option<u32> {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        // A figure that cannot be read now is read the next time.
        let now = socket::kernel_drops(&self.socket).ok()?;
        let new = now.wrapping_sub(mem::replace(&mut *seen, now));
        let counter = if self.is_filtered() { &drops.prefilter } else { &drops.overflow };
        counter.fetch_add(new.into(), Relaxed);
        Some(now)
    }
}

impl AsFd for FilteredSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

impl NetDrops {
    pub(super) fn get(&self) -> KernelDrops {
        KernelDrops {
            overflow: self.overflow.load(Relaxed),
            prefilter: self.prefilter.load(Relaxed),
        }
    }
}

impl KernelDrops {
    /// The figures with their causes, as metrics and the API name them.
    pub fn by_cause(self) -> [(&'static str, u64); 2] {
        [("overflow", self.overflow), ("prefilter", self.prefilter)]
    }
}
