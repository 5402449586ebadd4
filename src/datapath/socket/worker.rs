//! One worker: its public sockets, its upstream sockets, its core.
//!
//! A wake-up takes what is ready, at most its quota of each socket, lets the core judge it, and sends
//! what may pass. A socket that has more waits for its next turn, so a flood on one port does not
//! starve the others, nor the responses.

use std::io;
use std::mem;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender};
use std::time::{Duration, Instant};

use nix::sys::epoll::{Epoll, EpollEvent, EpollTimeout};
use nix::sys::eventfd::EventFd;

use crate::config::Datapath;
use crate::nat::{Arrival, Core, Direction, DropReason, ListenerId, Table, UpstreamId};

use crate::datapath::commands::{Command, WorkerReload};
use crate::datapath::kernel_filter::request;
use crate::datapath::socket::busy_poll::BusyPoll;
use crate::datapath::socket::event_key::EventKey;
use crate::datapath::socket::flood_guard::FloodGuard;
use crate::datapath::socket::public::{Listener, Listeners};
use crate::datapath::socket::receive_quota::ReceiveQuota;
use crate::datapath::socket::sys::batch::{Batch, Destination, Tag};
use crate::datapath::socket::sys::epoll_wait::wait;
use crate::datapath::socket::ticker::Ticker;
use crate::datapath::socket::upstream::{Shared, UpstreamSockets};
use crate::observe::warnings::RateLimitedWarnings;

/// How long a stopping worker waits for one more answer before it looks whether any is due.
const DRAIN_TICK: Duration = Duration::from_millis(20);
/// Ready sockets taken from the kernel at once.
const EVENTS: usize = 256;

/// Everything one worker thread owns.
pub(in crate::datapath) struct Worker {
    core: Core,
    listeners: Listeners,
    upstream: UpstreamSockets,
    epoll: Arc<Epoll>,
    batch: Batch,
    quota: ReceiveQuota,
    commands: Receiver<Command>,
    drain_until: Option<Instant>,
    /// Something more is to be closed than was at once.
    expiring: bool,
    /// Who waits until all flows have gone over to another configuration.
    reloading: Option<SyncSender<usize>>,
    /// Who waits until sockets are closed whose ports are wanted.
    closing: Option<SyncSender<()>>,
    ticker: Ticker,
    wake: Arc<EventFd>,
    warnings: RateLimitedWarnings,
    floods: FloodGuard,
    busy: BusyPoll,
}

/// What a worker is built from.
pub(in crate::datapath) struct WorkerSetup {
    pub core: Core,
    /// Watched by `epoll` already.
    pub listeners: Listeners,
    pub table: Arc<Table>,
    pub shared: Shared,
    pub upstream_limit: usize,
    pub settings: Datapath,
    pub started: Instant,
    pub commands: Receiver<Command>,
    pub epoll: Arc<Epoll>,
    pub wake: Arc<EventFd>,
}

impl Worker {
    pub(in crate::datapath) fn new(parts: WorkerSetup) -> io::Result<Self> {
        parts.epoll.add(&*parts.wake, EventKey::Wake.arrivals())?;
        let ticker = Ticker::new(&parts.epoll)?;
        let mut floods = FloodGuard::new(parts.started);
        let (table, none) = (parts.core.table(), Listeners::default());
        floods.reload(parts.settings.prefilter, (table, table), &none, &parts.listeners);
        let mut upstream = UpstreamSockets::new(
            Arc::clone(&parts.epoll),
            parts.shared,
            parts.upstream_limit,
            &parts.settings,
            parts.started,
            parts.table,
        );
        upstream.answer_from(parts.listeners.clone());
        Ok(Self {
            core: parts.core,
            listeners: parts.listeners,
            upstream,
            epoll: parts.epoll,
            batch: Batch::new(),
            quota: ReceiveQuota::default(),
            commands: parts.commands,
            drain_until: None,
            expiring: false,
            reloading: None,
            closing: None,
            ticker,
            wake: parts.wake,
            warnings: RateLimitedWarnings::default(),
            floods,
            busy: BusyPoll::new(parts.settings.busy_poll),
        })
    }

