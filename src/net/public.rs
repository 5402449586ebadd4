//! A public socket, with what the kernel says and does about it.

use std::io;
use std::iter::Sum;
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering::Relaxed};

use socket2::Socket;

use crate::relay::{MappingId, NetId, Table};

use super::{prefilter, socket};

/// A public socket of one worker.
#[derive(Debug)]
pub(super) struct PublicSocket {
    pub socket: Socket,
    pub mapping: MappingId,
    pub net: NetId,
    /// The configured address; unspecified when the socket serves all of the host's.
    pub address: IpAddr,
    filtered: AtomicBool,
    /// What the kernel's figure was when it was last looked at.
    seen: AtomicU32,
    overflowed: AtomicU64,
    refused: AtomicU64,
}

/// Datagrams that the kernel dropped on public sockets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KernelDrops {
    /// While no prefilter was on: a buffer was full, or memory short.
    pub overflow: u64,
    /// While the prefilter was on: refused by it, or a buffer was full. The kernel tells one figure
    /// for both.
    pub prefilter: u64,
}

impl KernelDrops {
    /// The figures with their causes, as metrics and the API name them.
    pub fn by_cause(self) -> [(&'static str, u64); 2] {
        [("overflow", self.overflow), ("prefilter", self.prefilter)]
    }
}

impl Sum for KernelDrops {
    fn sum<I: Iterator<Item = Self>>(drops: I) -> Self {
        drops.fold(Self::default(), |sum, drops| Self {
            overflow: sum.overflow + drops.overflow,
            prefilter: sum.prefilter + drops.prefilter,
        })
    }
}

impl PublicSocket {
    pub(super) fn new(socket: Socket, mapping: MappingId, table: &Table, address: IpAddr) -> Self {
        Self {
            socket,
            mapping,
            net: table.mapping(mapping).net,
            address,
            filtered: AtomicBool::new(false),
            seen: AtomicU32::new(0),
            overflowed: AtomicU64::new(0),
            refused: AtomicU64::new(0),
        }
    }

    /// Turns the prefilter on or off.
    pub(super) fn filter(&self, on: bool, table: &Table) -> io::Result<()> {
        self.account(); // what was dropped so far belongs to the way it was so far
        if on {
            prefilter::attach(&self.socket, table, self.net)?;
        } else {
            prefilter::detach(&self.socket)?;
        }
        self.filtered.store(on, Relaxed);
        Ok(())
    }

    /// Whether the prefilter is on.
    pub(super) fn is_filtered(&self) -> bool {
        self.filtered.load(Relaxed)
    }

    /// What the kernel dropped since the socket was opened.
    pub(super) fn drops(&self) -> KernelDrops {
        self.account();
        KernelDrops {
            overflow: self.overflowed.load(Relaxed),
            prefilter: self.refused.load(Relaxed),
        }
    }

    fn account(&self) {
        // A figure that cannot be read now is read the next time.
        let Ok(now) = socket::kernel_drops(&self.socket) else { return };
        let new = now.wrapping_sub(self.seen.swap(now, Relaxed));
        let counter = if self.is_filtered() { &self.refused } else { &self.overflowed };
        counter.fetch_add(u64::from(new), Relaxed);
    }
}
