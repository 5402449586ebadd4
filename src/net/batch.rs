//! Datagrams in and out in batches, through recvmmsg and sendmmsg; one that is alone goes through
//! recvfrom and sendto, which follow no header and save a tenth of a microsecond each.
//!
//! The system calls are made directly: the C library would make each a cancellation point, which
//! costs as much as all of the relay's own work on a datagram.
//!
//! The receive buffer is the send buffer: what was received stays in its slot until it has been
//! sent on. A slot's header for receiving points at it for good; those for sending are pointed at
//! slots right before the call that follows them.
//!
//! Datagrams of one length to one receiver are handed over as one message, which the kernel cuts
//! apart as late as it can (UDP_SEGMENT): a burst goes through most of the system once.

use std::io;
use std::mem;
use std::net::{IpAddr, SocketAddr};
use std::os::fd::{AsRawFd, BorrowedFd};
use std::ptr;

use nix::errno::Errno;

use crate::relay::{Direction, MappingId};

use super::address::{Control, Name};
use super::socket;

/// Octets kept of a datagram. A longer one is cut, and still longer than any that is accepted.
const SLOT: usize = 128;
/// Datagrams held between two sends.
const SLOTS: usize = 512;
/// Datagrams taken from one socket before the next one has its turn.
pub(super) const AT_ONCE: usize = 32;
/// Datagrams that one message may be cut into; older kernels refuse more.
const SEGMENTS: usize = 64;

#[derive(Clone, Copy)]
#[repr(align(64))]
struct Octets([u8; SLOT]);

