//! The control plane, as the rest of the program sees it. A [`Router`] is started with a
//! configuration, asked for figures, given another configuration and stopped.
//!
//! Every socket is bound before the first worker runs, so a router starts as a whole or not at all.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use tokio::time::timeout;

use crate::config::{Config, KernelFlows};
use crate::nat::{Chance, Core, Counters, FlowRecord, Rules, Table};
use crate::thread;

use crate::datapath::active_config::ActiveConfig;
use crate::datapath::activity::Activity;
use crate::datapath::commands::Command;
use crate::datapath::last_reload::LastReload;
use crate::datapath::offload::{Carrier, Changes, Offload, OffloadError, OffloadState};
use crate::datapath::socket::descriptors::{self, Share};
use crate::datapath::socket::filtered::NetDrops;
use crate::datapath::socket::handle::Handle;
use crate::datapath::socket::port_pool::Ports;
use crate::datapath::socket::setup::{self, Missing, Opened, StartError};
use crate::datapath::socket::worker::{Shared, Worker};
use crate::datapath::throttlings::Throttlings;
use crate::listen;
use crate::logging::audit::Audit;
use crate::observe::Journal;

/// How long the workers may take to send their flows.
const ANSWER_TIME: Duration = Duration::from_secs(1);

/// A running router.
#[derive(Debug)]
pub struct Router {
    pub(in crate::datapath) active: RwLock<Arc<ActiveConfig>>,
    pub(in crate::datapath) last_reload: Mutex<Arc<LastReload>>,
    /// Held while the workers go over to another configuration, or are told to end.
    pub(in crate::datapath) changing: tokio::sync::Mutex<()>,
    audit: Arc<Audit>,
    throttlings: Arc<Throttlings>,
    activity: Arc<Activity>,
    journal: Journal,
    /// The flows in the kernel, or why it carries none.
    pub(in crate::datapath) offload: Result<Arc<Offload>, OffloadError>,
    /// The ports of the upstream sockets.
    pub(in crate::datapath) ports: Arc<Ports>,
    pub(in crate::datapath) workers: Vec<Handle>,
    /// For each worker, a channel whose other end the worker drops when it ends.
    ends: Mutex<Vec<oneshot::Receiver<()>>>,
    ready: AtomicBool,
    started: Instant,
}

/// A router that has all of its sockets and no thread yet.
pub struct Bound {
    router: Router,
    workers: Vec<Worker>,
    changes: Option<Changes>,
}

impl Bound {
    /// Whether the kernel carries flows, for which the process has to change maps and ask for interfaces.
    pub fn has_offload(&self) -> bool {
        self.router.offload.is_ok()
    }

    /// Starts the workers. They inherit the permissions of the calling thread.
    pub fn start(self) -> Result<Router, StartError> {
        let Self { mut router, workers, changes } = self;
        if let (Ok(offload), Some(changes)) = (&router.offload, changes) {
            offload.follow(changes, &router.ports)?;
        }
        let mut ends = Vec::new();
        for (index, worker) in workers.into_iter().enumerate() {
            let (ending, end) = oneshot::channel::<()>();
            thread::start(format!("worker-{index}"), move || {
                let _ending = ending;
                worker.run();
            })?;
            ends.push(end);
        }
        router.ends = Mutex::new(ends);
        router.ready = AtomicBool::new(true);
        Ok(router)
    }
}

impl Router {
    /// Binds every socket and starts the workers.
    pub fn start(config: Config) -> Result<Self, StartError> {
        Self::bind(config)?.start()
    }

