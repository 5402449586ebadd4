//! One worker: its public sockets, its upstream sockets, its core.
//!
//! A wake-up takes what is ready, at most one batch a socket, lets the core judge it, and sends
//! what may pass. A socket that has more waits for its next turn, so a flood on one port does not
//! starve the others, nor the responses.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender};
use std::time::{Duration, Instant};

use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use nix::sys::eventfd::EventFd;
use socket2::Socket;

use crate::config::{Prefilter, Runtime};
use crate::relay::{
    Arrival, CloseReason, Core, Direction, FlowRecord, ListenerId, Shell, Table, UpstreamId,
};

use super::batch::{AT_ONCE, Batch, Tag};
use super::busy::BusyPoll;
use super::prefilter::{self, FloodWatch};
use super::public::PublicSocket;
use super::socket;

/// How often flows are looked through for idle ones.
const TICK: Duration = Duration::from_secs(1);
/// How long a stopping worker waits for one more answer before it looks whether any is due.
const DRAIN_TICK: Duration = Duration::from_millis(20);
/// Errors of the system are logged at most this often.
const COMPLAINT_INTERVAL: Duration = Duration::from_secs(10);
/// Ready sockets taken from the kernel at once.
const EVENTS: usize = 256;

/// What a worker is asked to do.
pub(super) enum Command {
    /// Send up to so many flows.
    Flows(usize, SyncSender<Vec<FlowRecord>>),
    /// Take no more requests, wait for answers until then at the latest, and end.
    Drain(Instant),
}

/// Everything one worker thread owns.
pub(super) struct Worker {
    core: Core,
    public: Arc<[PublicSocket]>,
    /// Of each public socket.
    watches: Box<[FloodWatch]>,
    sockets: Sockets,
    batch: Batch,
    /// Sockets that may have more than their last batch. The kernel tells of a socket only when
    /// something arrives there, so it does not tell of these.
    unfinished: Vec<Place>,
    commands: Receiver<Command>,
    drain_until: Option<Instant>,
    next_tick: Instant,
    wake: Arc<EventFd>,
    complaints: Complaints,
    floods: Complaints,
    /// Public sockets on which the prefilter was turned on.
    filtered: usize,
    busy: BusyPoll,
    prefilter: Prefilter,
    table: Arc<Table>,
    started: Instant,
}

/// What opens and closes with the flows: the core's [`Shell`].
struct Sockets {
    epoll: Epoll,
    /// By [`UpstreamId`].
    upstream: Vec<Option<Socket>>,
    open: usize,
    limit: usize,
    receive_buffer: usize,
    table: Arc<Table>,
    complaints: Complaints,
}

/// Errors of the system, told at most every ten seconds: a broken network is one fact, not a
/// thousand lines.
#[derive(Default)]
struct Complaints {
    last: Option<Instant>,
}

/// What an event of epoll, or a datagram to be sent, belongs to.
#[derive(Clone, Copy)]
enum Place {
    Public(ListenerId),
    Upstream(UpstreamId),
    Wake,
}

/// What a worker is built from.
pub(super) struct Parts {
    pub core: Core,
    pub public: Arc<[PublicSocket]>,
    pub table: Arc<Table>,
    pub upstream_limit: usize,
    pub runtime: Runtime,
    pub started: Instant,
    pub commands: Receiver<Command>,
    pub wake: Arc<EventFd>,
}

