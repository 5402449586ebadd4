//! Gives another configuration to a running router.
//!
//! A sound configuration comes into force even when single sockets cannot be opened, so that what
//! it withdraws is certainly withdrawn. Each worker goes over between two datagrams. The rest of
//! the program sees the new configuration as a whole. The sockets that cannot be opened are named,
//! and are tried again later.

use std::collections::BTreeMap;
use std::sync::mpsc;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::config::{self, Changes, Config, NotInForce};
use crate::nat::{Counters, ListenerId, Net, Succession, Transition};

use crate::datapath::active_config::ActiveConfig;
use crate::datapath::commands::{Command, WorkerReload};
use crate::datapath::router::{Router, addresses, lock};
use crate::datapath::socket::descriptors::{self, Share};
use crate::datapath::socket::filtered::NetDrops;
use crate::datapath::socket::handle::Handle;
use crate::datapath::socket::public::Listeners;
use crate::datapath::socket::setup::{self, Missing, Opened};

/// How long a reload waits for the relay's own upstream sockets that hold a wanted public port and
/// still wait for last answers. After that time the public sockets count as missing.
const LAST_ANSWERS: Duration = Duration::from_millis(500);

/// The error while the workers are ending.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the relay is stopping")]
pub struct Stopping;

/// The outcome of a reload.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Reloaded {
    /// How the new configuration differs from the one before.
    #[serde(flatten)]
    pub changes: Changes,
    /// Flows that were closed because the new configuration has no place for them.
    pub flows_closed: usize,
    /// The parts of the new configuration that are not in force.
    pub not_in_force: Vec<NotInForce>,
}

impl Router {
    /// Notes that a reload begins. [`reload`](Self::reload) or
    /// [`refuse_reload`](Self::refuse_reload) ends it.
    pub fn begin_reload(&self) {
        Arc::make_mut(&mut lock(&self.last_reload)).begun += 1;
    }

    /// Notes that the reload changed nothing. `error` tells why; `faults` are the faults of its
    /// configuration, one per line.
    pub fn refuse_reload(&self, error: String, faults: Vec<String>) {
        Arc::make_mut(&mut lock(&self.last_reload)).failed(error, faults);
    }

    /// Brings a configuration into force, as far as that is possible. Blocks until every worker has
    /// gone over.
    pub fn reload(&self, config: Config) -> Result<Reloaded, Stopping> {
        let outcome = self.replace(config);
        let mut last = lock(&self.last_reload);
        let last = Arc::make_mut(&mut last);
        match &outcome {
            Ok(reloaded) => last.succeeded(reloaded),
            Err(error) => last.failed(error.to_string(), Vec::new()),
        }
        outcome
    }

    /// Whether public sockets are missing. [`retry`](Self::retry) tries to open them.
    pub fn misses_sockets(&self) -> bool {
        !lock(&self.last_reload).missing.is_empty()
    }

    /// Tries again to open the public sockets that are missing. Blocks until every worker has those
    /// that could be opened.
    pub fn retry(&self) {
        let _changing = self.changing.blocking_lock();
        if self.is_ready()
            && let Ok(missing) = self.open_missing()
        {
            Arc::make_mut(&mut lock(&self.last_reload)).missing =
                setup::told(&missing, &self.ports);
        }
    }

    fn replace(&self, mut config: Config) -> Result<Reloaded, Stopping> {
        let _changing = self.changing.blocking_lock();
        if !self.is_ready() {
            return Err(Stopping);
        }
        let old = self.active_config();
        let settled = config::keep_settled(&old.config, &mut config);
        let changes = Changes::between(&old.config, &config);

        let known = old.drops_by_name();
        let drops_of = |net: &Net| known.get(net.name.as_str()).copied().cloned();
        let drops = config.table.nets().iter().map(|net| drops_of(net).unwrap_or_default());
        let drops: Vec<_> = drops.collect();
        // So no new upstream socket gets in the way of a new public one.
        self.ports.keep_out_of(&[&old.config, &config]);
        let share = self.share(&config);
        let Opened { listeners, mut missing } = self.open(&config, &drops, &old, &share);
        let flows_closed = self.go_over(&old, config, drops, listeners, share.upstreams)?;
        drop(old);
        self.ports.keep_out_of(&[&self.active_config().config]);
        if !missing.is_empty() {
            // The ports of the old configuration are free now. Those of upstream sockets are free
            // soon.
            self.close_left();
            missing = self.open_missing()?;
        }

        let mut last = lock(&self.last_reload);
        let last = Arc::make_mut(&mut last);
        (last.settled, last.missing) = (settled, setup::told(&missing, &self.ports));
        let not_in_force = last.not_in_force().cloned().collect();
        Ok(Reloaded { changes, flows_closed, not_in_force })
    }

    /// Has the workers close the upstream sockets whose ports are wanted for public ones, each when
    /// its last answers are in. Waits for that, but not for long.
    fn close_left(&self) {
        let end = Instant::now() + LAST_ANSWERS;
        let ask = |worker: &Handle| {
            let (reply, answer) = mpsc::sync_channel(1);
            worker.ask(Command::CloseLeft(reply));
            answer
        };
        let answers: Vec<_> = self.workers.iter().map(ask).collect();
        for answer in answers {
            // There is no answer in time, or the worker is ending. The missing sockets are tried
            // again later.
            let _ = answer.recv_timeout(end.saturating_duration_since(Instant::now()));
        }
    }

