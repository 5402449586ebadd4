//! When public sockets are flooded, and when it is over: then the prefilter goes on and off.

use std::time::Instant;

use crate::config::Prefilter;
use crate::nat::{ListenerId, Table};

use crate::datapath::kernel_filter::flood::FloodWatch;
use crate::datapath::kernel_filter::request;
use crate::datapath::socket::public::{Listener, Listeners};
use crate::logging::warnings::RateLimitedWarnings;

/// Filters turned on in one wake-up; the other sockets that are flooded have theirs in the next ones.
const ON_AT_ONCE: usize = 8;
/// Sockets looked at in one wake-up.
const LOOKS_AT_ONCE: usize = 128;
/// Of the sockets without a filter, every so many are looked at in a round: what is dropped there is
/// accounted for long before its 32 bits come round.
const ROUNDS: usize = 16;

/// Turns the prefilter of one worker's public sockets on and off, where that is left to it.
///
/// A flood is told by what all sockets of a net see of it, or all of the worker, however it is
/// spread over them. The filter goes on where it arrives.
pub(in crate::datapath) struct FloodGuard {
    automatic: bool,
    /// Of each public socket, in its place.
    sockets: Vec<Watched>,
    /// Of each net.
    nets: Vec<Flood>,
    /// Of what is no flood of one net.
    worker: Flood,
    /// Sockets on which the prefilter is on.
    filtered: usize,
    /// Filters that may still be turned on in this wake-up.
    may_turn_on: usize,
    /// Where the round is that is under way.
    next: Option<usize>,
    round: usize,
    /// Rounds until each socket has been looked at since the last datagram that was noted.
    rounds_due: usize,
    started: Instant,
    warnings: RateLimitedWarnings,
}

/// A socket, as far as floods go.
#[derive(Clone, Copy, Debug, Default)]
struct Watched {
    /// The kernel's figure at the last look.
    dropped: u32,
    /// Whose flood turned the filter on.
    by: Option<Whose>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Whose {
    Net,
    Worker,
}

/// A flood, or none, of many sockets.
#[derive(Debug, Default)]
struct Flood {
    watch: FloodWatch,
    /// What the kernel dropped on the sockets that have a filter because of it.
    dropped: u32,
    /// Sockets that have one.
    filtered: usize,
    over: bool,
}

impl FloodGuard {
    /// Without sockets, until the first [`reload`](Self::reload).
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

    /// Another wake-up.
    #[inline]
    pub(in crate::datapath) fn next_turn(&mut self) {
        self.may_turn_on = ON_AT_ONCE;
    }

    /// Whether no socket needs to be looked at.
    #[inline]
    pub(in crate::datapath) fn is_quiet(&self) -> bool {
        self.filtered == 0 && self.rounds_due == 0
    }

    /// Whether a round is under way, which [`end_quiet_floods`](Self::end_quiet_floods) goes on with.
    #[inline]
    pub(in crate::datapath) fn is_looking(&self) -> bool {
        self.next.is_some()
    }

    /// Notes datagrams that the prefilter would have refused the worker, and turns it on where they
    /// are a flood.
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

    /// Begins a round, unless one is under way. To be called about once a second.
    pub(in crate::datapath) fn begin_round(&mut self) {
        if self.next.is_none() && !self.is_quiet() {
            self.next = Some(0);
        }
    }

    /// Looks at some sockets of a round: accounts for what the kernel dropped there, and turns the
    /// prefilter off where the flood is over.
    pub(in crate::datapath) fn end_quiet_floods(&mut self, listeners: &Listeners, table: &Table) {
        let Some(first) = self.next else { return };
        let end = self.sockets.len().min(first + LOOKS_AT_ONCE);
        for place in first..end {
            let Some(public) = listeners.get(ListenerId(place as u32)) else { continue };
            let filtered = public.socket.is_filtered();
            if !filtered && place % ROUNDS != self.round % ROUNDS {
                continue;
            }
            // One that cannot be read is read in the next round.
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

    /// Goes over to another configuration, before a datagram is judged by it. The kernel never
    /// refuses what the new one accepts: where a program cannot be had, there is none.
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
                // One that was always on says nothing of a flood.
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
        self.next = None; // places may be others'
    }
}
