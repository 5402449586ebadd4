//! `/api/v1/probe`: asks one node, and says what is wrong with it.
//!
//! It works under the confinement: it needs a UDP socket, and the table of neighbours in /proc/self.
//! What needs more is left to `pnet-nat probe`.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Json;
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::http::header::RETRY_AFTER;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use strum::VariantArray;
use tokio::sync::Mutex;

use crate::admin::Shared;
use crate::nat::DropReason;
use crate::observe::totals::{NodeTotals, Presence};
use crate::probe::{Asked, Counted, Report};

/// How long an answer may take.
const ANSWER_TIME: Duration = Duration::from_secs(1);
/// The shortest time from one probe to the next, so that nobody makes the relay flood a node.
const INTERVAL: Duration = Duration::from_secs(1);

/// Locked while a node is asked; when the last probe began.
#[derive(Clone, Default)]
pub(in crate::admin) struct Probes(Arc<Mutex<Option<Instant>>>);

/// Query of [`probe`].
#[derive(Deserialize)]
pub(in crate::admin) struct ProbeQuery {
    net: String,
    node: u8,
}

/// `POST /api/v1/probe?net=&node=`
pub(in crate::admin) async fn probe(
    State(shared): State<Shared>,
    Query(query): Query<ProbeQuery>,
) -> Response {
    let active = shared.router.active_config();
    let config = &active.config;
    if !config.admin.as_ref().is_some_and(|admin| admin.probe) {
        let message =
            "probes over HTTP are off; use pnet-nat probe, or set [admin] probe = true first\n";
        return (StatusCode::NOT_FOUND, message).into_response();
    }
    let table = &config.table;
    let mut nets = table.net_ids().filter(|id| table.net(*id).name == query.net);
    let mapping = nets.next().and_then(|net| {
        table.mappings_of(net).find(|id| table.mapping(*id).node_address == query.node)
    });
    let Some(mapping) = mapping else {
        return (StatusCode::NOT_FOUND, "no net with this name has this node\n").into_response();
    };
    let Ok(mut last) = shared.probes.0.try_lock() else { return too_many() };
    if last.is_some_and(|last| last.elapsed() < INTERVAL) {
        return too_many();
    }
    *last = Some(Instant::now());
    let asked = Asked::of(config, &table.mapping(mapping));
    let seen = asked.ask(ANSWER_TIME).await;
    let mut checks = asked.judge(seen.as_ref());
    let uptime = shared.router.started().elapsed();
    let totals = NodeTotals::of_node(&active.counters, mapping);
    checks.extend(counted(&totals, uptime).judge(&asked.subject));
    Json(Report::new(checks)).into_response()
}

fn too_many() -> Response {
    let message = "another probe is under way, or was a moment ago\n";
    (StatusCode::TOO_MANY_REQUESTS, [(RETRY_AFTER, "1")], message).into_response()
}

/// What the relay has counted of a node.
fn counted(totals: &NodeTotals, now: Duration) -> Counted {
    let contact = &totals.contact;
    let dropped = |reason: &DropReason| (reason.label().to_owned(), totals.dropped(*reason));
    Counted {
        is_silent: contact.presence(now) == Presence::Silent,
        last_answer_seconds: contact
            .last_response
            .map(|last| now.saturating_sub(last).as_secs_f64()),
        dropped: DropReason::VARIANTS.iter().map(dropped).collect(),
    }
}
