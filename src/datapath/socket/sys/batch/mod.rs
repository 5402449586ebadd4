//! Datagrams in and out in batches, through recvmmsg and sendmmsg; one that is alone goes through
//! recvfrom and sendto, which follow no header and save a tenth of a microsecond each.
//!
//! The receive buffer is the send buffer: what was received stays in its slot until it has been
//! sent on. Every pointer that the kernel follows is made right before the call that hands it over,
//! and nothing touches what it leads to until that call is back.
//!
//! Datagrams of one length to one receiver are handed over as one message, which the kernel cuts
//! apart as late as it can (UDP_SEGMENT): a burst goes through most of the system once.

mod calls;
#[cfg(test)]
mod fake;
#[cfg(all(test, not(miri)))] // on real sockets
mod tests;

use std::io;
use std::iter;
use std::mem;
use std::net::{IpAddr, SocketAddr};
use std::ops::Range;
use std::os::fd::BorrowedFd;
use std::ptr;
use std::slice;

use nix::errno::Errno;

use crate::nat::{Direction, FlowId, MappingId};

use crate::datapath::socket::sys::address::{Control, Name};
use calls::{Kernel, Linux};

/// Octets kept of a datagram. A longer one is cut, and still longer than any that is accepted.
const SLOT: usize = 128;
/// Datagrams held between two sends.
const SLOTS: usize = 512;
/// Datagrams taken from one socket before the next one has its turn.
pub(in crate::datapath) const AT_ONCE: usize = 32;
/// Datagrams that one message may be cut into; older kernels refuse more.
const SEGMENTS: usize = 64;

#[derive(Clone, Copy)]
#[repr(align(64))]
struct Octets([u8; SLOT]);

/// Room for the datagrams of one wake-up.
pub(in crate::datapath) struct Batch<K = Linux> {
    kernel: K,
    octets: Box<[Octets]>,
    names: Box<[Name]>,
    controls: Box<[Control]>,
    /// Of the last receive, a datagram each,
    incoming: Box<[libc::mmsghdr]>,
    /// and where they put octets.
    rooms: Box<[libc::iovec]>,
    /// Messages to be sent,
    headers: Box<[libc::mmsghdr]>,
    /// and the octets in them.
    parts: Box<[libc::iovec]>,
    queue: Vec<Outgoing>,
    /// Slots that hold datagrams until the flush.
    used: usize,
    /// Whether the kernel cuts messages into datagrams.
    segments: bool,
}

// SAFETY: the pointers in headers, rooms and parts are leftovers between calls: each call that has
// the kernel follow some sets them first, to what the same batch owns.
unsafe impl<K: Send> Send for Batch<K> {}

/// How the address is known that a datagram was sent to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::datapath) enum Destination {
    /// It is the one that the socket is bound to, or of no interest.
    Bound,
    /// A control message of each datagram tells it.
    FromControl,
}

/// What was received in one slot.
pub(in crate::datapath) struct Incoming<'a> {
    /// Where it waits until [`Batch::queue`].
    pub slot: usize,
    /// The sender.
    pub from: SocketAddr,
    /// The unicast address it was sent to, when the socket tells.
    pub to: Option<IpAddr>,
    /// The datagram, or its beginning.
    pub octets: &'a mut [u8],
}

/// A datagram that waits to be sent.
struct Outgoing {
    /// Which socket sends it, in the caller's own numbers.
    key: u64,
    /// The same for all datagrams to one receiver.
    peer: u64,
    slot: usize,
    name_len: libc::socklen_t,
    control_len: usize,
    tag: Tag,
}

/// What the caller wants back with the outcome of a send.
#[derive(Clone, Copy, Debug)]
pub(in crate::datapath) struct Tag {
    pub mapping: MappingId,
    pub direction: Direction,
    pub octets: usize,
    /// See [`ToServer::asks`](crate::nat::ToServer::asks).
    pub asks: Option<FlowId>,
}

impl Batch {
    pub(in crate::datapath) fn new() -> Self {
        Self::on(Linux)
    }
}

