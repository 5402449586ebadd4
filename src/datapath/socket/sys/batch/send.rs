//! Sends the datagrams of a batch.

use std::io;
use std::iter;
use std::mem;
use std::net::{IpAddr, SocketAddr};
use std::ops::Range;
use std::os::fd::BorrowedFd;
use std::slice;

use nix::errno::Errno;

use super::calls::Kernel;
use super::{Batch, Outgoing, SEGMENTS, Tag, uninterrupted};

impl<K: Kernel, const SLOT: usize> Batch<K, SLOT> {
    /// Queues the datagram in `slot`; see [`Received::queue`](super::Received::queue).
    pub(super) fn queue(
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

    /// Sends all that is queued, and reports the outcome of each datagram. Each socket takes one
    /// system call, when the kernel takes all of its datagrams at once. Datagrams from one socket
    /// to one receiver leave in the order in which they were queued.
    pub(in crate::datapath) fn flush<'s>(
        &mut self,
        socket: impl Fn(u64) -> Option<BorrowedFd<'s>>,
        mut outcome: impl FnMut(Tag, io::Result<()>),
    ) {
        let mut queue = mem::take(&mut self.queue);
        // Slot numbers only grow until the flush, so sorting by slot keeps the order.
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
                // Perhaps the way to this receiver cannot take segments, or the system is short of
                // memory. So each datagram is tried alone, and so are those behind it.
                self.segments = false;
                self.send(socket, run, outcome);
                self.segments = error != Errno::EIO; // EIO: some way out has no checksums
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

    /// Sends as many of these messages as the kernel takes. An error is that of the first message.
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

    /// Sends a single datagram that needs nothing but its destination.
    fn send_one(&mut self, socket: BorrowedFd<'_>, alone: &Outgoing) -> nix::Result<()> {
        let octets = self.octets[alone.slot].0.as_ptr().cast();
        let name = self.names[alone.slot].as_ptr();
        let len = alone.tag.octets;
        let sent = uninterrupted(|| {
            // SAFETY: octets and name belong to one slot, which holds as many octets: `queue` has
            // checked that.
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

    /// Points these messages at their datagrams. Each buffer behind the pointers is borrowed once
    /// for all messages: another borrow would invalidate the pointers that were made before it.
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

    /// Whether a datagram can be the next segment of a message. All segments have one length,
    /// except the last one, which may be shorter. An empty segment would vanish.
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

/// Number of datagrams that a message carries. The C libraries disagree on the type.
pub(super) fn segments(message: &libc::mmsghdr) -> usize {
    message.msg_hdr.msg_iovlen as _
}

/// A number for a receiver. Two different receivers hardly ever have the same number.
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

/// Fails when the number of octets sent is not that of these datagrams as a whole.
fn whole(sent: usize, datagrams: &[Outgoing]) -> nix::Result<()> {
    let octets: usize = datagrams.iter().map(|datagram| datagram.tag.octets).sum();
    if sent == octets { Ok(()) } else { Err(Errno::EMSGSIZE) }
}
