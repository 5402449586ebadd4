//! Guards upstream sockets against floods of strays, which are datagrams that no server sent. While
//! a flood lasts, the kernel refuses them.

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
    /// One watch for all sockets, so that a flood is noticed however it is spread over them.
    watch: FloodWatch,
    /// What the kernel dropped while it refused strays.
    dropped: u32,
    started: Instant,
    warnings: RateLimitedWarnings,
}

impl StrayGuard {
    /// A guard that turns no filter on before the first [`reload`](Self::reload).
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
    /// sends: a socket that cannot get its new program has no filter.
    pub(super) fn reload(&mut self, settings: &Datapath, table: &Table, sockets: &UpstreamSockets) {
        self.warnings = RateLimitedWarnings::default();
        self.filters = settings.prefilter != Prefilter::Off;
        let program = || kernel_filter::upstream::program(table).ok();
        // The program is made only when some filter is on.
        let program = LazyCell::new(|| if self.filters { program() } else { None });
        for Upstream { socket, .. } in sockets.iter().filter(|it| it.socket.is_filtered()) {
            let kept =
                program.is_some() && socket.filter(program.as_ref(), sockets.drops()).is_ok();
            if !kept && let Err(error) = socket.filter(None, sockets.drops()) {
                self.warnings.note(&error, "cannot let strays through");
            }
        }
    }

    /// Notes strays at a socket, and has the kernel refuse them when they are a flood.
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
            || !upstream.kind.ipv4 // IPv6 serves single servers only, and few of them
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

    /// Adds up what the kernel dropped since the last call, and turns the filters off when the
    /// flood is over. The worker calls this about once a second.
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
