//! `pnet-nat probe`: what is wrong between clients, router and nodes, found on the router.
//!
//! `host` and `system` read what the system says, and `relay` what a running relay says; `net`, `ports`, `firewall`,
//! `conntrack` and `machine` are the checks, each a function of what was read. Those of a node are in
//! [`crate::probe`]. Invariant: nothing is changed, and a node gets one harmless request at a time.

mod conntrack;
mod firewall;
mod host;
mod machine;
mod net;
mod ports;
mod print;
mod relay;
mod system;

use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use clap::builder::BoolishValueParser;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep};

use super::admin_server::{self, AdminServer};
use super::output::{Format, Paint, out};
use super::progress::{ProgressLine, bar};
use super::{BAD_USE, complain, source, told};
use crate::config::Config;
use crate::harmless::harmless_json;
use crate::nat::{Mapping, NetId};
use crate::peer::until;
use crate::probe::{Asked, Check, Report, Verdict};
use relay::Relay;
use system::System;

/// Nodes that are asked at the same time. Each has its own socket.
const AT_ONCE: usize = 64;
/// Time from the first request to one node to that of the next, so that none waits for the others, and the
/// plant gets no burst.
const STEP: Duration = Duration::from_millis(2);
/// How long the relay may take for an answer.
const RELAY_TIME: Duration = Duration::from_secs(3);

/// Find out on the router why there is no answer: interfaces, routes, firewall, ports, and each node.
///
/// Each check is a line: good, doubtful, bad, or unknown where it cannot be told from here, and what to do
/// about it. Nothing is changed. Each node is asked with a request that has no data, once with each password
/// of its net.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat probe\n\
    \x20         pnet-nat probe --net section-1 --node 3\n\
    As root it sees more: the firewall, and whose the ports are. Exit codes: 0 nothing is bad, 1 something \
    is, 2 bad command line or configuration.")]
pub(super) struct Args {
    #[command(flatten)]
    relay: admin_server::Options,

    /// Only this net.
    #[arg(long, value_name = "NAME", env = "PNET_NAT_NET")]
    net: Option<String>,

    /// Only the node with this node address.
    #[arg(long, value_name = "NODE", env = "PNET_NAT_NODE")]
    node: Option<u8>,

    /// Show each node that answers, and not only how many do.
    #[arg(long, env = "PNET_NAT_FULL", value_parser = BoolishValueParser::new())]
    full: bool,

    /// How long to wait for each answer of a node.
    #[arg(
        long,
        value_name = "TIME",
        default_value = "1s",
        value_parser = humantime::parse_duration,
        env = "PNET_NAT_TIMEOUT"
    )]
    timeout: Duration,

    /// Output: a line for each check, or one JSON object.
    #[arg(long, value_enum, default_value_t = Format::Text, env = "PNET_NAT_FORMAT")]
    format: Format,
}

