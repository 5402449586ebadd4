//! `/api/v1`: nets, flows and configuration as JSON.
//!
//! The structs in these files are the shape of the JSON. None contains a password: of a credential, only
//! its name is shown.

mod config;
mod drop_reasons;
mod flows;
mod nets;
mod probe;
mod status;
mod traffic;

use std::iter;

use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};

use super::turn::Turn;

pub(super) use config::config;
pub(super) use drop_reasons::drop_reasons;
pub(super) use flows::{FlowLists, flows};
pub(super) use nets::nets;
pub(super) use probe::{Probes, probe};
pub(super) use status::status;

/// An object with one list, made item by item as the client reads it.
fn json_list(
    name: &str,
    items: impl Iterator<Item = serde_json::Result<String>> + Send + 'static,
    turn: &Turn,
) -> Response {
    let separators = iter::once("\n").chain(iter::repeat(",\n"));
    let items = separators.zip(items);
    let items = items.map(|(separator, item)| item.map(|item| separator.to_owned() + &item));
    let chunks = iter::once(Ok(format!("{{\"{name}\":[")))
        .chain(items)
        .chain(iter::once(Ok("\n]}\n".to_owned())));
    ([(CONTENT_TYPE, "application/json")], turn.body(chunks)).into_response()
}