    /// Opens the missing sockets of the configuration in force, and returns those that are still
    /// missing.
    fn open_missing(&self) -> Result<Vec<Missing>, Stopping> {
        let now = self.active_config();
        let drops = now.drops().to_vec();
        let share = self.share(&now.config);
        let Opened { listeners, missing } = self.open(&now.config, &drops, &now, &share);
        let mut new = BTreeMap::<_, Vec<_>>::new();
        for id in new_ones(&listeners, &now.listeners()) {
            let Some(listener) = listeners.first().and_then(|all| all.get(id)) else { continue };
            new.entry(listener.address.ip()).or_default().push(listener.address.port());
        }
        if !new.is_empty() {
            self.go_over(&now, now.config.clone(), drops, listeners, share.upstreams)?;
        }
        for (ip, ports) in new {
            tracing::info!(listen = setup::ports_of(ip, ports), "listening");
        }
        Ok(missing)
    }

    /// How the file descriptors are divided under a configuration.
    fn share(&self, config: &Config) -> Share {
        descriptors::share(addresses(config), self.workers.len())
    }

    /// Opens the public sockets of a configuration, and has the workers' epoll watch them.
    fn open(
        &self,
        config: &Config,
        drops: &[Arc<NetDrops>],
        old: &ActiveConfig,
        share: &Share,
    ) -> Opened {
        let before = old.listeners().clone();
        let mut opened = setup::open(config, drops, &before, self.workers.len(), share);
        for id in new_ones(&opened.listeners, &before) {
            let each = self.workers.iter().zip(&opened.listeners);
            let mut watched = each.filter_map(|(worker, all)| Some((worker, all.get(id)?)));
            let watched = watched.try_for_each(|(worker, new)| worker.watch(id, new));
            let Err(why) = watched else { continue };
            let address = opened.listeners.first().and_then(|all| Some(all.get(id)?.address));
            opened.missing.extend(address.map(|address| Missing { address, why }));
            opened.listeners.iter_mut().for_each(|all| all.remove(id));
        }
        opened
    }

    /// Has the workers go over to another configuration with these sockets, and returns how many
    /// flows were closed.
    fn go_over(
        &self,
        old: &ActiveConfig,
        config: Config,
        drops: Vec<Arc<NetDrops>>,
        listeners: Vec<Listeners>,
        upstream_limit: usize,
    ) -> Result<usize, Stopping> {
        let (was, is) = (&old.config.table, &config.table);
        let rules = old.rules.followed_by(Arc::clone(is), config.limits);
        let before = old.listeners().clone();
        let gone = listeners.iter().zip(&before).flat_map(|(is, was)| is.gone(was)).collect();
        drop(before);
        let transition = Arc::new(Transition::new(&old.rules, &rules, gone));
        let counters: Vec<_> =
            old.counters.iter().map(|worker| Arc::new(worker.followed_by(was, is))).collect();
        let next = |listeners: &Listeners, of_worker: &Arc<Counters>| WorkerReload {
            succession: Succession {
                rules: rules.clone(),
                counters: Arc::clone(of_worker),
                transition: Arc::clone(&transition),
            },
            listeners: listeners.clone(),
            upstream_limit,
            settings: config.datapath.clone(),
            offload: counters.get(old.workers).cloned(),
        };
        let mut answers = Vec::new();
        for ((worker, listeners), counters) in self.workers.iter().zip(&listeners).zip(&counters) {
            let (reply, answer) = mpsc::sync_channel(1);
            worker.ask(Command::Reload(Box::new(next(listeners, counters)), reply));
            answers.push(answer);
        }
        let mut flows_closed = 0;
        for answer in answers {
            // An answer is missing only when a worker has panicked, and a panic ends the process.
            flows_closed += answer.recv().map_err(|_| Stopping)?;
        }
        if config.datapath.receive_buffer != old.config.datapath.receive_buffer {
            resize_buffers(&config, &listeners);
        }
        if let Ok(offload) = &self.offload {
            offload.reload(&config, &self.ports);
            offload.wait_for_programs(); // so that none of them passes what is withdrawn
        }
        let (upstream_drops, workers) = (Arc::clone(&old.upstream_drops), old.workers);
        let next = Arc::new(ActiveConfig::new(
            config,
            rules,
            counters,
            workers,
            drops,
            upstream_drops,
            listeners,
        ));
        *self.active.write().unwrap_or_else(PoisonError::into_inner) = next;
        old.retire();
        Ok(flows_closed)
    }
}

/// The places of the sockets that are not in `before`.
fn new_ones(listeners: &[Listeners], before: &[Listeners]) -> Vec<ListenerId> {
    let (Some(now), Some(before)) = (listeners.first(), before.first()) else { return Vec::new() };
    now.iter().map(|(id, _)| id).filter(|&id| !now.keeps(id, before)).collect()
}

fn resize_buffers(config: &Config, listeners: &[Listeners]) {
    for (_, listener) in listeners.iter().flat_map(Listeners::iter) {
        // Where the kernel grants less, the line below tells so.
        let _ = listener.socket.socket().set_recv_buffer_size(config.datapath.receive_buffer);
    }
    setup::tell_short_buffers(config, listeners);
}
