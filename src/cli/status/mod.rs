//! `pnet-nat status`: what the status page shows, in the terminal.
//!
//! `seen` is what the API tells, `table` how it looks. Here it is asked for, once or again and again.

mod snapshot;
mod table;

use std::fs;
use std::io::{self, IsTerminal, Write, stdout};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};
use clap::builder::BoolishValueParser;
use serde_json::{Map, Value, json};
use terminal_size::{Height, Width, terminal_size_of};
use tokio::sync::oneshot;
use ureq::Agent;

use super::agent::agent;
use super::output::{Format, Paint, out};
use super::signals::Signals;
use crate::config::Token;
use crate::harmless::{harmless, harmless_json, harmless_value};
use crate::logging::no_color;
use crate::thread::{self, ThreadError};

use snapshot::Snapshot;
use table::Layout;

/// As many octets as an answer may have: nets with 8,000 nodes make 6 MB.
const MOST_OCTETS: u64 = 64 << 20;

/// Show nets and nodes of a running relay: who answers, how fast, and what is dropped.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat status\n\
    \x20         pnet-nat status --watch --net section-1\n\
    \x20         pnet-nat status --format json | jq '.nets[].silent_nodes'\n\
    Exit codes: 0 shown, whatever there is to see; 1 no answer, or none of a relay.")]
pub(super) struct Args {
    /// Where the relay's admin server is: host and port are those of [admin] listen.
    #[arg(
        long,
        env = "PNET_NAT_STATUS_URL",
        value_name = "URL",
        default_value = "http://127.0.0.1:9378"
    )]
    url: String,

    /// File with the token, where [admin] token_file is set.
    #[arg(long, env = "PNET_NAT_TOKEN_FILE", value_name = "FILE")]
    token_file: Option<PathBuf>,

    /// How long to wait for the answer.
    #[arg(
        long,
        env = "PNET_NAT_STATUS_TIMEOUT",
        value_name = "TIME",
        default_value = "5s",
        value_parser = humantime::parse_duration
    )]
    timeout: Duration,

    /// This net alone.
    #[arg(long, value_name = "NAME", env = "PNET_NAT_NET")]
    net: Option<String>,

    /// Every node; without it, of more than 100 only those that are silent.
    #[arg(long, env = "PNET_NAT_FULL", value_parser = BoolishValueParser::new())]
    full: bool,

    /// Show it anew every 2 s, or as often as said, with rates, until Ctrl-C.
    #[arg(
        long,
        env = "PNET_NAT_WATCH",
        value_name = "TIME",
        num_args = 0..=1,
        default_missing_value = "2s",
        value_parser = humantime::parse_duration
    )]
    watch: Option<Duration>,

    /// How it is shown: tables for people, or one JSON object a line.
    #[arg(
        long,
        env = "PNET_NAT_FORMAT",
        value_name = "FORMAT",
        value_enum,
        default_value_t = Format::Text
    )]
    format: Format,
}

/// Shows it once, or until Ctrl-C.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    let relay = Relay::new(&args)?;
    let Some(interval) = args.watch else {
        let text = match args.format {
            Format::Json => format!("{}\n", harmless_json(&relay.ask()?.to_string())),
            Format::Text => paper(args.full).draw(&relay.read(relay.ask()?)?, None, &relay.url),
        };
        out().write_all(text.as_bytes())?;
        return Ok(ExitCode::SUCCESS);
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(watch(&args, relay.into(), interval))
}

/// A relay that does not answer now may do so again: that is shown, and is no end.
async fn watch(args: &Args, relay: Arc<Relay>, interval: Duration) -> anyhow::Result<ExitCode> {
    let mut signals = Signals::new()?;
    let asking = asking(Arc::clone(&relay))?;
    let mut before: Option<(Instant, Snapshot)> = None;
    loop {
        let now = Instant::now();
        let (reply, answer) = oneshot::channel();
        // A thread that is gone drops the reply.
        let _ = asking.send(reply);
        let answer = tokio::select! {
            answer = answer => answer?,
            _ = signals.next() => return Ok(ExitCode::SUCCESS),
        };
        let text = match (answer, args.format) {
            (Ok(answer), Format::Json) => format!("{}\n", harmless_json(&answer.to_string())),
            (Ok(answer), Format::Text) => {
                let seen = relay.read(answer)?;
                let earlier = before.as_ref().map(|(then, seen)| (now - *then, seen));
                let text = paper(args.full).draw(&seen, earlier, &relay.url);
                before = Some((now, seen));
                text
            }
            (Err(error), Format::Json) => {
                format!(
                    "{}\n",
                    harmless_json(&json!({ "error": format!("{error:#}") }).to_string())
                )
            }
            (Err(error), Format::Text) => {
                format!("pnet-nat: {}\n", harmless(&format!("{error:#}")))
            }
        };
        show(&text, args.format)?;
        tokio::select! {
            _ = signals.next() => return Ok(ExitCode::SUCCESS),
            () = tokio::time::sleep(interval) => {}
        }
    }
}