    /// Binds every socket, and starts no thread yet.
    pub fn bind(config: Config) -> Result<Bound, StartError> {
        let started = Instant::now();
        listen::look_up();
        let addresses = addresses(&config);
        let plan = descriptors::plan(addresses, config.runtime.workers)?;
        let drops: Vec<Arc<NetDrops>> =
            config.table.nets().iter().map(|_| Arc::default()).collect();
        let share = Share { public_sockets: addresses, upstreams: plan.upstreams, lack: None };
        let Opened { listeners, missing } = setup::open(&config, &drops, &[], plan.workers, &share);
        if let Some(Missing { why, .. }) = missing.into_iter().next() {
            return Err(why);
        }
        setup::tell_short_buffers(&config, &listeners);

        let rules = Rules::new(Arc::clone(&config.table), config.limits);
        let audit = Arc::new(Audit::new(config.log.audit_lines));
        let ports = Arc::new(Ports::new(&config));
        let upstream_drops: Arc<NetDrops> = Arc::default();
        let throttlings: Arc<Throttlings> = Arc::default();
        let activity: Arc<Activity> = Arc::default();
        let shared = Shared {
            audit: Arc::clone(&audit),
            throttlings: Arc::clone(&throttlings),
            activity: Arc::clone(&activity),
            ports: Arc::clone(&ports),
            drops: Arc::clone(&upstream_drops),
        };
        let offload = Offload::start(&config, &ports, rules.most_flows(), started);
        let (offload, changes) = match offload {
            Ok((offload, changes)) => (Ok(Arc::new(offload)), Some(changes)),
            Err(error) => (Err(error), None),
        };
        if config.datapath.kernel == KernelFlows::Required
            && let Err(error) = offload
        {
            return Err(error.into());
        }
        let lender = offload.as_ref().ok().map(|offload| Arc::clone(offload) as _);
        let in_kernel = lender.map(|lender| Arc::new(Counters::of_offload(&config.table, lender)));
        let (mut handles, mut counters, mut workers) = (Vec::new(), Vec::new(), Vec::new());
        for listeners in &listeners {
            let counter = Arc::new(Counters::new(&config.table));
            let carrier = offload.as_ref().ok().zip(in_kernel.as_ref());
            let carrier = carrier
                .map(|(offload, counters)| Carrier::new(Arc::clone(offload), Arc::clone(counters)));
            let core =
                Core::new(rules.clone(), Arc::clone(&counter), started, Chance::of_the_system());
            let (handle, worker) = Handle::build(
                &config,
                core,
                listeners.clone(),
                plan.upstreams,
                started,
                &shared,
                carrier,
            )?;
            handles.push(handle);
            counters.push(counter);
            workers.push(worker);
        }
        counters.extend(in_kernel);
        let active = ActiveConfig::new(
            config,
            rules,
            counters,
            handles.len(),
            drops,
            upstream_drops,
            listeners,
        );
        let router = Self::new(active, audit, ports, handles, started);
        let router = Self { throttlings, activity, offload, ..router };
        Ok(Bound { router, workers, changes })
    }

    fn new(
        active: ActiveConfig,
        audit: Arc<Audit>,
        ports: Arc<Ports>,
        workers: Vec<Handle>,
        started: Instant,
    ) -> Self {
        let journal = Journal::new(&active.config.table);
        Self {
            active: RwLock::new(Arc::new(active)),
            last_reload: Mutex::default(),
            changing: tokio::sync::Mutex::default(),
            audit,
            throttlings: Arc::default(),
            activity: Arc::default(),
            journal,
            offload: Err(OffloadError::Off),
            ports,
            workers,
            ends: Mutex::default(),
            ready: AtomicBool::new(false),
            started,
        }
    }

    /// A router without sockets and threads, to test the code that asks a router for figures.
    #[cfg(test)]
    pub(crate) fn idle(config: Config, workers: usize) -> Arc<Self> {
        let counters: Vec<_> =
            (0..workers).map(|_| Arc::new(Counters::new(&config.table))).collect();
        let drops = config.table.nets().iter().map(|_| Arc::default()).collect();
        let audit = Arc::new(Audit::new(config.log.audit_lines));
        let ports = Arc::new(Ports::new(&config));
        let rules = Rules::new(Arc::clone(&config.table), config.limits);
        let (drops, upstream_drops) = (drops, Arc::default());
        let active =
            ActiveConfig::new(config, rules, counters, workers, drops, upstream_drops, Vec::new());
        Arc::new(Self::new(active, audit, ports, Vec::new(), Instant::now()))
    }

    /// Says from now on that it is not ready, and goes on as before. Returns for how long that is wanted.
    pub fn announce_end(&self) -> Duration {
        self.ready.store(false, Ordering::Release);
        self.active_config().config.runtime.pre_drain
    }

    /// Takes no more requests, waits for the answers that are due, and ends the workers. It waits
    /// at most for the configured drain time, and returns when the workers have ended.
    pub async fn shut_down(&self) {
        self.ready.store(false, Ordering::Release);
        {
            let _unchanged = self.changing.lock().await;
            let end = Instant::now() + self.active_config().config.runtime.drain;
            self.workers.iter().for_each(|worker| worker.ask(Command::Drain(end)));
        }
        let ends = std::mem::take(&mut *lock(&self.ends));
        for end in ends {
            // A worker that panicked has reported that itself.
            let _ = end.await;
        }
    }

