//! `pnet-nat node`: simulated server nodes, for commissioning and tests.
//!
//! `peer::node` is the node itself; here are the options and the printed lines.

use std::io::Write;
use std::net::Ipv4Addr;
use std::process::ExitCode;
use std::str::FromStr;
use std::time::Duration;

use anyhow::Context;
use tokio::task::JoinSet;

use super::output::out;
use super::password_file;
use super::signals::Signals;
use crate::config::NodeRange;
use crate::peer::{NodeSettings, ServerNode, echo};
use crate::pnet::wire::{Header, NORMAL_PORT, Password, SECURE_PORT};

/// Run simulated P-NET server nodes that send back the data of each request.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:  pnet-nat node --listen 127.17.17.1-4 --password-file secrets/section-1\n\
    Every 127.x.x.x address belongs to this machine, so the example needs no set-up."
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

    /// File with exactly the 8 octets of the password, not accessible to others (mode 600).
    #[arg(
        long,
        value_name = "FILE",
        value_parser = password_file,
        env = "PNET_NAT_PASSWORD_FILE"
    )]
    password_file: Password,

    /// How long a node takes for each request, such as 20ms.
    #[arg(
        long,
        value_name = "TIME",
        default_value = "0s",
        value_parser = humantime::parse_duration,
        env = "PNET_NAT_DELAY"
    )]
    delay: Duration,
}

/// Runs the nodes until SIGINT or SIGTERM.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(serve(args))
}

async fn serve(args: Args) -> anyhow::Result<ExitCode> {
    let mut signals = Signals::new()?;
    let mut out = out();
    let mut nodes = Vec::new();
    for address in args.listen.iter().flat_map(AddressRange::addresses) {
        nodes.push(ServerNode::bind(settings(&args, address))?);
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
        let (received, answered, refused) =
            (counts.received(), counts.answered(), counts.refused());
        writeln!(
            out,
            "node {node_address}: received {received}, answered {answered}, refused {refused}"
        )?;
    }
    Ok(ExitCode::SUCCESS)
}

fn settings(args: &Args, address: Ipv4Addr) -> NodeSettings {
    NodeSettings {
        address,
        normal_port: args.normal_port,
        secure_port: args.secure_port,
        header: Header::default(),
        password: args.password_file.clone(),
        delay: args.delay,
        reply: echo,
    }
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