    /// Relays until told to drain, and drained.
    pub(in crate::datapath) fn run(mut self) {
        let mut events = [EpollEvent::empty(); EVENTS];
        loop {
            let ready = match wait(&self.epoll, &mut events, self.time_out()) {
                Ok(ready) => ready,
                Err(nix::errno::Errno::EINTR) => 0,
                Err(error) => {
                    self.warnings.note(&error.into(), "cannot wait for datagrams");
                    0
                }
            };
            let now = Instant::now();
            self.quota.next_turn();
            self.floods.next_turn();
            for event in &events[..ready] {
                self.handle_event(EventKey::from_key(event.data()), now);
            }
            self.flush(now);
            self.tidy(now);
            self.busy.note(now, ready);
            self.ticker.run(!self.core.is_idle() || !self.floods.is_quiet());
            if let Some(end) = self.drain_until
                && (now >= end || (ready == 0 && !self.core.awaits_answers(now)))
            {
                break self.core.shut_down(now, &mut self.upstream);
            }
        }
    }

    fn time_out(&self) -> EpollTimeout {
        let at_once = self.busy.goes_on() || self.floods.is_looking();
        let wait = match self.drain_until {
            _ if at_once || self.expiring || self.reloading.is_some() => Duration::ZERO,
            Some(_) => DRAIN_TICK,
            None => return EpollTimeout::NONE,
        };
        EpollTimeout::try_from(wait).unwrap_or(EpollTimeout::ZERO)
    }

    fn handle_event(&mut self, key: EventKey, now: Instant) {
        self.make_room(now);
        let received = match key {
            EventKey::Public(_) if self.drain_until.is_some() => return,
            EventKey::Public(id) => self.relay_requests(id, now),
            EventKey::Upstream(id) => self.relay_responses(id, now),
            EventKey::Wake => return self.handle_commands(now),
            EventKey::Tick => return self.tick(),
        };
        self.batch.keep(received);
        self.quota.note(key, received);
    }

    fn relay_requests(&mut self, id: ListenerId, now: Instant) -> usize {
        // Its socket may be closed, or not have its place yet.
        let Some(listener) = self.listeners.get(id) else { return 0 };
        let most = self.quota.most(EventKey::Public(id));
        let received = self.batch.receive(listener.socket.as_fd(), most, listener.destination());
        let received = received.unwrap_or_else(|error| {
            let what = "cannot receive on a public socket";
            self.warnings.note_of(listener.net, self.core.table(), &error, what);
            0
        });
        let mut refused = 0;
        for index in 0..received {
            let Some(incoming) = self.batch.incoming(index) else { continue };
            let arrival = Arrival {
                listener: id,
                mapping: listener.mapping,
                // Where the socket has to tell, and does not, that is no unicast address.
                public_address: incoming.to.unwrap_or(listener.address.ip()),
                client: incoming.from,
            };
            let (slot, octets) = (incoming.slot, incoming.octets.len());
            let verdict = self.core.request(now, &arrival, incoming.octets, &mut self.upstream);
            match verdict {
                Ok(to) => {
                    let (mapping, direction) = (listener.mapping, Direction::Request);
                    let tag = Tag { mapping, direction, octets, asks: to.asks };
                    self.batch.queue(slot, EventKey::Upstream(to.via).key(), None, to.server, tag);
                }
                Err(reason) => refused += usize::from(request::is_refused_by_filter(reason)),
            }
        }
        if refused > 0 {
            self.floods.note(id, listener, self.core.table(), now, refused);
        }
        received
    }

    fn relay_responses(&mut self, id: UpstreamId, now: Instant) -> usize {
        let Some(socket) = self.upstream.get(id) else { return 0 };
        let most = self.quota.most(EventKey::Upstream(id));
        let received =
            self.batch.receive(socket, most, Destination::Bound).unwrap_or_else(|error| {
                self.warnings.note(&error, "cannot receive from the servers");
                0
            });
        let mut strays = 0;
        for index in 0..received {
            let Some(incoming) = self.batch.incoming(index) else { continue };
            let (slot, octets) = (incoming.slot, incoming.octets.len());
            match self.core.response(now, id, incoming.from, incoming.octets) {
                Ok(to) => {
                    let (mapping, direction) = (to.mapping, Direction::Response);
                    let tag = Tag { mapping, direction, octets, asks: None };
                    let own = self.listeners.get(to.via).and_then(Listener::own_address);
                    let from = own.is_none().then_some(to.public_address);
                    self.batch.queue(slot, EventKey::Public(to.via).key(), from, to.client, tag);
                }
                Err(reason) => strays += usize::from(reason == DropReason::UnknownFlow),
            }
        }
        if strays > 0 {
            self.upstream.note_strays(id, now, strays);
        }
        received
    }

