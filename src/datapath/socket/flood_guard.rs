//! Turns the request filter on when public sockets are flooded, and off when the flood is over.

use std::time::Instant;

use crate::config::Prefilter;
use crate::nat::{ListenerId, Table};

use crate::datapath::kernel_filter::flood::FloodWatch;
use crate::datapath::kernel_filter::request;
use crate::datapath::socket::public::{Listener, Listeners};
use crate::logging::warnings::RateLimitedWarnings;

/// The most filters that one wake-up turns on. The other flooded sockets get theirs in the next
/// wake-ups.
const ON_AT_ONCE: usize = 8;
/// The most sockets that one wake-up looks at.
const LOOKS_AT_ONCE: usize = 128;
/// Number of rounds in which each socket without a filter is looked at once. So the kernel's drops
/// there are accounted for long before their 32-bit figure wraps.
const ROUNDS: usize = 16;

/// Turns the request filter of one worker's public sockets on and off, where the setting leaves
/// that to the relay.
///
/// The datagrams of all sockets of a net are counted together, and so are those of the whole
/// worker. So a flood is noticed however it is spread over the sockets. The filter goes on where
/// the flood arrives.
pub(in crate::datapath) struct FloodGuard {
    automatic: bool,
    /// The state of each public socket, by its place.
    sockets: Vec<Watched>,
    /// The flood of each net.
    nets: Vec<Flood>,
    /// The flood of the whole worker, from datagrams that are no flood of one net.
    worker: Flood,
    /// Number of sockets on which the request filter is on.
    filtered: usize,
    /// How many filters may still be turned on in this wake-up.
    may_turn_on: usize,
    /// The place at which the current round goes on.
    next: Option<usize>,
    round: usize,
    /// Rounds that are left until each socket has been looked at since the last noted datagram.
    rounds_due: usize,
    started: Instant,
    warnings: RateLimitedWarnings,
}

/// The state of a socket.
#[derive(Clone, Copy, Debug, Default)]
struct Watched {
    /// The kernel's figure at the last look.
    dropped: u32,
    /// Whose flood turned the filter on: that of the net or that of the worker.
    by: Option<Whose>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Whose {
    Net,
    Worker,
}

/// What is known of a flood over many sockets.
#[derive(Debug, Default)]
struct Flood {
    watch: FloodWatch,
    /// What the kernel dropped on the sockets that have a filter because of this flood.
    dropped: u32,
    /// Number of these sockets.
    filtered: usize,
    over: bool,
}

impl FloodGuard {
    /// A guard without sockets until the first [`reload`](Self::reload).
    pub(in crate::datapath) fn new(started: Instant) -> Self {
        Self {
            automatic: false,
            sockets: Vec::new(),
            nets: Vec::new(),
            worker: Flood::default(),
            filtered: 0,
            may_turn_on: ON_AT_ONCE,
            next: None,
            round: 0,
            rounds_due: 0,
            started,
            warnings: RateLimitedWarnings::default(),
        }
    }

    /// Begins another wake-up.
    #[inline]
    pub(in crate::datapath) fn next_turn(&mut self) {
        self.may_turn_on = ON_AT_ONCE;
    }

    /// Whether no socket needs to be looked at.
    #[inline]
    pub(in crate::datapath) fn is_quiet(&self) -> bool {
        self.filtered == 0 && self.rounds_due == 0
    }

    /// Whether a round is under way. [`end_quiet_floods`](Self::end_quiet_floods) continues it.
    #[inline]
    pub(in crate::datapath) fn is_looking(&self) -> bool {
        self.next.is_some()
    }

    /// Notes `refused` datagrams that the request filter would have kept from the worker. Turns the
    /// filter on where they are a flood.
    pub(in crate::datapath) fn note(
        &mut self,
        id: ListenerId,
        public: &Listener,
        table: &Table,
        now: Instant,
        refused: usize,
    ) {
        self.rounds_due = ROUNDS;
        if !self.automatic || public.socket.is_filtered() {
            return;
        }
        let since_start = now.saturating_duration_since(self.started);
        let net = &mut self.nets[usize::from(public.net.0)];
        let by = if net.watch.flooded(since_start, refused, FloodWatch::FLOOD) {
            Whose::Net
        } else if self.worker.watch.flooded(since_start, refused, FloodWatch::FLOOD_OF_WORKER) {
            Whose::Worker
        } else {
            return;
        };
        let Some(may_turn_on) = self.may_turn_on.checked_sub(1) else { return };
        self.may_turn_on = may_turn_on;
        if let Err(error) = public.filter(true, table) {
            return self.warnings.note_of(
                public.net,
                table,
                &error,
                "cannot turn the prefilter on",
            );
        }
        self.filtered += 1;
        self.sockets[id.0 as usize].by = Some(by);
        let flood = if by == Whose::Net { net } else { &mut self.worker };
        flood.filtered += 1;
        flood.over = false;
        if flood.filtered == 1 {
            match by {
                Whose::Net => {
                    let net = &table.net(public.net).name;
                    let public_port = table.mapping(public.mapping).public_port;
                    tracing::warn!(%net, public_port, "flood: prefilter on");
                }
                Whose::Worker => tracing::warn!("flood of many nets: prefilter on"),
            }
        }
    }

