//! `/api/v1/refused`: whose datagrams are dropped, and why.

use std::net::IpAddr;
use std::time::Duration;

use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

use super::json_list_and;
use crate::admin::Shared;
use crate::nat::{NetId, Refusal, Table};
use crate::observe::refusals::Refusals;

const DEFAULT_REFUSALS: usize = 1000;
const MOST_REFUSALS: usize = 10_000;

/// Query of [`refused`].
#[derive(Deserialize)]
pub(in crate::admin) struct RefusedQuery {
    limit: Option<usize>,
    /// Only what was for the net with this name.
    net: Option<String>,
}

/// `GET /api/v1/refused?limit=&net=`
pub(in crate::admin) async fn refused(
    State(shared): State<Shared>,
    Query(query): Query<RefusedQuery>,
) -> Response {
    let limit = query.limit.unwrap_or(DEFAULT_REFUSALS);
    if limit > MOST_REFUSALS {
        let message = format!("limit is at most {MOST_REFUSALS}\n");
        return (StatusCode::BAD_REQUEST, message).into_response();
    }
    let active = shared.router.active_config();
    let table = &active.config.table;
    let is_asked_for =
        |id: NetId| query.net.as_ref().is_none_or(|name| table.net(id).name == *name);
    if !table.net_ids().any(is_asked_for) {
        return (StatusCode::NOT_FOUND, "no net has this name\n").into_response();
    }
    let refusals = shared.turn.take(|| Refusals::of(&active.counters, table)).await;
    let Refusals { mut list, not_listed } = refusals;
    list.retain(|&(net, _)| is_asked_for(net));
    list.truncate(limit);
    let (now, table) = (shared.router.started().elapsed(), table.clone());
    let rows = list
        .into_iter()
        .map(move |(net, refusal)| serde_json::to_string(&Row::of(&table, net, &refusal, now)));
    json_list_and("refused", rows, &format!(",\n\"not_listed\":{not_listed}"), &shared.turn)
}

/// Datagrams of one sender, for one node, that were dropped for one reason.
#[derive(Serialize)]
struct Row<'a> {
    source: IpAddr,
    net: &'a str,
    /// 0: a PROFINET device.
    node: u8,
    direction: &'static str,
    reason: &'static str,
    count: u64,
    /// Time since the first that counts, and since the last.
    first_age_seconds: f64,
    last_age_seconds: f64,
}

impl<'a> Row<'a> {
    fn of(table: &'a Table, net: NetId, refusal: &Refusal, now: Duration) -> Self {
        let age = |at| now.saturating_sub(Duration::from_nanos(at)).as_secs_f64();
        let Refusal { refused, count, first, last } = *refusal;
        Self {
            source: refused.sender,
            net: &table.net(net).name,
            node: refused.node,
            direction: refused.direction.label(),
            reason: refused.reason.label(),
            count,
            first_age_seconds: age(first),
            last_age_seconds: age(last),
        }
    }
}
