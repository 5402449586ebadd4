//! What the service manager hears of a running relay, where there is one that listens (systemd's
//! sd_notify protocol, `$NOTIFY_SOCKET`).

use std::future;
use std::sync::Arc;
use std::time::Duration;

use sd_notify::NotifyState;
use tokio::time;

use crate::net::Router;

/// It relays, with the configuration in force.
pub fn ready(router: &Router) {
    notify(&[NotifyState::Ready, NotifyState::Status(&status(router))]);
}

/// It reads its configuration again. [`ready`] says that it is done, however it went.
pub fn reloading() {
    // A manager that wants the time takes the message only with it.
    let Ok(now) = NotifyState::monotonic_usec_now() else { return };
    notify(&[NotifyState::Reloading, now, NotifyState::Status("reading the configuration again")]);
}

/// It takes no more requests.
pub fn stopping() {
    notify(&[NotifyState::Stopping, NotifyState::Status("waiting for answers that are due")]);
}

/// Pings the manager's watchdog, if it has one, for as long as every worker answers.
pub async fn watchdog(router: Arc<Router>) -> ! {
    let Some(patience) = sd_notify::watchdog_enabled() else { future::pending().await };
    // Its own margin: half to ping in, of which the workers get half to answer in.
    let (interval, within) = (patience / 2, patience / 4);
    let mut next = time::interval(interval.max(Duration::from_millis(1)));
    next.set_missed_tick_behavior(time::MissedTickBehavior::Delay);
    loop {
        next.tick().await;
        if router.is_alive(within).await {
            notify(&[NotifyState::Watchdog]);
        } else {
            tracing::error!("a worker does not answer; the watchdog is not pinged");
        }
    }
}

fn status(router: &Router) -> String {
    let in_force = router.in_force();
    let (nets, mappings) = (in_force.config.table.nets(), in_force.config.table.mappings());
    let last = router.last_reload();
    let kept = match (&last.error, last.successful()) {
        (Some(_), _) => "reload failed, as before: ",
        (None, false) => "not all of the configuration is in force: ",
        (None, true) => "",
    };
    format!("{kept}relaying; nets: {}, public ports: {}", nets.len(), mappings.len())
}

fn notify(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        tracing::warn!(%error, "the service manager cannot be told");
    }
}