    /// The configuration in force, with its counters.
    pub fn active_config(&self) -> Arc<ActiveConfig> {
        Arc::clone(&self.active.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// How the last reload went.
    pub fn last_reload(&self) -> Arc<LastReload> {
        Arc::clone(&lock(&self.last_reload))
    }

    /// The audit log, which limits its own lines.
    pub(crate) fn audit(&self) -> &Audit {
        &self.audit
    }

    /// The senders that were throttled lately.
    pub(crate) fn throttlings(&self) -> &Throttlings {
        &self.throttlings
    }

    /// Whether the workers sleep.
    pub(crate) fn activity(&self) -> &Activity {
        &self.activity
    }

    /// The last events, and the figures of the last day.
    pub fn journal(&self) -> &Journal {
        &self.journal
    }

    /// Whether the kernel carries flows.
    pub fn offload(&self) -> OffloadState {
        match &self.offload {
            Ok(offload) => offload.state(),
            Err(why) => OffloadState { why_not: Some(why.to_string()), ..OffloadState::default() },
        }
    }

    /// Whether every socket is bound and no shutdown has begun.
    pub fn is_ready(&self) -> bool {
        self.ready.load(Ordering::Acquire)
    }

    /// When the router started. [`NodeCounters::last_response`](crate::nat::NodeCounters) counts
    /// from this time.
    pub fn started(&self) -> Instant {
        self.started
    }

    /// Returns up to `limit` open flows, with the table that they belong to. It asks the workers,
    /// and returns `None` when one of them does not answer within a second or has ended.
    pub async fn flows(&self, limit: usize) -> Option<Vec<(Arc<Table>, Vec<FlowRecord>)>> {
        let mut flows = self.ask(ANSWER_TIME, |reply| Command::Flows(limit, reply)).await?;
        let mut left = limit;
        for (_, flows) in &mut flows {
            flows.truncate(left);
            left -= flows.len();
        }
        Some(flows)
    }

    /// Whether every worker answers within this time.
    pub async fn is_alive(&self, within: Duration) -> bool {
        self.ask(within, Command::Ping).await.is_some()
    }

    /// Asks the workers. Returns their answers, if each worker answers within this time.
    async fn ask<T>(
        &self,
        time: Duration,
        command: impl Fn(tokio::sync::mpsc::Sender<T>) -> Command,
    ) -> Option<Vec<T>> {
        // There is room for all answers, so no worker waits until its answer is taken.
        let (reply, mut answers) = tokio::sync::mpsc::channel(self.workers.len().max(1));
        self.workers.iter().for_each(|worker| worker.ask(command(reply.clone())));
        drop(reply);
        let mut all = Vec::with_capacity(self.workers.len());
        let gather = async {
            while let Some(answer) = answers.recv().await {
                all.push(answer);
            }
        };
        let _ = timeout(time, gather).await;
        (all.len() == self.workers.len()).then_some(all)
    }
}

/// Number of sockets that each worker needs for its public ports.
pub(in crate::datapath) fn addresses(config: &Config) -> usize {
    config.table.mappings().iter().map(|mapping| config.addresses_of(mapping).len()).sum()
}

/// File descriptors that a relay with this configuration needs.
#[cfg(feature = "cli")]
pub(crate) fn descriptors_needed(config: &Config) -> usize {
    descriptors::needed(addresses(config), config.runtime.workers)
}

/// Locks even after a panic: what these locks guard is changed in one step, so it is always whole.
pub(in crate::datapath) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config;
    use crate::datapath::Reloaded;

    #[test]
    fn is_alive_as_long_as_every_worker_answers() {
        let text = "[public]\nlisten = [\"127.0.0.1\"]\n[runtime]\nworkers = 2\n\
                    [[server]]\nname = \"press\"\npublic_port = 20999\nnode = 7\n\
                    address = \"127.9.9.7:34379\"\nallow = [\"127.0.0.1\"]\n\
                    allow_without_password = true";
        let read = || config::parse(text, Path::new("pnet-nat.toml"));
        let router = Router::start(read().unwrap().0).unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        let is_alive = || runtime.block_on(router.is_alive(Duration::from_secs(20)));
        assert!(is_alive());
        let changes = router.reload(read().unwrap().0).unwrap();
        assert_eq!(changes, Reloaded::default());
        runtime.block_on(router.shut_down());
        assert!(!is_alive(), "they have ended");
        let refused = router.reload(read().unwrap().0).unwrap_err();
        assert_eq!(refused.to_string(), "the relay is stopping");
    }
}