/// Room for the datagrams of one wake-up.
pub(super) struct Batch {
    octets: Box<[Octets]>,
    names: Box<[Name]>,
    controls: Box<[Control]>,
    /// Of each slot, to receive into it.
    incoming: Box<[libc::mmsghdr]>,
    /// Where `incoming` puts octets.
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

// SAFETY: the pointers in `incoming` and `rooms` lead to boxed slices that the same batch owns, and
// move with it. Those in `headers` and `parts` are leftovers between calls: each call that has the
// kernel follow some sets them first, to slots of the same batch.
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
    /// The same for all datagrams to one receiver.
    peer: u64,
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
        let (header, part): (libc::mmsghdr, libc::iovec) =
            unsafe { (mem::zeroed(), mem::zeroed()) };
        let mut batch = Self {
            octets: vec![Octets([0; SLOT]); SLOTS].into(),
            names: vec![Name::default(); SLOTS].into(),
            controls: vec![Control::default(); SLOTS].into(),
            incoming: vec![header; SLOTS].into(),
            rooms: vec![part; SLOTS].into(),
            headers: vec![header; SLOTS].into(),
            parts: vec![part; SLOTS].into(),
            queue: Vec::with_capacity(SLOTS),
            used: 0,
            segments: socket::cuts_messages(),
        };
        for slot in 0..SLOTS {
            let octets = batch.octets[slot].0.as_mut_ptr().cast();
            batch.rooms[slot] = libc::iovec { iov_base: octets, iov_len: SLOT };
            let header = &mut batch.incoming[slot].msg_hdr;
            header.msg_name = batch.names[slot].as_mut_ptr();
            header.msg_namelen = Name::CAPACITY;
            header.msg_iov = &mut batch.rooms[slot];
            header.msg_iovlen = 1;
            header.msg_control = batch.controls[slot].as_mut_ptr();
            header.msg_controllen = Control::CAPACITY as _;
        }
        batch
    }

    /// Whether another [`receive`](Self::receive) needs a [`flush`](Self::flush) first.
    pub(super) fn is_full(&self) -> bool {
        self.used + AT_ONCE > SLOTS
    }

    /// Takes what waits on a socket, up to `most` datagrams, of [`AT_ONCE`], and returns how many.
    /// `tells`: the socket tells where each was sent to.
    pub(super) fn receive(
        &mut self,
        socket: BorrowedFd<'_>,
        most: usize,
        tells: bool,
    ) -> io::Result<usize> {
        let received = if most == 1 && !tells {
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
        let headers = &mut self.incoming[self.used..][..most];
        uninterrupted(|| {
            // SAFETY: there are `most` headers, whose pointers lead to slots of boxed slices that
            // `self` owns, and which say how long these are; `self` is borrowed exclusively during
            // the call.
            unsafe {
                libc::syscall(
                    libc::SYS_recvmmsg,
                    socket.as_raw_fd(),
                    headers.as_mut_ptr(),
                    most,
                    libc::MSG_DONTWAIT,
                    ptr::null_mut::<libc::timespec>(),
                )
            }
        })
    }

    /// The same for one datagram.
    fn receive_one(&mut self, socket: BorrowedFd<'_>) -> nix::Result<usize> {
        let (slot, message) = (self.used, &mut self.incoming[self.used]);
        let len = uninterrupted(|| {
            // SAFETY: octets and name are a slot's, whose lengths are given; `self`, which owns
            // them, is borrowed exclusively during the call.
            unsafe {
                libc::syscall(
                    libc::SYS_recvfrom,
                    socket.as_raw_fd(),
                    self.octets[slot].0.as_mut_ptr(),
                    SLOT,
                    libc::MSG_DONTWAIT,
                    self.names[slot].as_mut_ptr(),
                    ptr::from_mut(&mut message.msg_hdr.msg_namelen),
                )
            }
        })?;
        message.msg_len = len as libc::c_uint;
        message.msg_hdr.msg_controllen = 0;
        Ok(1)
    }

    /// The datagram at `index` among those of the last [`receive`](Self::receive); none when its
    /// sender's address is of no known family.
    #[inline]
    pub(super) fn incoming(&mut self, index: usize) -> Option<Incoming<'_>> {
        let slot = self.used + index;
        let header = &self.incoming[slot];
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
        for message in &mut self.incoming[self.used..self.used + count] {
            // The kernel wrote how much of the room it took.
            message.msg_hdr.msg_namelen = Name::CAPACITY;
            message.msg_hdr.msg_controllen = Control::CAPACITY as _;
        }
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
        self.queue.push(Outgoing { key, peer: peer(to), slot, name_len, control_len, tag });
    }

    /// Sends all that is queued, a system call a socket where the kernel takes all at once, and
    /// reports each outcome. Datagrams from one socket to one receiver leave in the order they were
    /// queued.
    pub(super) fn flush<'s>(
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
            let sent = send(socket, &mut self.headers[next..messages]);
            let tried = &self.headers[next..next + sent.unwrap_or(1)];
            let datagrams = tried.iter().map(segments).sum();
            if let Err(error) = sent
                && datagrams > 1
            {
                // Perhaps the way to this receiver knows no segments, perhaps the system is short
                // of memory: each datagram has its own chance, and so have those behind it.
                self.segments = false;
                self.send(socket, run, outcome);
                self.segments = error != Errno::EIO; // no checksums on some way out
                return;
            }
            next += tried.len();
            let (done, rest) = run.split_at(datagrams);
            run = rest;
            for datagram in done {
                outcome(datagram.tag, sent.map(drop).map_err(io::Error::from));
            }
        }
    }

    /// Sends a datagram that is alone, and about which there is no more to say than where it goes.
    fn send_one(&mut self, socket: BorrowedFd<'_>, alone: &Outgoing) -> nix::Result<()> {
        let sent = uninterrupted(|| {
            // SAFETY: octets and name are those of a slot of boxed slices that `self` owns; the
            // datagram fits its slot since it was received into it, and so does its receiver's name.
            unsafe {
                libc::syscall(
                    libc::SYS_sendto,
                    socket.as_raw_fd(),
                    self.octets[alone.slot].0.as_ptr(),
                    alone.tag.octets,
                    libc::MSG_DONTWAIT,
                    self.names[alone.slot].as_mut_ptr(),
                    alone.name_len,
                )
            }
        });
        sent.map(drop)
    }

    /// Sets up the messages that carry the datagrams, and returns how many there are.
    fn prepare(&mut self, run: &[Outgoing]) -> usize {
        let mut messages = 0;
        let mut first = 0;
        for (place, outgoing) in run.iter().enumerate() {
            self.parts[place] = libc::iovec {
                iov_base: self.octets[outgoing.slot].0.as_mut_ptr().cast(),
                iov_len: outgoing.tag.octets,
            };
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
            header.msg_iov = &mut self.parts[place];
            header.msg_iovlen = 1;
            header.msg_name = self.names[outgoing.slot].as_mut_ptr();
            header.msg_namelen = outgoing.name_len;
            header.msg_control = self.controls[outgoing.slot].as_mut_ptr();
            header.msg_controllen = outgoing.control_len as _;
            messages += 1;
            first = place;
        }
        messages
    }

    /// Whether a datagram can be the next segment of a message: all are of one length, but for the
    /// last, which may be shorter.
    fn continues(&self, message: &[Outgoing], next: &Outgoing) -> bool {
        let (Some(first), Some(last)) = (message.first(), message.last()) else { return false };
        let name = |of: &Outgoing| self.names[of.slot].address(of.name_len);
        let source = |of: &Outgoing| self.controls[of.slot].local_address(of.control_len);
        self.segments
            && message.len() < SEGMENTS
            && first.peer == next.peer
            && first.tag.octets == last.tag.octets
            && first.tag.octets >= next.tag.octets
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

/// Sends as many messages as the kernel takes; the error is the first one's.
fn send(socket: BorrowedFd<'_>, messages: &mut [libc::mmsghdr]) -> nix::Result<usize> {
    uninterrupted(|| {
        // SAFETY: `messages` is an exclusive slice of headers that `prepare` has just pointed at
        // slots of boxed slices of the batch, which its caller borrows exclusively. A part's length
        // is the datagram's, which fits its slot since it was received into it; the parts of a
        // message stand one behind the other.
        unsafe {
            libc::syscall(
                libc::SYS_sendmmsg,
                socket.as_raw_fd(),
                messages.as_mut_ptr(),
                messages.len(),
                libc::MSG_DONTWAIT,
            )
        }
    })
}

/// The outcome of a system call, made again for as long as signals interrupt it.
#[inline]
fn uninterrupted(mut call: impl FnMut() -> libc::c_long) -> nix::Result<usize> {
    loop {
        match Errno::result(call()) {
            Err(Errno::EINTR) => {}
            outcome => return outcome.map(|figure| figure as usize),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;
    use std::os::fd::AsFd;
    use std::time::Duration;

    use super::*;

    const TAG: Tag = Tag { mapping: MappingId(0), direction: Direction::Response, octets: 0 };

    fn receiver(address: &str) -> UdpSocket {
        let socket = UdpSocket::bind((address, 0)).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        socket
    }

    /// Queues datagrams of these lengths; each octet tells its datagram's number.
    fn queue(batch: &mut Batch, key: u64, lengths: &[u8], from: Option<IpAddr>, to: SocketAddr) {
        for (number, &len) in (0..).zip(lengths) {
            let octets = usize::from(len);
            batch.octets[batch.used].0[..octets].fill(number);
            batch.queue(batch.used, key, from, to, Tag { octets, ..TAG });
            batch.keep(1);
        }
    }

    /// Sends what is queued and returns how many datagrams the system took, and how many not.
    fn flush(batch: &mut Batch, socket: &UdpSocket) -> (usize, usize) {
        let (mut taken, mut refused) = (0, 0);
        batch.flush(
            |_| Some(socket.as_fd()),
            |_, outcome| match outcome {
                Ok(()) => taken += 1,
                Err(_) => refused += 1,
            },
        );
        (taken, refused)
    }

    fn expect(receiver: &UdpSocket, lengths: &[u8], from: IpAddr) {
        for (number, &len) in (0..).zip(lengths) {
            let mut octets = [0; SLOT];
            let (got, sender) = receiver.recv_from(&mut octets).unwrap();
            assert_eq!(octets[..got], vec![number; usize::from(len)]);
            assert_eq!(sender.ip(), from);
        }
    }

    #[test]
    fn bursts_arrive_as_they_were_queued() {
        let lengths: Vec<u8> = [&[38, 38, 38, 20, 38, 38, 60, 16][..], &[30; 70]].concat();
        for (any, address) in [("0.0.0.0", "127.0.0.3"), ("::", "::1")] {
            let from: IpAddr = address.parse().unwrap();
            let socket = UdpSocket::bind((any, 0)).unwrap();
            let (one, other) = (receiver(address), receiver(address));
            for (segments, messages) in [(true, 5), (false, lengths.len())] {
                let mut batch = Batch::new();
                batch.segments &= segments;
                queue(&mut batch, 1, &lengths, Some(from), one.local_addr().unwrap());
                let queue_of_one = mem::take(&mut batch.queue);
                assert_eq!(batch.prepare(&queue_of_one), messages);
                batch.queue = queue_of_one;
                queue(&mut batch, 1, &lengths, Some(from), other.local_addr().unwrap());
                queue(&mut batch, 2, &lengths, Some(from), one.local_addr().unwrap());
                assert_eq!(flush(&mut batch, &socket), (3 * lengths.len(), 0));
                expect(&one, &lengths, from);
                expect(&one, &lengths, from);
                expect(&other, &lengths, from);
            }
        }
    }

    /// However many are asked for, and whether or not the socket tells where they were sent to.
    #[test]
    fn what_is_received_is_told_alike() {
        for (bound, address, tells) in [
            ("127.0.0.5", "127.0.0.5", false),
            ("0.0.0.0", "127.0.0.6", true),
            ("::1", "::1", false),
            ("::", "::1", true),
        ] {
            let bound: IpAddr = bound.parse().unwrap();
            let socket = socket::public((bound, 0).into(), 1, 1 << 16).unwrap().remove(0);
            let port = socket.local_addr().unwrap().as_socket().unwrap().port();
            let sender = receiver(address);
            let mut batch = Batch::new();
            for most in [1, 2, 1, AT_ONCE] {
                assert_eq!(batch.receive(socket.as_fd(), most, tells).unwrap(), 0);
                for octets in [&[9; 38][..], &[]] {
                    sender.send_to(octets, (address, port)).unwrap();
                    assert_eq!(batch.receive(socket.as_fd(), most, tells).unwrap(), 1);
                    let incoming = batch.incoming(0).unwrap();
                    assert_eq!(incoming.octets, octets);
                    assert_eq!(incoming.from, sender.local_addr().unwrap());
                    assert_eq!(incoming.to, tells.then(|| address.parse().unwrap()));
                    batch.keep(1);
                }
            }
        }
    }

    #[test]
    fn a_refused_burst_hurts_nobody_else() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let good = receiver("127.0.0.1");
        let mut batch = Batch::new();
        queue(&mut batch, 1, &[38; 3], None, "127.0.0.1:0".parse().unwrap());
        queue(&mut batch, 1, &[38; 4], None, good.local_addr().unwrap());
        assert_eq!(flush(&mut batch, &socket), (4, 3), "nobody listens on port 0");
        expect(&good, &[38; 4], "127.0.0.1".parse().unwrap());
        assert!(batch.segments);
    }
}
