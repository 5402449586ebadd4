//! Reads the configuration again while the relay runs. The new configuration comes into force
//! or is refused. Either way, the log reports the result. Only one reload runs at a time.
//!
//! A thread that does nothing else reads the files, because they may be on a disk that is stuck.
//! Then the reload is given up after a while, and its configuration never comes into force. Later
//! reloads are refused until the thread has finished reading.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use tokio::sync::{Mutex, oneshot};
use tokio::time::timeout;
use tracing::warn;

use crate::config::{Changes, Config, Faults, Source, Warning};
use crate::datapath::{Reloaded, Router, Stopping};
use crate::listen::chain;
use crate::logging::{list, log_faults};
use crate::observe::events::EventKind;
use crate::service;
use crate::thread::{self, ThreadError};

/// The longest time that reading the files of a configuration may take.
const READING_TIME: Duration = Duration::from_secs(30);

/// The message where the faults themselves are listed next to it.
const NOT_SOUND: &str = "the configuration is not sound";

/// How many faults are kept for the status of the last reload.
const MOST_FAULTS: usize = 100;

/// How often the relay tries again to open sockets that it could not open before.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Why another configuration did not come into force.
#[derive(Debug, thiserror::Error)]
enum ReloadError {
    /// The configuration has faults.
    #[error(transparent)]
    Faults(#[from] Faults),
    /// The files of the configuration cannot be read in time.
    #[error(
        "reading the configuration takes longer than {} s; is a disk or a network share stuck? The \
         configuration in force stays", .0.as_secs()
    )]
    TooSlow(Duration),
    /// The files of an earlier reload are still being read, and that read has to finish first.
    #[error(
        "an earlier reload still reads its files; is a disk or a network share stuck? The \
         configuration in force stays"
    )]
    StillReading,
    #[error(transparent)]
    Stopping(#[from] Stopping),
}

/// A router, and access to the thread that reads the configuration file for it.
#[derive(Clone, Debug)]
pub struct Reloader {
    router: Arc<Router>,
    /// Sends orders to the thread. A reload holds the lock, so that only one runs at a time.
    thread: Arc<Mutex<mpsc::Sender<Order>>>,
    /// The thread is reading for a reload that was given up.
    is_stuck: Arc<AtomicBool>,
    /// The longest time that reading may take.
    reading_time: Duration,
}

/// An order to the thread.
enum Order {
    Read(oneshot::Sender<Read>),
    /// Bring this configuration into force.
    Apply(Box<Config>, oneshot::Sender<Result<Reloaded, Stopping>>),
}

/// The result of reading the files: a configuration with warnings, or all faults.
type Read = Result<(Config, Vec<Warning>), Faults>;

impl Reloader {
    /// Starts the thread. Each reload for `router` then reads this configuration.
    pub fn start(source: Source, router: Arc<Router>) -> Result<Self, ThreadError> {
        let of = Arc::clone(&router);
        let read = move || source.load_again(&of.active_config().config.table);
        Self::reading(read, READING_TIME, router)
    }

    fn reading(
        read: impl FnMut() -> Read + Send + 'static,
        reading_time: Duration,
        router: Arc<Router>,
    ) -> Result<Self, ThreadError> {
        let (thread, orders) = mpsc::channel();
        let is_stuck = Arc::default();
        let (of, stuck) = (Arc::clone(&router), Arc::clone(&is_stuck));
        thread::start("reload", move || obey(&orders, read, &of, &stuck))?;
        Ok(Self { router, thread: Arc::new(Mutex::new(thread)), is_stuck, reading_time })
    }

    /// Reads the file and the password files that it names, and brings the new configuration into
    /// force. If there are faults, reports all of them and leaves the configuration in force as it
    /// is. The reload continues to its end even when nobody waits for it.
    pub async fn reload(&self) -> Result<Reloaded, String> {
        let reloader = self.clone();
        let reload = tokio::spawn(async move {
            let thread = reloader.thread.lock().await;
            reloader.router.begin_reload();
            service::reloading();
            let outcome = match reloader.read(&thread).await {
                Ok(config) => apply(&thread, config).await,
                Err(error) => {
                    refuse(&reloader.router, &error);
                    Err(error)
                }
            };
            log(&outcome);
            note(&reloader.router, &outcome);
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
        // If the thread has ended, it drops the reply.
        let _ = thread.send(Order::Read(reply));
        let read = match timeout(self.reading_time, &mut read).await {
            Ok(read) => read.map_err(|_| Stopping)?,
            Err(_) => {
                self.is_stuck.store(true, SeqCst);
                read.close();
                // From now on, the thread's reply fails, so the thread learns that nobody waits.
                // But its reply may have arrived just before.
                let in_time =
                    read.try_recv().map_err(|_| ReloadError::TooSlow(self.reading_time))?;
                self.is_stuck.store(false, SeqCst);
                in_time
            }
        };
        let (config, warnings) = read?;
        warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
        Ok(config)
    }
}

async fn apply(thread: &mpsc::Sender<Order>, config: Config) -> Result<Reloaded, ReloadError> {
    let (reply, applied) = oneshot::channel();
    let _ = thread.send(Order::Apply(Box::new(config), reply));
    Ok(applied.await.unwrap_or(Err(Stopping))?)
}

/// The loop of the thread. It ends with the process.
fn obey(
    orders: &mpsc::Receiver<Order>,
    mut read: impl FnMut() -> Read,
    router: &Router,
    is_stuck: &AtomicBool,
) {
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
                if reply.send(read()).is_err() {
                    is_stuck.store(false, SeqCst);
                    warn!(
                        "a configuration is read at last, and dropped, for its reload was given up; reload again"
                    );
                }
            }
            // The new configuration is in force, whether or not somebody waits for the result.
            Order::Apply(config, reply) => _ = reply.send(router.reload(*config)),
        }
    }
}

