//! What a running relay tells the service manager, if there is one that listens. It uses systemd's
//! sd_notify protocol (`$NOTIFY_SOCKET`).

use std::env;
use std::ffi::OsStr;
use std::future;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use sd_notify::NotifyState;
use tokio::time;

use crate::datapath::Router;

const NOT_HEARD: &str = "the service manager cannot be told";

/// The shortest time between two warnings that the manager cannot be told.
const COMPLAINT_INTERVAL: Duration = Duration::from_secs(600);

/// Tells the manager that the relay works, with the configuration in force.
pub fn ready(router: &Router) {
    notify(&[NotifyState::Ready, NotifyState::Status(&status(router))]);
}

/// Tells the manager that the relay reads its configuration again. [`ready`] ends this state,
/// whether the reload succeeded or failed.
pub fn reloading() {
    // Some managers accept this message only with the time in it.
    let Ok(now) = NotifyState::monotonic_usec_now() else { return };
    notify(&[NotifyState::Reloading, now, NotifyState::Status("reading the configuration again")]);
}

/// Tells the manager that the relay is about to take no more requests.
pub fn stopping() {
    notify(&[NotifyState::Stopping, NotifyState::Status("waiting for answers that are due")]);
}

/// Pings the manager's watchdog, if it has one, as long as every worker answers.
pub async fn watchdog(router: Arc<Router>) -> ! {
    let Some(patience) = sd_notify::watchdog_enabled() else { future::pending().await };
    // This leaves a margin. The relay pings in half of the time that the manager allows. The
    // workers have half of that to answer.
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
    let active = router.active_config();
    let (nets, mappings) = (active.config.table.nets(), active.config.table.mappings());
    let last = router.last_reload();
    let kept = match (&last.error, last.successful()) {
        (Some(_), _) => "reload failed, as before: ",
        (None, false) => "not all of the configuration is in force: ",
        (None, true) => "",
    };
    format!("{kept}relaying; nets: {}, public ports: {}", nets.len(), mappings.len())
}

/// The connection to the manager.
#[derive(Debug)]
struct Manager {
    socket: UnixDatagram,
    address: SocketAddr,
    /// When the log last warned that the manager cannot be told.
    complained: Mutex<Option<Instant>>,
}

static MANAGER: OnceLock<Manager> = OnceLock::new();

/// Connects to the manager, if there is one. This has to happen before the confinement, which
/// forbids connections to a socket with an abstract name. A socket that is connected already keeps
/// working.
pub fn connect() {
    let Some(name) = env::var_os("NOTIFY_SOCKET") else { return };
    match Manager::connected(&name) {
        Ok(manager) => _ = MANAGER.set(manager),
        Err(error) => tracing::warn!(%error, socket = %name.display(), "{NOT_HEARD}"),
    }
}

impl Manager {
    fn connected(name: &OsStr) -> io::Result<Self> {
        let address = match name.as_bytes().strip_prefix(b"@") {
            Some(name) => SocketAddr::from_abstract_name(name)?,
            None => SocketAddr::from_pathname(name)?,
        };
        let socket = UnixDatagram::unbound()?;
        // A manager that is stuck must not hold up the relay.
        socket.set_nonblocking(true)?;
        socket.connect_addr(&address)?;
        Ok(Self { socket, address, complained: Mutex::default() })
    }

    fn send(&self, message: &[u8]) -> io::Result<usize> {
        // A manager that was restarted has a new socket of the same name.
        let again =
            |_| self.socket.connect_addr(&self.address).and_then(|()| self.socket.send(message));
        self.socket.send(message).or_else(again)
    }
}

fn notify(states: &[NotifyState<'_>]) {
    let Some(manager) = MANAGER.get() else { return };
    let message: String = states.iter().map(|state| format!("{state}\n")).collect();
    let Err(error) = manager.send(message.as_bytes()) else { return };
    let mut complained = manager.complained.lock().unwrap_or_else(PoisonError::into_inner);
    if complained.is_none_or(|last| last.elapsed() >= COMPLAINT_INTERVAL) {
        *complained = Some(Instant::now());
        tracing::warn!(%error, "{NOT_HEARD}");
    }
}
