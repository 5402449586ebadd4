//! The admin server: metrics, health, a status page and an API for people and monitoring.
//!
//! It only reads, except for a reload and for requests to a node, where the configuration allows them. Whatever its clients do, the
//! datapath goes on and a probe is answered: a connection has one request, the number of connections, the
//! time and the buffers are limited, and an answer is made piece by piece as it is read.

mod access;
mod api;
mod connections;
pub mod control;
mod listeners;
mod page;
mod scrape;
#[cfg(test)]
mod tests;
mod turn;

use std::future::Future;
use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::http::StatusCode;
use axum::middleware;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Extension, Json};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::task::yield_now;
use tokio::time::{sleep, timeout};
use tokio_io_timeout::TimeoutStream;
use tracing::warn;

use crate::datapath::Router;
use crate::observe::metrics::Metrics;
use crate::reload::Reloader;
use crate::sandbox::Sandbox;

use connections::Connections;
use control::FromControl;
use listeners::Connection;
pub use listeners::Listeners;
use scrape::Scrapes;
use turn::Turn;

/// The longest time from accepting a connection until its request is complete.
const HEADER_TIME: Duration = Duration::from_secs(2);
/// How long a client may go without reading an octet of its answer.
const STILL_TIME: Duration = Duration::from_secs(10);
/// The longest time from accepting a connection to the last octet of the answer.
const CONNECTION_TIME: Duration = Duration::from_secs(600);
/// The largest request in octets, and about how much of an answer waits for a slow client.
const BUFFER: usize = 16 * 1024;
/// How long a stopping server waits for open requests.
const GRACE: Duration = Duration::from_secs(1);
/// How long to wait after a failed accept; most likely there are no file descriptors left.
const ACCEPT_PAUSE: Duration = Duration::from_secs(1);

/// The paths, and what each is for.
const ROUTES: [(&str, &str); 14] = [
    ("/", "the status page, for browsers"),
    ("/metrics", "for Prometheus"),
    ("/-/healthy", "200 as long as the process runs"),
    ("/-/ready", "200 while it relays, 503 before, and from SIGTERM on"),
    (
        "/-/reload",
        "POST: reads the configuration again; over the control socket, or with [admin] reload",
    ),
    ("/api/v1/status", "version, readiness, reload and confinement"),
    ("/api/v1/nets", "nets and nodes with their counters; ?nodes=false&net=NAME for less"),
    ("/api/v1/drop-reasons", "why datagrams are dropped, in plain words"),
    ("/api/v1/flows?limit=1000", "open flows, at most 10000, and the use of passwords; ?net=NAME"),
    (
        "/api/v1/events",
        "what happened: nodes, reloads, throttling, floods; ?after=NUMBER for later ones",
    ),
    (
        "/api/v1/history",
        "figures of the last hour and day; ?net=NAME for the states of its nodes too",
    ),
    ("/api/v1/refused?limit=1000", "who is refused and why, newest first; ?net=NAME for one net"),
    ("/api/v1/config", "the configuration in force, without passwords"),
    ("/api/v1/probe?net=NAME&node=N", "POST: asks a node, where [admin] probe allows it"),
];

/// Answers requests until `shutdown` completes, then waits up to a second for the open ones. Without
/// `reloader` there is no configuration file to reload.
pub async fn serve(
    listeners: Listeners,
    router: Arc<Router>,
    reloader: Option<Reloader>,
    sandbox: Sandbox,
    shutdown: impl Future<Output = ()>,
) {
    let routes = routes(router, reloader, sandbox);
    let control_routes = routes.clone().layer(Extension(FromControl));
    let mut connections = Connections::default();
    let accepting = async {
        loop {
            match listeners.accept().await {
                Ok(connection) => {
                    let source = connection.source();
                    let routes = match &connection {
                        Connection::Tcp(..) => routes.clone(),
                        Connection::Control(_) => control_routes.clone(),
                    };
                    connections.add(source, async move {
                        // Nobody needs to know that a client was too slow or went away.
                        let _ = timeout(CONNECTION_TIME, answer(connection, routes)).await;
                    });
                    // Lets connections that were cut close before the next one is accepted.
                    yield_now().await;
                }
                Err(error) => pause_after(&error).await,
            }
        }
    };
    tokio::select! {
        () = accepting => {}
        () = shutdown => {}
    }
    connections.close(GRACE).await;
}

