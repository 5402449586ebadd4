//! `pnet-nat status`: what the status page shows, in the terminal.
//!
//! `snapshot` is what the API answers, `table` how it is shown, and `refused` both of who is refused.
//! Here the relay is asked, once or again and again.

mod refused;
mod snapshot;
mod table;

use std::io::{self, Write, stdout};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::bail;
use clap::builder::BoolishValueParser;
use serde_json::{Map, Value, json};
use terminal_size::{Height, Width, terminal_size_of};

use super::admin_server::{self, AdminServer};
use super::output::{Format, Paint, out};
use super::signals::Signals;
use crate::config::AdminPlace;
use crate::harmless::{harmless, harmless_json, harmless_value};

use refused::Refused;
use snapshot::Snapshot;
use table::Layout;

/// How many senders are asked for.
const MOST_REFUSED: usize = 1000;

/// Show nets and nodes of a running relay: which nodes answer, how fast, and what is dropped.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat status\n\
    \x20         pnet-nat status --watch --net section-1\n\
    \x20         pnet-nat status --refused\n\
    \x20         pnet-nat status --format json | jq '.nets[].silent_nodes'\n\
    Exit codes: 0 shown, whatever the state; 1 no answer, or not the answer of a relay.")]
pub(super) struct Args {
    #[command(flatten)]
    relay: admin_server::Options,

    /// How long to wait for each answer.
    #[arg(
        long,
        env = "PNET_NAT_STATUS_TIMEOUT",
        value_name = "TIME",
        default_value = "5s",
        value_parser = humantime::parse_duration
    )]
    timeout: Duration,

    /// Show only this net.
    #[arg(long, value_name = "NAME", env = "PNET_NAT_NET")]
    net: Option<String>,

    /// Show who is refused instead, newest first: the senders of dropped datagrams, for which net and
    /// node, why, how often and when. With --net, for this net only.
    #[arg(long, env = "PNET_NAT_REFUSED", value_parser = BoolishValueParser::new())]
    refused: bool,

    /// Show every node; without it, only the silent ones are shown if there are more than 100. With
    /// --refused, show every sender; without it, the last 50.
    #[arg(long, env = "PNET_NAT_FULL", value_parser = BoolishValueParser::new())]
    full: bool,

    /// Show it again every 2 s, or at this interval, with rates, until Ctrl-C.
    #[arg(
        long,
        env = "PNET_NAT_WATCH",
        value_name = "TIME",
        num_args = 0..=1,
        default_missing_value = "2s",
        value_parser = humantime::parse_duration
    )]
    watch: Option<Duration>,

    /// Output: tables for people, or one JSON object a line.
    #[arg(
        long,
        env = "PNET_NAT_FORMAT",
        value_name = "FORMAT",
        value_enum,
        default_value_t = Format::Text
    )]
    format: Format,
}

/// Shows the status once, or again and again until Ctrl-C.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    let relay = Relay::new(&args)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        match args.watch {
            Some(interval) => watch(&args, &relay, interval).await,
            None => once(&args, &relay).await,
        }
    })
}

async fn once(args: &Args, relay: &Relay) -> anyhow::Result<ExitCode> {
    let answer = relay.ask().await?;
    let text = match args.format {
        Format::Json => json_line(&answer),
        Format::Text => draw(args, relay, answer, None)?.0,
    };
    out().write_all(text.as_bytes())?;
    Ok(ExitCode::SUCCESS)
}

