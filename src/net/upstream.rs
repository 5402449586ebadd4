//! The upstream sockets of a worker and the log of its flows: what the core asks of its
//! surroundings.
//!
//! Which flow uses which socket is the core's affair; here they are opened, watched and closed.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use nix::sys::epoll::Epoll;
use socket2::Socket;

use crate::relay::{CloseReason, FlowRecord, Shell, Table, UpstreamId};

use super::complaints::Complaints;
use super::place::Place;
use super::socket;

/// The upstream sockets, and with them the core's [`Shell`].
pub(super) struct UpstreamSockets {
    epoll: Arc<Epoll>,
    /// By [`UpstreamId`].
    sockets: Vec<Option<Socket>>,
    open: usize,
    limit: usize,
    receive_buffer: usize,
    table: Arc<Table>,
    complaints: Complaints,
}

impl UpstreamSockets {
    /// No sockets, and at most `limit` of them ever; `epoll` will tell of what arrives.
    pub(super) fn new(
        epoll: Arc<Epoll>,
        limit: usize,
        receive_buffer: usize,
        table: Arc<Table>,
    ) -> Self {
        let complaints = Complaints::default();
        Self { epoll, sockets: Vec::new(), open: 0, limit, receive_buffer, table, complaints }
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
        if self.open == self.limit {
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
        log_flow(&self.table, flow, None);
    }

    fn flow_closed(&mut self, flow: &FlowRecord, reason: CloseReason) {
        log_flow(&self.table, flow, Some(reason));
    }
}

/// N-10: who, by which public port, since when, and by which credential.
fn log_flow(table: &Table, flow: &FlowRecord, closed: Option<CloseReason>) {
    let mapping = table.mapping(flow.mapping);
    let net = table.net(mapping.net);
    let credential = flow.credential.map(|index| &net.credentials[index].name);
    tracing::info!(
        net = %net.name,
        node = mapping.node_address,
        client = %flow.client,
        public_address = %flow.public_address,
        public_port = mapping.public_port,
        credential = credential.map(tracing::field::display),
        upstream_port = flow.upstream_port,
        reason = closed.map(CloseReason::label),
        age_seconds = closed.map(|_| flow.age.as_secs()),
        "flow {}",
        if closed.is_some() { "closed" } else { "opened" }
    );
}
