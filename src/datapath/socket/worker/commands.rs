//! Carries out what the control plane asks of a worker, between two datagrams.

use std::mem;
use std::sync::Arc;
use std::time::Instant;

use crate::config::Datapath;
use crate::datapath::commands::{Command, WorkerReload};
use crate::datapath::socket::busy_poll::BusyPoll;
use crate::datapath::socket::effects::WorkerEffects;
use crate::datapath::socket::public::Listeners;
use crate::datapath::socket::sys::batch::Batch;
use crate::logging::warnings::RateLimitedWarnings;
use crate::nat::Table;

use super::{Relay, Worker};

impl Worker {
    #[cold]
    pub(super) fn handle_commands(&mut self, now: Instant) {
        // The flag goes down before the commands are read. So a command that comes after this wakes
        // the worker again.
        let _ = self.wake.read();
        while let Ok(command) = self.commands.try_recv() {
            // If the asker has gone, nobody needs the answer.
            match command {
                Command::Ping(reply) => _ = reply.try_send(()),
                Command::Flows(limit, reply) => {
                    let flows = self.relay.core.flows(now).take(limit).collect();
                    _ = reply.try_send((Arc::clone(self.relay.core.table()), flows));
                }
                Command::Reload(next, reply) => {
                    self.activity.note();
                    self.reload(*next, now);
                    self.reloading = Some(reply);
                }
                Command::CloseLeft(reply) => self.closing = Some(reply),
                Command::Drain(end) => {
                    self.drain_until = Some(end);
                    // Requests are not taken any more, and answers go on here.
                    self.relay.core.recall_all(&mut self.relay.effects);
                    for (_, listener) in self.relay.effects.public.iter() {
                        let _ = self.epoll.delete(&listener.socket);
                    }
                }
            }
        }
    }

    /// Goes over to another configuration between two datagrams. It holds from the next datagram
    /// on; the flows follow in small groups.
    fn reload(&mut self, next: WorkerReload, now: Instant) {
        while self.reloading.is_some() {
            self.tidy(now);
        }
        self.flush(now); // what waits is counted under the old table
        let WorkerReload { succession, listeners, upstream_limit, settings, offload } = next;
        let before = mem::replace(&mut self.relay.effects.public, listeners);
        let old = Arc::clone(self.relay.core.table());
        self.relay.core.reload(now, succession, &mut self.relay.effects);
        if let (Some(carrier), Some(counters)) = (&mut self.relay.effects.carrier, offload) {
            carrier.reload(counters);
        }
        for (id, was) in before.iter() {
            let is = self.relay.effects.public.get(id);
            if is.is_none_or(|is| !Arc::ptr_eq(&is.drops, &was.drops)) {
                was.account();
            }
        }
        self.follow_core(&old, &before, upstream_limit, &settings);
    }

    /// Has everything around the core go over to the core's table. `before` are the public sockets
    /// under the `old` table.
    pub(super) fn follow_core(
        &mut self,
        old: &Table,
        before: &Listeners,
        upstream_limit: usize,
        settings: &Datapath,
    ) {
        let Relay { core, effects, floods, strays, .. } = &mut self.relay;
        let table = core.table();
        if table.nets().iter().any(|net| net.kind.has_long_datagrams()) {
            self.long.get_or_insert_with(|| Box::new(Batch::new()));
        }
        let WorkerEffects { public, upstream, warnings, .. } = effects;
        *warnings = RateLimitedWarnings::default();
        floods.reload(settings.prefilter, (old, table), before, public);
        upstream.reload(upstream_limit, settings.receive_buffer, table, warnings);
        strays.reload(settings, table, upstream);
        self.busy = BusyPoll::new(settings.busy_poll);
    }
}
