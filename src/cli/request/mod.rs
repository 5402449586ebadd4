//! `pnet-nat request`: asks server nodes as a remote client does.
//!
//! `peer::client_node` exchanges the datagrams. Here are the options; `routes` makes of them where the
//! requests go, `asking` sends them in rounds, and `report` is what is printed. Invariant: no password is
//! ever printed.

mod asking;
mod report;
mod routes;
mod schedule;

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use super::output::Format;
use super::{BAD_USE, complain, password_file, values};
use crate::config::NodeRange;
use crate::peer::{ClientNode, Share};
use crate::pnet::endpoint::client::MAX_ENDPOINTS;
use crate::pnet::wire::{Elements, IpNetId, Password};

/// Ask server nodes behind a NAT router, as a remote client does.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:  pnet-nat request --to 192.0.2.1 --start-port 20000 --node 1-4 \\\n\
    \x20                          --password-file secrets/section-1\n\
    \x20         pnet-nat request --table client.toml --net 2 --node 1-4 --count 100 --window 8\n\
    Without --data, each request carries its number; a simulated node sends it back. Exit codes: 0 all \
    were answered, 1 some were lost, or more than --tolerate lets, 2 bad command line or table. A request \
    that still waits at the --deadline, or at Ctrl-C, is lost."
)]
pub(super) struct Args {
    #[command(flatten)]
    way: WayArgs,

    /// Node addresses, separated by commas: 4 or 1-4.
    #[arg(
        long,
        required = true,
        value_name = "NODE[-LAST]",
        value_delimiter = ',',
        env = "PNET_NAT_NODE"
    )]
    node: Vec<NodeRange>,

    /// What lies behind each node: ports and node addresses, such as 2.33.
    #[arg(long, value_name = "ELEMENTS", value_parser = values::elements, env = "PNET_NAT_BEYOND")]
    beyond: Option<Elements>,

    /// File with exactly the 8 octets of the password, not accessible to others (mode 600). With --table,
    /// it takes the place of the file that the row names.
    #[arg(
        long,
        value_name = "FILE",
        value_parser = password_file,
        required_unless_present_any = ["table", "port"],
        env = "PNET_NAT_PASSWORD_FILE"
    )]
    password_file: Option<Password>,

    #[command(flatten)]
    content: ContentArgs,

    #[command(flatten)]
    pace: PaceArgs,

    /// Output: text for people, or one JSON object a line.
    #[arg(long, value_enum, default_value_t = Format::Text, env = "PNET_NAT_FORMAT")]
    format: Format,
}

/// By which way the nodes are reached.
#[derive(Debug, clap::Args)]
struct WayArgs {
    /// Public address of the NAT router, or its host name.
    #[arg(long, value_name = "HOST", required_unless_present = "table", env = "PNET_NAT_TO")]
    to: Option<String>,

    /// Start port of the plant section: public port = start port + node address.
    #[arg(
        long,
        value_name = "PORT",
        value_parser = clap::value_parser!(u16).range(1..=65410),
        required_unless_present_any = ["table", "port"],
        env = "PNET_NAT_START_PORT"
    )]
    start_port: Option<u16>,

    /// Port of a single node, which then has this one, whatever its node address.
    #[arg(
        long,
        value_name = "PORT",
        value_parser = clap::value_parser!(u16).range(1..),
        conflicts_with = "start_port",
        env = "PNET_NAT_PORT"
    )]
    port: Option<u16>,

    /// File with the client's IPNetTable in TOML, which says how to reach the nodes; docs/client.md
    /// explains every key.
    #[arg(
        long,
        value_name = "FILE",
        requires = "net",
        conflicts_with_all = ["to", "start_port", "port"],
        env = "PNET_NAT_TABLE"
    )]
    table: Option<PathBuf>,

    /// IPNetID of the net in that table, the number of its row.
    #[arg(long, value_name = "IPNETID", requires = "table", env = "PNET_NAT_IP_NET_ID")]
    net: Option<IpNetId>,
}

