//! Public sockets, what they stand for, and what the kernel says and does about them.
//!
//! A socket outlives a reload as long as its address and port are wanted; what it stands for may
//! change. Its place in a worker's [`Listeners`] stays the same all its life.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};

use socket2::Socket;

use crate::relay::{ListenerId, MappingId, NetId, Table};

use super::{prefilter, socket};

/// A public socket of one worker.
#[derive(Debug)]
pub(super) struct PublicSocket {
    pub socket: Socket,
    filtered: AtomicBool,
    /// What the kernel's figure was when it was last looked at. Locked while it is read, for who
    /// reads it first has to account for it first.
    seen: Mutex<u32>,
}

/// A public socket of one worker, and what it stands for in the NAT table in force.
#[derive(Clone, Debug)]
pub(super) struct Listener {
    pub socket: Arc<PublicSocket>,
    /// Where it listens.
    pub address: SocketAddr,
    pub mapping: MappingId,
    pub net: NetId,
    pub drops: Arc<NetDrops>,
}

/// The public sockets of one worker, by [`ListenerId`]. A place whose socket was closed is empty,
/// until another takes it.
#[derive(Clone, Debug, Default)]
pub(super) struct Listeners(Vec<Option<Listener>>);

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
    /// While no prefilter was on: a buffer was full, or memory short.
    pub overflow: u64,
    /// While a filter was on, the prefilter or the one against strays: refused by it, or a buffer was
    /// full. The kernel tells one figure for both.
    pub prefilter: u64,
}

impl KernelDrops {
    /// The figures with their causes, as metrics and the API name them.
    pub fn by_cause(self) -> [(&'static str, u64); 2] {
        [("overflow", self.overflow), ("prefilter", self.prefilter)]
    }
}

impl NetDrops {
    pub(super) fn get(&self) -> KernelDrops {
        KernelDrops {
            overflow: self.overflow.load(Relaxed),
            prefilter: self.prefilter.load(Relaxed),
        }
    }

    /// Adds datagrams that the kernel dropped on a socket, with a filter on it or without.
    pub(super) fn add(&self, datagrams: u32, filtered: bool) {
        let counter = if filtered { &self.prefilter } else { &self.overflow };
        counter.fetch_add(datagrams.into(), Relaxed);
    }
}

impl PublicSocket {
    pub(super) fn new(socket: Socket) -> Self {
        Self { socket, filtered: AtomicBool::new(false), seen: Mutex::new(0) }
    }

    /// Whether the prefilter is on.
    pub(super) fn is_filtered(&self) -> bool {
        self.filtered.load(Relaxed)
    }
}

impl Listener {
    /// The configured address; none when the socket serves all of the host's.
    pub(super) fn own_address(&self) -> Option<IpAddr> {
        Some(self.address.ip()).filter(|address| !address.is_unspecified())
    }

    /// Turns the prefilter on, with the program for the net as `table` has it, or off. A program
    /// takes the place of another at once.
    pub(super) fn filter(&self, on: bool, table: &Table) -> io::Result<()> {
        self.account(); // what was dropped so far belongs to the way it was so far
        let PublicSocket { socket, filtered, .. } = &*self.socket;
        if on {
            prefilter::attach(socket, table, self.net)?;
        } else if filtered.load(Relaxed) {
            prefilter::detach(socket)?;
        }
        filtered.store(on, Relaxed);
        Ok(())
    }

    /// Adds to the net's figures what the kernel dropped since the last call, and returns all that it
    /// has dropped on the socket, whatever the cause: a figure that starts again from 0 after 2³².
    pub(super) fn account(&self) -> Option<u32> {
        let mut seen = self.socket.seen.lock().unwrap_or_else(PoisonError::into_inner);
        // A figure that cannot be read now is read the next time.
        let now = socket::kernel_drops(&self.socket.socket).ok()?;
        let new = now.wrapping_sub(std::mem::replace(&mut *seen, now));
        self.drops.add(new, self.socket.is_filtered());
        Some(now)
    }
}

impl Listeners {
    #[inline]
    pub(super) fn get(&self, id: ListenerId) -> Option<&Listener> {
        self.0.get(id.0 as usize)?.as_ref()
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (ListenerId, &Listener)> {
        let places = (0..).map(ListenerId).zip(&self.0);
        places.filter_map(|(id, listener)| Some((id, listener.as_ref()?)))
    }

    /// Places, empty ones included.
    pub(super) fn places(&self) -> usize {
        self.0.len()
    }

    /// Puts a listener in its place.
    pub(super) fn put(&mut self, id: ListenerId, listener: Listener) {
        let index = id.0 as usize;
        if self.0.len() <= index {
            self.0.resize_with(index + 1, || None);
        }
        self.0[index] = Some(listener);
    }

    /// Whether the socket in this place is the same in both.
    pub(super) fn keeps(&self, id: ListenerId, other: &Self) -> bool {
        let (here, there) = (self.get(id), other.get(id));
        here.zip(there).is_some_and(|(here, there)| Arc::ptr_eq(&here.socket, &there.socket))
    }
}
