//! One worker, with its public sockets, its upstream sockets and its core.
//!
//! At a wake-up the worker reads what is ready, from each socket at most its quota. It lets the
//! core decide, and sends what may pass. A socket that has more waits for its next turn, so a flood
//! on one port delays neither the other ports nor the responses.

mod commands;
mod relay;

use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender};
use std::time::{Duration, Instant};

use nix::sys::epoll::{Epoll, EpollEvent, EpollTimeout};
use nix::sys::eventfd::EventFd;

use crate::config::Datapath;
use crate::nat::{Core, ListenerId, UpstreamId};

use crate::datapath::activity::Activity;
use crate::datapath::commands::Command;
use crate::datapath::offload::Carrier;
use crate::datapath::socket::busy_poll::BusyPoll;
use crate::datapath::socket::effects::WorkerEffects;
use crate::datapath::socket::event_key::EventKey;
use crate::datapath::socket::filtered::NetDrops;
use crate::datapath::socket::flood_guard::FloodGuard;
use crate::datapath::socket::port_pool::Ports;
use crate::datapath::socket::public::Listeners;
use crate::datapath::socket::receive_quota::ReceiveQuota;
use crate::datapath::socket::stray_guard::StrayGuard;
use crate::datapath::socket::sys::batch::{Batch, LONG, Linux};
use crate::datapath::socket::sys::epoll_wait::wait;
use crate::datapath::socket::ticker::Ticker;
use crate::datapath::socket::upstream::UpstreamSockets;
use crate::datapath::throttlings::Throttlings;
use crate::logging::audit::Audit;
use crate::logging::warnings::RateLimitedWarnings;

use relay::Relay;

/// How long a stopping worker waits for one more answer before it checks whether any is still due.
const DRAIN_TICK: Duration = Duration::from_millis(20);
/// The most ready sockets that are taken from the kernel at once.
const EVENTS: usize = 256;

/// Everything that one worker thread owns.
pub(in crate::datapath) struct Worker {
    relay: Relay,
    epoll: Arc<Epoll>,
    batch: Batch,
    /// There as soon as some net has long datagrams.
    long: Option<Box<Batch<Linux, LONG>>>,
    commands: Receiver<Command>,
    drain_until: Option<Instant>,
    /// Whether more is left to close than one call closes.
    expiring: bool,
    /// Where to report that all flows have gone over to another configuration.
    reloading: Option<SyncSender<usize>>,
    /// Where to report that the sockets whose ports are wanted are closed.
    closing: Option<SyncSender<()>>,
    ticker: Ticker,
    wake: Arc<EventFd>,
    busy: BusyPoll,
    activity: Arc<Activity>,
}

/// What all workers share.
#[derive(Clone, Debug)]
pub(in crate::datapath) struct Shared {
    pub audit: Arc<Audit>,
    pub throttlings: Arc<Throttlings>,
    pub activity: Arc<Activity>,
    pub ports: Arc<Ports>,
    /// Counts what the kernel drops on the upstream sockets.
    pub drops: Arc<NetDrops>,
}

/// What a worker is built from.
pub(in crate::datapath) struct WorkerSetup {
    pub core: Core,
    /// `epoll` watches them already.
    pub listeners: Listeners,
    pub shared: Shared,
    pub upstream_limit: usize,
    pub settings: Datapath,
    pub carrier: Option<Carrier>,
    pub started: Instant,
    pub commands: Receiver<Command>,
    pub epoll: Arc<Epoll>,
    pub wake: Arc<EventFd>,
}

impl Worker {
    pub(in crate::datapath) fn new(setup: WorkerSetup) -> io::Result<Self> {
        let WorkerSetup { core, listeners, epoll, wake, settings, carrier, started, .. } = setup;
        let Shared { audit, throttlings, activity, ports, drops } = setup.shared;
        epoll.add(&*wake, EventKey::Wake.arrivals())?;
        let effects = WorkerEffects {
            public: listeners,
            upstream: UpstreamSockets::new(Arc::clone(&epoll), ports, drops),
            audit,
            throttlings,
            warnings: RateLimitedWarnings::default(),
            carrier,
        };
        let relay = Relay {
            core,
            effects,
            quota: ReceiveQuota::default(),
            floods: FloodGuard::new(started),
            strays: StrayGuard::new(started),
        };
        let mut worker = Self {
            relay,
            ticker: Ticker::new(&epoll)?,
            epoll,
            batch: Batch::new(),
            long: None,
            commands: setup.commands,
            drain_until: None,
            expiring: false,
            reloading: None,
            closing: None,
            wake,
            busy: BusyPoll::new(settings.busy_poll),
            activity,
        };
        let table = Arc::clone(worker.relay.core.table());
        worker.follow_core(&table, &Listeners::default(), setup.upstream_limit, &settings);
        Ok(worker)
    }

