//! Floods of strays: datagrams at upstream sockets that no server sent. While one lasts, the kernel
//! refuses them.

use std::cell::LazyCell;
use std::mem;
use std::time::Instant;

use crate::config::{Datapath, Prefilter};
use crate::datapath::kernel_filter;
use crate::datapath::kernel_filter::flood::FloodWatch;
use crate::logging::warnings::RateLimitedWarnings;
use crate::nat::{Table, UpstreamId};

use super::upstream::{Upstream, UpstreamSockets};

/// Turns the upstream filter of one worker's sockets on and off.
pub(super) struct StrayGuard {
    /// Whether the kernel may refuse strays.
    filters: bool,
    /// Of all sockets, however the strays are spread over them.
    watch: FloodWatch,
    /// What the kernel dropped while it refused strays.
    dropped: u32,
    started: Instant,
    warnings: RateLimitedWarnings,
}

impl StrayGuard {
    /// Turns no filter on before the first [`reload`](Self::reload).
    pub(super) fn new(started: Instant) -> Self {
        Self {
            filters: false,
            watch: FloodWatch::default(),
            dropped: 0,
            started,
            warnings: RateLimitedWarnings::default(),
        }
    }

    /// Goes over to another configuration. The kernel never refuses what a server of the new table
    /// sends: where a program cannot be had, there is none.
    pub(super) fn reload(&mut self, settings: &Datapath, table: &Table, sockets: &UpstreamSockets) {
        self.warnings = RateLimitedWarnings::default();
        self.filters = settings.prefilter != Prefilter::Off;
        let program = || kernel_filter::upstream::program(table).ok();
        // Made only where a filter is on.
        let program = LazyCell::new(|| if self.filters { program() } else { None });
        for Upstream { socket, .. } in sockets.iter().filter(|it| it.socket.is_filtered()) {
            let kept =
                program.is_some() && socket.filter(program.as_ref(), sockets.drops()).is_ok();
            if !kept && let Err(error) = socket.filter(None, sockets.drops()) {
                self.warnings.note(&error, "cannot let strays through");
            }
        }
    }

    /// Notes strays at a socket, and has the kernel refuse them where they are a flood.
    pub(super) fn note(
        &mut self,
        sockets: &UpstreamSockets,
        id: UpstreamId,
        table: &Table,
        now: Instant,
        strays: usize,
    ) {
        let Some(upstream) = sockets.upstream(id) else { return };
        let since_start = now.saturating_duration_since(self.started);
        if !self.filters
            || !upstream.ipv4 // single servers alone, and few
            || upstream.socket.is_filtered()
            || !self.watch.flooded(since_start, strays, FloodWatch::FLOOD)
        {
            return;
        }
        let refuse = |program| upstream.socket.filter(Some(&program), sockets.drops());
        match kernel_filter::upstream::program(table).and_then(refuse) {
            Err(error) => self.warnings.note(&error, "cannot refuse strays"),
            Ok(()) if self.warnings.due(now, "flood") => {
                tracing::warn!("flood of what no server sent: refused by the kernel");
            }
            Ok(()) => {}
        }
    }

    /// Adds up what the kernel dropped since the last call, and lets everything through where a
    /// flood is over. To be called about once a second.
    pub(super) fn account(&mut self, sockets: &mut UpstreamSockets) {
        let drops = sockets.drops().clone();
        let mut refused = false;
        for Upstream { socket, dropped, .. } in sockets.iter_mut() {
            let Some(figure) = socket.account(&drops) else { continue };
            let new = figure.wrapping_sub(mem::replace(dropped, figure));
            if socket.is_filtered() {
                refused = true;
                self.dropped = self.dropped.wrapping_add(new);
            }
        }
        if !refused || !self.watch.over(self.dropped) {
            return;
        }
        for Upstream { socket, .. } in sockets.iter().filter(|it| it.socket.is_filtered()) {
            if let Err(error) = socket.filter(None, &drops) {
                self.warnings.note(&error, "cannot let strays through");
            }
        }
    }
}