fn refuse(router: &Router, error: &ReloadError) {
    match error {
        ReloadError::Faults(Faults(faults)) => {
            let more = faults.len().saturating_sub(MOST_FAULTS);
            let more = (more > 0).then(|| format!("{more} more faults"));
            let faults = faults.iter().take(MOST_FAULTS).map(ToString::to_string);
            router.refuse_reload(NOT_SOUND.to_owned(), faults.chain(more).collect());
        }
        error => router.refuse_reload(chain(error), Vec::new()),
    }
}

/// Notes the outcome as an event.
fn note(router: &Router, outcome: &Result<Reloaded, ReloadError>) {
    let (kind, text) = match outcome {
        Ok(reloaded) if reloaded.not_in_force.is_empty() => {
            (EventKind::Reload, format!("reload: {}", summary(reloaded)))
        }
        Ok(reloaded) => {
            let not_in_force: Vec<_> =
                reloaded.not_in_force.iter().map(ToString::to_string).collect();
            let text = format!("reload: not in force: {}", not_in_force.join("; "));
            (EventKind::ReloadFailed, text)
        }
        Err(ReloadError::Faults(Faults(faults))) => {
            let first = faults.first().map(ToString::to_string).unwrap_or_default();
            let more = faults.len().saturating_sub(1);
            let more = if more > 0 { format!(" (and {more} more faults)") } else { String::new() };
            (EventKind::ReloadFailed, format!("reload failed: {NOT_SOUND}: {first}{more}"))
        }
        Err(error) => (EventKind::ReloadFailed, format!("reload failed: {}", chain(error))),
    };
    router.journal().note(kind, text);
}

/// What a reload changed, in one line.
fn summary(reloaded: &Reloaded) -> String {
    let Reloaded { changes, flows_closed, .. } = reloaded;
    let settings: Vec<_> = changes.settings_changed.iter().map(ToString::to_string).collect();
    let lists = [
        ("settings changed", &settings),
        ("nets added", &changes.nets_added),
        ("nets removed", &changes.nets_removed),
        ("nets changed", &changes.nets_changed),
        ("nodes added", &changes.mappings_added),
        ("nodes removed", &changes.mappings_removed),
        ("nodes changed", &changes.mappings_changed),
        ("passwords added", &changes.credentials_added),
        ("passwords withdrawn", &changes.credentials_withdrawn),
        ("passwords changed", &changes.credentials_changed),
    ];
    let lists = lists.into_iter().filter(|(_, list)| !list.is_empty());
    let mut parts: Vec<_> =
        lists.map(|(what, list)| format!("{what}: {}", list.join(", "))).collect();
    if *flows_closed > 0 {
        parts.push(format!("flows closed: {flows_closed}"));
    }
    if parts.is_empty() { "nothing changed".to_owned() } else { parts.join("; ") }
}

fn log(outcome: &Result<Reloaded, ReloadError>) {
    match outcome {
        Ok(reloaded) => log_reloaded(reloaded),
        Err(ReloadError::Faults(faults)) => {
            log_faults(faults);
            tracing::error!(error = NOT_SOUND, "reload failed");
        }
        Err(error) => tracing::error!(error = chain(error), "reload failed"),
    }
}

fn log_reloaded(reloaded: &Reloaded) {
    let Reloaded { changes, flows_closed, not_in_force } = reloaded;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::fixture::config;

    /// How long a step may take that should take no time.
    const PATIENCE: Duration = Duration::from_secs(20);

    /// When the files are on a disk that is stuck, the reload is given up and its configuration
    /// never comes into force. Later reloads are refused without touching the disk, until the disk
    /// works again.
    #[tokio::test]
    async fn a_disk_that_is_stuck() {
        let router = Router::idle(config(), 1);
        let (asked, was_asked) = mpsc::channel();
        let (disk, on_disk) = mpsc::channel::<Config>();
        let read = move || {
            asked.send(()).unwrap();
            match on_disk.recv() {
                Ok(config) => Ok((config, Vec::new())),
                Err(_) => Err(Faults(Vec::new())),
            }
        };
        let time = Duration::from_millis(20);
        let reloader = Reloader::reading(read, time, Arc::clone(&router)).unwrap();
        let before = router.active_config();
        let fails_with = async || timeout(PATIENCE, reloader.reload()).await.unwrap().unwrap_err();

        let why = fails_with().await;
        assert_eq!(why, ReloadError::TooSlow(time).to_string());
        assert_eq!(router.last_reload().error.as_ref(), Some(&why), "status and metrics tell it");
        was_asked.recv_timeout(PATIENCE).unwrap();
        for _ in 0..3 {
            assert_eq!(fails_with().await, ReloadError::StillReading.to_string());
        }
        assert!(was_asked.try_recv().is_err(), "nothing more was asked of it");

        disk.send(config()).unwrap();
        drop(disk);
        let unsound = ReloadError::Faults(Faults(Vec::new())).to_string();
        let end = std::time::Instant::now() + PATIENCE;
        // The machine may be slow, so the next reload may also exceed its reading time.
        while fails_with().await != unsound {
            assert!(std::time::Instant::now() < end, "later reloads are read again");
        }
        assert!(Arc::ptr_eq(&router.active_config(), &before), "what came late is dropped");
    }
}
