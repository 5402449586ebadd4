//! `pnet-nat node`: simulated server nodes, for commissioning and tests.
//!
//! `peer::node` is the node itself; here are the options and the printed lines.

use std::io::Write;
use std::net::Ipv4Addr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::time::Duration;

use anyhow::Context;
use tokio::task::JoinSet;

use super::output::out;
use super::signals::Signals;
use super::{BAD_USE, complain, load_ip_net_table, password_file, values};
use crate::config::NodeRange;
use crate::peer::{Faults, NodeCounts, NodeError, NodeSettings, ServerNode, Share};
use crate::pnet::endpoint::{Echo, Memory};
use crate::pnet::wire::{NORMAL_PORT, Password, SECURE_PORT};

/// Run simulated P-NET server nodes: they send back the data of each request, or hold a memory.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:  pnet-nat node --listen 127.17.17.1-4 --password-file secrets/section-1\n\
    Every 127.x.x.x address belongs to this machine, so the example needs no set-up.\n\n\
    A memory is read and written with the two control-status that are named, as in\n\
    --reply memory --read 0x01 --write 0x02, for the standard does not give them. A request begins\n\
    with the offset in two octets, the upper one first. To read, one octet with the number of\n\
    octets follows; to write, the octets."
)]
pub(super) struct Args {
    /// Addresses of the nodes, separated by commas: 172.17.17.1 or 127.17.17.1-4; the last number
    /// is the node address.
    #[arg(
        long,
        required = true,
        value_name = "ADDRESS[-LAST]",
        value_delimiter = ',',
        env = "PNET_NAT_LISTEN"
    )]
    listen: Vec<AddressRange>,

    /// Secure port: a UDP port that requires the password.
    #[arg(long, value_name = "PORT", default_value_t = SECURE_PORT, env = "PNET_NAT_SECURE_PORT")]
    secure_port: u16,

    /// Normal port: a UDP port that requires no password.
    #[arg(long, value_name = "PORT", default_value_t = NORMAL_PORT, env = "PNET_NAT_NORMAL_PORT")]
    normal_port: u16,

    /// Files with exactly the 8 octets of a password, not accessible to others (mode 600),
    /// separated by commas. Each password opens the Secure port.
    #[arg(
        long,
        required = true,
        value_name = "FILE",
        value_delimiter = ',',
        value_parser = password_file,
        env = "PNET_NAT_PASSWORD_FILE"
    )]
    password_file: Vec<Password>,

    /// File with an IPNetTable in TOML: clients that it names are answered through it, all others as
    /// dynamic clients. Its node address is that of each node in turn. Without it, a node knows its own
    /// subnet alone.
    #[arg(long, value_name = "FILE", env = "PNET_NAT_TABLE")]
    table: Option<PathBuf>,

    /// What a node answers: the data of the request, or what is in its memory.
    #[arg(long, value_enum, default_value_t = Reply::Echo, env = "PNET_NAT_REPLY")]
    reply: Reply,

    /// Octets in the memory of a node.
    #[arg(long, value_name = "OCTETS", default_value = "1024", env = "PNET_NAT_MEMORY")]
    memory: u16,

    /// Control-status of requests that read the memory, such as 0x01. Without it, none does.
    #[arg(long, value_name = "OCTET", value_parser = values::octet, env = "PNET_NAT_READ")]
    read: Option<u8>,

    /// Control-status of requests that write the memory. Without it, none does.
    #[arg(long, value_name = "OCTET", value_parser = values::octet, env = "PNET_NAT_WRITE")]
    write: Option<u8>,

    #[command(flatten)]
    faults: FaultArgs,
}

/// Faults that every node makes on purpose.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Faults on purpose")]
struct FaultArgs {
    /// How long each response takes, such as 20ms.
    #[arg(
        long,
        value_name = "TIME",
        default_value = "0s",
        value_parser = humantime::parse_duration,
        env = "PNET_NAT_DELAY"
    )]
    delay: Duration,

    /// The longest further time that chance adds to each response.
    #[arg(
        long,
        value_name = "TIME",
        default_value = "0s",
        value_parser = humantime::parse_duration,
        env = "PNET_NAT_JITTER"
    )]
    jitter: Duration,

    /// The share of responses that are lost, such as 10%.
    #[arg(long, value_name = "SHARE", default_value = "0%", env = "PNET_NAT_DROP")]
    drop: Share,

    /// The share of responses that leave twice.
    #[arg(long, value_name = "SHARE", default_value = "0%", env = "PNET_NAT_DUPLICATE")]
    duplicate: Share,

    /// The share of responses that take 50 ms longer, so that later ones overtake them.
    #[arg(long, value_name = "SHARE", default_value = "0%", env = "PNET_NAT_REORDER")]
    reorder: Share,

    /// Send responses from another port than the one that was asked.
    #[arg(long, env = "PNET_NAT_ANSWER_FROM_OTHER_PORT")]
    answer_from_other_port: bool,

    /// Put another password into responses than their requests have.
    #[arg(long, env = "PNET_NAT_WRONG_PASSWORD")]
    wrong_password: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Reply {
    /// The data of the request.
    Echo,
    /// A flat memory that requests read and write.
    Memory,
}

