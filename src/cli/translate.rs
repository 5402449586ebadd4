//! `pnet-nat translate`: where a client with a given IPNetTable sends a package, and by which router.
//!
//! Opens no socket. Of passwords it knows only whether there is one.

use std::io::Write;
use std::net::Ipv4Addr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;

use comfy_table::Table;
use serde::Serialize;

use super::output::{Format, out, plain_table, print_json};
use super::{BAD_USE, complain, load_ip_net_table};
use crate::config::{NodeRange, NotANodeRange};
use crate::pnet::ip_net_table::{Destination, IpNetTable, TranslateError, Translation};
use crate::pnet::wire::{BNA, IpNetId, NodeAddress};

/// Show where a client sends its packages: addresses, ports and routers by its IPNetTable.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat translate --table client.toml --net 2 --node 1-4\n\
    `check` prints such a table for the clients of a configuration. Methods a, b and d are those of \
    IEC PAS 62412, clause 8. Exit code 2: the table is not legal, or has no way to a node.")]
pub(super) struct Args {
    /// File with the client's IPNetTable, in TOML; docs/client.md explains every key.
    #[arg(long, value_name = "FILE", env = "PNET_NAT_TABLE")]
    table: PathBuf,

    /// IPNetID of the net, the number of its row.
    #[arg(long, value_name = "IPNETID", env = "PNET_NAT_IP_NET_ID")]
    net: IpNetId,

    /// Node addresses, separated by commas: 4 or 1-4; 126 is a broadcast.
    #[arg(
        long,
        required = true,
        value_name = "NODE[-LAST]",
        value_delimiter = ',',
        env = "PNET_NAT_NODE"
    )]
    node: Vec<Destinations>,

    /// Output: text for people, or one JSON object a line.
    #[arg(long, value_enum, default_value_t = Format::Text, env = "PNET_NAT_FORMAT")]
    format: Format,
}

/// Prints a line for each node; or the faults of the table, or why it has no way, and returns exit
/// code 2.
pub(super) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let table = match load_ip_net_table(&args.table) {
        Ok((table, _)) => table,
        Err(code) => return Ok(code),
    };
    let destinations = args.node.iter().flat_map(Destinations::each);
    let translate = |destination: Destination| {
        let way = table.translate(args.net, destination)?;
        Ok(Line::new(args.net, destination, &way))
    };
    let lines = match destinations.map(translate).collect::<Result<Vec<_>, TranslateError>>() {
        Ok(lines) => lines,
        Err(error) => {
            let (file, remedy) = (args.table.display(), remedy(error, &table));
            complain(format_args!("pnet-nat: {file}: {error}; {remedy}"));
            return Ok(ExitCode::from(BAD_USE));
        }
    };
    let mut out = out();
    match args.format {
        Format::Json => lines.iter().try_for_each(|line| print_json(line, &mut out))?,
        Format::Text => writeln!(out, "{}", as_table(&lines))?,
    }
    Ok(ExitCode::SUCCESS)
}

fn remedy(error: TranslateError, table: &IpNetTable) -> String {
    match error {
        TranslateError::UnusedNet(_) => {
            let nets: Vec<_> = table.rows().map(|(id, _)| id.to_string()).collect();
            format!("the nets of this table: {}", nets.join(", "))
        }
        TranslateError::DynamicClients(_) => {
            "a server answers them where their requests came from".to_owned()
        }
        TranslateError::BroadcastOverUdpRange(_) => {
            format!("name a net of type IPRange, or leave {BNA} out")
        }
    }
}

/// What `--node` names: some nodes, or all of them at once.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Destinations {
    Nodes(NodeRange),
    Broadcast,
}

impl Destinations {
    fn each(&self) -> Vec<Destination> {
        match self {
            Self::Broadcast => vec![Destination::Broadcast],
            Self::Nodes(NodeRange(range)) => {
                let nodes = range.clone().filter_map(NodeAddress::new);
                nodes.map(Destination::Node).collect()
            }
        }
    }
}

impl FromStr for Destinations {
    type Err = NotDestinations;

    fn from_str(text: &str) -> Result<Self, NotDestinations> {
        if text.parse() == Ok(BNA) {
            return Ok(Self::Broadcast);
        }
        Ok(Self::Nodes(text.parse()?))
    }
}

/// A text that is neither nodes nor the broadcast address.
#[derive(Debug, thiserror::Error)]
#[error("{0}; {BNA} alone is a broadcast")]
struct NotDestinations(#[from] NotANodeRange);

/// The way to one destination, as it is printed.
#[derive(Debug, Serialize)]
struct Line {
    net: u8,
    node: u8,
    method: char,
    address: Ipv4Addr,
    port: u16,
    next_hop: Option<u8>,
    password: bool,
}

impl Line {
    fn new(net: IpNetId, destination: Destination, way: &Translation) -> Self {
        Self {
            net: net.get(),
            node: destination.number(),
            method: way.method.letter(),
            address: way.address,
            port: way.port,
            next_hop: way.next_hop.map(NodeAddress::get),
            password: way.use_password,
        }
    }
}

fn as_table(lines: &[Line]) -> Table {
    let mut table =
        plain_table(["Net", "Node", "Method", "Address", "Port", "Next hop", "Password"]);
    for line in lines {
        table.add_row([
            line.net.to_string(),
            line.node.to_string(),
            line.method.to_string(),
            line.address.to_string(),
            line.port.to_string(),
            line.next_hop.map_or("–".to_owned(), |router| format!("node {router}")),
            if line.password { "yes" } else { "no" }.to_owned(),
        ]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_are_named_as_in_a_configuration_and_126_is_a_broadcast() {
        let each = |text: &str| text.parse::<Destinations>().map(|it| it.each());
        let numbers =
            |text| -> Vec<_> { each(text).unwrap().into_iter().map(Destination::number).collect() };
        assert_eq!(numbers("4"), [4]);
        assert_eq!(numbers("1-4"), [1, 2, 3, 4]);
        assert_eq!(numbers("1-125").len(), 125);
        assert_eq!(each("126").unwrap(), [Destination::Broadcast]);
        for bad in ["", "0", "127", "1-126", "126-127", "4-1", "all"] {
            let error = each(bad).unwrap_err().to_string();
            assert!(error.contains("126 alone is a broadcast"), "{bad:?}: {error}");
        }
    }
}
