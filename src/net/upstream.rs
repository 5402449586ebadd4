//! The upstream sockets of a worker, and the way to the audit log: what the core asks of its
//! surroundings.
//!
//! Which flow uses which socket is the core's affair; here they are opened, watched and closed.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use nix::sys::epoll::Epoll;
use socket2::Socket;

use crate::relay::{CloseReason, FlowRecord, MappingId, Shell, Table, Throttled, UpstreamId};

use super::audit::Audit;
use super::complaints::Complaints;
use super::place::Place;
use super::socket;

/// The upstream sockets, and with them the core's [`Shell`].
pub(super) struct UpstreamSockets {
    epoll: Arc<Epoll>,
    /// By [`UpstreamId`].
    sockets: Vec<Option<Socket>>,
    open: usize,
    flows_closed: usize,
    limit: usize,
    receive_buffer: usize,
    table: Arc<Table>,
    audit: Arc<Audit>,
    complaints: Complaints,
}

impl UpstreamSockets {
    /// No sockets, and at most `limit` of them ever; `epoll` will tell of what arrives.
    pub(super) fn new(
        epoll: Arc<Epoll>,
        limit: usize,
        receive_buffer: usize,
        table: Arc<Table>,
        audit: Arc<Audit>,
    ) -> Self {
        let complaints = Complaints::default();
        let (sockets, open, flows_closed) = (Vec::new(), 0, 0);
        Self { epoll, sockets, open, flows_closed, limit, receive_buffer, table, audit, complaints }
    }

    /// Goes over to another configuration. Sockets beyond a lower limit stay open.
    pub(super) fn reload(&mut self, limit: usize, receive_buffer: usize, table: Arc<Table>) {
        if receive_buffer != self.receive_buffer {
            for socket in self.sockets.iter().flatten() {
                if let Err(error) = socket.set_recv_buffer_size(receive_buffer) {
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
        self.sockets.get(id.0 as usize)?.as_ref().map(Socket::as_fd)
    }

    fn open(&mut self, id: UpstreamId, ipv4: bool) -> io::Result<u16> {
        let (socket, port) = socket::upstream(ipv4, self.receive_buffer)?;
        self.epoll.add(&socket, Place::Upstream(id).arrivals())?;
        let index = id.0 as usize;
        if self.sockets.len() <= index {
            self.sockets.resize_with(index + 1, || None);
        }
        self.sockets[index] = Some(socket);
        self.open += 1;
        Ok(port)
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
        if self.sockets[id.0 as usize].take().is_some() {
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
