//! The upstream sockets of a worker, and the way to the audit log: what the core asks of its
//! surroundings.
//!
//! Which flow uses which socket is the core's affair; here they are opened, watched and closed.

use std::io;
use std::mem;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::Instant;

use nix::sys::epoll::Epoll;
use socket2::Socket;

use crate::config::{Prefilter, Runtime};
use crate::relay::{CloseReason, FlowRecord, MappingId, Shell, Table, Throttled, UpstreamId};

use super::audit::Audit;
use super::complaints::Complaints;
use super::flood::FloodWatch;
use super::place::Place;
use super::public::NetDrops;
use super::{socket, strays};

/// The upstream sockets, and with them the core's [`Shell`].
pub(super) struct UpstreamSockets {
    epoll: Arc<Epoll>,
    /// By [`UpstreamId`].
    sockets: Vec<Option<Upstream>>,
    open: usize,
    flows_closed: usize,
    limit: usize,
    receive_buffer: usize,
    /// Whether the kernel may refuse strays.
    filters: bool,
    table: Arc<Table>,
    audit: Arc<Audit>,
    drops: Arc<NetDrops>,
    started: Instant,
    complaints: Complaints,
}

#[derive(Debug)]
struct Upstream {
    socket: Socket,
    ipv4: bool,
    /// What of the kernel's figure of drops is accounted for.
    seen: u32,
    strays: FloodWatch,
    /// The kernel refuses strays.
    filtered: bool,
}

impl UpstreamSockets {
    /// No sockets, and at most `limit` of them ever; `epoll` will tell of what arrives.
    pub(super) fn new(
        epoll: Arc<Epoll>,
        limit: usize,
        runtime: &Runtime,
        started: Instant,
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
            receive_buffer: runtime.receive_buffer,
            filters: runtime.prefilter != Prefilter::Off,
            table,
            audit,
            drops,
            started,
            complaints: Complaints::default(),
        }
    }

    /// Goes over to another configuration. Sockets beyond a lower limit stay open.
    pub(super) fn reload(&mut self, limit: usize, runtime: &Runtime, table: Arc<Table>) {
        let receive_buffer = runtime.receive_buffer;
        if receive_buffer != self.receive_buffer {
            for upstream in self.sockets.iter().flatten() {
                if let Err(error) = upstream.socket.set_recv_buffer_size(receive_buffer) {
                    self.complaints.note(&error, "cannot change a receive buffer");
                }
            }
        }
        self.filters = runtime.prefilter != Prefilter::Off;
        for upstream in self.sockets.iter_mut().flatten().filter(|upstream| upstream.filtered) {
            // It never refuses what a server of the new table sends.
            let kept = self.filters && upstream.filter(true, &table, &self.drops).is_ok();
            if !kept && let Err(error) = upstream.filter(false, &table, &self.drops) {
                self.complaints.note(&error, "cannot let strays through");
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

    /// Notes answers that nobody waits for, and has the kernel refuse strays where they are a flood.
    pub(super) fn note_strays(&mut self, id: UpstreamId, now: Instant, strays: usize) {
        let Some(Some(upstream)) = self.sockets.get_mut(id.0 as usize) else { return };
        let since_start = now.saturating_duration_since(self.started);
        if !self.filters
            || !upstream.ipv4 // single servers alone, and few
            || upstream.filtered
            || !upstream.strays.flooded(since_start, strays)
        {
            return;
        }
        match upstream.filter(true, &self.table, &self.drops) {
            Err(error) => self.complaints.note(&error, "cannot refuse strays"),
            Ok(()) if self.complaints.due(now, "flood") => {
                tracing::warn!("flood of what no server sent: refused by the kernel");
            }
            Ok(()) => {}
        }
    }

    /// Adds up what the kernel dropped since the last call, and lets everything through where a
    /// flood is over. To be called about once a second.
    pub(super) fn account(&mut self) {
        for upstream in self.sockets.iter_mut().flatten() {
            upstream.account(&self.drops);
            if upstream.filtered
                && upstream.strays.over(upstream.seen)
                && let Err(error) = upstream.filter(false, &self.table, &self.drops)
            {
                self.complaints.note(&error, "cannot let strays through");
            }
        }
    }

    fn open(&mut self, id: UpstreamId, ipv4: bool) -> io::Result<u16> {
        let (socket, port) = socket::upstream(ipv4, self.receive_buffer)?;
        self.epoll.add(&socket, Place::Upstream(id).arrivals())?;
        let index = id.0 as usize;
        if self.sockets.len() <= index {
            self.sockets.resize_with(index + 1, || None);
        }
        self.sockets[index] = Some(Upstream {
            socket,
            ipv4,
            seen: 0,
            strays: FloodWatch::default(),
            filtered: false,
        });
        self.open += 1;
        Ok(port)
    }
}

impl Upstream {
    fn account(&mut self, drops: &NetDrops) {
        // A figure that cannot be read now is read the next time.
        let Ok(now) = socket::kernel_drops(&self.socket) else { return };
        drops.add(now.wrapping_sub(mem::replace(&mut self.seen, now)), self.filtered);
    }

    /// Has the kernel refuse strays, by the servers of `table`, or let everything through.
    fn filter(&mut self, on: bool, table: &Table, drops: &NetDrops) -> io::Result<()> {
        self.account(drops); // what was dropped so far belongs to the way it was so far
        if on {
            strays::attach(&self.socket, table)?;
        } else {
            self.socket.detach_filter()?;
        }
        self.filtered = on;
        Ok(())
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