/// Runs the nodes until SIGINT or SIGTERM.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(serve(args))
}

async fn serve(args: Args) -> anyhow::Result<ExitCode> {
    let mut signals = Signals::new()?;
    let mut out = out();
    let table = match args.table.as_deref().map(load_ip_net_table).transpose() {
        Ok(table) => table.map(|(table, _)| table),
        Err(code) => return Ok(code),
    };
    let mut nodes = Vec::new();
    for address in args.listen.iter().flat_map(AddressRange::addresses) {
        let settings = NodeSettings { table: table.clone(), ..settings(&args, address) };
        let node = match args.reply {
            Reply::Echo => ServerNode::bind(settings, Echo),
            Reply::Memory => {
                ServerNode::bind(settings, Memory::new(args.memory, args.read, args.write))
            }
        };
        match node {
            Ok(node) => nodes.push(node),
            Err(fault @ NodeError::Table { .. }) => {
                complain(format_args!("pnet-nat: --table: {fault}"));
                return Ok(ExitCode::from(BAD_USE));
            }
            Err(error) => return Err(error.into()),
        }
    }
    let mut serving = JoinSet::new();
    let mut counts = Vec::new();
    for node in nodes {
        let NodeSettings { address, normal_port, secure_port, .. } = *node.settings();
        let node_address = node.settings().node_address();
        writeln!(
            out,
            "node {node_address} on {address}: Normal port {normal_port}, Secure port {secure_port}"
        )?;
        counts.push((node_address, node.counts()));
        serving.spawn(node.serve());
    }
    tokio::select! {
        Some(ended) = serving.join_next() => ended?.context("a node's socket failed")?,
        _ = signals.next() => {}
    }
    for (node_address, counts) in counts {
        writeln!(out, "node {node_address}: {}", summary(&counts))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn settings(args: &Args, address: Ipv4Addr) -> NodeSettings {
    let FaultArgs { delay, jitter, drop, duplicate, reorder, .. } = args.faults;
    NodeSettings {
        normal_port: args.normal_port,
        secure_port: args.secure_port,
        faults: Faults {
            delay,
            jitter,
            drop,
            duplicate,
            reorder,
            answer_from_other_port: args.faults.answer_from_other_port,
            wrong_password: args.faults.wrong_password,
        },
        ..NodeSettings::new(address, args.password_file.clone())
    }
}

/// What became of a node's datagrams: `received 7, answered 5, refused 2 (2 wrong password)`.
fn summary(counts: &NodeCounts) -> String {
    let mut text = format!("received {}, answered {}", counts.received(), counts.answered());
    for (what, count) in [
        ("unconfirmed", counts.unconfirmed()),
        ("without an answer", counts.unserved()),
        ("lost", counts.lost()),
    ] {
        if count > 0 {
            text += &format!(", {what} {count}");
        }
    }
    text += &format!(", refused {}", counts.refused_total());
    let reasons = counts.refused().filter(|&(_, count)| count > 0);
    let reasons: Vec<_> = reasons.map(|(reason, count)| format!("{count} {reason}")).collect();
    if !reasons.is_empty() {
        text += &format!(" ({})", reasons.join(", "));
    }
    text
}

/// Addresses of one /24 whose last octets are node addresses.
#[derive(Clone, Debug, PartialEq, Eq)]
struct AddressRange {
    subnet: [u8; 3],
    nodes: NodeRange,
}

impl AddressRange {
    fn addresses(&self) -> impl Iterator<Item = Ipv4Addr> + '_ {
        let [a, b, c] = self.subnet;
        self.nodes.0.clone().map(move |node_address| Ipv4Addr::new(a, b, c, node_address))
    }
}

/// A text that is not an address or range of nodes.
#[derive(Debug, thiserror::Error)]
#[error(
    "write an IPv4 address or a range of its last number, which is a node address from 1 to 125: \
     \"172.17.17.1\", \"127.17.17.1-4\""
)]
struct NotAnAddressRange;

impl FromStr for AddressRange {
    type Err = NotAnAddressRange;

    fn from_str(text: &str) -> Result<Self, NotAnAddressRange> {
        let (subnet, nodes) = text.rsplit_once('.').ok_or(NotAnAddressRange)?;
        let subnet: Ipv4Addr = format!("{subnet}.0").parse().map_err(|_| NotAnAddressRange)?;
        let [a, b, c, _] = subnet.octets();
        let nodes = nodes.parse().map_err(|_| NotAnAddressRange)?;
        Ok(Self { subnet: [a, b, c], nodes })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_or_a_range_of_its_last_number() {
        let addresses = |text: &str| -> Vec<String> {
            let range: AddressRange = text.parse().unwrap();
            range.addresses().map(|address| address.to_string()).collect()
        };
        assert_eq!(addresses("172.17.17.33"), ["172.17.17.33"]);
        assert_eq!(addresses("127.17.17.1-3"), ["127.17.17.1", "127.17.17.2", "127.17.17.3"]);
        for bad in ["", "4", "172.17.17.0", "172.17.17.126", "172.17.17", "::1", "172.17.17.4-1"] {
            assert!(bad.parse::<AddressRange>().is_err(), "{bad:?}");
        }
    }
}
