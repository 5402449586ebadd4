//! `/api/v1/history`: figures of the last hour and day.

use std::io::{self, Write};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use axum::extract::{Query, State};
use axum::http::header::{ACCEPT_ENCODING, CONTENT_ENCODING, CONTENT_TYPE, VARY};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::write::GzEncoder;
use serde::Deserialize;
use strum::VariantArray;

use crate::admin::Shared;
use crate::admin::scrape::takes_gzip;
use crate::observe::history::{Figures, History, HistoryView, Series};

/// Query of [`history`].
#[derive(Deserialize)]
pub(in crate::admin) struct HistoryQuery {
    /// Also the states of the nodes of this net.
    net: Option<String>,
}

/// `GET /api/v1/history?net=`
pub(in crate::admin) async fn history(
    State(shared): State<Shared>,
    Query(query): Query<HistoryQuery>,
    headers: HeaderMap,
) -> Response {
    let net = query.net.as_deref();
    let view = shared.router.journal().history().view(net);
    if net.is_some() && view.nodes.is_empty() {
        return (StatusCode::NOT_FOUND, "no net has this name\n").into_response();
    }
    let pieces = pieces(view, net.is_some());
    let headers_of_all = [(CONTENT_TYPE, "application/json"), (VARY, ACCEPT_ENCODING.as_str())];
    if !takes_gzip(&headers) {
        let pieces = pieces.map(Ok::<_, io::Error>);
        return (headers_of_all, shared.turn.body(pieces)).into_response();
    }
    // The encoder takes more memory than what it makes, so there is only one at a time.
    let packing = shared.packing.lock().await;
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    for piece in pieces {
        // Writing to memory does not fail.
        shared.turn.take(|| encoder.write_all(piece.as_bytes()).unwrap_or_default()).await;
    }
    let packed = encoder.finish().unwrap_or_default();
    drop(packing);
    (headers_of_all, [(CONTENT_ENCODING, "gzip")], packed).into_response()
}

/// The answer, a series or a node at a time.
fn pieces(view: HistoryView, with_nodes: bool) -> impl Iterator<Item = String> + Send {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
    let HistoryView { hour, day, nodes } = view;
    let begin = format!("{{\"now\":{now:.3}");
    let nodes = nodes.into_iter().enumerate().map(|(index, (node, strip))| {
        let comma = if index == 0 { "" } else { "," };
        format!("{comma}\n\"{node}\":\"{}\"", strip.letters())
    });
    let (open, close) = if with_nodes { (",\n\"nodes\":{", "}") } else { ("", "") };
    std::iter::once(begin)
        .chain(block("hour", hour, History::STEP))
        .chain(block("day", day, History::MINUTE))
        .chain([open.to_owned()])
        .chain(nodes)
        .chain([format!("{close}}}\n")])
}

/// One length of steps, as a member of the object.
fn block(
    name: &'static str,
    steps: Vec<Figures>,
    step: Duration,
) -> impl Iterator<Item = String> + Send {
    let begin = format!(",\n\"{name}\":{{\"step_seconds\":{}", step.as_secs());
    let series = Series::VARIANTS.iter().map(move |&series| {
        let figures: Vec<_> = steps.iter().map(|step| json(step[series as usize])).collect();
        format!(",\n\"{}\":[{}]", series.label(), figures.join(","))
    });
    std::iter::once(begin).chain(series).chain(["}".to_owned()])
}

/// A figure with three digits; a whole number as it is.
fn json(figure: f32) -> String {
    if figure.is_nan() {
        return "null".to_owned();
    }
    if figure.fract() == 0.0 {
        return format!("{figure:.0}");
    }
    let digits = 2 - figure.abs().log10().floor() as i32;
    let unit = 10_f64.powi(digits);
    ((f64::from(figure) * unit).round() / unit).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_three_digits_and_what_is_unknown_is_null() {
        for (figure, text) in [
            (f32::NAN, "null"),
            (0.0, "0"),
            (12345.0, "12345"),
            (12345.6, "12300"),
            (1.0 / 6.0, "0.167"),
            (0.0052, "0.0052"),
            (29.96, "30"),
        ] {
            assert_eq!(json(figure), text, "{figure}");
        }
    }
}
