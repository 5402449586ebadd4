//! The configuration file, read again for a router at work: brought into force or refused, and told
//! of either way. One reload at a time.

use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;

use tokio::sync::Mutex;
use tokio::task::spawn_blocking;

use crate::config::{self, Changes};
use crate::net::{ReloadError, Router};
use crate::service;

/// A router and the file that its configuration is in.
#[derive(Debug)]
pub struct Reloader {
    path: PathBuf,
    router: Arc<Router>,
    turn: Arc<Mutex<()>>,
}

impl Reloader {
    /// Reads the file at `path` for `router`, whenever it is told to.
    pub fn new(path: PathBuf, router: Arc<Router>) -> Self {
        Self { path, router, turn: Arc::default() }
    }

    /// Reads the file and the password files that it names, and brings them into force; or tells
    /// every fault, and the configuration in force stays. Goes on to its end even when nobody waits.
    pub async fn reload(&self) -> Result<Changes, String> {
        let turn = Arc::clone(&self.turn).lock_owned().await;
        let (path, router) = (self.path.clone(), Arc::clone(&self.router));
        let reloaded = spawn_blocking(move || {
            let _turn = turn;
            service::reloading();
            let outcome = router.reload(config::load(&path).map(|(config, warnings)| {
                warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
                config
            }));
            log(&outcome);
            service::ready(&router);
            outcome.map_err(|error| chain(&error))
        });
        reloaded.await.unwrap_or_else(|error| Err(error.to_string()))
    }
}

fn log(outcome: &Result<Changes, ReloadError>) {
    match outcome {
        Ok(changes) => log_changes(changes),
        Err(ReloadError::Faults(faults)) => {
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
            tracing::error!(error = "the configuration is not sound", "reload failed");
        }
        Err(error) => tracing::error!(error = chain(error), "reload failed"),
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
    } = changes;
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
        "reload"
    );
}

fn list(names: &[impl AsRef<str>]) -> String {
    names.iter().map(AsRef::as_ref).collect::<Vec<_>>().join("; ")
}

/// An error and what caused it.
fn chain(error: &dyn Error) -> String {
    match error.source() {
        Some(cause) => format!("{error}: {}", chain(cause)),
        None => error.to_string(),
    }
}
