//! When a public socket is flooded, and when it is over: then the prefilter goes on and off.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::config::Prefilter;
use crate::relay::{ListenerId, Table};

use super::complaints::Complaints;
use super::prefilter;
use super::public::{Listener, Listeners};

/// Turns the prefilter of one worker's public sockets on and off, where that is left to it.
pub(super) struct FloodGuard {
    automatic: bool,
    /// Of each public socket, in its place.
    watches: Vec<FloodWatch>,
    /// Sockets on which the prefilter is on.
    filtered: usize,
    table: Arc<Table>,
    started: Instant,
    complaints: Complaints,
}

impl FloodGuard {
    pub(super) fn new(
        prefilter: Prefilter,
        places: usize,
        table: Arc<Table>,
        started: Instant,
    ) -> Self {
        Self {
            automatic: prefilter == Prefilter::Auto,
            watches: (0..places).map(|_| FloodWatch::default()).collect(),
            filtered: 0,
            table,
            started,
            complaints: Complaints::default(),
        }
    }

    /// Whether no socket needs a [`look`](Self::look).
    pub(super) fn is_quiet(&self) -> bool {
        self.filtered == 0
    }

    /// Notes datagrams that the prefilter would have spared the worker, and turns it on where they
    /// are a flood.
    pub(super) fn note(&mut self, id: ListenerId, public: &Listener, now: Instant, spared: usize) {
        let watch = &mut self.watches[id.0 as usize];
        if !self.automatic
            || public.socket.is_filtered()
            || !watch.flooded(now.saturating_duration_since(self.started), spared)
        {
            return;
        }
        if let Err(error) = public.filter(true, &self.table) {
            return self.complaints.note(&error, "cannot turn the prefilter on");
        }
        self.filtered += 1;
        if self.complaints.due(now, "flood") {
            let net = &self.table.net(public.net).name;
            let public_port = self.table.mapping(public.mapping).public_port;
            tracing::warn!(%net, public_port, "flood: prefilter on");
        }
    }

    /// Turns the prefilter off where the flood is over. To be called about once a second.
    pub(super) fn look(&mut self, listeners: &Listeners) {
        if self.is_quiet() {
            return;
        }
        for (id, public) in listeners.iter().filter(|(_, public)| public.socket.is_filtered()) {
            // Accounted for before its 32 bits come round. One that cannot be read is read at the
            // next look.
            let Some(figure) = public.account() else { continue };
            if !self.watches[id.0 as usize].over(figure) {
                continue;
            }
            match public.filter(false, &self.table) {
                Ok(()) => self.filtered -= 1,
                Err(error) => self.complaints.note(&error, "cannot turn the prefilter off"),
            }
        }
        if self.is_quiet() {
            tracing::info!("floods are over: prefilter off");
        }
    }

    /// Goes over to another configuration, before a datagram is judged by it. The kernel never
    /// refuses what the new one accepts: where a program cannot be had, there is none.
    pub(super) fn reload(
        &mut self,
        prefilter: Prefilter,
        table: Arc<Table>,
        before: &Listeners,
        after: &Listeners,
    ) {
        self.watches.resize_with(after.places(), FloodWatch::default);
        for (id, public) in after.iter() {
            let Some(was) = before.get(id).filter(|_| after.keeps(id, before)) else {
                self.watches[id.0 as usize] = FloodWatch::default();
                continue;
            };
            let filtered = public.socket.is_filtered();
            let filter = match prefilter {
                // One that was always on says nothing of a flood.
                Prefilter::Auto => filtered && self.automatic,
                Prefilter::Always => true,
                Prefilter::Off => false,
            };
            let same = || prefilter::is_same((&self.table, was.net), (&table, public.net));
            if filter == filtered && (!filter || same()) {
                continue;
            }
            if let Err(error) = public.filter(filter, &table) {
                self.complaints.note(&error, "cannot change the prefilter");
                let _ = public.filter(false, &table);
            }
        }
        self.automatic = prefilter == Prefilter::Auto;
        let filtered = after.iter().filter(|(_, public)| public.socket.is_filtered());
        self.filtered = if self.automatic { filtered.count() } else { 0 };
        self.table = table;
    }
}

/// Watches one socket for a flood, to tell when a filter in the kernel pays.
#[derive(Debug, Default)]
pub(super) struct FloodWatch {
    /// Which tenth of a second it is, since the router's start.
    window: u64,
    /// Datagrams in this window that a filter would have spared the worker.
    spared: usize,
    /// The kernel's figure at the last look.
    dropped: u32,
    quiet_looks: u32,
}

impl FloodWatch {
    /// So many in a tenth of a second are a flood.
    const FLOOD: usize = 100;
    /// Fewer between two looks are quiet,
    const QUIET: u32 = 100;
    /// and so many quiet looks are peace. A worker looks about once a second.
    const QUIET_LOOKS: u32 = 10;

    /// Notes `spared` more datagrams, and tells whether a flood has begun.
    pub(super) fn flooded(&mut self, since_start: Duration, spared: usize) -> bool {
        let window = since_start.as_millis() as u64 / 100;
        if window != self.window {
            (self.window, self.spared) = (window, 0);
        }
        self.spared += spared;
        self.spared >= Self::FLOOD
    }

    /// Takes the kernel's figure, and tells whether the flood is over.
    pub(super) fn over(&mut self, dropped: u32) -> bool {
        let new = dropped.wrapping_sub(std::mem::replace(&mut self.dropped, dropped));
        self.quiet_looks = if new < Self::QUIET { self.quiet_looks + 1 } else { 0 };
        let over = self.quiet_looks >= Self::QUIET_LOOKS;
        if over {
            (self.quiet_looks, self.spared) = (0, 0);
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
            assert!(!watch.flooded(tenth(n), 99), "990 a second are none");
        }
        assert!(watch.flooded(tenth(49), 1));
        let mut dropped = u32::MAX - 50;
        let mut look = |new| {
            dropped = dropped.wrapping_add(new);
            watch.over(dropped)
        };
        assert!(!look(0), "what the kernel dropped before counts once");
        assert!((0..9).all(|_| !look(99)) && !look(100) && (0..9).all(|_| !look(0)));
        assert!(look(0));
        assert!(!watch.flooded(tenth(49), 99));
    }
}
