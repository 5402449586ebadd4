//! Another configuration for a router at work.
//!
//! All that can fail comes first: what needs a restart, the file descriptors, the new sockets. Until
//! then nothing has changed for anybody, and a fault leaves it at that. Then each worker goes over,
//! between two datagrams, and the rest of the program sees the new one as a whole.

use std::collections::HashSet;
use std::net::IpAddr;
use std::num::NonZeroUsize;
use std::sync::mpsc;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use crate::config::{Changes, Config, Faults};
use crate::relay::{Counters, Net, Succession, Transition};

use super::bind::{self, StartError};
use super::descriptors;
use super::filtered::NetDrops;
use super::in_force::InForce;
use super::public::Listeners;
use super::router::{Router, addresses, lock};
use super::worker::{self, Command, Next};

/// Why another configuration did not come into force.
#[derive(Debug, thiserror::Error)]
pub enum ReloadError {
    /// It is not sound.
    #[error(transparent)]
    Faults(#[from] Faults),
    /// What it changes is settled at the start.
    #[error("{} cannot change while the relay runs; restart it", .0.join(", "))]
    NeedsRestart(Vec<&'static str>),
    /// Its sockets cannot be had.
    #[error(transparent)]
    Sockets(#[from] StartError),
    /// Its files are not to be had.
    #[error(
        "reading the configuration takes longer than {} s; is a disk or a network share stuck? The \
         configuration in force stays", .0.as_secs()
    )]
    TooSlow(Duration),
    /// Nor are those of an earlier reload, which have to come first.
    #[error(
        "an earlier reload still reads its files; is a disk or a network share stuck? The \
         configuration in force stays"
    )]
    StillReading,
    /// The workers are ending.
    #[error("the relay is stopping")]
    Stopping,
}

/// How the last reload went; at first, the start.
#[derive(Clone, Copy, Debug)]
pub struct LastReload {
    /// Whether its configuration came into force.
    pub successful: bool,
    /// When the configuration in force came into force.
    pub success_at: Instant,
}

impl LastReload {
    pub(super) fn succeeded() -> Self {
        Self { successful: true, success_at: Instant::now() }
    }
}

impl Router {
    /// Brings a configuration into force that was just read, or says why not; then the one in force
    /// stays, whole. Blocks until every worker has gone over.
    pub fn reload(&self, read: Result<Config, ReloadError>) -> Result<Changes, ReloadError> {
        let outcome = read.and_then(|config| self.replace(config));
        let mut last = lock(&self.last_reload);
        match outcome {
            Ok(_) => *last = LastReload::succeeded(),
            Err(_) => last.successful = false,
        }
        outcome
    }

    fn replace(&self, config: Config) -> Result<Changes, ReloadError> {
        let _changing = self.changing.blocking_lock();
        if !self.is_ready() {
            return Err(ReloadError::Stopping);
        }
        let old = self.in_force();
        refuse_what_needs_a_restart(&old.config, &config)?;
        let mut changes = Changes::between(&old.config, &config);

        let workers = NonZeroUsize::new(self.workers.len());
        let plan = descriptors::plan(addresses(&config), workers).map_err(StartError::from)?;
        let known = old.drops_by_name();
        let drops_of = |net: &Net| known.get(net.name.as_str()).copied().cloned();
        let drops = config.table.nets().iter().map(|net| drops_of(net).unwrap_or_default());
        let drops: Vec<Arc<NetDrops>> = drops.collect();
        let upstream_drops = Arc::clone(&old.upstream_drops);
        let before = old.listeners().clone();
        // No new upstream socket gets in the way of a new public one.
        self.ports.keep_out_of(&[&old.config, &config]);
        let opened = bind::open(&config, &drops, &before, self.workers.len()).and_then(|opened| {
            for ((worker, next), before) in self.workers.iter().zip(&opened).zip(&before) {
                worker::watch(&worker.epoll, next, before)?;
            }
            Ok(opened)
        });
        let in_force = if opened.is_ok() { &config } else { &old.config };
        self.ports.keep_out_of(&[in_force]);
        let listeners = opened?;

        // From here on nothing fails.
        let (was, is) = (&old.config.table, &config.table);
        let rules = old.rules.followed_by(Arc::clone(is), config.limits);
        let gone = listeners.iter().zip(&before).flat_map(|(is, was)| is.gone(was)).collect();
        let transition = Arc::new(Transition::new(&old.rules, &rules, gone));
        let counters: Vec<_> =
            old.counters.iter().map(|worker| Arc::new(worker.followed_by(was, is))).collect();
        let next = |listeners: &Listeners, counters: &Arc<Counters>| Next {
            succession: Succession {
                rules: rules.clone(),
                counters: Arc::clone(counters),
                transition: Arc::clone(&transition),
            },
            listeners: listeners.clone(),
            upstream_limit: plan.upstreams,
            runtime: config.runtime.clone(),
        };
        let mut answers = Vec::new();
        for ((worker, listeners), counters) in self.workers.iter().zip(&listeners).zip(&counters) {
            let (reply, answer) = mpsc::sync_channel(1);
            worker.ask(Command::Reload(Box::new(next(listeners, counters)), reply));
            answers.push(answer);
        }
        for answer in answers {
            // None comes from a worker that has panicked: it takes the process along.
            changes.flows_closed += answer.recv().map_err(|_| ReloadError::Stopping)?;
        }
        if config.runtime.receive_buffer != old.config.runtime.receive_buffer {
            resize_buffers(&config, &listeners);
        }
        let next =
            Arc::new(InForce::new(config, rules, counters, drops, upstream_drops, listeners));
        *self.in_force.write().unwrap_or_else(PoisonError::into_inner) = next;
        old.retire();
        Ok(changes)
    }
}

fn refuse_what_needs_a_restart(old: &Config, new: &Config) -> Result<(), ReloadError> {
    let (was, is) = (old.admin.as_ref(), new.admin.as_ref());
    let admin_moves = was.zip(is).is_some_and(|(was, is)| was.listen != is.listen);
    let changed = [
        ("[runtime] user", old.runtime.user != new.runtime.user),
        ("[runtime] workers", old.runtime.workers != new.runtime.workers),
        ("[admin] enabled", was.is_some() != is.is_some()),
        ("[admin] listen", admin_moves),
        ("[public] listen, between one address and all of them,", all_or_one(old, new)),
    ];
    let changed: Vec<_> =
        changed.into_iter().filter_map(|(key, changed)| changed.then_some(key)).collect();
    if changed.is_empty() { Ok(()) } else { Err(ReloadError::NeedsRestart(changed)) }
}

/// Whether a new address includes an old one or the other way round: the old sockets, which serve
/// until the new ones are there, would keep them off their ports.
fn all_or_one(old: &Config, new: &Config) -> bool {
    let (old, new): (HashSet<IpAddr>, HashSet<IpAddr>) =
        (old.listen.iter().copied().collect(), new.listen.iter().copied().collect());
    let in_the_way = |a: &IpAddr, b: &IpAddr| {
        a != b && a.is_ipv4() == b.is_ipv4() && (a.is_unspecified() || b.is_unspecified())
    };
    new.difference(&old).any(|new| old.iter().any(|old| in_the_way(old, new)))
}

fn resize_buffers(config: &Config, listeners: &[Listeners]) {
    for (_, listener) in listeners.iter().flat_map(Listeners::iter) {
        // What the kernel did not grant is told below.
        let _ = listener.socket.socket().set_recv_buffer_size(config.runtime.receive_buffer);
    }
    bind::tell_short_buffers(config, listeners);
}
