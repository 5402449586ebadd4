//! The status page: three files and an icon, the same for everybody. All it shows comes from the API,
//! with the token of its user.

use axum::http::header::CONTENT_TYPE;
use axum::response::{Html, IntoResponse};

/// The paths of its files.
pub(super) const PATHS: [&str; 4] = ["/", "/status.js", "/status.css", "/status.svg"];

/// `GET /`
pub(super) async fn html() -> Html<&'static str> {
    Html(include_str!("page/status.html"))
}

/// `GET /status.js`: one script. Its parts know what is in those before them.
pub(super) async fn script() -> impl IntoResponse {
    const SCRIPT: &str = concat!(
        include_str!("page/status/asking.js"),
        include_str!("page/status/words.js"),
        include_str!("page/status/drawing.js"),
        include_str!("page/status/figures.js"),
        include_str!("page/status/drops.js"),
        include_str!("page/status/plots.js"),
        include_str!("page/status/filter.js"),
        include_str!("page/status/nodes.js"),
        include_str!("page/status/nets.js"),
        include_str!("page/status/refused.js"),
        include_str!("page/status/flows.js"),
        include_str!("page/status/events.js"),
        include_str!("page/status/relay.js"),
        include_str!("page/status/banner.js"),
        include_str!("page/status/links.js"),
        include_str!("page/status/rounds.js"),
    );
    ([(CONTENT_TYPE, "text/javascript; charset=utf-8")], SCRIPT)
}

/// `GET /status.css`
pub(super) async fn style() -> impl IntoResponse {
    ([(CONTENT_TYPE, "text/css; charset=utf-8")], include_str!("page/status.css"))
}

/// `GET /status.svg`
pub(super) async fn icon() -> impl IntoResponse {
    ([(CONTENT_TYPE, "image/svg+xml")], include_str!("page/status.svg"))
}
