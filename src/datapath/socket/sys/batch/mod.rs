//! Receives and sends datagrams in batches, through recvmmsg and sendmmsg. A single datagram goes
//! through recvfrom and sendto, which need no message header and save a tenth of a microsecond
//! each.
//!
//! The receive buffer is also the send buffer: a received datagram stays in its slot until it has
//! been sent on. Every pointer that the kernel follows is made right before the call that hands it
//! over. Nothing touches the memory behind it until that call has returned.
//!
//! Datagrams of one length to one receiver are handed over as one message, which the kernel cuts
//! apart as late as it can (UDP_SEGMENT). So a burst goes through most of the system once.

mod calls;
#[cfg(test)]
mod fake;
mod send;
#[cfg(all(test, not(miri)))] // on real sockets
mod tests;

use std::io;
use std::mem;
use std::net::{IpAddr, SocketAddr};
use std::os::fd::BorrowedFd;
use std::ptr;

use nix::errno::Errno;

use crate::nat::{Direction, FlowId, MappingId, Payload};

use crate::datapath::socket::sys::address::{Control, Name};
use calls::Kernel;
pub(in crate::datapath) use calls::Linux;

/// Octets that are kept of a datagram of P-NET. A longer datagram is cut, and what is left is still
/// longer than any that is accepted.
pub(in crate::datapath) const SHORT: usize = 128;
/// The same for protocols whose datagrams fill a frame of Ethernet.
pub(in crate::datapath) const LONG: usize = 1536;
/// The most datagrams that are taken from one socket before the next socket has its turn.
pub(in crate::datapath) const AT_ONCE: usize = 32;
/// The most datagrams that one message may be cut into. Older kernels refuse more.
const SEGMENTS: usize = 64;

#[derive(Clone, Copy)]
#[repr(align(64))]
struct Octets<const SLOT: usize>([u8; SLOT]);

/// Room for the datagrams of one wake-up, with so many octets for each.
pub(in crate::datapath) struct Batch<K = Linux, const SLOT: usize = SHORT> {
    kernel: K,
    octets: Box<[Octets<SLOT>]>,
    names: Box<[Name]>,
    controls: Box<[Control]>,
    /// The messages of the last receive, one for each datagram.
    incoming: Box<[libc::mmsghdr]>,
    /// Where these messages put octets.
    rooms: Box<[libc::iovec]>,
    /// Messages that are to be sent.
    headers: Box<[libc::mmsghdr]>,
    /// The octets in these messages.
    parts: Box<[libc::iovec]>,
    queue: Vec<Outgoing>,
    /// Slots that hold datagrams until the flush.
    used: usize,
    /// Whether the kernel cuts messages into datagrams.
    segments: bool,
}

// SAFETY: between calls, the pointers in headers, rooms and parts are leftovers: each call that has
// the kernel follow some of them sets them first, to memory that the same batch owns.
unsafe impl<K: Send, const SLOT: usize> Send for Batch<K, SLOT> {}

/// How the address that a datagram was sent to is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::datapath) enum Destination {
    /// The address is the one that the socket is bound to, or nobody needs it.
    Bound,
    /// A control message of each datagram tells the address.
    FromControl,
}

/// The datagrams of one [`receive`](Batch::receive). They stay in their slots until the flush, also
/// those that are not queued.
pub(in crate::datapath) struct Received<'b, K = Linux, const SLOT: usize = SHORT> {
    batch: &'b mut Batch<K, SLOT>,
    count: usize,
    /// How many were looked at.
    seen: usize,
}

/// A datagram that was received.
pub(in crate::datapath) struct Incoming<'a> {
    /// The sender.
    pub from: SocketAddr,
    /// The unicast address that the datagram was sent to, when the socket tells it.
    pub to: Option<IpAddr>,
    /// The datagram, or its beginning.
    pub payload: Payload<'a>,
}

/// A datagram that waits to be sent.
struct Outgoing {
    /// The socket that sends the datagram, in the caller's own numbers.
    key: u64,
    /// A number that is the same for all datagrams to one receiver.
    peer: u64,
    slot: usize,
    name_len: libc::socklen_t,
    control_len: usize,
    tag: Tag,
}

/// What the caller gets back with the outcome of a send.
#[derive(Clone, Copy, Debug)]
pub(in crate::datapath) struct Tag {
    pub mapping: MappingId,
    pub direction: Direction,
    pub octets: usize,
    /// See [`ToServer::asks`](crate::nat::ToServer::asks).
    pub asks: Option<FlowId>,
}

impl<const SLOT: usize> Batch<Linux, SLOT> {
    pub(in crate::datapath) fn new() -> Self {
        Self::on(Linux)
    }
}

impl<K: Kernel, const SLOT: usize> Batch<K, SLOT> {
    /// The most datagrams that are held between two sends.
    const SLOTS: usize = if SLOT > SHORT { 64 } else { 512 };

    /// A batch that receives and sends through this kernel.
    fn on(kernel: K) -> Self {
        // SAFETY: message headers and parts are plain integers and pointers; all zero is valid.
        let (header, part): (libc::mmsghdr, libc::iovec) =
            unsafe { (mem::zeroed(), mem::zeroed()) };
        Self {
            // Long datagrams are few, and some ways out take none that would have to be cut.
            segments: SLOT <= SHORT && kernel.cuts_messages(),
            kernel,
            octets: vec![Octets([0; SLOT]); Self::SLOTS].into(),
            names: vec![Name::default(); Self::SLOTS].into(),
            controls: vec![Control::default(); Self::SLOTS].into(),
            incoming: vec![header; AT_ONCE].into(),
            rooms: vec![part; AT_ONCE].into(),
            headers: vec![header; Self::SLOTS].into(),
            parts: vec![part; Self::SLOTS].into(),
            queue: Vec::with_capacity(Self::SLOTS),
            used: 0,
        }
    }