/// The admin server's routes.
pub fn routes(router: Arc<Router>, reloader: Option<Reloader>, sandbox: Sandbox) -> axum::Router {
    let metrics = Metrics::new(router.clone(), sandbox.clone());
    let shared = Shared {
        router,
        reloader,
        sandbox,
        metrics,
        scrapes: Scrapes::default(),
        turn: Turn::default(),
        flow_lists: api::FlowLists::default(),
        packing: Arc::default(),
        probes: api::Probes::default(),
    };
    axum::Router::new()
        .route("/", get(page::html))
        .route("/status.js", get(page::script))
        .route("/status.css", get(page::style))
        .route("/status.svg", get(page::icon))
        .route("/metrics", get(scrape::scrape))
        .route("/-/healthy", get("healthy\n"))
        .route("/-/ready", get(ready))
        .route("/-/reload", post(reload))
        .route("/api/v1/status", get(api::status))
        .route("/api/v1/nets", get(api::nets))
        .route("/api/v1/drop-reasons", get(api::drop_reasons))
        .route("/api/v1/flows", get(api::flows))
        .route("/api/v1/events", get(api::events))
        .route("/api/v1/history", get(api::history))
        .route("/api/v1/refused", get(api::refused))
        .route("/api/v1/config", get(api::config))
        .route("/api/v1/probe", post(api::probe))
        .fallback(not_found)
        .layer(middleware::from_fn_with_state(shared.clone(), access::control))
        .with_state(shared)
}

/// What the handlers share.
#[derive(Clone)]
struct Shared {
    router: Arc<Router>,
    reloader: Option<Reloader>,
    sandbox: Sandbox,
    metrics: Metrics,
    scrapes: Scrapes,
    turn: Turn,
    flow_lists: api::FlowLists,
    /// Held while a history is compressed, which takes some memory.
    packing: Arc<tokio::sync::Mutex<()>>,
    probes: api::Probes,
}

async fn answer(connection: Connection, routes: axum::Router) -> hyper::Result<()> {
    connection.keep_little_unsent();
    match connection {
        Connection::Tcp(stream, _) => answer_on(stream, routes).await,
        Connection::Control(stream) => answer_on(stream, routes).await,
    }
}

async fn answer_on(stream: impl AsyncRead + AsyncWrite, routes: axum::Router) -> hyper::Result<()> {
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(STILL_TIME));
    let stream = pin!(stream);
    http1::Builder::new()
        .keep_alive(false)
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_TIME)
        .max_buf_size(BUFFER)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(routes))
        .await
}

async fn pause_after(error: &io::Error) {
    warn!(%error, "the admin server cannot accept a connection; is the limit of open files reached?");
    sleep(ACCEPT_PAUSE).await;
}

async fn ready(State(shared): State<Shared>) -> (StatusCode, &'static str) {
    if shared.router.is_ready() {
        (StatusCode::OK, "ready\n")
    } else {
        (StatusCode::SERVICE_UNAVAILABLE, "not ready\n")
    }
}

async fn reload(
    State(shared): State<Shared>,
    from_control: Option<Extension<FromControl>>,
) -> Response {
    let active = shared.router.active_config();
    let allowed = active.config.admin.as_ref().is_some_and(|admin| admin.reload);
    let allowed = allowed || from_control.is_some();
    let Some(reloader) = shared.reloader.filter(|_| allowed) else {
        let message = "reload over HTTP is off; use the control socket or SIGHUP, or set [admin] reload = true first\n";
        return (StatusCode::FORBIDDEN, message).into_response();
    };
    drop(active);
    match reloader.reload().await {
        Ok(reloaded) if reloaded.not_in_force.is_empty() => Json(reloaded).into_response(),
        Ok(changes) => (StatusCode::CONFLICT, Json(changes)).into_response(),
        Err(faults) => (StatusCode::UNPROCESSABLE_ENTITY, faults + "\n").into_response(),
    }
}

async fn not_found() -> Response {
    let line = |(path, what)| format!("{path}  {what}\n");
    let routes: String = ROUTES.into_iter().map(line).collect();
    (StatusCode::NOT_FOUND, format!("Nothing here. The paths are:\n{routes}")).into_response()
}