/// Asks when it is told to, in a thread of its own: a signal is heeded while nobody answers.
fn asking(relay: Arc<Relay>) -> Result<mpsc::Sender<Reply>, ThreadError> {
    let (asking, replies) = mpsc::channel::<Reply>();
    thread::start("ask", move || {
        for reply in replies {
            // Who asked may have gone; then nobody wants to know.
            let _ = reply.send(relay.ask());
        }
    })?;
    Ok(asking)
}

/// Where an answer goes.
type Reply = oneshot::Sender<anyhow::Result<Value>>;

/// Shows a table in place of the one before it, as far as the terminal has room.
fn show(text: &str, format: Format) -> io::Result<()> {
    let mut out = out();
    let (Some((_, height)), Format::Text) = (terminal(), format) else {
        out.write_all(text.as_bytes())?;
        return out.flush();
    };
    let room = usize::from(height.0).saturating_sub(2);
    write!(out, "\x1b[H\x1b[?7l")?; // to the top; lines do not wrap
    for line in text.lines().take(room) {
        writeln!(out, "{line}\x1b[K")?;
    }
    write!(out, "\x1b[J\x1b[?7h")?; // the rest of what was there goes
    if let Some(more) = text.lines().count().checked_sub(room).filter(|more| *more > 0) {
        write!(out, "{more} more lines: pnet-nat status, or --net\r")?;
    }
    out.flush()
}

fn paper(full: bool) -> Layout {
    Layout {
        paint: Paint { colour: stdout().is_terminal() && !no_color() },
        width: terminal().map(|(width, _)| width.0),
        full,
    }
}

/// The size of the terminal that stdout is; none where it is another thing.
fn terminal() -> Option<(Width, Height)> {
    terminal_size_of(stdout())
}

/// The way to a relay's API.
struct Relay {
    agent: Agent,
    url: String,
    net: Option<String>,
    /// The value of `Authorization`.
    bearer: Option<String>,
}

impl Relay {
    fn new(args: &Args) -> anyhow::Result<Self> {
        let agent = agent(args.timeout);
        let url = args.url.trim_end_matches('/').to_owned();
        let bearer = args.token_file.as_deref().map(bearer).transpose()?;
        Ok(Self { agent, url, net: args.net.clone(), bearer })
    }

    /// All that is shown, as one object.
    fn ask(&self) -> anyhow::Result<Value> {
        let nets = self.get("/api/v1/nets", self.net.as_deref())?.remove("nets");
        let nets = nets.with_context(|| not_the_api(&self.url))?;
        Ok(json!({
            "status": self.get("/api/v1/status", None)?,
            "drop_reasons": self.get("/api/v1/drop-reasons", None)?,
            "nets": nets,
        }))
    }

    fn read(&self, answer: Value) -> anyhow::Result<Snapshot> {
        Snapshot::read(harmless_value(answer), self.net.is_some())
    }

    fn get(&self, path: &str, net: Option<&str>) -> anyhow::Result<Map<String, Value>> {
        let url = format!("{}{path}", self.url);
        let mut request = self.agent.get(&url);
        if let Some(net) = net {
            request = request.query("net", net);
        }
        if let Some(bearer) = &self.bearer {
            request = request.header("authorization", bearer.as_str());
        }
        let no_answer = |error: ureq::Error| {
            anyhow!(
                "no answer from {}: {error}; is the relay running, and is this its [admin] listen? \
                 See --url",
                self.url
            )
        };
        let mut answer = request.call().map_err(no_answer)?;
        let text = answer.body_mut().with_config().limit(MOST_OCTETS).read_to_string();
        let text = text.map_err(no_answer)?;
        match (answer.status().as_u16(), &self.bearer) {
            (200, _) => serde_json::from_str(&text).with_context(|| not_the_api(&url)),
            (401, None) => bail!("{url} asks for a token: --token-file, as in [admin] token_file"),
            (401, Some(_)) => bail!("{url} has another token than the one of --token-file"),
            (status, _) => bail!("{url} answered {status}: {}", harmless(text.trim_end())),
        }
    }
}

fn not_the_api(url: &str) -> String {
    format!("{url} is not the API of a pnet-nat")
}

/// The value of `Authorization` with the token in a file.
pub(super) fn bearer(path: &Path) -> anyhow::Result<String> {
    let text = fs::read_to_string(path).with_context(|| format!("{path:?} cannot be read"))?;
    let token = text.trim_end_matches(['\n', '\r']);
    Token::new(token.as_bytes()).with_context(|| format!("{path:?}"))?;
    Ok(format!("Bearer {token}"))
}
