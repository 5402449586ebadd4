//! The way out of a batch.

use std::io;
use std::iter;
use std::mem;
use std::net::{IpAddr, SocketAddr};
use std::ops::Range;
use std::os::fd::BorrowedFd;
use std::slice;

use nix::errno::Errno;

use super::calls::Kernel;
use super::{Batch, Outgoing, SEGMENTS, SLOT, Tag, uninterrupted};

impl<K: Kernel> Batch<K> {
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
    pub(super) fn prepare(&mut self, run: &[Outgoing]) -> usize {
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
pub(super) fn segments(message: &libc::mmsghdr) -> usize {
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