impl<K: Kernel> Batch<K> {
    /// A batch whose datagrams this kernel receives and sends.
    fn on(kernel: K) -> Self {
        // SAFETY: message headers and parts are plain integers and pointers; all zero is valid.
        let (header, part): (libc::mmsghdr, libc::iovec) =
            unsafe { (mem::zeroed(), mem::zeroed()) };
        Self {
            segments: kernel.cuts_messages(),
            kernel,
            octets: vec![Octets([0; SLOT]); SLOTS].into(),
            names: vec![Name::default(); SLOTS].into(),
            controls: vec![Control::default(); SLOTS].into(),
            incoming: vec![header; AT_ONCE].into(),
            rooms: vec![part; AT_ONCE].into(),
            headers: vec![header; SLOTS].into(),
            parts: vec![part; SLOTS].into(),
            queue: Vec::with_capacity(SLOTS),
            used: 0,
        }
    }

    /// Whether another [`receive`](Self::receive) needs a [`flush`](Self::flush) first.
    pub(in crate::datapath) fn is_full(&self) -> bool {
        self.used + AT_ONCE > SLOTS
    }

    /// Takes what waits on a socket, up to `most` datagrams, of [`AT_ONCE`], and returns how many.
    pub(in crate::datapath) fn receive(
        &mut self,
        socket: BorrowedFd<'_>,
        most: usize,
        destination: Destination,
    ) -> io::Result<usize> {
        let received = if most == 1 && destination == Destination::Bound {
            self.receive_one(socket)
        } else {
            self.receive_many(socket, most)
        };
        match received {
            Err(Errno::EAGAIN) => Ok(0),
            received => Ok(received?),
        }
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
        // nothing else uses them before the call is back.
        let received = uninterrupted(|| unsafe { self.kernel.recvmmsg(socket, messages, most) })?;
        Ok(received.min(most))
    }

    /// The same for one datagram.
    fn receive_one(&mut self, socket: BorrowedFd<'_>) -> nix::Result<usize> {
        let octets = self.octets[self.used].0.as_mut_ptr().cast();
        let name = self.names[self.used].as_mut_ptr();
        let mut name_len = Name::CAPACITY;
        let len = uninterrupted(|| {
            let name_len = ptr::from_mut(&mut name_len);
            // SAFETY: octets and name are one slot's, as long as is said; nothing else uses them
            // before the call is back.
            unsafe { self.kernel.recvfrom(socket, octets, SLOT, name, name_len) }
        })?;
        let message = &mut self.incoming[0];
        message.msg_len = len as libc::c_uint;
        message.msg_hdr.msg_namelen = name_len;
        message.msg_hdr.msg_controllen = 0;
        Ok(1)
    }

