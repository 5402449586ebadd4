//! Opens, finds and closes the upstream sockets of a worker. The core decides which flow uses which
//! socket.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use nix::sys::epoll::Epoll;

use crate::logging::warnings::RateLimitedWarnings;
use crate::nat::{Table, UpstreamId};

use super::event_key::EventKey;
use super::filtered::{FilteredSocket, NetDrops};
use super::port_pool::{Port, Ports};
use super::sys::options;

/// The upstream sockets of a worker.
pub(super) struct UpstreamSockets {
    epoll: Arc<Epoll>,
    ports: Arc<Ports>,
    drops: Arc<NetDrops>,
    /// The sockets, by [`UpstreamId`].
    sockets: Vec<Option<Upstream>>,
    /// Number of open sockets: for IPv6, for IPv4.
    open: [usize; 2],
    /// Whether the table has servers: with IPv6, with IPv4.
    served: [bool; 2],
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
    pub ipv4: bool,
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
            open: [0; 2],
            served: [false; 2],
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
        let has_servers = |ipv4| table.mappings().iter().any(|to| to.server.is_ipv4() == ipv4);
        self.served = [false, true].map(has_servers);
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

    /// Whether the limit allows another socket. Sockets of one IP version cannot reach servers of
    /// the other, so a quarter of the limit is kept for each version that has servers.
    pub(super) fn may_open(&self, ipv4: bool) -> bool {
        let other = self.open[usize::from(!ipv4)];
        let kept = if self.served[usize::from(!ipv4)] { self.limit / 4 } else { 0 };
        self.open[usize::from(ipv4)] + other.max(kept) < self.limit
    }

    /// Opens the socket with this index, and returns its port.
    pub(super) fn open(&mut self, id: UpstreamId, ipv4: bool) -> io::Result<u16> {
        let (socket, port) = options::upstream(ipv4, self.receive_buffer, &self.ports)?;
        self.epoll.add(&socket, EventKey::Upstream(id).arrivals())?;
        let index = id.0 as usize;
        if self.sockets.len() <= index {
            self.sockets.resize_with(index + 1, || None);
        }
        let number = port.number();
        self.sockets[index] =
            Some(Upstream { socket: FilteredSocket::new(socket), _port: port, ipv4, dropped: 0 });
        self.open[usize::from(ipv4)] += 1;
        Ok(number)
    }

    /// Closes the socket with this index, which also removes it from epoll.
    pub(super) fn close(&mut self, id: UpstreamId) {
        if let Some(upstream) = self.sockets[id.0 as usize].take() {
            upstream.socket.account(&self.drops);
            self.open[usize::from(upstream.ipv4)] -= 1;
        }
    }
}
