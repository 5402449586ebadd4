//! Watches the relay for the [`Journal`](super::Journal): which nodes fall silent and answer again,
//! which nets are flooded, who is throttled, and how much is relayed.
//!
//! It runs beside the data path and only reads what is there for others too: the counters, and
//! whether a socket has a filter. So it costs the workers nothing. They tell it of one thing only: who
//! is throttled, once for each throttling and not for each datagram.

mod counted;
#[cfg(test)]
mod tests;
mod watch;

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use nix::time::{ClockId, clock_gettime};
use tokio::time::{self, MissedTickBehavior};

use crate::datapath::{ActiveConfig, Router};
use crate::nat::Counters;
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
    /// When the last step ended, counted from the observer's start.
    step_ended: Duration,
    /// The observer's start.
    began: Duration,
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
            began: since_boot(),
        }
    }

    /// Looks again and again, for ever.
    pub async fn run(&mut self) -> ! {
        let mut ticks = time::interval(Self::TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        ticks.tick().await;
        loop {
            ticks.tick().await;
            self.look(since_boot().saturating_sub(self.began), self.router.started().elapsed())
                .await;
        }
    }

    /// Looks at everything. `at` counts from the observer's start, by the clock of the history, and
    /// `since_start` from the relay's start, by the clock of the counters.
    async fn look(&mut self, at: Duration, since_start: Duration) {
        let active = self.router.active_config();
        self.watch.look(&self.router, &active, since_start, SystemTime::now());
        // A tick may come a little early.
        if at + Self::TICK / 2 >= self.step_ended + History::STEP {
            self.end_step(active, at, since_start).await;
        }
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

/// The time since the machine's start, and that goes on while the machine sleeps.
fn since_boot() -> Duration {
    // Every kernel that the relay runs on has this clock.
    clock_gettime(ClockId::CLOCK_BOOTTIME).map(Duration::from).unwrap_or_default()
}