    /// The datagram at `index` among those of the last [`receive`](Self::receive); none when its
    /// sender's address is of no known family.
    #[inline]
    pub(in crate::datapath) fn incoming(&mut self, index: usize) -> Option<Incoming<'_>> {
        let (slot, header) = (self.used + index, &self.incoming[index]);
        let len = (header.msg_len as usize).min(SLOT);
        Some(Incoming {
            slot,
            from: self.names[slot].address(header.msg_hdr.msg_namelen)?,
            to: self.controls[slot].local_address(header.msg_hdr.msg_controllen as _),
            octets: &mut self.octets[slot].0[..len],
        })
    }

    /// Keeps the first `count` datagrams of the last [`receive`](Self::receive) until the flush.
    pub(in crate::datapath) fn keep(&mut self, count: usize) {
        self.used += count;
    }

    /// Queues the datagram in `slot` for sending on the socket `key`; from the address `from`, when
    /// the socket has not one of its own.
    pub(in crate::datapath) fn queue(
        &mut self,
        slot: usize,
        key: u64,
        from: Option<IpAddr>,
        to: SocketAddr,
        tag: Tag,
    ) {
        assert!(tag.octets <= SLOT);
        let name_len = self.names[slot].set(to);
        let control_len = from.map_or(0, |from| self.controls[slot].set_source(from));
        self.queue.push(Outgoing { key, peer: peer(to), slot, name_len, control_len, tag });
    }

    /// Sends all that is queued, a system call a socket where the kernel takes all at once, and
    /// reports each outcome. Datagrams from one socket to one receiver leave in the order they were
    /// queued.
    pub(in crate::datapath) fn flush<'s>(
        &mut self,
        socket: impl Fn(u64) -> Option<BorrowedFd<'s>>,
        mut outcome: impl FnMut(Tag, io::Result<()>),
    ) {
        let mut queue = mem::take(&mut self.queue);
        // Slots only grow until the flush, so they keep the order.
        queue.sort_unstable_by_key(|outgoing| (outgoing.key, outgoing.peer, outgoing.slot));
        for run in queue.chunk_by(|a, b| a.key == b.key) {
            match socket(run[0].key) {
                Some(socket) => self.send(socket, run, &mut outcome),
                None => run.iter().for_each(|datagram| {
                    outcome(datagram.tag, Err(io::ErrorKind::NotConnected.into()));
                }),
            }
        }
        queue.clear();
        self.queue = queue;
        self.used = 0;
    }

    /// Sends datagrams that leave from one socket.
    fn send(
        &mut self,
        socket: BorrowedFd<'_>,
        mut run: &[Outgoing],
        outcome: &mut impl FnMut(Tag, io::Result<()>),
    ) {
        if let [alone] = run
            && alone.control_len == 0
        {
            let sent = self.send_one(socket, alone);
            return outcome(alone.tag, sent.map_err(io::Error::from));
        }
        let messages = self.prepare(run);
        let mut next = 0;
        while next < messages {
            let sent = self.send_some(socket, next..messages);
            let tried = &self.headers[next..next + sent.unwrap_or(1)];
            if let Err(error) = sent
                && segments(&tried[0]) > 1
            {
                // Perhaps the way to this receiver knows no segments, perhaps the system is short
                // of memory: each datagram has its own chance, and so have those behind it.
                self.segments = false;
                self.send(socket, run, outcome);
                self.segments = error != Errno::EIO; // no checksums on some way out
                return;
            }
            next += tried.len();
            for message in tried {
                let (done, rest) = run.split_at(segments(message));
                run = rest;
                let sent = sent.and_then(|_| whole(message.msg_len as usize, done));
                for datagram in done {
                    outcome(datagram.tag, sent.map_err(io::Error::from));
                }
            }
        }
    }

    /// Sends as many of these messages as the kernel takes; the error is the first one's.
    fn send_some(&mut self, socket: BorrowedFd<'_>, messages: Range<usize>) -> nix::Result<usize> {
        let messages = &mut self.headers[messages];
        let (count, messages) = (messages.len(), messages.as_mut_ptr());
        // SAFETY: `prepare` has pointed the messages at slots and parts, and told how long these
        // are; since then nothing else has used them.
        match uninterrupted(|| unsafe { self.kernel.sendmmsg(socket, messages, count) })? {
            0 => Err(Errno::EAGAIN),
            sent => Ok(sent.min(count)),
        }
    }

    /// Sends a datagram that is alone, and about which there is no more to say than where it goes.
    fn send_one(&mut self, socket: BorrowedFd<'_>, alone: &Outgoing) -> nix::Result<()> {
        let octets = self.octets[alone.slot].0.as_ptr().cast();
        let name = self.names[alone.slot].as_ptr();
        let len = alone.tag.octets;
        let sent = uninterrupted(|| {
            // SAFETY: octets and name are one slot's, which holds as many: `queue` has seen to it.
            unsafe { self.kernel.sendto(socket, octets, len, name, alone.name_len) }
        })?;
        whole(sent, slice::from_ref(alone))
    }

    /// Sets up the messages that carry the datagrams, and returns how many there are.
    fn prepare(&mut self, run: &[Outgoing]) -> usize {
        let messages = self.group(run);
        self.point(run, messages);
        messages
    }

    /// Decides which datagrams leave as one message, and returns how many messages there are.
    fn group(&mut self, run: &[Outgoing]) -> usize {
        let mut messages = 0;
        let mut first = 0;
        for (place, outgoing) in run.iter().enumerate() {
            if self.continues(&run[first..place], outgoing) {
                let header = &mut self.headers[messages - 1].msg_hdr;
                let Outgoing { slot, control_len, tag, .. } = &run[first];
                let segment = tag.octets as u16; // a slot's length at most
                header.msg_controllen =
                    self.controls[*slot].add_segment_len(*control_len, segment) as _;
                header.msg_iovlen += 1;
                continue;
            }
            let header = &mut self.headers[messages].msg_hdr;
            header.msg_iovlen = 1;
            header.msg_namelen = outgoing.name_len;
            header.msg_controllen = outgoing.control_len as _;
            messages += 1;
            first = place;
        }
        messages
    }

    /// Points these messages at their datagrams. Whatever the pointers lead to is borrowed once for
    /// all of them: to borrow it again would take the right to it from those made before.
    fn point(&mut self, mut run: &[Outgoing], messages: usize) {
        let octets = self.octets.as_mut_ptr();
        let names = self.names.as_mut_ptr();
        let controls = self.controls.as_mut_ptr();
        let mut parts = &mut self.parts[..run.len()];
        for message in &mut self.headers[..messages] {
            let count = segments(message);
            let (datagrams, later) = run.split_at(count);
            let (its, others) = parts.split_at_mut(count);
            for (part, datagram) in iter::zip(&mut *its, datagrams) {
                part.iov_base = octets.wrapping_add(datagram.slot).cast();
                part.iov_len = datagram.tag.octets;
            }
            let (first, header) = (&datagrams[0], &mut message.msg_hdr);
            header.msg_iov = its.as_mut_ptr();
            header.msg_name = names.wrapping_add(first.slot).cast();
            header.msg_control = controls.wrapping_add(first.slot).cast();
            (run, parts) = (later, others);
        }
    }

    /// Whether a datagram can be the next segment of a message: all are of one length, but for the
    /// last, which may be shorter. An empty one would vanish.
    fn continues(&self, message: &[Outgoing], next: &Outgoing) -> bool {
        let (Some(first), Some(last)) = (message.first(), message.last()) else { return false };
        let name = |of: &Outgoing| self.names[of.slot].address(of.name_len);
        let source = |of: &Outgoing| self.controls[of.slot].octets(of.control_len);
        self.segments
            && message.len() < SEGMENTS
            && first.peer == next.peer
            && first.tag.octets == last.tag.octets
            && (1..=first.tag.octets).contains(&next.tag.octets)
            && name(first) == name(next)
            && source(first) == source(next)
    }
}

/// Datagrams that a message carries. The C libraries disagree on the type.
fn segments(message: &libc::mmsghdr) -> usize {
    message.msg_hdr.msg_iovlen as _
}

/// A number for a receiver, which strangers to each other hardly ever share.
fn peer(address: SocketAddr) -> u64 {
    let ip = match address.ip() {
        IpAddr::V4(address) => address.to_bits().into(),
        IpAddr::V6(address) => {
            let bits = address.to_bits();
            (bits >> 64) as u64 ^ bits as u64
        }
    };
    ip.rotate_left(16) ^ u64::from(address.port())
}

/// Whether so many octets are these datagrams' as a whole.
fn whole(sent: usize, datagrams: &[Outgoing]) -> nix::Result<()> {
    let octets: usize = datagrams.iter().map(|datagram| datagram.tag.octets).sum();
    if sent == octets { Ok(()) } else { Err(Errno::EMSGSIZE) }
}

/// The outcome of a system call, made again for as long as signals interrupt it.
#[inline]
fn uninterrupted(mut call: impl FnMut() -> nix::Result<usize>) -> nix::Result<usize> {
    loop {
        match call() {
            Err(Errno::EINTR) => {}
            outcome => return outcome,
        }
    }
}
