//! How commands find a relay and ask it: one request on a connection of its own, over the control socket
//! or the admin server, without the environment's proxies and without following redirects.
//!
//! Only a host name that a name server must resolve needs another thread. So the commands work even when
//! the system has no threads left.

use std::fs;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, bail};
use axum::body::{Body, to_bytes};
use axum::http::header::{AUTHORIZATION, HOST};
use axum::http::{HeaderMap, HeaderValue, Method, Request, StatusCode, Uri};
use hyper::client::conn::http1;
use hyper_util::rt::TokioIo;
use nix::unistd::{AccessFlags, access};
use serde_json::{Map, Value};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpStream, UnixStream};
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tokio::time::timeout;

use crate::admin::control;
use crate::config::{Source, Token, TwoSources, USUAL_FILE};
use crate::harmless::harmless;
use crate::thread;

/// The largest answer that is read, in octets: nets with 8,000 nodes make 6 MB.
const MOST_OCTETS: usize = 64 << 20;

/// The control socket of the service that the package installs.
const CONTROL: &str = "/run/pnet-nat/control.sock";

/// Which relay to ask.
#[derive(Debug, clap::Args)]
pub(super) struct Options {
    /// Where to ask the relay: http://HOST:PORT of its admin server, or unix:PATH of its control socket
    /// [default: as --config says].
    #[arg(long, alias = "url", value_name = "URL", env = "PNET_NAT_STATUS_URL")]
    pub(super) target: Option<String>,

    #[command(flatten)]
    pub(super) files: Files,
}

/// The same as [`Options`], but several relays may be named.
#[derive(Debug, clap::Args)]
pub(super) struct ManyOptions {
    /// Where to ask the relay: http://HOST:PORT of its admin server, or unix:PATH of its control socket
    /// [default: as --config says]. Given several times, the relays are shown side by side.
    #[arg(long, alias = "url", value_name = "URL", env = "PNET_NAT_STATUS_URL")]
    target: Vec<String>,

    #[command(flatten)]
    files: Files,
}

impl ManyOptions {
    /// The options for each of the relays: one at least.
    pub(super) fn each(&self) -> Vec<Options> {
        let of = |target: Option<String>| Options { target, files: self.files.clone() };
        match self.target.as_slice() {
            [] => vec![of(None)],
            targets => targets.iter().cloned().map(Some).map(of).collect(),
        }
    }
}

/// The files that say where a relay can be asked.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Files {
    /// The relay's configuration file; its [admin] says where the relay can be asked, and which token that
    /// needs [default: /etc/pnet-nat/pnet-nat.toml].
    #[arg(short, long, value_name = "FILE", env = "PNET_NAT_CONFIG")]
    pub(super) config: Option<PathBuf>,

    /// File with the token, where [admin] token_file is set. The control socket needs none.
    #[arg(long, value_name = "FILE", env = "PNET_NAT_TOKEN_FILE")]
    pub(super) token_file: Option<PathBuf>,
}

/// Where a relay can be asked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// The URL of its admin server, without a slash at the end.
    Http(String),
    /// Its control socket.
    Control(PathBuf),
}

impl Place {
    fn of_url(url: &str) -> Self {
        match url.strip_prefix("unix:") {
            Some(path) => Self::Control(path.into()),
            None => Self::Http(url.trim_end_matches('/').to_owned()),
        }
    }

    /// The place that a URL names, or else the configuration, with the file of the token that it needs.
    pub(super) fn find(
        url: Option<&str>,
        file: Option<&Path>,
    ) -> anyhow::Result<(Self, Option<PathBuf>)> {
        if let Some(url) = url {
            return Ok((Self::of_url(url), None));
        }
        // Of two configurations, which a relay refuses, the file is taken.
        let source = Source::choose(file).unwrap_or_else(|TwoSources(file)| Source::File(file));
        let admin = source.admin_place();
        let file = match &source {
            Source::File(file) => file,
            Source::Environment(_) => Path::new(""),
        };
        let beside = file.parent().unwrap_or(Path::new(""));
        let of_package = || (file == Path::new(USUAL_FILE)).then(|| CONTROL.into());
        let control = admin.control.map(|control| beside.join(control));
        let control = control.or_else(control::of_the_service).or_else(of_package);
        let usable = |control: &PathBuf| access(control, AccessFlags::W_OK).is_ok();
        match (control, admin.enabled) {
            (Some(control), enabled) if usable(&control) || !enabled => {
                Ok((Self::Control(control), None))
            }
            (None, false) => bail!(
                "{file:?} switches the admin server off ([admin] enabled) and names no [admin] control, \
                 so the relay cannot be asked"
            ),
            _ => {
                let token_file = admin.token_file.map(|file| beside.join(file));
                Ok((Self::Http(format!("http://{}", reachable(admin.listen))), token_file))
            }
        }
    }

    /// The same in the form that `--target` takes.
    pub(super) fn url(&self) -> String {
        match self {
            Self::Http(url) => url.clone(),
            Self::Control(path) => format!("unix:{}", path.display()),
        }
    }

    /// What may be the matter when there is no answer.
    fn hint(&self) -> &'static str {
        match self {
            Self::Http(_) => {
                "is the relay running, and is this its [admin] listen? See --target and --config"
            }
            Self::Control(_) => {
                "is the relay running? Its user, its group and root may use this socket; see --target"
            }
        }
    }
}

