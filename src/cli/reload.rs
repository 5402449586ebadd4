//! `pnet-nat reload`: has a running relay read its configuration again, and tells the relay's own
//! verdict.

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
/// How often it is asked whether the reload is over.
const PAUSE: Duration = Duration::from_millis(50);

/// Have a running relay read its configuration again, and wait for its verdict.
///
/// With --pid it sends SIGHUP, else it asks the admin server, where [admin] reload = true allows it.
/// The verdict comes from the admin server in both cases.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat reload --config /etc/pnet-nat/pnet-nat.toml\n\
    Exit codes: 0 all of it is in force; 1 it is not, or nobody knows.")]
pub(super) struct Args {
    /// The process of the relay.
    #[arg(long, value_name = "PID", env = "PNET_NAT_PID")]
    pid: Option<i32>,

    #[command(flatten)]
    relay: admin_server::Options,

    /// The relay's configuration, whose [admin] says where the admin server is and what token it wants.
    #[arg(long, value_name = "FILE", env = "PNET_NAT_CONFIG")]
    config: Option<PathBuf>,

    /// How long to wait for the verdict.
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
        return Ok(ExitCode::FAILURE); // whether or not somebody reads why
    }
    shown?;
    Ok(ExitCode::SUCCESS)
}

/// What came of a reload.
struct Verdict {
    successful: bool,
    text: String,
}

/// Sends SIGHUP and waits until a reload is over that began afterwards.
async fn signal(pid: i32, relay: anyhow::Result<Relay>, time: Duration) -> anyhow::Result<Verdict> {
    let before = async {
        let relay = relay?;
        let begun = number(&relay.state().await?, "begun")?;
        anyhow::Ok((relay, begun))
    };
    let before = before.await;
    // Even if nobody can report the outcome: a password that is withdrawn must not stay in force.
    kill(Pid::from_raw(pid), Signal::SIGHUP).with_context(|| {
        format!("process {pid} cannot be signalled; is it the relay, and yours or are you root?")
    })?;
    let told = "the verdict cannot be had; SIGHUP was sent, see the log for what came of it";
    let (relay, before) = before.context(told)?;
    let end = Instant::now() + time;
    while Instant::now() < end {
        sleep(PAUSE).await;
        // While it takes over sockets it may be slow to answer.
        let Ok(state) = relay.state().await else { continue };
        if number(&state, "number")? > before {
            return Ok(Verdict::of(&state));
        }
    }
    bail!("not over within {}: {told}", humantime::format_duration(time))
}

fn number(state: &Value, key: &str) -> anyhow::Result<u64> {
    state[key].as_u64().context("this relay does not number its reloads; is it an older one?")
}

impl Verdict {
    fn of(state: &Value) -> Self {
        let mut text = String::new();
        if let Some(error) = state["error"].as_str() {
            text += &format!("reload failed, and the configuration before it stays: {error}\n");
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

/// The relay whose verdict is wanted.
struct Relay(AdminServer);

impl Relay {
    fn of(args: &Args) -> anyhow::Result<Self> {
        let place = match (&args.relay.url, &args.config) {
            // What is wrong with it, the relay says.
            (None, Some(file)) => {
                config::read_text(file).ok().map(|text| config::admin_place(&text))
            }
            _ => None,
        };
        let place = place.unwrap_or_default();
        if !place.enabled {
            bail!("the admin server is off ([admin] enabled), and it alone tells the verdict");
        }
        let beside = args.config.as_deref().and_then(Path::parent).unwrap_or(Path::new(""));
        let token_file = place.token_file.map(|file| beside.join(file));
        let listen = reachable(place.listen);
        AdminServer::new(&args.relay, listen, token_file.as_deref(), ANSWER_TIME).map(Self)
    }

    /// What the relay says of its last reload.
    async fn state(&self) -> anyhow::Result<Value> {
        self.0.get("/api/v1/status").await?.remove("reload").with_context(|| self.0.no_api())
    }

    /// Asks for a reload and waits for what comes of it.
    async fn post(&self, time: Duration) -> anyhow::Result<Verdict> {
        let (status, text) = self.0.ask(Method::POST, "/-/reload", time).await?;
        let url = &self.0.url;
        match status.as_u16() {
            200 | 409 => Ok(Verdict::of(&self.state().await?)),
            422 => Ok(Verdict { successful: false, text: format!("reload failed\n{text}") }),
            403 => bail!("{url}: {}; or give --pid", text.trim_end()),
            status => bail!("{url} answered {status}: {}", text.trim_end()),
        }
    }
}

/// Where a server that listens on all addresses is reached from here.
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
