//! The configuration file, read again for a router at work: brought into force or refused, and told
//! of either way. One reload at a time.
//!
//! Files are read by a thread that does nothing else, for they may be on a disk that is stuck. Then
//! the reload is given up after a while and never comes into force: later ones are refused until the
//! thread is back.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use tokio::sync::{Mutex, oneshot};
use tokio::time::timeout;
use tracing::warn;

use crate::config::{self, Changes, Config, Faults, Warning};
use crate::log::list;
use crate::net::{ReloadError, Router, chain};
use crate::service;
use crate::thread::{self, ThreadError};

/// How long reading the files of a configuration may take.
const READING_TIME: Duration = Duration::from_secs(30);

/// How often sockets that could not be had are tried again.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// A router and the file that its configuration is in.
#[derive(Clone, Debug)]
pub struct Reloader {
    router: Arc<Router>,
    /// Held by the one reload at a time.
    thread: Arc<Mutex<mpsc::Sender<Order>>>,
    /// The thread reads for a reload that was given up.
    is_stuck: Arc<AtomicBool>,
}

/// What the thread does.
enum Order {
    Read(oneshot::Sender<Result<(Config, Vec<Warning>), Faults>>),
    /// Bring it into force.
    Apply(Box<Config>, oneshot::Sender<Result<Changes, ReloadError>>),
}

impl Reloader {
    /// Reads the file at `path` for `router`, whenever it is told to.
    pub fn start(path: PathBuf, router: Arc<Router>) -> Result<Self, ThreadError> {
        let (thread, orders) = mpsc::channel();
        let is_stuck = Arc::default();
        let (of, stuck) = (Arc::clone(&router), Arc::clone(&is_stuck));
        thread::start("reload", move || obey(&orders, &path, &of, &stuck))?;
        Ok(Self { router, thread: Arc::new(Mutex::new(thread)), is_stuck })
    }

    /// Reads the file and the password files that it names, and brings them into force; or tells
    /// every fault, and the configuration in force stays. Goes on to its end even when nobody waits.
    pub async fn reload(&self) -> Result<Changes, String> {
        let reloader = self.clone();
        let reload = tokio::spawn(async move {
            let thread = reloader.thread.lock().await;
            reloader.router.begin_reload();
            service::reloading();
            let outcome = match reloader.read(&thread).await {
                Ok(config) => apply(&thread, config).await,
                Err(error) => reloader.router.reload(Err(error)),
            };
            log(&outcome);
            service::ready(&reloader.router);
            outcome.map_err(|error| chain(&error))
        });
        reload.await.unwrap_or_else(|error| Err(error.to_string()))
    }

    async fn read(&self, thread: &mpsc::Sender<Order>) -> Result<Config, ReloadError> {
        if self.is_stuck.load(SeqCst) {
            return Err(ReloadError::StillReading);
        }
        let (reply, mut read) = oneshot::channel();
        // A thread that is gone drops the reply.
        let _ = thread.send(Order::Read(reply));
        let read = match timeout(READING_TIME, &mut read).await {
            Ok(read) => read.map_err(|_| ReloadError::Stopping)?,
            Err(_) => {
                self.is_stuck.store(true, SeqCst);
                read.close();
                // From here on the thread learns that nobody waits; it may have been just in time.
                let in_time = read.try_recv().map_err(|_| ReloadError::TooSlow(READING_TIME))?;
                self.is_stuck.store(false, SeqCst);
                in_time
            }
        };
        let (config, warnings) = read?;
        warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
        Ok(config)
    }
}

async fn apply(thread: &mpsc::Sender<Order>, config: Config) -> Result<Changes, ReloadError> {
    let (reply, applied) = oneshot::channel();
    let _ = thread.send(Order::Apply(Box::new(config), reply));
    applied.await.unwrap_or(Err(ReloadError::Stopping))
}

/// What the thread does, until the process ends.
fn obey(orders: &mpsc::Receiver<Order>, path: &Path, router: &Router, is_stuck: &AtomicBool) {
    loop {
        let order = if router.misses_sockets() {
            orders.recv_timeout(RETRY_INTERVAL)
        } else {
            orders.recv().map_err(Into::into)
        };
        let order = match order {
            Ok(order) => order,
            Err(RecvTimeoutError::Timeout) => {
                router.retry();
                if !router.misses_sockets() {
                    service::ready(router);
                }
                continue;
            }
            Err(RecvTimeoutError::Disconnected) => return,
        };
        match order {
            Order::Read(reply) => {
                let read = config::load_again(path, &router.in_force().config.table);
                if reply.send(read).is_err() {
                    is_stuck.store(false, SeqCst);
                    warn!(
                        "a configuration is read at last, and dropped, for its reload was given up; reload again"
                    );
                }
            }
            // What came of it is in force, whether or not somebody waits.
            Order::Apply(config, reply) => _ = reply.send(router.reload(Ok(*config))),
        }
    }
}

fn log(outcome: &Result<Changes, ReloadError>) {
    match outcome {
        Ok(changes) => log_changes(changes),
        Err(ReloadError::Faults(faults)) => {
            log_faults(faults);
            tracing::error!(error = "the configuration is not sound", "reload failed");
        }
        Err(error) => tracing::error!(error = chain(error), "reload failed"),
    }
}

/// Logs one event for each fault.
pub(crate) fn log_faults(faults: &Faults) {
    for fault in &faults.0 {
        tracing::error!(
            file = %fault.file.display(),
            line = fault.line,
            key = fault.key,
            problem = fault.problem,
            remedy = fault.remedy,
            "configuration fault"
        );
    }
}

fn log_changes(changes: &Changes) {
    let Changes {
        settings_changed,
        nets_added,
        nets_removed,
        nets_changed,
        mappings_added,
        mappings_removed,
        mappings_changed,
        credentials_added,
        credentials_withdrawn,
        credentials_changed,
        flows_closed,
        not_in_force,
    } = changes;
    for item in not_in_force {
        tracing::warn!(what = item.what, why = item.why, "not in force");
    }
    let not_in_force: Vec<_> = not_in_force.iter().map(ToString::to_string).collect();
    tracing::info!(
        settings_changed = list(settings_changed),
        nets_added = list(nets_added),
        nets_removed = list(nets_removed),
        nets_changed = list(nets_changed),
        mappings_added = list(mappings_added),
        mappings_removed = list(mappings_removed),
        mappings_changed = list(mappings_changed),
        credentials_added = list(credentials_added),
        credentials_withdrawn = list(credentials_withdrawn),
        credentials_changed = list(credentials_changed),
        flows_closed,
        not_in_force = list(&not_in_force),
        "reload"
    );
}
