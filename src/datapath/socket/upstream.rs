//! The upstream sockets of a worker, and the way to the audit log: what the core asks of its
//! surroundings.
//!
//! Which flow uses which socket is the core's affair; here they are opened, watched and closed.

use std::cell::LazyCell;
use std::io;
use std::mem;
use std::net::SocketAddr;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::Instant;

use nix::sys::epoll::Epoll;

use crate::config::{Datapath, Prefilter};
use crate::nat::{
    Arrival, CloseReason, Effects, FlowRecord, MappingId, NetId, Table, Throttled, UpstreamId,
};

use crate::datapath::kernel_filter;
use crate::datapath::kernel_filter::flood::FloodWatch;
use crate::datapath::socket::event_key::EventKey;
use crate::datapath::socket::filtered::{FilteredSocket, NetDrops};
use crate::datapath::socket::port_pool::{Port, Ports};
use crate::datapath::socket::public::Listeners;
use crate::datapath::socket::sys::options;
use crate::datapath::socket::way_back;
use crate::observe::audit::Audit;
use crate::observe::warnings::RateLimitedWarnings;

/// The upstream sockets, and with them the core's [`Effects`].
pub(in crate::datapath) struct UpstreamSockets {
    epoll: Arc<Epoll>,
    shared: Shared,
    /// By [`UpstreamId`].
    sockets: Vec<Option<Upstream>>,
    /// How many are open: for IPv6, for IPv4.
    open: [usize; 2],
    /// Whether there are servers: with IPv6, with IPv4.
    served: [bool; 2],
    limit: usize,
    receive_buffer: usize,
    /// Whether the kernel may refuse strays.
    filters: bool,
    /// Of all sockets, however they are spread over them.
    strays: FloodWatch,
    /// What the kernel dropped while it refused strays.
    dropped: u32,
    table: Arc<Table>,
    started: Instant,
    warnings: RateLimitedWarnings,
    /// The worker's public sockets: from there answers leave.
    public: Listeners,
}

/// What the workers have in common.
#[derive(Clone, Debug)]
pub(in crate::datapath) struct Shared {
    pub audit: Arc<Audit>,
    pub ports: Arc<Ports>,
    /// What the kernel dropped on the upstream sockets.
    pub drops: Arc<NetDrops>,
}

#[derive(Debug)]
struct Upstream {
    /// Filtered: the kernel refuses strays.
    socket: FilteredSocket,
    /// Given back when the socket is closed.
    _port: Port,
    ipv4: bool,
    /// The kernel's figure at the last look.
    dropped: u32,
}

impl UpstreamSockets {
    /// No sockets, and at most `limit` of them ever; `epoll` will tell of what arrives.
    pub(in crate::datapath) fn new(
        epoll: Arc<Epoll>,
        shared: Shared,
        limit: usize,
        settings: &Datapath,
        started: Instant,
        table: Arc<Table>,
    ) -> Self {
        Self {
            epoll,
            shared,
            sockets: Vec::new(),
            open: [0; 2],
            served: served(&table),
            limit,
            receive_buffer: settings.receive_buffer,
            filters: settings.prefilter != Prefilter::Off,
            strays: FloodWatch::default(),
            dropped: 0,
            table,
            started,
            warnings: RateLimitedWarnings::default(),
            public: Listeners::default(),
        }
    }

    /// Takes over the worker's public sockets.
    pub(in crate::datapath) fn answer_from(&mut self, public: Listeners) {
        self.public = public;
    }

    /// Goes over to another configuration. Sockets beyond a lower limit stay open.
    pub(in crate::datapath) fn reload(
        &mut self,
        limit: usize,
        settings: &Datapath,
        table: Arc<Table>,
    ) {
        self.warnings = RateLimitedWarnings::default();
        let receive_buffer = settings.receive_buffer;
        if receive_buffer != self.receive_buffer {
            for upstream in self.sockets.iter().flatten() {
                if let Err(error) = upstream.socket.socket().set_recv_buffer_size(receive_buffer) {
                    self.warnings.note(&error, "cannot change a receive buffer");
                }
            }
        }
        self.filters = settings.prefilter != Prefilter::Off;
        // It never refuses what a server of the new table sends. Made where there is a flood alone.
        let program = LazyCell::new(|| {
            self.filters.then(|| kernel_filter::upstream::program(&table)).and_then(Result::ok)
        });
        let sockets = self.sockets.iter().flatten().map(|upstream| &upstream.socket);
        for socket in sockets.filter(|socket| socket.is_filtered()) {
            let kept =
                program.is_some() && socket.filter(program.as_ref(), &self.shared.drops).is_ok();
            if !kept && let Err(error) = socket.filter(None, &self.shared.drops) {
                self.warnings.note(&error, "cannot let strays through");
            }
        }
        self.served = served(&table);
        (self.limit, self.receive_buffer, self.table) = (limit, receive_buffer, table);
    }

