//! Datagrams in and out in batches, through recvmmsg and sendmmsg.
//!
//! The system calls are made directly: the C library would make each a cancellation point, which
//! costs as much as all of the relay's own work on a datagram.
//!
//! The receive buffer is the send buffer: what was received stays in its slot until it has been
//! sent on. A message header's pointers are set right before the call that follows them.

use std::io;
use std::mem;
use std::net::{IpAddr, SocketAddr};
use std::os::fd::{AsRawFd, BorrowedFd};

use crate::relay::{Direction, MappingId};

use super::address::{Control, Name};

/// Octets kept of a datagram. A longer one is cut, and still longer than any that is accepted.
const SLOT: usize = 128;
/// Datagrams held between two sends.
const SLOTS: usize = 512;
/// Datagrams taken from one socket before the next one has its turn.
pub(super) const AT_ONCE: usize = 32;

#[derive(Clone, Copy)]
#[repr(align(64))]
struct Octets([u8; SLOT]);

/// Room for the datagrams of one wake-up.
pub(super) struct Batch {
    octets: Box<[Octets]>,
    names: Box<[Name]>,
    controls: Box<[Control]>,
    headers: Box<[libc::mmsghdr]>,
    parts: Box<[libc::iovec]>,
    queue: Vec<Outgoing>,
    /// Slots that hold datagrams until the flush.
    used: usize,
}

// SAFETY: the pointers in `headers` and `parts` are leftovers between calls: each call that has the
// kernel follow some sets them first, to slots that the same batch owns.
unsafe impl Send for Batch {}

/// What was received in one slot.
pub(super) struct Incoming<'a> {
    /// Where it waits until [`Batch::queue`].
    pub slot: usize,
    /// The sender.
    pub from: SocketAddr,
    /// The address it was sent to, when the socket tells.
    pub to: Option<IpAddr>,
    /// The datagram, or its beginning.
    pub octets: &'a mut [u8],
}

/// A datagram that waits to be sent.
struct Outgoing {
    /// Which socket sends it, in the caller's own numbers.
    key: u64,
    slot: usize,
    name_len: libc::socklen_t,
    control_len: usize,
    tag: Tag,
}

/// What the caller wants back with the outcome of a send.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tag {
    pub mapping: MappingId,
    pub direction: Direction,
    pub octets: usize,
}

impl Batch {
    pub(super) fn new() -> Self {
        // SAFETY: message headers and parts are plain integers and pointers; all zero is valid.
        let (header, part) = unsafe { (mem::zeroed(), mem::zeroed()) };
        Self {
            octets: vec![Octets([0; SLOT]); SLOTS].into(),
            names: vec![Name::default(); SLOTS].into(),
            controls: vec![Control::default(); SLOTS].into(),
            headers: vec![header; SLOTS].into(),
            parts: vec![part; SLOTS].into(),
            queue: Vec::with_capacity(SLOTS),
            used: 0,
        }
    }

    /// Whether another [`receive`](Self::receive) needs a [`flush`](Self::flush) first.
    pub(super) fn is_full(&self) -> bool {
        self.used + AT_ONCE > SLOTS
    }

    /// Takes what waits on a socket, up to [`AT_ONCE`] datagrams, and returns how many.
    pub(super) fn receive(&mut self, socket: BorrowedFd<'_>) -> io::Result<usize> {
        for (place, slot) in (self.used..self.used + AT_ONCE).enumerate() {
            let part = &mut self.parts[place];
            part.iov_base = self.octets[slot].0.as_mut_ptr().cast();
            part.iov_len = SLOT;
            let header = &mut self.headers[place].msg_hdr;
            header.msg_name = self.names[slot].as_mut_ptr();
            header.msg_namelen = Name::CAPACITY;
            header.msg_iov = part;
            header.msg_iovlen = 1;
            header.msg_control = self.controls[slot].as_mut_ptr();
            header.msg_controllen = Control::CAPACITY as _;
        }
        loop {
            // SAFETY: there are AT_ONCE headers, whose pointers and lengths have just been set to
            // slots of boxed slices that `self` owns; `self` is borrowed exclusively during the
            // call.
            let received = unsafe {
                libc::syscall(
                    libc::SYS_recvmmsg,
                    socket.as_raw_fd(),
                    self.headers.as_mut_ptr(),
                    AT_ONCE,
                    libc::MSG_DONTWAIT,
                    std::ptr::null_mut::<libc::timespec>(),
                )
            };
            if let Ok(received) = usize::try_from(received) {
                return Ok(received);
            }
            let error = io::Error::last_os_error();
            match error.kind() {
                io::ErrorKind::WouldBlock => return Ok(0),
                io::ErrorKind::Interrupted => {} // to miss what is there is to miss it for good
                _ => return Err(error),
            }
        }
    }

