//! `pnet-nat flows`: who is connected, and which passwords are used.
//!
//! `table` is how the relay's answer is shown. Here the relay is asked, once or again and again.

mod table;

use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::Context;
use clap::builder::BoolishValueParser;
use serde_json::Value;

use super::admin_server::{self, AdminServer, percent_encoded};
use super::output::{Format, out};
use super::screen::{json_line, watch};
use crate::harmless::harmless_value;

use table::Flows;

/// Show who is connected to a running relay: clients, their nodes and passwords, and what passes.
///
/// A line is a client of a net with all of its nodes. Below, each password: how many requests carried it
/// since the start, and how many of the flows use it now.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat flows\n\
    \x20         pnet-nat flows --watch --net section-1\n\
    \x20         pnet-nat flows --format json | jq '.flows[].client'\n\
    Exit codes: 0 shown, whatever is connected; 1 no answer, or not the answer of a relay.")]
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

    /// Ask for this many flows at most.
    #[arg(
        long,
        value_name = "N",
        env = "PNET_NAT_LIMIT",
        default_value_t = 1000,
        value_parser = clap::value_parser!(u16).range(1..=10_000)
    )]
    limit: u16,

    /// Show each flow by itself: with the client's port, and one node a line.
    #[arg(long, env = "PNET_NAT_FULL", value_parser = BoolishValueParser::new())]
    full: bool,

    /// Show it again every 2 s, or at this interval, until Ctrl-C.
    #[arg(
        long,
        env = "PNET_NAT_WATCH",
        value_name = "TIME",
        num_args = 0..=1,
        default_missing_value = "2s",
        value_parser = humantime::parse_duration
    )]
    watch: Option<Duration>,

    /// Output: tables for people, or one JSON object a line, with each flow by itself.
    #[arg(
        long,
        env = "PNET_NAT_FORMAT",
        value_name = "FORMAT",
        value_enum,
        default_value_t = Format::Text
    )]
    format: Format,
}

/// Shows the flows once, or again and again until Ctrl-C.
pub(super) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let relay = AdminServer::new(&args.relay, args.timeout)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        match args.watch {
            Some(interval) => {
                let more = "pnet-nat flows, or --net";
                watch(interval, args.format, more, async || Ok(text(args, &relay).await)).await
            }
            None => {
                out().write_all(text(args, &relay).await?.as_bytes())?;
                Ok(ExitCode::SUCCESS)
            }
        }
    })
}

/// What is shown.
async fn text(args: &Args, relay: &AdminServer) -> anyhow::Result<String> {
    let net = args.net.as_ref().map(|net| format!("&net={}", percent_encoded(net)));
    let path = format!("/api/v1/flows?limit={}{}", args.limit, net.unwrap_or_default());
    let answer = Value::Object(relay.get(&path).await?);
    Ok(match args.format {
        Format::Json => json_line(&answer),
        Format::Text => {
            let flows = serde_json::from_value::<Flows>(harmless_value(answer));
            flows.with_context(|| relay.no_api())?.draw(args.full)
        }
    })
}
