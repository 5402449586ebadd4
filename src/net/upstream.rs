//! The upstream sockets of a worker, and the way to the audit log: what the core asks of its
//! surroundings.
//!
//! Which flow uses which socket is the core's affair; here they are opened, watched and closed.

use std::io;
use std::mem;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use nix::sys::epoll::Epoll;
use socket2::Socket;

use crate::relay::{CloseReason, FlowRecord, MappingId, Shell, Table, Throttled, UpstreamId};

use super::audit::Audit;
use super::complaints::Complaints;
use super::place::Place;
use super::public::NetDrops;
use super::socket;

/// The upstream sockets, and with them the core's [`Shell`].
pub(super) struct UpstreamSockets {
    epoll: Arc<Epoll>,
    /// By [`UpstreamId`].
    sockets: Vec<Option<Upstream>>,
    open: usize,
    flows_closed: usize,
    limit: usize,
    receive_buffer: usize,
    table: Arc<Table>,
    audit: Arc<Audit>,
    drops: Arc<NetDrops>,
    complaints: Complaints,
}

#[derive(Debug)]
struct Upstream {
    socket: Socket,
    /// What of the kernel's figure of drops is accounted for.
    seen: u32,
}

impl UpstreamSockets {
    /// No sockets, and at most `limit` of them ever; `epoll` will tell of what arrives.
    pub(super) fn new(
        epoll: Arc<Epoll>,
        limit: usize,
        receive_buffer: usize,
        table: Arc<Table>,
        audit: Arc<Audit>,
        drops: Arc<NetDrops>,
    ) -> Self {
        Self {
            epoll,
            sockets: Vec::new(),
            open: 0,
            flows_closed: 0,
            limit,
            receive_buffer,
            table,
            audit,
            drops,
            complaints: Complaints::default(),
        }
    }

    /// Goes over to another configuration. Sockets beyond a lower limit stay open.
    pub(super) fn reload(&mut self, limit: usize, receive_buffer: usize, table: Arc<Table>) {
        if receive_buffer != self.receive_buffer {
            for upstream in self.sockets.iter().flatten() {
                if let Err(error) = upstream.socket.set_recv_buffer_size(receive_buffer) {
                    self.complaints.note(&error, "cannot change a receive buffer");
                }
            }
        }
        (self.limit, self.receive_buffer, self.table) = (limit, receive_buffer, table);
    }

    /// Flows closed so far.
    pub(super) fn flows_closed(&self) -> usize {
        self.flows_closed
    }

    /// The socket with this index, if it is open.
    pub(super) fn get(&self, id: UpstreamId) -> Option<BorrowedFd<'_>> {
        Some(self.sockets.get(id.0 as usize)?.as_ref()?.socket.as_fd())
    }

    /// Adds up what the kernel dropped since the last call. To be called about once a second.
    pub(super) fn account(&mut self) {
        self.sockets.iter_mut().flatten().for_each(|upstream| upstream.account(&self.drops));
    }

    fn open(&mut self, id: UpstreamId, ipv4: bool) -> io::Result<u16> {
        let (socket, port) = socket::upstream(ipv4, self.receive_buffer)?;
        self.epoll.add(&socket, Place::Upstream(id).arrivals())?;
        let index = id.0 as usize;
        if self.sockets.len() <= index {
            self.sockets.resize_with(index + 1, || None);
        }
        self.sockets[index] = Some(Upstream { socket, seen: 0 });
        self.open += 1;
        Ok(port)
    }
}

impl Upstream {
    fn account(&mut self, drops: &NetDrops) {
        // A figure that cannot be read now is read the next time.
        let Ok(now) = socket::kernel_drops(&self.socket) else { return };
        drops.add_overflow(now.wrapping_sub(mem::replace(&mut self.seen, now)));
    }
}

impl Shell for UpstreamSockets {
    fn open_upstream(&mut self, id: UpstreamId, ipv4: bool) -> Option<u16> {
        if self.open >= self.limit {
            return None; // counted as upstream_exhausted, and told by the log's summary
        }
        match self.open(id, ipv4) {
            Ok(port) => Some(port),
            Err(error) => {
                self.complaints.note(&error, "cannot open an upstream socket");
                None
            }
        }
    }

    fn close_upstream(&mut self, id: UpstreamId) {
        // Closing takes it out of epoll.
        if let Some(mut upstream) = self.sockets[id.0 as usize].take() {
            upstream.account(&self.drops);
            self.open -= 1;
        }
    }

    fn flow_opened(&mut self, flow: &FlowRecord) {
        self.audit.flow_opened(&self.table, flow);
    }

    fn flow_closed(&mut self, flow: &FlowRecord, reason: CloseReason) {
        self.flows_closed += 1;
        self.audit.flow_closed(&self.table, flow, reason);
    }

    fn throttling_begun(&mut self, throttled: &Throttled, mapping: MappingId) {
        self.audit.throttling_begun(&self.table, throttled, mapping);
    }

    fn throttling_ended(&mut self, throttled: &Throttled) {
        self.audit.throttling_ended(throttled);
    }
}