/// Goes on when the relay does not answer, since it may answer again later.
async fn watch(args: &Args, relay: &Relay, interval: Duration) -> anyhow::Result<ExitCode> {
    let mut signals = Signals::new()?;
    let mut before: Option<(Instant, Snapshot)> = None;
    loop {
        let now = Instant::now();
        let answer = tokio::select! {
            answer = relay.ask() => answer,
            _ = signals.next() => return Ok(ExitCode::SUCCESS),
        };
        let text = match (answer, args.format) {
            (Ok(answer), Format::Json) => json_line(&answer),
            (Ok(answer), Format::Text) => {
                let earlier = before.as_ref().map(|(then, seen)| (now - *then, seen));
                let (text, seen) = draw(args, relay, answer, earlier)?;
                before = seen.map(|seen| (now, seen));
                text
            }
            (Err(error), Format::Json) => json_line(&json!({ "error": format!("{error:#}") })),
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

/// The text, and the state that the next look is compared with.
fn draw(
    args: &Args,
    relay: &Relay,
    answer: Value,
    earlier: Option<(Duration, &Snapshot)>,
) -> anyhow::Result<(String, Option<Snapshot>)> {
    let answer = harmless_value(answer);
    if args.refused {
        return Ok((Refused::read(answer)?.draw(paper(args.full)), None));
    }
    let seen = Snapshot::read(answer, relay.net.is_some())?;
    let text = paper(args.full).draw(&seen, earlier, &relay.server.url);
    Ok((text, Some(seen)))
}

fn json_line(value: &Value) -> String {
    harmless_json(&value.to_string()) + "\n"
}

/// Shows a table in place of the one before, cut to the height of the terminal.
fn show(text: &str, format: Format) -> io::Result<()> {
    let mut out = out();
    let (Some((_, height)), Format::Text) = (terminal(), format) else {
        out.write_all(text.as_bytes())?;
        return out.flush();
    };
    let room = usize::from(height.0).saturating_sub(2);
    write!(out, "\x1b[H\x1b[?7l")?; // cursor to the top, no wrapping
    for line in text.lines().take(room) {
        writeln!(out, "{line}\x1b[K")?;
    }
    write!(out, "\x1b[J\x1b[?7h")?; // clear the rest, wrap again
    if let Some(more) = text.lines().count().checked_sub(room).filter(|more| *more > 0) {
        write!(out, "{more} more lines: pnet-nat status, or --net\r")?;
    }
    out.flush()
}

fn paper(full: bool) -> Layout {
    Layout { paint: Paint::of_stdout(), width: terminal().map(|(width, _)| width.0), full }
}

/// The size of the terminal; none if stdout is not a terminal.
fn terminal() -> Option<(Width, Height)> {
    terminal_size_of(stdout())
}

/// A relay, and what of it to show.
struct Relay {
    server: AdminServer,
    net: Option<String>,
    /// Whether to show who is refused, and nothing else.
    refused: bool,
}

impl Relay {
    fn new(args: &Args) -> anyhow::Result<Self> {
        let usual = AdminPlace::default().listen;
        let server = AdminServer::new(&args.relay, usual, None, args.timeout)?;
        Ok(Self { server, net: args.net.clone(), refused: args.refused })
    }

    /// Everything that is shown, as one object.
    async fn ask(&self) -> anyhow::Result<Value> {
        // Percent-encoded as a whole, so that any text is possible.
        let encoded = |net: &String| net.bytes().map(|octet| format!("%{octet:02x}")).collect();
        let net: Option<String> = self.net.as_ref().map(encoded);
        let net = net.map(|net| format!("&net={net}")).unwrap_or_default();
        let mut all = Map::new();
        if !self.refused {
            all.append(&mut self.get(&format!("/api/v1/nets?nodes=true{net}"), "nets").await?);
            all.insert("status".to_owned(), self.server.get("/api/v1/status").await?.into());
        }
        let refused = format!("/api/v1/refused?limit={MOST_REFUSED}{net}");
        all.append(&mut self.get(&refused, "refused").await?);
        let drop_reasons = self.server.get("/api/v1/drop-reasons").await?;
        all.insert("drop_reasons".to_owned(), drop_reasons.into());
        Ok(all.into())
    }

    /// The answer at a path, which has to have this member.
    async fn get(&self, path: &str, member: &str) -> anyhow::Result<Map<String, Value>> {
        let answer = self.server.get(path).await?;
        if !answer.contains_key(member) {
            bail!(self.server.no_api());
        }
        Ok(answer)
    }
}
