//! `pnet-nat status`: what the status page shows, in the terminal.
//!
//! `snapshot` is what the API answers, `table` how it is shown, `refused` both of who is refused, and `events`
//! what happened. Here the relay is asked, once or again and again. `side_by_side` shows several relays.

mod events;
mod refused;
mod side_by_side;
mod snapshot;
mod table;

use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::bail;
use clap::builder::BoolishValueParser;
use serde_json::{Map, Value, json};
use tokio::task::JoinSet;

use super::admin_server::{self, AdminServer, percent_encoded};
use super::output::{Format, Paint, out};
use super::screen::{json_line, watch, width};
use crate::harmless::harmless_value;

use events::Events;
use refused::Refused;
use side_by_side::{Said, as_json};
use snapshot::Snapshot;
use table::Layout;

/// How many senders are asked for.
const MOST_REFUSED: usize = 1000;

/// Show nets and nodes of a running relay: which nodes answer, how fast, and what is dropped.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat status\n\
    \x20         pnet-nat status --watch --net section-1\n\
    \x20         pnet-nat status --events\n\
    \x20         pnet-nat status --refused\n\
    \x20         pnet-nat status --format json | jq '.nets[].silent_nodes'\n\
    \x20         pnet-nat status --target http://10.0.0.1:9378 --target http://10.0.0.2:9378\n\
    Exit codes: 0 shown, whatever the state; 1 no answer of a relay, or not the answer of one.")]
pub(super) struct Args {
    #[command(flatten)]
    relays: admin_server::ManyOptions,

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

    /// Show what happened instead, newest first: nodes that fell silent or answered again, reloads,
    /// throttling, floods. With --net, of this net only.
    #[arg(
        long,
        env = "PNET_NAT_EVENTS",
        value_parser = BoolishValueParser::new(),
        conflicts_with_all = ["watch", "refused"]
    )]
    events: bool,

    /// Show who is refused instead, newest first: the senders of dropped datagrams, for which net and
    /// node, why, how often and when. With --net, for this net only.
    #[arg(long, env = "PNET_NAT_REFUSED", value_parser = BoolishValueParser::new())]
    refused: bool,

    /// Show every node; without it, only the silent ones are shown if there are more than 100. With
    /// --events or --refused, show all of them; without it, the last 50.
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
    let relays = args.relays.each();
    let relays = relays.iter().map(|options| Relay::new(&args, options, relays.len() == 1));
    let relays = relays.collect::<anyhow::Result<Vec<_>>>()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        match (relays.as_slice(), args.watch) {
            ([relay], None) if args.events => events(&args, relay).await,
            ([relay], Some(interval)) => again(&args, relay, interval).await,
            ([relay], None) => once(&args, relay).await,
            _ if args.events || args.refused => {
                bail!("--events and --refused show one relay: give one --target")
            }
            (relays, interval) => many(&args, relays, interval).await,
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

async fn events(args: &Args, relay: &Relay) -> anyhow::Result<ExitCode> {
    let answer = harmless_value(Value::Object(relay.server.get("/api/v1/events").await?));
    let events = Events::read(answer, args.net.as_deref())?;
    let text = match args.format {
        Format::Json => json_line(&json!({ "events": events.0 })),
        Format::Text => events.draw(paper(args.full)),
    };
    out().write_all(text.as_bytes())?;
    Ok(ExitCode::SUCCESS)
}

async fn again(args: &Args, relay: &Relay, interval: Duration) -> anyhow::Result<ExitCode> {
    let mut before: Option<(Instant, Snapshot)> = None;
    watch(interval, args.format, "pnet-nat status, or --net", async || {
        let now = Instant::now();
        let answer = match relay.ask().await {
            Ok(answer) => answer,
            Err(error) => return Ok(Err(error)),
        };
        if args.format == Format::Json {
            return Ok(Ok(json_line(&answer)));
        }
        let earlier = before.as_ref().map(|(then, seen)| (now - *then, seen));
        let (text, seen) = draw(args, relay, answer, earlier)?;
        before = seen.map(|seen| (now, seen));
        Ok(Ok(text))
    })
    .await
}

/// Shows several relays side by side.
async fn many(
    args: &Args,
    relays: &[Arc<Relay>],
    interval: Option<Duration>,
) -> anyhow::Result<ExitCode> {
    if let Some(interval) = interval {
        let for_more = "pnet-nat status, or --net";
        return watch(interval, args.format, for_more, async || Ok(Ok(look(args, relays).await.0)))
            .await;
    }
    let (text, all_answered) = look(args, relays).await;
    out().write_all(text.as_bytes())?;
    Ok(if all_answered { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The text, and whether every relay answered. All are asked at the same time.
async fn look(args: &Args, relays: &[Arc<Relay>]) -> (String, bool) {
    let mut asked = JoinSet::new();
    for (index, relay) in relays.iter().cloned().enumerate() {
        asked.spawn(async move { (index, relay.ask().await) });
    }
    let mut answers = asked.join_all().await;
    answers.sort_by_key(|(index, _)| *index);
    let (mut all, mut seen) = (Vec::new(), Vec::new());
    for (index, answer) in answers {
        let relay = &relays[index];
        let read = answer.and_then(|answer| {
            let snapshot = Snapshot::read(harmless_value(answer.clone()), relay.net.is_some())?;
            Ok((answer, snapshot))
        });
        let (answer, snapshot): (Said<_>, Said<_>) = match read {
            Ok((answer, snapshot)) => (Ok(answer), Ok(snapshot)),
            Err(error) => {
                let error = format!("{error:#}");
                (Err(error.clone()), Err(error))
            }
        };
        all.push((relay.server.url.clone(), answer));
        seen.push((relay.server.url.clone(), snapshot));
    }
    let all_answered = seen.iter().all(|(_, said)| said.is_ok());
    let text = match args.format {
        Format::Json => json_line(&as_json(all, &seen)),
        Format::Text => paper(args.full).side_by_side(&seen),
    };
    (text, all_answered)
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

fn paper(full: bool) -> Layout {
    Layout { paint: Paint::of_stdout(), width: width(), full }
}

/// A relay, and what of it to show.
struct Relay {
    server: AdminServer,
    net: Option<String>,
    /// Whether to show who is refused, and nothing else.
    refused: bool,
    /// Whether to show each node.
    nodes: bool,
}

impl Relay {
    fn new(args: &Args, options: &admin_server::Options, nodes: bool) -> anyhow::Result<Arc<Self>> {
        let server = AdminServer::new(options, args.timeout)?;
        Ok(Arc::new(Self { server, net: args.net.clone(), refused: args.refused, nodes }))
    }

    /// Everything that is shown, as one object.
    async fn ask(&self) -> anyhow::Result<Value> {
        let net = self.net.as_ref().map(|net| format!("&net={}", percent_encoded(net)));
        let net = net.unwrap_or_default();
        let mut all = Map::new();
        if !self.refused {
            let nets = format!("/api/v1/nets?nodes={}{net}", self.nodes);
            all.append(&mut self.get(&nets, "nets").await?);
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
