//! Who gets an answer. With a token, only requests that carry it. Without one, every request that does
//! not come from a web page of another site.
//!
//! Probes are always answered: they reveal nothing, and probes seldom have a token. The files of the
//! status page need no token either, since a browser sends none when it loads a page. The page asks the
//! user for the token. Over the control socket every request is answered.

use axum::extract::{Request, State};
use axum::http::header::{
    AUTHORIZATION, CACHE_CONTROL, CONTENT_SECURITY_POLICY, HOST, HeaderName, ORIGIN,
    REFERRER_POLICY, WWW_AUTHENTICATE, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::control::FromControl;
use super::{Shared, page};
use crate::config::Admin;

/// Sent with every answer: our pages load nothing from other sites and cannot be shown inside them, and
/// nothing is cached.
const HEADERS: [(HeaderName, &str); 5] = [
    (
        CONTENT_SECURITY_POLICY,
        "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (REFERRER_POLICY, "no-referrer"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (CACHE_CONTROL, "no-store"),
];

/// Passes a request on, or refuses it.
pub(super) async fn control(
    State(shared): State<Shared>,
    request: Request,
    next: Next,
) -> Response {
    // The mode of the control socket has decided who may connect.
    let from_control = request.extensions().get::<FromControl>().is_some();
    let verdict = if from_control {
        Ok(())
    } else {
        let active = shared.router.active_config();
        active.config.admin.as_ref().map_or(Ok(()), |admin| admit(admin, &request))
    };
    let mut response = match verdict {
        Ok(()) => next.run(request).await,
        Err(refusal) => refusal.into_response(),
    };
    for (name, value) in HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Refusal {
    Token,
    Host,
    Origin,
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        match self {
            Self::Token => {
                let challenge = [(WWW_AUTHENTICATE, "Bearer realm=\"pnet-nat\"")];
                let text =
                    "The token of [admin] token_file is needed: Authorization: Bearer TOKEN\n";
                (StatusCode::UNAUTHORIZED, challenge, text).into_response()
            }
            Self::Host => {
                let text =
                    "Use the IP address or localhost in the URL, or set [admin] token_file.\n";
                (StatusCode::MISDIRECTED_REQUEST, text).into_response()
            }
            Self::Origin => {
                (StatusCode::FORBIDDEN, "Requests from other sites are refused.\n").into_response()
            }
        }
    }
}

fn admit(admin: &Admin, request: &Request) -> Result<(), Refusal> {
    let path = request.uri().path();
    let probe = matches!(path, "/-/healthy" | "/-/ready");
    let Some(token) = &admin.token else {
        let open = probe || (path == "/metrics" && admin.metrics_without_token);
        return if open { Ok(()) } else { refuse_other_sites(request.method(), request.headers()) };
    };
    let open =
        probe || page::PATHS.contains(&path) || (path == "/metrics" && admin.metrics_without_token);
    let has_token = |value: &HeaderValue| {
        let (scheme, given) = value.as_bytes().split_at_checked("Bearer ".len())?;
        (scheme.eq_ignore_ascii_case(b"Bearer ") && token.matches(given)).then_some(())
    };
    let given = request.headers().get(AUTHORIZATION).and_then(has_token);
    if open || given.is_some() { Ok(()) } else { Err(Refusal::Token) }
}

/// A browser on this host sends whatever a page makes it send. The owner of a page can let the page's
/// host name resolve to this host, but the browser still sends that name in `Host`. And with a request
/// that changes something, the browser sends the page's `Origin`.
fn refuse_other_sites(method: &Method, headers: &HeaderMap) -> Result<(), Refusal> {
    let host = headers.get(HOST).map(|host| host.to_str().unwrap_or_default());
    if !host.is_none_or(is_own) {
        return Err(Refusal::Host);
    }
    let origin = headers.get(ORIGIN).map(|origin| origin.to_str().unwrap_or_default());
    let own = |origin: &str| origin.strip_prefix("http://") == host;
    if !method.is_safe() && !origin.is_none_or(own) {
        return Err(Refusal::Origin);
    }
    Ok(())
}

/// Whether a host is one that no stranger can have registered: an IP address or `localhost`.
fn is_own(host: &str) -> bool {
    let Ok(authority) = host.parse::<Authority>() else { return false };
    let host = authority.host().trim_start_matches('[').trim_end_matches(']');
    host.eq_ignore_ascii_case("localhost") || host.parse::<std::net::IpAddr>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Token;

    fn ask(admin: &Admin, method: &str, path: &str, headers: &[(&str, &str)]) -> Option<Refusal> {
        let mut request = axum::http::Request::builder().method(method).uri(path);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        admit(admin, &request.body(axum::body::Body::empty()).unwrap()).err()
    }

    fn admin(token: Option<&str>, metrics_without_token: bool) -> Admin {
        let listen = "127.0.0.1:9378".parse().unwrap();
        let token = token.map(|token| Token::new(token.as_bytes()).unwrap());
        Admin { listen, token, metrics_without_token, reload: false, probe: false, title: None }
    }

    const TOKEN: &str = "0123456789abcdef";

    #[test]
    fn with_a_token_all_but_probes_need_it() {
        let admin = admin(Some(TOKEN), false);
        for path in ["/status", "/metrics", "/api/v1/flows", "/none", "/-/ready/", "/-/reload"] {
            for method in ["GET", "POST", "DELETE"] {
                let ask = |value: &str| ask(&admin, method, path, &[("authorization", value)]);
                assert_eq!(ask("Bearer 0123456789abcdef"), None);
                assert_eq!(ask("bearer 0123456789abcdef"), None);
                for wrong in ["", "Bearer ", "Bearer 0123456789abcdeg", "Bearer 0123456789abcde"]
                    .into_iter()
                    .chain(["Bearer 0123456789abcdef0", "Basic 0123456789abcdef", TOKEN])
                {
                    assert_eq!(ask(wrong), Some(Refusal::Token), "{wrong}");
                }
            }
            assert_eq!(super::tests::ask(&admin, "GET", path, &[]), Some(Refusal::Token));
        }
        for path in ["/-/healthy", "/-/ready", "/", "/status.js", "/status.css", "/status.svg"] {
            assert_eq!(ask(&admin, "GET", path, &[("host", "relay.example")]), None);
        }
    }

    #[test]
    fn metrics_can_be_left_open() {
        let admin = admin(Some(TOKEN), true);
        assert_eq!(ask(&admin, "GET", "/metrics", &[]), None);
        assert_eq!(ask(&admin, "GET", "/metrics/", &[]), Some(Refusal::Token));
        assert_eq!(ask(&admin, "GET", "/api/v1/nets", &[]), Some(Refusal::Token));
    }

    #[test]
    fn without_a_token_pages_of_others_are_refused() {
        let admin = admin(None, false);
        for host in ["127.0.0.1:9378", "localhost:9378", "LOCALHOST", "[::1]:9378", "10.1.2.3"] {
            assert_eq!(ask(&admin, "GET", "/", &[("host", host)]), None, "{host}");
        }
        let others = ["evil.example:9378", "127.0.0.1.evil.example", "localhost.evil.example"];
        for host in others.into_iter().chain(["", "a b", "localhost@evil.example", "127.0.0.1."]) {
            let refused = ask(&admin, "GET", "/", &[("host", host)]);
            assert_eq!(refused, Some(Refusal::Host), "{host}");
        }
        assert_eq!(ask(&admin, "GET", "/", &[]), None, "browsers always tell");

        let post = |origin| ask(&admin, "POST", "/", &[("host", "localhost:9378"), origin]);
        assert_eq!(post(("origin", "http://localhost:9378")), None);
        assert_eq!(post(("accept", "*/*")), None);
        for origin in ["http://localhost:8080", "https://evil.example", "null", ""] {
            assert_eq!(post(("origin", origin)), Some(Refusal::Origin), "{origin}");
        }
    }
}