/// Makes all checks and prints them. The exit code is 1 when one of them is bad.
pub(super) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let read = source(args.relay.files.config.as_deref());
    // The host's routes are checked here, and do not refuse the configuration.
    let (config, _) = match read.and_then(|source| told(source.load_without_host())) {
        Ok(read) => read,
        Err(code) => return Ok(code),
    };
    let mappings = match selected(args, &config) {
        Ok(mappings) => mappings,
        Err(message) => {
            complain(format_args!("pnet-nat: {message}"));
            return Ok(ExitCode::from(BAD_USE));
        }
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let report = Report::new(runtime.block_on(probe(args, &config, &mappings)));
    let text = match args.format {
        Format::Text => print::text(&report, args.full, Paint::of_stdout()),
        Format::Json => harmless_json(&serde_json::to_string(&report)?) + "\n",
    };
    out().write_all(text.as_bytes())?;
    Ok(if report.verdict == Verdict::Bad { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// The mappings that are probed; otherwise what is wrong with the command line.
fn selected(args: &Args, config: &Config) -> Result<Vec<Mapping>, String> {
    let table = &config.table;
    let is_wanted =
        |net: &NetId| args.net.as_ref().is_none_or(|name| table.net(*net).name == *name);
    let nets: Vec<_> = table.net_ids().filter(is_wanted).collect();
    if let (true, Some(name)) = (nets.is_empty(), &args.net) {
        return Err(format!("no net has the name {name:?}"));
    }
    let mappings = nets.into_iter().flat_map(|net| table.mappings_of(net));
    let mappings = mappings.map(|mapping| table.mapping(mapping));
    let is_wanted = |mapping: &Mapping| args.node.is_none_or(|node| mapping.node_address == node);
    let mappings: Vec<_> = mappings.filter(is_wanted).collect();
    match args.node.filter(|_| mappings.is_empty()) {
        Some(node) => Err(format!("no net has a node {node}, or not the one of --net")),
        None => Ok(mappings),
    }
}

/// All checks, from the machine to the nodes.
async fn probe(args: &Args, config: &Config, mappings: &[Mapping]) -> Vec<Check> {
    let relay = ask_relay(args, config).await;
    let mut checks = match &relay {
        Some(Ok(relay)) => relay.judge(),
        Some(Err(error)) => vec![relay::no_answer(error)],
        None => vec![relay::no_admin_server()],
    };
    let relay = relay.and_then(Result::ok);
    let system = System::read();
    checks.extend(system.machine(config));
    for mappings in mappings.chunk_by(|a, b| a.net == b.net) {
        checks.extend(system.net(config, mappings));
        let name = &config.table.net(mappings[0].net).name;
        checks.extend(relay.iter().flat_map(|relay| relay.judge_net(name)));
    }
    let asked: Vec<_> = mappings.iter().map(|mapping| Asked::of(config, mapping)).collect();
    let seen = ask_nodes(asked, args.timeout).await;
    for (mapping, of_node) in mappings.iter().zip(seen) {
        checks.extend(of_node.checks);
        let net = &config.table.net(mapping.net).name;
        let counted = relay.as_ref().and_then(|relay| relay.counted(net, mapping.node_address));
        checks.extend(counted.iter().flat_map(|counted| counted.judge(&of_node.subject)));
    }
    checks
}

/// Asks the relay; none where it cannot be asked.
async fn ask_relay(args: &Args, config: &Config) -> Option<anyhow::Result<Relay>> {
    Some(match AdminServer::new(&args.relay, RELAY_TIME) {
        Ok(server) => Relay::ask(&server).await,
        Err(_) if config.admin.is_none() => return None,
        Err(error) => Err(error),
    })
}

/// The checks of a node.
struct OfNode {
    subject: String,
    checks: Vec<Check>,
}

/// Asks all nodes, some of them at the same time, and shows how far it is.
async fn ask_nodes(asked: Vec<Asked>, answer_time: Duration) -> Vec<OfNode> {
    let (all, room) = (asked.len(), Arc::new(Semaphore::new(AT_ONCE)));
    let mut asking = JoinSet::new();
    for (index, asked) in asked.into_iter().enumerate() {
        let room = Arc::clone(&room);
        let steps = u32::try_from(index).unwrap_or(u32::MAX);
        asking.spawn(async move {
            sleep(STEP * steps).await;
            let _place = room.acquire().await;
            let seen = asked.ask(answer_time).await;
            (index, OfNode { checks: asked.judge(seen.as_ref()), subject: asked.subject })
        });
    }
    let mut progress = ProgressLine::new(true);
    let mut done = Vec::with_capacity(all);
    loop {
        tokio::select! {
            finished = asking.join_next() => match finished {
                Some(Ok(finished)) => done.push(finished),
                Some(Err(_)) => {}
                None => break,
            },
            () = until(progress.due().map(Instant::from)) => {
                let share = done.len() as f64 / all.max(1) as f64;
                progress.draw(&format!("{}, {} of {all} nodes", bar(share), done.len()));
            }
        }
    }
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, of_node)| of_node).collect()
}