/// What each request says.
#[derive(Debug, clap::Args)]
struct ContentArgs {
    /// Control-status, such as 0x2A. The standard does not give its codes.
    #[arg(
        long,
        value_name = "OCTET",
        default_value = "0",
        value_parser = values::octet,
        env = "PNET_NAT_CONTROL"
    )]
    control: u8,

    /// Data as hex text, or a file: "dead beef" or @FILE.
    #[arg(long, value_name = "HEX|@FILE", value_parser = Octets::parse, env = "PNET_NAT_DATA")]
    data: Option<Octets>,

    /// Flat addressing: write --data into the node's memory from this offset on, or read --size octets
    /// there, in as many pieces as it takes. --control says which of the two it is to the node.
    #[arg(long, value_name = "OFFSET", env = "PNET_NAT_OFFSET")]
    offset: Option<u16>,

    /// Octets to read from the node's memory.
    #[arg(
        long,
        value_name = "OCTETS",
        requires = "offset",
        conflicts_with = "data",
        env = "PNET_NAT_SIZE"
    )]
    size: Option<u16>,
}

/// How many requests are sent, and when.
#[derive(Debug, clap::Args)]
struct PaceArgs {
    /// Number of requests to each node.
    #[arg(long, value_name = "N", default_value = "1", env = "PNET_NAT_COUNT")]
    count: NonZeroU32,

    /// Time from one round of requests to the next.
    #[arg(
        long,
        value_name = "TIME",
        default_value = "1s",
        value_parser = humantime::parse_duration,
        env = "PNET_NAT_INTERVAL"
    )]
    interval: Duration,

    /// How long to wait for each answer.
    #[arg(
        long,
        value_name = "TIME",
        default_value = "1s",
        value_parser = humantime::parse_duration,
        env = "PNET_NAT_TIMEOUT"
    )]
    timeout: Duration,

    /// How many requests may wait for their answers at the same time.
    #[arg(
        long,
        value_name = "N",
        default_value = "1",
        value_parser = clap::value_parser!(u8).range(1..=MAX_ENDPOINTS as i64),
        env = "PNET_NAT_WINDOW"
    )]
    window: u8,

    /// How often a request is sent again that has no answer.
    #[arg(long, value_name = "N", default_value = "0", env = "PNET_NAT_RETRIES")]
    retries: u32,

    /// How long all of it may take; then the statistics are printed.
    #[arg(
        long,
        value_name = "TIME",
        value_parser = humantime::parse_duration,
        env = "PNET_NAT_DEADLINE"
    )]
    deadline: Option<Duration>,

    /// The share of lost requests that is no failure, such as 10%.
    #[arg(long, value_name = "SHARE", default_value = "0%", env = "PNET_NAT_TOLERATE")]
    tolerate: Share,
}

/// Octets of a request; clap would take a list of numbers for a list of options.
#[derive(Clone, Debug)]
struct Octets(Vec<u8>);

impl Octets {
    fn parse(text: &str) -> anyhow::Result<Self> {
        values::octets(text).map(Self)
    }
}

/// Sends the requests. The exit code is 1 when more of them were lost than may be.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    if args.content.offset.is_some() && args.content.size.is_none() && args.content.data.is_none() {
        return Ok(bad_use("--offset needs --data to write, or --size to read"));
    }
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(ask(args))
}

async fn ask(args: Args) -> anyhow::Result<ExitCode> {
    let (arep, routes) = match routes::find(&args).await? {
        Ok(found) => found,
        Err(code) => return Ok(code),
    };
    let family = routes[0].way.address.ip();
    let node = ClientNode::bind(arep, family).await?;
    asking::Asking::new(&args, node, routes).run().await
}

/// Says what is wrong with the command line, and returns the exit code.
fn bad_use(message: impl std::fmt::Display) -> ExitCode {
    complain(format_args!("pnet-nat: {message}"));
    ExitCode::from(BAD_USE)
}
