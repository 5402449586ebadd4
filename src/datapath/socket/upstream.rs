//! Opens, finds and closes the upstream sockets of a worker. The core decides which flow uses which
//! socket.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use nix::sys::epoll::Epoll;

use crate::logging::warnings::RateLimitedWarnings;
use crate::nat::{SocketKind, Table, UpstreamId};

use super::event_key::EventKey;
use super::filtered::{FilteredSocket, NetDrops};
use super::port_pool::{Port, Ports};
use super::sys::options;

/// How many kinds of sockets there are.
const KINDS: usize = 4;

/// The number of a kind.
fn index(kind: SocketKind) -> usize {
    usize::from(kind.ipv4) + 2 * usize::from(kind.is_long)
}

/// The upstream sockets of a worker.
pub(super) struct UpstreamSockets {
    epoll: Arc<Epoll>,
    ports: Arc<Ports>,
    drops: Arc<NetDrops>,
    /// The sockets, by [`UpstreamId`].
    sockets: Vec<Option<Upstream>>,
    /// Number of open sockets of each kind.
    open: [usize; KINDS],
    /// Whether the table has servers that need this kind.
    served: [bool; KINDS],
    limit: usize,
    receive_buffer: usize,
}

/// An upstream socket.
#[derive(Debug)]
pub(super) struct Upstream {
    /// While its filter is on, the kernel refuses strays.
    pub socket: FilteredSocket,
    /// The port, which is given back when the socket is closed.
    _port: Port,
    pub kind: SocketKind,
    /// The kernel's figure at the last look.
    pub dropped: u32,
}

impl UpstreamSockets {
    /// No sockets, and none may be opened before the first [`reload`](Self::reload). `epoll` will
    /// report what arrives. `drops` counts what the kernel drops.
    pub(super) fn new(epoll: Arc<Epoll>, ports: Arc<Ports>, drops: Arc<NetDrops>) -> Self {
        Self {
            epoll,
            ports,
            drops,
            sockets: Vec::new(),
            open: [0; KINDS],
            served: [false; KINDS],
            limit: 0,
            receive_buffer: 0,
        }
    }

    /// Goes over to another configuration, with at most `limit` sockets. When the limit becomes
    /// lower, sockets beyond it stay open.
    pub(super) fn reload(
        &mut self,
        limit: usize,
        receive_buffer: usize,
        table: &Table,
        warnings: &mut RateLimitedWarnings,
    ) {
        if receive_buffer != self.receive_buffer {
            for upstream in self.iter() {
                if let Err(error) = upstream.socket.socket().set_recv_buffer_size(receive_buffer) {
                    warnings.note(&error, "cannot change a receive buffer");
                }
            }
        }
        self.served = [false; KINDS];
        for mapping in table.mappings() {
            self.served[index(table.socket_kind(mapping))] = true;
        }
        (self.limit, self.receive_buffer) = (limit, receive_buffer);
    }

    /// The socket with this index, if it is open.
    pub(super) fn get(&self, id: UpstreamId) -> Option<BorrowedFd<'_>> {
        Some(self.upstream(id)?.socket.as_fd())
    }

    /// The socket with this index and what is known of it, if it is open.
    pub(super) fn upstream(&self, id: UpstreamId) -> Option<&Upstream> {
        self.sockets.get(id.0 as usize)?.as_ref()
    }

    /// The open sockets.
    pub(super) fn iter(&self) -> impl Iterator<Item = &Upstream> {
        self.sockets.iter().flatten()
    }

    /// The open sockets.
    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = &mut Upstream> {
        self.sockets.iter_mut().flatten()
    }

    /// What the kernel drops on the upstream sockets.
    pub(super) fn drops(&self) -> &Arc<NetDrops> {
        &self.drops
    }

    /// The ports of the sockets of all workers.
    pub(super) fn ports(&self) -> &Arc<Ports> {
        &self.ports
    }

    /// Whether the limit allows another socket. Sockets of one kind cannot stand in for another, so
    /// a part of the limit is kept for each kind that has servers: a quarter, or an eighth where
    /// there are more than two.
    pub(super) fn may_open(&self, kind: SocketKind) -> bool {
        let served = self.served.iter().filter(|served| **served).count();
        let share = if served > 2 { self.limit / 8 } else { self.limit / 4 };
        let kept = |other: usize| if self.served[other] { share } else { 0 };
        let others = (0..KINDS).filter(|other| *other != index(kind));
        let others: usize = others.map(|other| self.open[other].max(kept(other))).sum();
        self.open[index(kind)] + others < self.limit
    }

    /// Opens the socket with this index, and returns its port.
    pub(super) fn open(&mut self, id: UpstreamId, kind: SocketKind) -> io::Result<u16> {
        let (socket, port) = options::upstream(kind.ipv4, self.receive_buffer, &self.ports)?;
        self.epoll.add(&socket, EventKey::Upstream(id).arrivals())?;
        let place = id.0 as usize;
        if self.sockets.len() <= place {
            self.sockets.resize_with(place + 1, || None);
        }
        let number = port.number();
        self.sockets[place] =
            Some(Upstream { socket: FilteredSocket::new(socket), _port: port, kind, dropped: 0 });
        self.open[index(kind)] += 1;
        Ok(number)
    }

    /// Closes the socket with this index, which also removes it from epoll.
    pub(super) fn close(&mut self, id: UpstreamId) {
        if let Some(upstream) = self.sockets[id.0 as usize].take() {
            upstream.socket.account(&self.drops);
            self.open[index(upstream.kind)] -= 1;
        }
    }
}