    /// The datagram at `index` among those of the last [`receive`](Self::receive); none when its
    /// sender's address is of no known family.
    #[inline]
    pub(super) fn incoming(&mut self, index: usize) -> Option<Incoming<'_>> {
        let slot = self.used + index;
        let header = &self.headers[index];
        let len = (header.msg_len as usize).min(SLOT);
        Some(Incoming {
            slot,
            from: self.names[slot].address(header.msg_hdr.msg_namelen)?,
            to: self.controls[slot].local_address(header.msg_hdr.msg_controllen as _),
            octets: &mut self.octets[slot].0[..len],
        })
    }

    /// Keeps the first `count` datagrams of the last [`receive`](Self::receive) until the flush.
    pub(super) fn keep(&mut self, count: usize) {
        self.used += count;
    }

    /// Queues the datagram in `slot` for sending on the socket `key`; from the address `from`, when
    /// the socket has not one of its own.
    pub(super) fn queue(
        &mut self,
        slot: usize,
        key: u64,
        from: Option<IpAddr>,
        to: SocketAddr,
        tag: Tag,
    ) {
        let name_len = self.names[slot].set(to);
        let control_len = from.map_or(0, |from| self.controls[slot].set_source(from));
        self.queue.push(Outgoing { key, slot, name_len, control_len, tag });
    }

    /// Sends all that is queued, a system call a socket where the kernel takes all at once, and
    /// reports each outcome. Datagrams to the same socket leave in the order they were queued.
    pub(super) fn flush<'s>(
        &mut self,
        socket: impl Fn(u64) -> Option<BorrowedFd<'s>>,
        mut outcome: impl FnMut(Tag, io::Result<()>),
    ) {
        // Slots only grow until the flush, so they keep the order within a socket.
        self.queue.sort_unstable_by_key(|outgoing| (outgoing.key, outgoing.slot));
        for (place, outgoing) in self.queue.iter().enumerate() {
            let part = &mut self.parts[place];
            part.iov_base = self.octets[outgoing.slot].0.as_mut_ptr().cast();
            part.iov_len = outgoing.tag.octets;
            let header = &mut self.headers[place].msg_hdr;
            header.msg_iov = part;
            header.msg_iovlen = 1;
            header.msg_name = self.names[outgoing.slot].as_mut_ptr();
            header.msg_namelen = outgoing.name_len;
            header.msg_control = self.controls[outgoing.slot].as_mut_ptr();
            header.msg_controllen = outgoing.control_len as _;
        }
        let mut place = 0;
        for run in self.queue.chunk_by(|a, b| a.key == b.key) {
            let headers = &mut self.headers[place..place + run.len()];
            place += run.len();
            match socket(run[0].key) {
                Some(socket) => send(socket, headers, run, &mut outcome),
                None => run.iter().for_each(|datagram| {
                    outcome(datagram.tag, Err(io::ErrorKind::NotConnected.into()));
                }),
            }
        }
        self.queue.clear();
        self.used = 0;
    }
}

fn send(
    socket: BorrowedFd<'_>,
    headers: &mut [libc::mmsghdr],
    run: &[Outgoing],
    outcome: &mut impl FnMut(Tag, io::Result<()>),
) {
    let mut done = 0;
    while done < run.len() {
        let rest = &mut headers[done..];
        // SAFETY: `rest` is an exclusive slice of headers that `flush` has just pointed at slots of
        // boxed slices of the batch, which it borrows exclusively for the whole call. A part's
        // length is the datagram's, which fits its slot since it was received into it.
        let sent = unsafe {
            libc::syscall(
                libc::SYS_sendmmsg,
                socket.as_raw_fd(),
                rest.as_mut_ptr(),
                rest.len(),
                libc::MSG_DONTWAIT,
            )
        };
        if sent > 0 {
            let taken = sent as usize;
            run[done..done + taken].iter().for_each(|datagram| outcome(datagram.tag, Ok(())));
            done += taken;
            continue;
        }
        // The error is the first datagram's; those behind it have their own chance.
        let error = io::Error::last_os_error();
        if error.kind() != io::ErrorKind::Interrupted {
            outcome(run[done].tag, Err(error));
            done += 1;
        }
    }
}