    /// Relays until the worker is told to drain and has drained.
    pub(in crate::datapath) fn run(mut self) {
        let mut events = [EpollEvent::empty(); EVENTS];
        loop {
            let ready = match wait(&self.epoll, &mut events, self.time_out()) {
                Ok(ready) => ready,
                Err(nix::errno::Errno::EINTR) => 0,
                Err(error) => {
                    self.relay.effects.warnings.note(&error.into(), "cannot wait for datagrams");
                    0
                }
            };
            let now = Instant::now();
            self.relay.quota.next_turn();
            self.relay.floods.next_turn();
            for event in &events[..ready] {
                self.handle_event(EventKey::from_key(event.data()), now);
            }
            self.flush(now);
            self.tidy(now);
            self.busy.note(now, ready);
            self.ticker.run(!self.relay.core.is_idle() || !self.relay.floods.is_quiet());
            if let Some(end) = self.drain_until
                && (now >= end || (ready == 0 && !self.relay.core.awaits_answers(now)))
            {
                break self.relay.core.shut_down(now, &mut self.relay.effects);
            }
        }
    }

    fn time_out(&self) -> EpollTimeout {
        let at_once = self.busy.goes_on() || self.relay.floods.is_looking();
        let wait = match self.drain_until {
            _ if at_once || self.expiring || self.reloading.is_some() => Duration::ZERO,
            Some(_) => DRAIN_TICK,
            None => return EpollTimeout::NONE,
        };
        EpollTimeout::try_from(wait).unwrap_or(EpollTimeout::ZERO)
    }

    fn handle_event(&mut self, key: EventKey, now: Instant) {
        // Who only asks whether it is alive gives it nothing to do.
        if key != EventKey::Wake {
            self.activity.note();
        }
        let received = match key {
            EventKey::Public(_) if self.drain_until.is_some() => return,
            EventKey::Public(id) => self.relay_requests(id, now),
            EventKey::Upstream(id) => self.relay_responses(id, now),
            EventKey::Wake => return self.handle_commands(now),
            EventKey::Tick => return self.tick(),
        };
        self.relay.quota.note(key, received);
    }

    fn relay_requests(&mut self, id: ListenerId, now: Instant) -> usize {
        let is_long = self.relay.effects.public.get(id).is_some_and(|public| public.is_long);
        match &mut self.long {
            Some(long) if is_long => self.relay.requests(long, id, now),
            _ => self.relay.requests(&mut self.batch, id, now),
        }
    }

    fn relay_responses(&mut self, id: UpstreamId, now: Instant) -> usize {
        let upstream = self.relay.effects.upstream.upstream(id);
        let is_long = upstream.is_some_and(|upstream| upstream.kind.is_long);
        match &mut self.long {
            Some(long) if is_long => self.relay.responses(long, id, now),
            _ => self.relay.responses(&mut self.batch, id, now),
        }
    }

    /// Sends what is queued.
    fn flush(&mut self, now: Instant) {
        self.relay.flush(&mut self.batch, now);
        if let Some(long) = &mut self.long {
            self.relay.flush(long, now);
        }
    }

    /// Does a part of the work on many flows, so that datagrams are handled in between.
    #[inline]
    fn tidy(&mut self, now: Instant) {
        if self.relay.floods.is_looking() {
            self.relay.floods.end_quiet_floods(&self.relay.effects.public, self.relay.core.table());
        }
        if self.expiring {
            self.expiring = self.relay.core.expire(now, &mut self.relay.effects);
        }
        if self.reloading.is_some()
            && let Some(flows_closed) = self.relay.core.go_over(now, &mut self.relay.effects)
            && let Some(reply) = self.reloading.take()
        {
            // If the asker has gone, nobody needs the answer.
            let _ = reply.try_send(flows_closed);
        }
        if self.closing.is_some()
            && !self.relay.core.close_left(now, &mut self.relay.effects)
            && let Some(reply) = self.closing.take()
        {
            let _ = reply.try_send(());
        }
    }

    /// Does what has to be done about once a second.
    #[cold]
    fn tick(&mut self) {
        self.ticker.read();
        self.expiring = true;
        self.relay.strays.account(&mut self.relay.effects.upstream);
        self.relay.floods.begin_round();
    }
}
