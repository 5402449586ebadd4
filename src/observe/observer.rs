//! Watches the relay for the [`Journal`](super::Journal): which nodes fall silent and answer again,
//! which nets are flooded, who is throttled, and how much is relayed.
//!
//! It runs beside the data path and only reads what is there for others too: the counters, and
//! whether a socket has a filter. So it costs the workers nearly nothing. They tell it of two things: who
//! is throttled, once for each throttling and not for each datagram; and that they are awake, once
//! between two looks. While all of them sleep and nothing is still to come, it sleeps, too.

mod counted;
#[cfg(test)]
mod tests;
mod watch;

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use tokio::time::{self, MissedTickBehavior};

use crate::config::Prefilter;
use crate::datapath::{ActiveConfig, Router};
use crate::nat::Counters;
use crate::observe::DropReport;
use crate::observe::events::EventKind;
use crate::observe::history::History;
use crate::observe::totals::{Contact, Presence};

use counted::Counted;
use watch::Watch;

/// The observer of a router.
#[derive(Debug)]
pub struct Observer {
    router: Arc<Router>,
    watch: Watch,
    /// The configuration in force at the end of the last step, and what was counted then.
    active: Arc<ActiveConfig>,
    before: Counted,
    /// When the last step ended, counted from the relay's start.
    step_ended: Duration,
}

impl Observer {
    /// How often the observer looks.
    pub const TICK: Duration = Duration::from_secs(5);

    /// An observer of a router that has just started.
    pub fn new(router: Arc<Router>) -> Self {
        let active = router.active_config();
        let table = &active.config.table;
        let text = format!(
            "pnet-nat {} relays: {} nets, {} public ports, {} workers",
            env!("CARGO_PKG_VERSION"),
            table.nets().len(),
            table.mappings().len(),
            active.workers,
        );
        router.journal().note(EventKind::Start, text);
        Self {
            router,
            watch: Watch::default(),
            active,
            before: Counted::default(),
            step_ended: Duration::ZERO,
        }
    }

    /// Looks again and again, for ever, and has the drops reported.
    pub async fn run(&mut self, mut drops: Option<&mut DropReport>) -> ! {
        let mut ticks = time::interval(Self::TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        ticks.tick().await;
        loop {
            ticks.tick().await;
            let (at, since_start) = (self.router.journal().age(), self.router.started().elapsed());
            let is_settled = self.look(at, since_start).await;
            if drops.as_mut().is_none_or(|drops| drops.look()) && is_settled {
                self.rest().await;
                if let Some(drops) = &mut drops {
                    drops.begin_window();
                }
                ticks.reset();
            }
        }
    }

    /// Looks at everything. `at` counts from the relay's start by the clock of the history, and
    /// `since_start` by that of the counters. Returns whether all is noted and nothing will change
    /// before a worker wakes up.
    async fn look(&mut self, at: Duration, since_start: Duration) -> bool {
        let slept = self.router.activity().slept();
        let active = self.router.active_config();
        // The kernel refuses datagrams without a worker.
        let is_filtered = active.config.datapath.prefilter == Prefilter::Always;
        let is_settled = self.watch.look(&self.router, &active, since_start, SystemTime::now());
        // A tick may come a little early.
        let ends_step = at + Self::TICK / 2 >= self.step_ended + History::STEP;
        if ends_step {
            self.end_step(active, at, since_start).await;
        }
        slept && ends_step && is_settled && !is_filtered
    }

    /// Sleeps until a worker wakes up.
    async fn rest(&mut self) {
        let (router, journal) = (&self.router, self.router.journal());
        journal.history().rest();
        router.activity().awaited().await;
        self.step_ended = journal.age();
        journal.history().end_rest(self.step_ended);
    }

    async fn end_step(&mut self, active: Arc<ActiveConfig>, at: Duration, since_start: Duration) {
        // A configuration that is no longer in force goes on counting for the nodes that stay.
        let counted = Counted::of(&self.active).await;
        let mut step = counted.since(&self.before);
        let is_same = Arc::ptr_eq(&active, &self.active);
        self.before = if is_same { counted } else { Counted::of(&active).await };
        step.length = at.saturating_sub(self.step_ended);
        self.step_ended = at;

        let table = &active.config.table;
        let presence = |mapping| Contact::of_node(&active.counters, mapping).presence(since_start);
        let presences: Vec<_> = table.mapping_ids().map(presence).collect();
        let answering = presences.iter().filter(|presence| **presence == Presence::Answering);
        step.answering_nodes = answering.count() as u64;
        let flows = |worker: &Arc<Counters>| -> u64 {
            table.net_ids().map(|net| Counters::net(worker, net).flows.get()).sum()
        };
        step.flows = active.counters.iter().map(flows).sum();
        let mut history = self.router.journal().history();
        history.follow(table);
        history.note(at, &step, presences.into_iter());
        drop(history);
        self.active = active;
    }
}
