//! How commands ask a relay's admin server: one request on a connection of its own, without the
//! environment's proxies and without following redirects.
//!
//! Only a host name that a name server must resolve needs another thread. So the commands work even when
//! the system has no threads left.

use std::fs;
use std::io;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, bail};
use axum::body::{Body, to_bytes};
use axum::http::header::{AUTHORIZATION, HOST};
use axum::http::{HeaderMap, HeaderValue, Method, Request, StatusCode, Uri};
use hyper::client::conn::http1;
use hyper_util::rt::TokioIo;
use serde_json::{Map, Value};
use tokio::net::TcpStream;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tokio::time::timeout;

use crate::config::Token;
use crate::harmless::harmless;
use crate::thread;

/// The largest answer that is read, in octets: nets with 8,000 nodes make 6 MB.
const MOST_OCTETS: usize = 64 << 20;

/// Which relay to ask.
#[derive(Debug, clap::Args)]
pub(super) struct Options {
    /// Where the relay's admin server is: host and port are those of [admin] listen [default:
    /// http://127.0.0.1:9378].
    #[arg(long, value_name = "URL", env = "PNET_NAT_STATUS_URL")]
    pub(super) url: Option<String>,

    /// File with the token, where [admin] token_file is set.
    #[arg(long, value_name = "FILE", env = "PNET_NAT_TOKEN_FILE")]
    pub(super) token_file: Option<PathBuf>,
}

/// A relay's admin server.
pub(super) struct AdminServer {
    /// Without a slash at the end.
    pub(super) url: String,
    /// The header with the token, where there is one.
    token: HeaderMap,
    /// How long one answer may take.
    answer_time: Duration,
}

impl AdminServer {
    /// The server that `options` name, or the one at `listen` with the token in `token_file`.
    pub(super) fn new(
        options: &Options,
        listen: SocketAddr,
        token_file: Option<&Path>,
        answer_time: Duration,
    ) -> anyhow::Result<Self> {
        let url = options.url.clone().unwrap_or_else(|| format!("http://{listen}"));
        let token_file = options.token_file.as_deref().or(token_file);
        let token = token_file.map(token).transpose()?.unwrap_or_default();
        Ok(Self { url: url.trim_end_matches('/').to_owned(), token, answer_time })
    }

    /// The JSON object at a path of the API.
    pub(super) async fn get(&self, path: &str) -> anyhow::Result<Map<String, Value>> {
        let url = format!("{}{path}", self.url);
        let (status, text) = self.ask(Method::GET, path, self.answer_time).await?;
        match (status, self.token.is_empty()) {
            (StatusCode::OK, _) => serde_json::from_str(&text).with_context(|| self.no_api()),
            (StatusCode::UNAUTHORIZED, true) => {
                bail!("{url} asks for a token: --token-file, as in [admin] token_file")
            }
            (StatusCode::UNAUTHORIZED, false) => {
                bail!("{url} has another token than the one of --token-file")
            }
            (status, _) => {
                bail!("{url} answered {}: {}", status.as_u16(), harmless(text.trim_end()))
            }
        }
    }

    /// Any answer, also one that refuses.
    pub(super) async fn ask(
        &self,
        method: Method,
        path: &str,
        answer_time: Duration,
    ) -> anyhow::Result<(StatusCode, String)> {
        let answer = ask(method, &format!("{}{path}", self.url), &self.token, answer_time).await;
        answer.with_context(|| {
            format!(
                "no answer from {}; is the relay running, and is this its [admin] listen? See --url",
                self.url
            )
        })
    }

    /// The message when an answer is not the API's.
    pub(super) fn no_api(&self) -> String {
        format!("{} is not the API of a pnet-nat", self.url)
    }
}