    /// Begins a round, unless one is under way. The worker calls this about once a second.
    pub(in crate::datapath) fn begin_round(&mut self) {
        if self.next.is_none() && !self.is_quiet() {
            self.next = Some(0);
        }
    }

    /// Looks at the next sockets of a round. Accounts for what the kernel dropped there, and turns
    /// the request filter off where the flood is over.
    pub(in crate::datapath) fn end_quiet_floods(&mut self, listeners: &Listeners, table: &Table) {
        let Some(first) = self.next else { return };
        let end = self.sockets.len().min(first + LOOKS_AT_ONCE);
        for place in first..end {
            let Some(public) = listeners.get(ListenerId(place as u32)) else { continue };
            let filtered = public.socket.is_filtered();
            if !filtered && place % ROUNDS != self.round % ROUNDS {
                continue;
            }
            // A figure that cannot be read now is read in the next round.
            let Some(figure) = public.account() else { continue };
            let watched = &mut self.sockets[place];
            let new = figure.wrapping_sub(std::mem::replace(&mut watched.dropped, figure));
            let flood = match watched.by {
                Some(Whose::Net) => &mut self.nets[usize::from(public.net.0)],
                Some(Whose::Worker) => &mut self.worker,
                None => continue,
            };
            flood.dropped = flood.dropped.wrapping_add(new);
            if !flood.over {
                continue;
            }
            match public.filter(false, table) {
                Ok(()) => {
                    watched.by = None;
                    flood.filtered -= 1;
                    self.filtered -= 1;
                }
                Err(error) => {
                    let what = "cannot turn the prefilter off";
                    self.warnings.note_of(public.net, table, &error, what);
                }
            }
        }
        self.next = Some(end);
        if end == self.sockets.len() {
            self.end_round(table);
        }
    }

    #[cold]
    fn end_round(&mut self, table: &Table) {
        self.next = None;
        self.round += 1;
        self.rounds_due = self.rounds_due.saturating_sub(1);
        let nets = table.nets().iter().map(|net| Some(net.name.as_str()));
        let floods = nets.zip(&mut self.nets).chain([(None, &mut self.worker)]);
        for (net, flood) in floods {
            if flood.over && flood.filtered == 0 {
                flood.over = false;
                match net {
                    Some(net) => tracing::info!(net, "floods are over: prefilter off"),
                    None => tracing::info!("flood of many nets is over: prefilter off"),
                }
            } else if flood.filtered > 0 && !flood.over {
                flood.over = flood.watch.over(flood.dropped);
            }
        }
    }

    /// Goes over to another configuration, before any datagram is judged by it. The kernel never
    /// refuses what the new configuration accepts: a socket that cannot get its new program has no
    /// filter.
    pub(in crate::datapath) fn reload(
        &mut self,
        prefilter: Prefilter,
        (old, new): (&Table, &Table),
        before: &Listeners,
        after: &Listeners,
    ) {
        self.warnings = RateLimitedWarnings::default();
        self.sockets.resize_with(after.places(), Watched::default);
        self.nets = new.nets().iter().map(|_| Flood::default()).collect();
        self.worker = Flood::default();
        for (id, public) in after.iter() {
            let place = id.0 as usize;
            let Some(was) = before.get(id).filter(|_| after.keeps(id, before)) else {
                self.sockets[place] = Watched::default();
                continue;
            };
            let filtered = public.socket.is_filtered();
            let filter = match prefilter {
                // A filter that was always on does not show that there is a flood.
                Prefilter::Auto => filtered && self.automatic,
                Prefilter::Always => true,
                Prefilter::Off => false,
            };
            let same = || request::is_same((old, was.net), (new, public.net));
            if filter == filtered && (!filter || same()) {
                continue;
            }
            if let Err(error) = public.filter(filter, new) {
                self.warnings.note_of(public.net, new, &error, "cannot change the prefilter");
                let _ = public.filter(false, new);
            }
        }
        self.automatic = prefilter == Prefilter::Auto;
        self.filtered = 0;
        for (id, public) in after.iter() {
            let watched = &mut self.sockets[id.0 as usize];
            if !public.socket.is_filtered() {
                watched.by = None;
                continue;
            }
            self.filtered += 1;
            watched.by = watched.by.filter(|_| self.automatic);
            match watched.by {
                Some(Whose::Net) => self.nets[usize::from(public.net.0)].filtered += 1,
                Some(Whose::Worker) => self.worker.filtered += 1,
                None => {}
            }
        }
        self.next = None; // a place may belong to another socket now
    }
}