/// An address to reach the server at; it may listen on all addresses.
fn reachable(mut listen: SocketAddr) -> SocketAddr {
    if listen.ip().is_unspecified() {
        let loopback: IpAddr = match listen {
            SocketAddr::V4(_) => Ipv4Addr::LOCALHOST.into(),
            SocketAddr::V6(_) => Ipv6Addr::LOCALHOST.into(),
        };
        listen.set_ip(loopback);
    }
    listen
}

/// A relay that can be asked.
pub(super) struct AdminServer {
    place: Place,
    /// The place in the form that `--target` takes.
    pub(super) url: String,
    /// The header with the token, where there is one.
    token: HeaderMap,
    /// How long one answer may take.
    answer_time: Duration,
}

impl AdminServer {
    /// The relay that `options` name.
    pub(super) fn new(options: &Options, answer_time: Duration) -> anyhow::Result<Self> {
        let Options { target, files: Files { config, token_file } } = options;
        let (place, its_token_file) = Place::find(target.as_deref(), config.as_deref())?;
        let token = match (&place, token_file.as_ref().or(its_token_file.as_ref())) {
            (Place::Http(_), Some(file)) => token(file)?,
            _ => HeaderMap::new(),
        };
        Ok(Self { url: place.url(), place, token, answer_time })
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
                bail!("{url} has another token than the one of --token-file or --config")
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
        let answer = ask(method, &self.place, path, &self.token, answer_time).await;
        answer.with_context(|| format!("no answer from {}; {}", self.url, self.place.hint()))
    }

    /// The message when an answer is not the API's.
    pub(super) fn no_api(&self) -> String {
        format!("{} is not the API of a pnet-nat", self.url)
    }
}

/// A text as the value of a query. It is encoded as a whole, so that any text is possible.
pub(super) fn percent_encoded(text: &str) -> String {
    text.bytes().map(|octet| format!("%{octet:02x}")).collect()
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
    place: &Place,
    path: &str,
    headers: &HeaderMap,
    answer_time: Duration,
) -> anyhow::Result<(StatusCode, String)> {
    match timeout(answer_time, exchange(method, place, path, headers)).await {
        Ok(answer) => answer,
        Err(_) => bail!("it took more than {}", humantime::format_duration(answer_time)),
    }
}

async fn exchange(
    method: Method,
    place: &Place,
    path: &str,
    headers: &HeaderMap,
) -> anyhow::Result<(StatusCode, String)> {
    let base = match place {
        Place::Http(base) => base,
        Place::Control(socket) => {
            let stream = UnixStream::connect(socket).await?;
            let request = Request::builder().method(method).uri(path).header(HOST, "localhost");
            return answer(stream, request.body(Body::empty())?).await;
        }
    };
    let url: Uri = format!("{base}{path}").parse().context(no_url())?;
    let (Some("http"), Some(authority)) = (url.scheme_str(), url.authority()) else {
        bail!(no_url());
    };
    let addresses = look_up(authority.host(), authority.port_u16().unwrap_or(80)).await?;
    let stream = TcpStream::connect(addresses.as_slice()).await?;
    let path = url.path_and_query().map_or("/", |path| path.as_str());
    let mut request = Request::builder().method(method).uri(path).body(Body::empty())?;
    request.headers_mut().insert(HOST, authority.as_str().try_into()?);
    request.headers_mut().extend(headers.clone());
    answer(stream, request).await
}

fn no_url() -> String {
    format!("not a URL like http://127.0.0.1:9378 or unix:{CONTROL}")
}

async fn answer(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    request: Request<Body>,
) -> anyhow::Result<(StatusCode, String)> {
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await?;
    // Ends with this function, however that ends.
    let mut connections = JoinSet::new();
    connections.spawn(connection);
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
            let (place, headers) = (Place::of_url(url), HeaderMap::new());
            let asked = ask(Method::GET, &place, "/", &headers, Duration::from_secs(1)).await;
            let error = format!("{:#}", asked.unwrap_err());
            assert!(error.contains(part), "{url}: {error}");
        }
    }

    /// The socket where it can be used, or else the admin server, as the file says.
    #[test]
    fn a_relay_is_found_by_its_configuration() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("relay.toml");
        let find = |admin: &str| {
            fs::write(&file, format!("[admin]\n{admin}")).unwrap();
            Place::find(None, Some(&file)).map_err(|error| error.to_string())
        };
        let http = |url: &str| Place::Http(url.to_owned());
        let token_file = Some(folder.path().join("token"));
        assert_eq!(find("").unwrap(), (http("http://127.0.0.1:9378"), None));
        let moved = "listen = \"0.0.0.0:9000\"\ntoken_file = \"token\"";
        assert_eq!(find(moved).unwrap(), (http("http://127.0.0.1:9000"), token_file));
        assert!(find("enabled = false").unwrap_err().contains("cannot be asked"));

        let control = folder.path().join("socket");
        let both = "control = \"socket\"\nlisten = \"127.0.0.1:9000\"";
        assert_eq!(find(both).unwrap(), (http("http://127.0.0.1:9000"), None), "no socket yet");
        let only = find("control = \"socket\"\nenabled = false").unwrap();
        assert_eq!(only, (Place::Control(control.clone()), None));
        let _listener = std::os::unix::net::UnixListener::bind(&control).unwrap();
        assert_eq!(find(both).unwrap(), (Place::Control(control), None));

        let absent = folder.path().join("absent.toml");
        let found = Place::find(None, Some(&absent)).unwrap();
        assert_eq!(found, (http("http://127.0.0.1:9378"), None));
        let named = Place::find(Some("unix:/run/other.sock"), Some(&file)).unwrap();
        assert_eq!(named, (Place::Control("/run/other.sock".into()), None));
    }
}