/// The header with the token in a file.
fn token(path: &Path) -> anyhow::Result<HeaderMap> {
    let text = fs::read_to_string(path).with_context(|| format!("{path:?} cannot be read"))?;
    let token = text.trim_end_matches(['\n', '\r']);
    Token::new(token.as_bytes()).with_context(|| format!("{path:?}"))?;
    let mut value = HeaderValue::try_from(format!("Bearer {token}"))?;
    value.set_sensitive(true);
    Ok(HeaderMap::from_iter([(AUTHORIZATION, value)]))
}

/// Sends a request; fails when the answer is not complete in time.
pub(super) async fn ask(
    method: Method,
    url: &str,
    headers: &HeaderMap,
    answer_time: Duration,
) -> anyhow::Result<(StatusCode, String)> {
    match timeout(answer_time, exchange(method, url, headers)).await {
        Ok(answer) => answer,
        Err(_) => bail!("it took more than {}", humantime::format_duration(answer_time)),
    }
}

async fn exchange(
    method: Method,
    url: &str,
    headers: &HeaderMap,
) -> anyhow::Result<(StatusCode, String)> {
    let url: Uri = url.parse().context("not a URL")?;
    let (Some("http"), Some(authority)) = (url.scheme_str(), url.authority()) else {
        bail!("not a URL like http://127.0.0.1:9378");
    };
    let addresses = look_up(authority.host(), authority.port_u16().unwrap_or(80)).await?;
    let stream = TcpStream::connect(addresses.as_slice()).await?;
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await?;
    // Ends with this function, however that ends.
    let mut connections = JoinSet::new();
    connections.spawn(connection);
    let path = url.path_and_query().map_or("/", |path| path.as_str());
    let mut request = Request::builder().method(method).uri(path).body(Body::empty())?;
    request.headers_mut().insert(HOST, authority.as_str().try_into()?);
    request.headers_mut().extend(headers.clone());
    let (answer, body) = sender.send_request(request).await?.into_parts();
    let text = to_bytes(Body::new(body), MOST_OCTETS).await?;
    Ok((answer.status, String::from_utf8_lossy(&text).into_owned()))
}

/// The addresses of a host. A name server may take longer than the answer time, so another thread waits
/// for it; without one, this thread waits.
async fn look_up(host: &str, port: u16) -> io::Result<Vec<SocketAddr>> {
    let host = host.trim_matches(['[', ']']).to_owned();
    let is_known = is_known(&host);
    let look_up = move || Ok((host.as_str(), port).to_socket_addrs()?.collect());
    if is_known {
        return look_up();
    }
    let (reply, found) = oneshot::channel();
    let here = look_up.clone();
    let in_thread = move || {
        // The receiver is gone after a timeout.
        let _ = reply.send(look_up());
    };
    match thread::start("names", in_thread) {
        Err(_) => here(),
        Ok(()) => found.await.unwrap_or_else(|_| Err(io::ErrorKind::NotFound.into())),
    }
}

/// Whether this host is resolved without a name server.
fn is_known(host: &str) -> bool {
    host.parse::<IpAddr>().is_ok() || host.eq_ignore_ascii_case("localhost")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_and_localhost_are_known() {
        for known in ["127.0.0.1", "::1", "fe80::7", "localhost", "LocalHost"] {
            assert!(is_known(known), "{known}");
        }
        for asked in ["relay.example", "localhost.example", "127.0.0.1.example", "1"] {
            assert!(!is_known(asked), "{asked}");
        }
    }

    #[tokio::test]
    async fn a_url_that_is_none_is_told() {
        for (url, part) in [
            ("127.0.0.1:9378", "not a URL like http://"),
            ("https://127.0.0.1:9378", "not a URL like http://"),
            ("/-/ready", "not a URL like http://"),
            ("http://a b/", "not a URL"),
        ] {
            let asked = ask(Method::GET, url, &HeaderMap::new(), Duration::from_secs(1)).await;
            let error = format!("{:#}", asked.unwrap_err());
            assert!(error.contains(part), "{url}: {error}");
        }
    }
}