    /// The socket with this index, if it is open.
    pub(in crate::datapath) fn get(&self, id: UpstreamId) -> Option<BorrowedFd<'_>> {
        Some(self.sockets.get(id.0 as usize)?.as_ref()?.socket.as_fd())
    }

    /// Notes answers that nobody waits for, and has the kernel refuse strays where they are a flood.
    pub(in crate::datapath) fn note_strays(&mut self, id: UpstreamId, now: Instant, strays: usize) {
        let Some(Some(upstream)) = self.sockets.get_mut(id.0 as usize) else { return };
        let since_start = now.saturating_duration_since(self.started);
        if !self.filters
            || !upstream.ipv4 // single servers alone, and few
            || upstream.socket.is_filtered()
            || !self.strays.flooded(since_start, strays, FloodWatch::FLOOD)
        {
            return;
        }
        let refuse = |program| upstream.socket.filter(Some(&program), &self.shared.drops);
        match kernel_filter::upstream::program(&self.table).and_then(refuse) {
            Err(error) => self.warnings.note(&error, "cannot refuse strays"),
            Ok(()) if self.warnings.due(now, "flood") => {
                tracing::warn!("flood of what no server sent: refused by the kernel");
            }
            Ok(()) => {}
        }
    }

    /// Adds up what the kernel dropped since the last call, and lets everything through where a
    /// flood is over. To be called about once a second.
    pub(in crate::datapath) fn account(&mut self) {
        let mut refused = false;
        for Upstream { socket, dropped, .. } in self.sockets.iter_mut().flatten() {
            let Some(figure) = socket.account(&self.shared.drops) else { continue };
            let new = figure.wrapping_sub(mem::replace(dropped, figure));
            if socket.is_filtered() {
                refused = true;
                self.dropped = self.dropped.wrapping_add(new);
            }
        }
        if !refused || !self.strays.over(self.dropped) {
            return;
        }
        for Upstream { socket, .. } in self.sockets.iter().flatten() {
            if socket.is_filtered()
                && let Err(error) = socket.filter(None, &self.shared.drops)
            {
                self.warnings.note(&error, "cannot let strays through");
            }
        }
    }

    /// Within the limit; and sockets of one kind serve no server of the other, so that a quarter is
    /// kept for servers of each kind that there are.
    fn may_open(&self, ipv4: bool) -> bool {
        let other = self.open[usize::from(!ipv4)];
        let kept = if self.served[usize::from(!ipv4)] { self.limit / 4 } else { 0 };
        self.open[usize::from(ipv4)] + other.max(kept) < self.limit
    }

    fn open(&mut self, id: UpstreamId, ipv4: bool) -> io::Result<u16> {
        let (socket, port) = options::upstream(ipv4, self.receive_buffer, &self.shared.ports)?;
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
}

fn served(table: &Table) -> [bool; 2] {
    [false, true].map(|ipv4| table.mappings().iter().any(|to| to.server.is_ipv4() == ipv4))
}

impl Effects for UpstreamSockets {
    fn open_upstream(&mut self, id: UpstreamId, net: NetId, ipv4: bool) -> Option<u16> {
        if !self.may_open(ipv4) {
            return None; // counted as upstream_exhausted, and told by the log's summary
        }
        match self.open(id, ipv4) {
            Ok(port) => Some(port),
            Err(error) => {
                self.warnings.note_of(net, &self.table, &error, "cannot open an upstream socket");
                None
            }
        }
    }

    fn close_upstream(&mut self, id: UpstreamId) {
        // Closing takes it out of epoll.
        if let Some(upstream) = self.sockets[id.0 as usize].take() {
            upstream.socket.account(&self.shared.drops);
            self.open[usize::from(upstream.ipv4)] -= 1;
        }
    }

    fn has_upstream_port(&self, port: u16) -> bool {
        self.shared.ports.is_taken(port)
    }

    fn is_own_address(&mut self, address: SocketAddr) -> bool {
        // There is no way to an address that is refused.
        options::is_own(address, &self.shared.ports).unwrap_or(false)
    }

    fn can_answer(&mut self, arrival: &Arrival) -> bool {
        let Arrival { listener, public_address, client, .. } = *arrival;
        let listener = self.public.get(listener);
        listener.is_none_or(|listener| way_back::exists(listener, public_address, client))
    }

    fn flow_opened(&mut self, table: &Table, flow: &FlowRecord) {
        self.shared.audit.flow_opened(table, flow);
    }

    fn flow_closed(&mut self, table: &Table, flow: &FlowRecord, reason: CloseReason) {
        self.shared.audit.flow_closed(table, flow, reason);
    }

    fn throttling_begun(&mut self, throttled: &Throttled, mapping: MappingId) {
        self.shared.audit.throttling_begun(&self.table, throttled, mapping);
    }

    fn throttling_ended(&mut self, throttled: &Throttled) {
        self.shared.audit.throttling_ended(throttled);
    }
}
