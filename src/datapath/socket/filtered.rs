//! Sockets on which the kernel may refuse datagrams before it queues them, and figures of what it
//! dropped there.

use std::io;
use std::mem;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

use socket2::Socket;

use crate::datapath::kernel_filter::assembler::Program;
use crate::datapath::socket::sys::options;

/// A socket with or without a filter in the kernel.
#[derive(Debug)]
pub(in crate::datapath) struct FilteredSocket {
    socket: Socket,
    filtered: AtomicBool,
    /// The kernel's figure at the last look. The lock is held while the figure is read, because the
    /// thread that reads it first must also account for it first.
    seen: Mutex<u32>,
}

/// What the kernel dropped on a net's public sockets, or on all upstream sockets. Sockets that were
/// closed since are included.
#[derive(Debug, Default)]
pub(in crate::datapath) struct NetDrops {
    overflow: AtomicU64,
    prefilter: AtomicU64,
}

/// Datagrams that the kernel dropped on sockets of the relay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KernelDrops {
    /// Dropped because a buffer was full or memory was short. While a filter is on, drops count
    /// here only when the buffer was seen full.
    pub overflow: u64,
    /// Dropped while a request filter or an upstream filter was on and the buffer was not seen
    /// full. The kernel has only one figure for what a filter refused and what found no room. So a
    /// buffer that is full for less than a second may be missed.
    pub prefilter: u64,
}

impl FilteredSocket {
    /// A socket without a filter.
    pub(in crate::datapath) fn new(socket: Socket) -> Self {
        Self { socket, filtered: AtomicBool::new(false), seen: Mutex::new(0) }
    }

    pub(in crate::datapath) fn socket(&self) -> &Socket {
        &self.socket
    }

    /// Whether a filter is on.
    pub(in crate::datapath) fn is_filtered(&self) -> bool {
        self.filtered.load(Relaxed)
    }

    /// Has the kernel refuse what the program refuses, or let everything through without a program.
    /// A new program replaces the old one at once.
    pub(in crate::datapath) fn filter(
        &self,
        program: Option<&Program>,
        drops: &NetDrops,
    ) -> io::Result<()> {
        self.account(drops); // these drops belong to the filter state so far
        match program {
            Some(program) => program.attach(&self.socket)?,
            None if self.is_filtered() => self.socket.detach_filter()?,
            None => {}
        }
        self.filtered.store(program.is_some(), Relaxed);
        Ok(())
    }

    /// Adds to `drops` what the kernel dropped since the last call. Returns all that the kernel has
    /// dropped on the socket, for whatever cause. This figure starts again from 0 after 2³².
    pub(in crate::datapath) fn account(&self, drops: &NetDrops) -> Option<u32> {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        // A figure that cannot be read now is read the next time.
        let (now, full) = options::kernel_drops(&self.socket).ok()?;
        let new = now.wrapping_sub(mem::replace(&mut *seen, now));
        let counter = if self.is_filtered() && !full { &drops.prefilter } else { &drops.overflow };
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
    pub(in crate::datapath) fn get(&self) -> KernelDrops {
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

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use libc::{BPF_JEQ, BPF_LD, BPF_LEN, BPF_W};

    use super::*;
    use crate::datapath::kernel_filter::assembler::To;

    /// A socket whose filter refuses empty datagrams, and another socket that sends to it.
    fn filtered(drops: &NetDrops) -> (FilteredSocket, UdpSocket) {
        let inside = UdpSocket::bind("127.0.0.1:0").unwrap();
        inside.set_nonblocking(true).unwrap();
        let outside = UdpSocket::bind("127.0.0.1:0").unwrap();
        outside.connect(inside.local_addr().unwrap()).unwrap();
        let socket = FilteredSocket::new(inside.into());
        socket.socket().set_recv_buffer_size(8192).unwrap();
        let mut program = Program::new();
        program.step(BPF_LD | BPF_W | BPF_LEN, 0);
        program.compare(BPF_JEQ, 8, To::Refuse, To::Accept);
        socket.filter(Some(&program), drops).unwrap();
        (socket, outside)
    }

    #[test]
    fn a_full_buffer_is_told_from_refusal_while_a_filter_is_on() {
        let drops = NetDrops::default();
        let (socket, outside) = filtered(&drops);
        (0..500).for_each(|_| assert_eq!(outside.send(b"").unwrap(), 0));
        socket.account(&drops).unwrap();
        assert_eq!(drops.get(), KernelDrops { overflow: 0, prefilter: 500 });

        (0..500).for_each(|_| assert_eq!(outside.send(&[1; 38]).unwrap(), 38));
        socket.account(&drops).unwrap();
        let KernelDrops { overflow, prefilter } = drops.get();
        assert!((100..500).contains(&overflow), "{overflow}");
        assert_eq!(prefilter, 500);

        let mut octets = [std::mem::MaybeUninit::uninit(); 64];
        while socket.socket().recv(&mut octets).is_ok() {}
        outside.send(b"").unwrap();
        socket.account(&drops).unwrap();
        assert_eq!(drops.get(), KernelDrops { overflow, prefilter: 501 });
    }
}
