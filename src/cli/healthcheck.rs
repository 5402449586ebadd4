//! `pnet-nat healthcheck`: asks a running relay whether it is ready. For containers, which have no shell
//! and no curl.

use std::io::{Write, stdout};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use axum::http::{HeaderMap, Method, StatusCode, Uri};

use super::admin_server::{Place, ask};
use crate::harmless::harmless;

/// What is asked where only a server is named.
const READY: &str = "/-/ready";

/// Ask a running relay whether it is ready: exit 0 if it is, otherwise 1 and a line that says why.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat healthcheck\n\
    \x20         pnet-nat healthcheck --target http://127.0.0.1:9378/-/ready")]
pub(super) struct Args {
    /// The URL to ask, or unix:PATH of the relay's control socket [default: as --config says].
    #[arg(long, alias = "url", env = "PNET_NAT_HEALTHCHECK_URL", value_name = "URL")]
    target: Option<String>,

    /// The relay's configuration file, whose [admin] says where it can be asked [default:
    /// /etc/pnet-nat/pnet-nat.toml].
    #[arg(short, long, value_name = "FILE", env = "PNET_NAT_CONFIG")]
    config: Option<PathBuf>,

    /// How long to wait for the answer.
    #[arg(
        long,
        env = "PNET_NAT_HEALTHCHECK_TIMEOUT",
        value_name = "TIME",
        default_value = "3s",
        value_parser = humantime::parse_duration
    )]
    timeout: Duration,
}

/// Asks once.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let (url, why) = match Place::find(args.target.as_deref(), args.config.as_deref()) {
        Ok((place, _)) => {
            let path = if names_a_path(&place) { "" } else { READY };
            let no_headers = HeaderMap::new();
            let answer = ask(Method::GET, &place, path, &no_headers, args.timeout);
            let why = match runtime.block_on(answer) {
                Ok((StatusCode::OK, _)) => return Ok(ExitCode::SUCCESS),
                Ok((status, _)) => format!("answered {status}"),
                Err(error) => harmless(&format!("{error:#}")),
            };
            (format!("{}{path}: ", place.url()), why)
        }
        Err(error) => (String::new(), harmless(&format!("{error:#}"))),
    };
    // Nobody may read this; then the exit code is enough.
    let _ = writeln!(stdout(), "not ready: {url}{why}");
    Ok(ExitCode::FAILURE)
}

fn names_a_path(place: &Place) -> bool {
    let Place::Http(url) = place else { return false };
    url.parse().is_ok_and(|url: Uri| !matches!(url.path(), "" | "/"))
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};
    use std::net::TcpListener;
    use std::thread;

    use super::*;

    /// Asks a server that answers one request with this status line.
    fn ask(status: &'static str) -> ExitCode {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/", listener.local_addr().unwrap());
        let server = thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let request = BufReader::new(&stream).lines().map_while(Result::ok);
            let request: Vec<_> = request.take_while(|line| !line.is_empty()).collect();
            assert_eq!(request[0], "GET /-/ready HTTP/1.1");
            let headers = "content-length: 0\r\nconnection: close\r\nlocation: /\r\n";
            write!(stream, "HTTP/1.1 {status}\r\n{headers}\r\n").unwrap();
        });
        let code = run(Args { target: Some(url), config: None, timeout: Duration::from_secs(10) })
            .unwrap();
        server.join().unwrap();
        code
    }

    #[test]
    fn only_200_is_ready() {
        assert_eq!(ask("200 OK"), ExitCode::SUCCESS);
        for status in ["503 Service Unavailable", "204 No Content", "302 Found", "404 Not Found"] {
            assert_eq!(ask(status), ExitCode::FAILURE, "{status}");
        }
    }

    #[test]
    fn a_server_that_is_silent_or_absent_is_not_ready() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = Some(format!("http://{}/", listener.local_addr().unwrap()));
        let timeout = Duration::from_millis(200);
        let args = |target| Args { target, config: None, timeout };
        assert_eq!(run(args(url.clone())).unwrap(), ExitCode::FAILURE);
        drop(listener);
        assert_eq!(run(args(url)).unwrap(), ExitCode::FAILURE);
    }
}