    /// Whether another [`receive`](Self::receive) needs a [`flush`](Self::flush) first.
    pub(in crate::datapath) fn is_full(&self) -> bool {
        self.used + AT_ONCE > Self::SLOTS
    }

    /// Takes up to `most` datagrams that wait on a socket. `most` is at most [`AT_ONCE`].
    #[inline]
    pub(in crate::datapath) fn receive(
        &mut self,
        socket: BorrowedFd<'_>,
        most: usize,
        destination: Destination,
    ) -> io::Result<Received<'_, K, SLOT>> {
        let received = if most == 1 && destination == Destination::Bound {
            self.receive_one(socket)
        } else {
            self.receive_many(socket, most)
        };
        let count = match received {
            Err(Errno::EAGAIN) => 0,
            received => received?,
        };
        Ok(Received { batch: self, count, seen: 0 })
    }

    fn receive_many(&mut self, socket: BorrowedFd<'_>, most: usize) -> nix::Result<usize> {
        let messages = &mut self.incoming[..most];
        let rooms = messages.iter_mut().zip(&mut self.rooms);
        let names = self.names[self.used..].iter_mut().zip(&mut self.controls[self.used..]);
        let slots = names.zip(&mut self.octets[self.used..][..most]);
        for ((message, room), ((name, control), octets)) in rooms.zip(slots) {
            room.iov_base = octets.0.as_mut_ptr().cast();
            room.iov_len = SLOT;
            let header = &mut message.msg_hdr;
            header.msg_name = name.as_mut_ptr();
            header.msg_namelen = Name::CAPACITY;
            header.msg_iov = room;
            header.msg_iovlen = 1;
            header.msg_control = control.as_mut_ptr();
            header.msg_controllen = Control::CAPACITY as _;
        }
        let messages = messages.as_mut_ptr();
        // SAFETY: `most` messages were just pointed at as many slots, and told how long these are;
        // nothing else uses them before the call has returned.
        let received = uninterrupted(|| unsafe { self.kernel.recvmmsg(socket, messages, most) })?;
        Ok(received.min(most))
    }

    /// Receives like `receive_many`, but one datagram.
    fn receive_one(&mut self, socket: BorrowedFd<'_>) -> nix::Result<usize> {
        let octets = self.octets[self.used].0.as_mut_ptr().cast();
        let name = self.names[self.used].as_mut_ptr();
        let mut name_len = Name::CAPACITY;
        let len = uninterrupted(|| {
            let name_len = ptr::from_mut(&mut name_len);
            // SAFETY: octets and name belong to one slot and are as long as is said; nothing else
            // uses them before the call has returned.
            unsafe { self.kernel.recvfrom(socket, octets, SLOT, name, name_len) }
        })?;
        let message = &mut self.incoming[0];
        message.msg_len = len as libc::c_uint;
        message.msg_hdr.msg_namelen = name_len;
        message.msg_hdr.msg_controllen = 0;
        Ok(1)
    }
}

impl<K, const SLOT: usize> Received<'_, K, SLOT> {
    /// How many datagrams there are, whoever sent them.
    pub(in crate::datapath) fn count(&self) -> usize {
        self.count
    }

    /// The next datagram. One is passed over when its sender's address is of no known family.
    #[inline]
    pub(in crate::datapath) fn next_datagram(&mut self) -> Option<Incoming<'_>> {
        while self.seen < self.count {
            let (index, slot) = (self.seen, self.batch.used + self.seen);
            self.seen += 1;
            let batch = &mut *self.batch;
            let message = &batch.incoming[index];
            let (name_len, control_len) =
                (message.msg_hdr.msg_namelen, message.msg_hdr.msg_controllen as _);
            let len = message.msg_len as usize; // of a datagram that was cut, more than a slot has
            if let Some(from) = batch.names[slot].address(name_len) {
                let to = batch.controls[slot].local_address(control_len);
                let payload = Payload::new(&mut self.batch.octets[slot].0, len);
                return Some(Incoming { from, to, payload });
            }
        }
        None
    }
}

impl<K: Kernel, const SLOT: usize> Received<'_, K, SLOT> {
    /// Queues the last datagram for sending on the socket `key`. When the socket has no address of
    /// its own, the datagram leaves from the address `from`.
    #[inline]
    pub(in crate::datapath) fn queue(
        &mut self,
        key: u64,
        from: Option<IpAddr>,
        to: SocketAddr,
        tag: Tag,
    ) {
        let slot = self.batch.used + self.seen.checked_sub(1).expect("a datagram was looked at");
        self.batch.queue(slot, key, from, to, tag);
    }
}

impl<K, const SLOT: usize> Drop for Received<'_, K, SLOT> {
    fn drop(&mut self) {
        self.batch.used += self.count;
    }
}

/// Makes a system call again as long as signals interrupt it, and returns its outcome.
#[inline]
fn uninterrupted(mut call: impl FnMut() -> nix::Result<usize>) -> nix::Result<usize> {
    loop {
        match call() {
            Err(Errno::EINTR) => {}
            outcome => return outcome,
        }
    }
}
