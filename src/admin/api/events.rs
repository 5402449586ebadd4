//! `/api/v1/events`: what happened.

use std::time::UNIX_EPOCH;

use axum::extract::{Query, State};
use axum::response::Response;
use serde::{Deserialize, Serialize};

use super::json_list;
use crate::admin::Shared;
use crate::observe::events::Event;

/// Query of [`events`].
#[derive(Deserialize)]
pub(in crate::admin) struct EventsQuery {
    /// Only those with a larger number.
    after: Option<u64>,
}

/// `GET /api/v1/events?after=`
pub(in crate::admin) async fn events(
    State(shared): State<Shared>,
    Query(query): Query<EventsQuery>,
) -> Response {
    let events = shared.router.journal().events_after(query.after.unwrap_or(0));
    let events = events.into_iter().map(|event| serde_json::to_string(&EventState::of(&event)));
    json_list("events", events, &shared.turn)
}

/// Something that happened.
#[derive(Serialize)]
struct EventState<'a> {
    number: u64,
    /// Seconds since 1970.
    time: f64,
    kind: &'static str,
    net: Option<&'a str>,
    node: Option<u8>,
    text: &'a str,
}

impl<'a> EventState<'a> {
    fn of(event: &'a Event) -> Self {
        let time = event.time.duration_since(UNIX_EPOCH).unwrap_or_default();
        Self {
            number: event.number,
            time: time.as_millis() as f64 / 1e3,
            kind: event.kind.label(),
            net: event.net.as_deref(),
            node: event.node,
            text: &event.text,
        }
    }
}