    fn make_room(&mut self, now: Instant) {
        if self.batch.is_full() {
            self.flush(now);
        }
    }

    fn flush(&mut self, now: Instant) {
        let (listeners, upstream) = (&self.listeners, &self.upstream);
        self.batch.flush(
            |key| match EventKey::from_key(key) {
                EventKey::Public(id) => Some(listeners.get(id)?.socket.as_fd()),
                EventKey::Upstream(id) => upstream.get(id),
                EventKey::Wake | EventKey::Tick => None,
            },
            |tag, outcome| match outcome {
                Ok(()) => match tag.direction {
                    Direction::Request => {
                        self.core.request_sent(now, tag.mapping, tag.asks, tag.octets);
                    }
                    Direction::Response => self.core.response_sent(tag.mapping, tag.octets),
                },
                Err(error) => {
                    self.core.send_failed(tag.mapping, tag.direction);
                    let what = match tag.direction {
                        Direction::Request => "cannot send to a server",
                        Direction::Response => "cannot send to a client",
                    };
                    let table = self.core.table();
                    let net = table.mapping(tag.mapping).net;
                    self.warnings.note_of(net, table, &error, what);
                }
            },
        );
    }

    /// Does some of what concerns many flows, so that datagrams have their turns in between.
    #[inline]
    fn tidy(&mut self, now: Instant) {
        if self.floods.is_looking() {
            self.floods.end_quiet_floods(&self.listeners, self.core.table());
        }
        if self.expiring {
            self.expiring = self.core.expire(now, &mut self.upstream);
        }
        if self.reloading.is_some()
            && let Some(flows_closed) = self.core.go_over(now, &mut self.upstream)
            && let Some(reply) = self.reloading.take()
        {
            // Who asked may have gone; then nobody wants to know.
            let _ = reply.try_send(flows_closed);
        }
        if self.closing.is_some()
            && !self.core.close_left(now, &mut self.upstream)
            && let Some(reply) = self.closing.take()
        {
            let _ = reply.try_send(());
        }
    }

    /// What has to be looked at about once a second.
    #[cold]
    fn tick(&mut self) {
        self.ticker.read();
        self.expiring = true;
        self.upstream.account();
        self.floods.begin_round();
    }

    #[cold]
    fn handle_commands(&mut self, now: Instant) {
        // Only now is the flag down: what is asked from here on wakes us again.
        let _ = self.wake.read();
        while let Ok(command) = self.commands.try_recv() {
            // Who asked may have gone; then nobody wants to know.
            match command {
                Command::Ping(reply) => _ = reply.try_send(()),
                Command::Flows(limit, reply) => {
                    let flows = self.core.flows(now).take(limit).collect();
                    _ = reply.try_send((Arc::clone(self.core.table()), flows));
                }
                Command::Reload(next, reply) => {
                    self.reload(*next, now);
                    self.reloading = Some(reply);
                }
                Command::CloseLeft(reply) => self.closing = Some(reply),
                Command::Drain(end) => {
                    self.drain_until = Some(end);
                    for (_, listener) in self.listeners.iter() {
                        let _ = self.epoll.delete(&listener.socket);
                    }
                }
            }
        }
    }

    /// Goes over to another configuration, between two datagrams. It holds from the next one on;
    /// the flows follow some at a time.
    fn reload(&mut self, next: WorkerReload, now: Instant) {
        while self.reloading.is_some() {
            self.tidy(now);
        }
        self.flush(now); // what waits to be sent is counted under the table that it came by
        let WorkerReload { succession, listeners, upstream_limit, settings } = next;
        let before = mem::replace(&mut self.listeners, listeners);
        let after = &self.listeners;
        let (old, table) = (Arc::clone(self.core.table()), Arc::clone(&succession.rules.table));
        self.core.reload(now, succession, &mut self.upstream);
        self.warnings = RateLimitedWarnings::default();
        for (id, was) in before.iter() {
            if after.get(id).is_none_or(|is| !Arc::ptr_eq(&is.drops, &was.drops)) {
                was.account();
            }
        }
        self.floods.reload(settings.prefilter, (&old, &table), &before, after);
        self.upstream.reload(upstream_limit, &settings, table);
        self.upstream.answer_from(self.listeners.clone());
        self.busy = BusyPoll::new(settings.busy_poll);
    }
}