impl Worker {
    pub(super) fn new(parts: Parts) -> io::Result<Self> {
        let epoll = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC)?;
        epoll.add(&*parts.wake, readable(Place::Wake))?;
        for (id, public) in (0..).map(ListenerId).zip(parts.public.iter()) {
            epoll.add(&public.socket, readable(Place::Public(id)))?;
        }
        Ok(Self {
            core: parts.core,
            watches: parts.public.iter().map(|_| FloodWatch::default()).collect(),
            public: parts.public,
            sockets: Sockets {
                epoll,
                upstream: Vec::new(),
                open: 0,
                limit: parts.upstream_limit,
                receive_buffer: parts.runtime.receive_buffer,
                table: Arc::clone(&parts.table),
                complaints: Complaints::default(),
            },
            wake: parts.wake,
            complaints: Complaints::default(),
            floods: Complaints::default(),
            filtered: 0,
            busy: BusyPoll::new(parts.runtime.busy_poll),
            prefilter: parts.runtime.prefilter,
            table: parts.table,
            started: parts.started,
            batch: Batch::new(),
            unfinished: Vec::new(),
            commands: parts.commands,
            drain_until: None,
            next_tick: Instant::now(),
        })
    }

    /// Relays until told to drain, and drained.
    pub(super) fn run(mut self) {
        let mut events = [EpollEvent::empty(); EVENTS];
        let mut unfinished = Vec::new();
        loop {
            let ready = match self.sockets.epoll.wait(&mut events, self.time_out()) {
                Ok(ready) => ready,
                Err(nix::errno::Errno::EINTR) => 0,
                Err(error) => {
                    self.complaints.note(&error.into(), "cannot wait for datagrams");
                    0
                }
            };
            std::mem::swap(&mut self.unfinished, &mut unfinished);
            for event in &events[..ready] {
                self.take(Place::from_key(event.data()));
            }
            unfinished.drain(..).for_each(|place| self.take(place));
            self.flush();
            let now = Instant::now();
            self.busy.note(now, ready);
            if now >= self.next_tick {
                self.core.expire(now, &mut self.sockets);
                self.end_floods();
                self.next_tick = now + TICK;
            }
            if let Some(end) = self.drain_until
                && (now >= end || (ready == 0 && !self.core.awaits_answers(now)))
            {
                break self.core.shut_down(now, &mut self.sockets);
            }
        }
    }

    fn time_out(&self) -> EpollTimeout {
        let wait = match self.drain_until {
            _ if self.busy.goes_on() || !self.unfinished.is_empty() => Duration::ZERO,
            Some(_) => DRAIN_TICK,
            None if self.core.is_idle() && self.filtered == 0 => return EpollTimeout::NONE,
            None => TICK,
        };
        EpollTimeout::try_from(wait).unwrap_or(EpollTimeout::ZERO)
    }

    fn take(&mut self, place: Place) {
        self.make_room();
        let received = match place {
            Place::Public(_) if self.drain_until.is_some() => return,
            Place::Public(id) => self.take_requests(id),
            Place::Upstream(id) => self.take_responses(id),
            Place::Wake => return self.obey(),
        };
        self.batch.keep(received);
        if received == AT_ONCE {
            self.unfinished.push(place);
        }
    }

    fn take_requests(&mut self, id: ListenerId) -> usize {
        let public = &self.public[id.0 as usize];
        let received = self.batch.receive(public.socket.as_fd());
        let received = received.unwrap_or_else(|error| {
            self.complaints.note(&error, "cannot receive on a public socket");
            0
        });
        let now = Instant::now();
        let mut spared = 0;
        for index in 0..received {
            let Some(incoming) = self.batch.incoming(index) else { continue };
            let arrival = Arrival {
                listener: id,
                mapping: public.mapping,
                public_address: incoming.to.unwrap_or(public.address),
                client: incoming.from,
            };
            let (slot, octets) = (incoming.slot, incoming.octets.len());
            let verdict = self.core.request(now, &arrival, incoming.octets, &mut self.sockets);
            match verdict {
                Ok(to) => {
                    let (mapping, direction) = (public.mapping, Direction::Request);
                    let tag = Tag { mapping, direction, octets };
                    self.batch.queue(slot, Place::Upstream(to.via).key(), None, to.server, tag);
                }
                Err(reason) => spared += usize::from(prefilter::spares(reason)),
            }
        }
        if spared > 0 && self.prefilter == Prefilter::Auto {
            self.watch(id, now, spared);
        }
        received
    }

    fn take_responses(&mut self, id: UpstreamId) -> usize {
        let Some(socket) = self.sockets.upstream(id) else { return 0 };
        let received = self.batch.receive(socket).unwrap_or_else(|error| {
            self.complaints.note(&error, "cannot receive from the servers");
            0
        });
        let now = Instant::now();
        for index in 0..received {
            let Some(incoming) = self.batch.incoming(index) else { continue };
            let (slot, octets) = (incoming.slot, incoming.octets.len());
            if let Ok(to) = self.core.response(now, id, incoming.from, incoming.octets) {
                let tag = Tag { mapping: to.mapping, direction: Direction::Response, octets };
                let shared = self.public[to.via.0 as usize].address.is_unspecified();
                let from = shared.then_some(to.public_address);
                self.batch.queue(slot, Place::Public(to.via).key(), from, to.client, tag);
            }
        }
        received
    }

    /// Turns the prefilter on where a flood has begun.
    fn watch(&mut self, id: ListenerId, now: Instant, spared: usize) {
        let public = &self.public[id.0 as usize];
        let watch = &mut self.watches[id.0 as usize];
        if public.is_filtered() || !watch.flooded(now - self.started, spared) {
            return;
        }
        match public.filter(true, &self.table) {
            Ok(()) => {
                self.filtered += 1;
                if self.floods.due(now) {
                    let mapping = self.table.mapping(public.mapping);
                    let net = &self.table.net(mapping.net).name;
                    tracing::warn!(%net, public_port = mapping.public_port, "flood: prefilter on");
                }
            }
            Err(error) => self.complaints.note(&error, "cannot turn the prefilter on"),
        }
    }

    /// Turns the prefilter off where the flood is over.
    fn end_floods(&mut self) {
        if self.filtered == 0 {
            return;
        }
        let filtered = self.public.iter().zip(&mut self.watches);
        for (public, watch) in filtered.filter(|(public, _)| public.is_filtered()) {
            if !watch.over(public.drops().prefilter) {
                continue;
            }
            match public.filter(false, &self.table) {
                Ok(()) => self.filtered -= 1,
                Err(error) => self.complaints.note(&error, "cannot turn the prefilter off"),
            }
        }
        if self.filtered == 0 {
            tracing::info!("floods are over: prefilter off");
        }
    }

    fn make_room(&mut self) {
        if self.batch.is_full() {
            self.flush();
        }
    }

    fn flush(&mut self) {
        let (public, sockets) = (&self.public, &self.sockets);
        self.batch.flush(
            |key| match Place::from_key(key) {
                Place::Public(id) => Some(public[id.0 as usize].socket.as_fd()),
                Place::Upstream(id) => sockets.upstream(id),
                Place::Wake => None,
            },
            |tag, outcome| match outcome {
                Ok(()) => self.core.sent(tag.mapping, tag.direction, tag.octets),
                Err(error) => {
                    self.core.send_failed(tag.mapping, tag.direction);
                    self.complaints.note(
                        &error,
                        match tag.direction {
                            Direction::Request => "cannot send to a server",
                            Direction::Response => "cannot send to a client",
                        },
                    );
                }
            },
        );
    }

    fn obey(&mut self) {
        // Only now is the flag down: what is asked from here on wakes us again.
        let _ = self.wake.read();
        while let Ok(command) = self.commands.try_recv() {
            match command {
                Command::Flows(limit, reply) => {
                    let flows = self.core.flows(Instant::now()).take(limit).collect();
                    // Who asked may have gone; then nobody wants to know.
                    let _ = reply.try_send(flows);
                }
                Command::Drain(end) => {
                    self.drain_until = Some(end);
                    for public in self.public.iter() {
                        let _ = self.sockets.epoll.delete(&public.socket);
                    }
                }
            }
        }
    }
}

