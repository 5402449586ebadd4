//! When public sockets are flooded, and when it is over: then the prefilter goes on and off.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::config::Prefilter;
use crate::nat::{ListenerId, Table};

use crate::datapath::kernel_filter::request;
use crate::datapath::socket::public::{Listener, Listeners};
use crate::observe::warnings::RateLimitedWarnings;

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
    table: Arc<Table>,
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
    pub(in crate::datapath) fn new(
        prefilter: Prefilter,
        listeners: &Listeners,
        table: Arc<Table>,
        started: Instant,
    ) -> Self {
        let filtered = listeners.iter().filter(|(_, public)| public.socket.is_filtered());
        Self {
            automatic: prefilter == Prefilter::Auto,
            sockets: vec![Watched::default(); listeners.places()],
            nets: table.nets().iter().map(|_| Flood::default()).collect(),
            worker: Flood::default(),
            filtered: filtered.count(),
            may_turn_on: ON_AT_ONCE,
            next: None,
            round: 0,
            rounds_due: 0,
            table,
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
        if let Err(error) = public.filter(true, &self.table) {
            return self.warnings.note_of(
                public.net,
                &self.table,
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
                    let net = &self.table.net(public.net).name;
                    let public_port = self.table.mapping(public.mapping).public_port;
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
    pub(in crate::datapath) fn end_quiet_floods(&mut self, listeners: &Listeners) {
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
            match public.filter(false, &self.table) {
                Ok(()) => {
                    watched.by = None;
                    flood.filtered -= 1;
                    self.filtered -= 1;
                }
                Err(error) => {
                    let what = "cannot turn the prefilter off";
                    self.warnings.note_of(public.net, &self.table, &error, what);
                }
            }
        }
        self.next = Some(end);
        if end == self.sockets.len() {
            self.end_round();
        }
    }

    #[cold]
    fn end_round(&mut self) {
        self.next = None;
        self.round += 1;
        self.rounds_due = self.rounds_due.saturating_sub(1);
        let nets = self.table.nets().iter().map(|net| Some(net.name.as_str()));
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
        table: Arc<Table>,
        before: &Listeners,
        after: &Listeners,
    ) {
        self.warnings = RateLimitedWarnings::default();
        self.sockets.resize_with(after.places(), Watched::default);
        self.nets = table.nets().iter().map(|_| Flood::default()).collect();
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
            let same = || request::is_same((&self.table, was.net), (&table, public.net));
            if filter == filtered && (!filter || same()) {
                continue;
            }
            if let Err(error) = public.filter(filter, &table) {
                self.warnings.note_of(public.net, &table, &error, "cannot change the prefilter");
                let _ = public.filter(false, &table);
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
        self.table = table;
    }
}

/// Watches for a flood, to tell when a filter in the kernel pays.
#[derive(Debug, Default)]
pub(in crate::datapath) struct FloodWatch {
    /// Which tenth of a second it is, since the router's start.
    window: u64,
    /// Datagrams in this window that a filter would have refused the worker.
    refused: usize,
    /// The kernel's figure at the last look.
    dropped: u32,
    quiet_looks: u32,
}

impl FloodWatch {
    /// So many in a tenth of a second are a flood.
    pub(in crate::datapath) const FLOOD: usize = 100;
    /// And so many of one worker, where no net has that many.
    const FLOOD_OF_WORKER: usize = 10 * Self::FLOOD;
    /// Fewer between two looks are quiet,
    const QUIET: u32 = 100;
    /// and so many quiet looks are peace. A worker looks about once a second.
    const QUIET_LOOKS: u32 = 10;

    /// Notes `refused` more datagrams, and tells whether a flood has begun.
    pub(in crate::datapath) fn flooded(
        &mut self,
        since_start: Duration,
        refused: usize,
        flood: usize,
    ) -> bool {
        let window = since_start.as_millis() as u64 / 100;
        if window != self.window {
            (self.window, self.refused) = (window, 0);
        }
        self.refused += refused;
        self.refused >= flood
    }

    /// Takes the kernel's figure, and tells whether the flood is over.
    pub(in crate::datapath) fn over(&mut self, dropped: u32) -> bool {
        let new = dropped.wrapping_sub(std::mem::replace(&mut self.dropped, dropped));
        self.quiet_looks = if new < Self::QUIET { self.quiet_looks + 1 } else { 0 };
        let over = self.quiet_looks >= Self::QUIET_LOOKS;
        if over {
            (self.quiet_looks, self.refused) = (0, 0);
        }
        over
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_begins_within_a_tenth_of_a_second_and_ends_after_ten_quiet_looks() {
        let mut watch = FloodWatch::default();
        let tenth = |n: u64| Duration::from_millis(100 * n);
        for n in 0..50 {
            assert!(!watch.flooded(tenth(n), 99, FloodWatch::FLOOD), "990 a second are none");
        }
        assert!(watch.flooded(tenth(49), 1, FloodWatch::FLOOD));
        let mut dropped = u32::MAX - 50;
        let mut look = |new| {
            dropped = dropped.wrapping_add(new);
            watch.over(dropped)
        };
        assert!(!look(0), "what the kernel dropped before counts once");
        assert!((0..9).all(|_| !look(99)) && !look(100) && (0..9).all(|_| !look(0)));
        assert!(look(0));
        assert!(!watch.flooded(tenth(49), 99, FloodWatch::FLOOD));
    }
}
