//! `pnet-nat reload`: makes a running relay read its configuration again, and prints the outcome that the
//! relay reports.

use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use axum::http::Method;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use tokio::time::sleep;

use super::admin_server::{self, AdminServer};
use super::output::out;
use crate::config;
use crate::harmless::harmless_lines;

/// How long one answer may take. The reload itself may take longer.
const ANSWER_TIME: Duration = Duration::from_secs(5);
/// How long to wait before asking again whether the reload is over.
const PAUSE: Duration = Duration::from_millis(50);

/// Make a running relay read its configuration again, and wait for the outcome.
///
/// With --pid it sends SIGHUP; otherwise it asks the admin server, which needs [admin] reload = true. In
/// both cases the admin server reports the outcome.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat reload --config /etc/pnet-nat/pnet-nat.toml\n\
    Exit codes: 0 all of the configuration is in force; 1 it is not, or the outcome is not known.")]
pub(super) struct Args {
    /// Process ID of the relay.
    #[arg(long, value_name = "PID", env = "PNET_NAT_PID")]
    pid: Option<i32>,

    #[command(flatten)]
    relay: admin_server::Options,

    /// The relay's configuration file; its [admin] says where the admin server is and which token it needs.
    #[arg(long, value_name = "FILE", env = "PNET_NAT_CONFIG")]
    config: Option<PathBuf>,

    /// How long to wait for the outcome.
    #[arg(
        long,
        env = "PNET_NAT_RELOAD_TIMEOUT",
        value_name = "TIME",
        default_value = "60s",
        value_parser = humantime::parse_duration
    )]
    timeout: Duration,
}

/// Reloads once.
pub(super) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let verdict = runtime.block_on(async {
        let relay = Relay::of(args);
        match args.pid {
            Some(pid) => signal(pid, relay, args.timeout).await,
            None => relay?.post(args.timeout).await,
        }
    })?;
    let shown = out().write_all(harmless_lines(&verdict.text).as_bytes());
    if !verdict.successful {
        return Ok(ExitCode::FAILURE); // even if the reason cannot be written
    }
    shown?;
    Ok(ExitCode::SUCCESS)
}

/// The outcome of a reload.
struct Verdict {
    successful: bool,
    text: String,
}

/// Sends SIGHUP and waits for the end of a reload that began afterwards.
async fn signal(pid: i32, relay: anyhow::Result<Relay>, time: Duration) -> anyhow::Result<Verdict> {
    let before = async {
        let relay = relay?;
        let begun = number(&relay.state().await?, "begun")?;
        anyhow::Ok((relay, begun))
    };
    let before = before.await;
    // Even if nobody can report the outcome: a password that is withdrawn must not stay in force.
    kill(Pid::from_raw(pid), Signal::SIGHUP).with_context(|| {
        format!("process {pid} cannot be signalled; is it the relay, and are you its user or root?")
    })?;
    let told = "the outcome is not known; SIGHUP was sent, see the log of the relay";
    let (relay, before) = before.context(told)?;
    let end = Instant::now() + time;
    while Instant::now() < end {
        sleep(PAUSE).await;
        // It may be slow to answer while the reload runs.
        let Ok(state) = relay.state().await else { continue };
        if number(&state, "number")? > before {
            return Ok(Verdict::of(&state));
        }
    }
    bail!("the reload took more than {}: {told}", humantime::format_duration(time))
}

fn number(state: &Value, key: &str) -> anyhow::Result<u64> {
    state[key].as_u64().context("this relay does not number its reloads; is it an older version?")
}

impl Verdict {
    fn of(state: &Value) -> Self {
        let mut text = String::new();
        if let Some(error) = state["error"].as_str() {
            text += &format!("reload failed, the configuration in force stays: {error}\n");
        }
        for fault in state["faults"].as_array().into_iter().flatten() {
            text += &format!("{}\n", fault.as_str().unwrap_or_default());
        }
        text += &items(state);
        let successful = state["successful"] == true;
        if successful {
            text += "all of the configuration is in force\n";
        }
        Self { successful, text }
    }
}

/// A line for each item that is not in force.
fn items(state: &Value) -> String {
    let items = state["not_in_force"].as_array().into_iter().flatten();
    let line = |item: &Value| {
        let text = |key: &str| item[key].as_str().unwrap_or_default().to_owned();
        format!("not in force: {}: {}\n", text("what"), text("why"))
    };
    items.map(line).collect()
}

/// The relay to reload.
struct Relay(AdminServer);

impl Relay {
    fn of(args: &Args) -> anyhow::Result<Self> {
        let place = match (&args.relay.url, &args.config) {
            // The relay reports the faults of the file.
            (None, Some(file)) => {
                config::read_text(file).ok().map(|text| config::admin_place(&text))
            }
            _ => None,
        };
        let place = place.unwrap_or_default();
        if !place.enabled {
            bail!("the admin server is off ([admin] enabled), and only it reports the outcome");
        }
        let beside = args.config.as_deref().and_then(Path::parent).unwrap_or(Path::new(""));
        let token_file = place.token_file.map(|file| beside.join(file));
        let listen = reachable(place.listen);
        AdminServer::new(&args.relay, listen, token_file.as_deref(), ANSWER_TIME).map(Self)
    }

    /// The relay's last reload, as its API has it.
    async fn state(&self) -> anyhow::Result<Value> {
        self.0.get("/api/v1/status").await?.remove("reload").with_context(|| self.0.no_api())
    }

    /// Asks the admin server for a reload and waits for the outcome.
    async fn post(&self, time: Duration) -> anyhow::Result<Verdict> {
        let (status, text) = self.0.ask(Method::POST, "/-/reload", time).await?;
        let url = &self.0.url;
        match status.as_u16() {
            200 | 409 => Ok(Verdict::of(&self.state().await?)),
            422 => Ok(Verdict { successful: false, text: format!("reload failed\n{text}") }),
            403 => bail!("{url}: {}; or use --pid", text.trim_end()),
            status => bail!("{url} answered {status}: {}", text.trim_end()),
        }
    }
}

/// An address to reach the server at; it may listen on all addresses.
pub(super) fn reachable(mut listen: SocketAddr) -> SocketAddr {
    if listen.ip().is_unspecified() {
        let loopback: IpAddr = match listen {
            SocketAddr::V4(_) => Ipv4Addr::LOCALHOST.into(),
            SocketAddr::V6(_) => Ipv6Addr::LOCALHOST.into(),
        };
        listen.set_ip(loopback);
    }
    listen
}
