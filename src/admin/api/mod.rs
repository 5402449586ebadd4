//! `/api/v1`: nets, flows and configuration as JSON.
//!
//! The structs in these files are the shape of the JSON. None contains a password: of a credential, only
//! its name is shown.

mod config;
mod drop_reasons;
mod events;
mod flows;
mod history;
mod nets;
mod probe;
mod refused;
mod status;
mod traffic;

use std::iter;

use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};

use super::turn::Turn;

pub(super) use config::config;
pub(super) use drop_reasons::drop_reasons;
pub(super) use events::events;
pub(super) use flows::{FlowLists, flows};
pub(super) use history::history;
pub(super) use nets::nets;
pub(super) use probe::{Probes, probe};
pub(super) use refused::refused;
pub(super) use status::status;

/// An object with one list, made item by item as the client reads it.
fn json_list(
    name: &str,
    items: impl Iterator<Item = serde_json::Result<String>> + Send + 'static,
    turn: &Turn,
) -> Response {
    json_list_and(name, items, "", turn)
}

/// The same with further members of the object behind the list, each after a comma.
fn json_list_and(
    name: &str,
    items: impl Iterator<Item = serde_json::Result<String>> + Send + 'static,
    members: &str,
    turn: &Turn,
) -> Response {
    let separators = iter::once("\n").chain(iter::repeat(",\n"));
    let items = separators.zip(items);
    let items = items.map(|(separator, item)| item.map(|item| separator.to_owned() + &item));
    let chunks = iter::once(Ok(format!("{{\"{name}\":[")))
        .chain(items)
        .chain(iter::once(Ok(format!("\n]{members}}}\n"))));
    ([(CONTENT_TYPE, "application/json")], turn.body(chunks)).into_response()
}