impl Sockets {
    fn upstream(&self, id: UpstreamId) -> Option<BorrowedFd<'_>> {
        self.upstream.get(id.0 as usize)?.as_ref().map(Socket::as_fd)
    }

    fn open(&mut self, id: UpstreamId, ipv4: bool) -> io::Result<u16> {
        let (socket, port) = socket::upstream(ipv4, self.receive_buffer)?;
        self.epoll.add(&socket, readable(Place::Upstream(id)))?;
        let index = id.0 as usize;
        if self.upstream.len() <= index {
            self.upstream.resize_with(index + 1, || None);
        }
        self.upstream[index] = Some(socket);
        self.open += 1;
        Ok(port)
    }
}

impl Shell for Sockets {
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
        if self.upstream[id.0 as usize].take().is_some() {
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

impl Complaints {
    fn note(&mut self, error: &io::Error, what: &'static str) {
        if self.due(Instant::now()) {
            tracing::warn!(%error, "{what}");
        }
    }

    /// Whether one may be told now.
    fn due(&mut self, now: Instant) -> bool {
        let due = self.last.is_none_or(|last| now - last >= COMPLAINT_INTERVAL);
        if due {
            self.last = Some(now);
        }
        due
    }
}

const UPSTREAM: u64 = 1 << 32;
const WAKE: u64 = 1 << 33;

impl Place {
    fn key(self) -> u64 {
        match self {
            Self::Public(id) => u64::from(id.0),
            Self::Upstream(id) => UPSTREAM | u64::from(id.0),
            Self::Wake => WAKE,
        }
    }

    fn from_key(key: u64) -> Self {
        match key {
            WAKE => Self::Wake,
            _ if key & UPSTREAM != 0 => Self::Upstream(UpstreamId(key as u32)),
            _ => Self::Public(ListenerId(key as u32)),
        }
    }
}

fn readable(place: Place) -> EpollEvent {
    EpollEvent::new(EpollFlags::EPOLLIN | EpollFlags::EPOLLET, place.key())
}
