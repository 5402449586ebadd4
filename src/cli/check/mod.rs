//! `pnet-nat check`: every fault of a configuration, or the NAT table that it results in.
//!
//! Opens none of the relay's ports. Faults and warnings go to stderr, tables to stdout; in JSON, all of it
//! is one object on stdout.

mod client;
mod json;
mod sheet;

use std::fmt::Display;
use std::io::Write;
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::builder::BoolishValueParser;
use comfy_table::Table;
use ipnet::{IpNet, Ipv4Net};

use super::output::{Format, out, plain_table, print_json};
use super::{BAD_USE, WITHOUT_FILE, complain, exit_code_of};
use crate::config::{Config, Faults, Source, TwoSources, Warning};
use crate::logging::complain_of_faults;
use crate::nat::{Mapping, Net, NetKind};
use crate::sandbox::{self, User, UserError};

pub(super) use sheet::{SheetFormat, sheet};

/// Check a configuration: show every fault, or the NAT table and the clients' IPNetTable rows.
#[derive(Debug, clap::Args)]
#[command(after_help = format!(
    "Example:  pnet-nat check --config /etc/pnet-nat/pnet-nat.toml\n{WITHOUT_FILE}"
))]
pub(super) struct Args {
    /// The configuration file; config/pnet-nat.toml explains every key [default:
    /// /etc/pnet-nat/pnet-nat.toml].
    #[arg(short, long, value_name = "FILE", env = "PNET_NAT_CONFIG")]
    config: Option<PathBuf>,
    /// Show one line for each node, instead of one for each run of consecutive nodes.
    #[arg(long, env = "PNET_NAT_FULL", value_parser = BoolishValueParser::new())]
    full: bool,
    /// Print the client's sheet instead: what whoever sets up a client enters, as csv, md (if left out) or
    /// html. It names passwords and never has one.
    #[arg(
        long,
        value_name = "FORMAT",
        value_enum,
        num_args = 0..=1,
        default_missing_value = "md",
        env = "PNET_NAT_CLIENT_SHEET",
        hide_possible_values = true,
        conflicts_with = "format"
    )]
    client_sheet: Option<SheetFormat>,
    /// Output: tables for people, or one JSON object with faults, warnings, NAT table, nets and clients' rows.
    #[arg(long, value_enum, default_value_t = Format::Text, env = "PNET_NAT_FORMAT")]
    format: Format,
}

/// Prints all faults and returns exit code 2, or prints the warnings, the NAT table and the
/// clients' IPNetTable rows.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    let mut remarks = Vec::new();
    let source = Source::choose(args.config.as_deref()).map_err(Refusal::from);
    let checked = source.and_then(|source| check(&source, &mut remarks));
    if args.format == Format::Json {
        let code = checked.as_ref().map_or_else(Refusal::code, |_| ExitCode::SUCCESS);
        print_json(&json::object(&checked, &remarks), &mut out())?;
        return Ok(code);
    }
    let config = match told(checked, &remarks) {
        Ok(config) => config,
        Err(code) => return Ok(code),
    };
    let text = match args.client_sheet {
        None => summary(&config, args.full),
        Some(format) => {
            // The table that people look at says it itself; a file for clients does not have it.
            for remark in client::remarks_on_servers(&config) {
                complain(format_args!("note: {remark}"));
            }
            sheet(&config, format)
        }
    };
    out().write_all(text.as_bytes())?;
    Ok(ExitCode::SUCCESS)
}

/// The configuration of a file, of which warnings were printed; otherwise the faults were.
pub(super) fn judged(path: &Path) -> Result<Config, ExitCode> {
    let mut remarks = Vec::new();
    let checked = check(&Source::File(path.to_owned()), &mut remarks);
    told(checked, &remarks)
}

/// Prints the warnings, or why there is no configuration.
fn told(
    checked: Result<(Config, Vec<Warning>), Refusal>,
    remarks: &[String],
) -> Result<Config, ExitCode> {
    match checked {
        Err(refusal) => {
            remarks.iter().for_each(warn);
            refusal.complain();
            Err(refusal.code())
        }
        Ok((config, warnings)) => {
            warnings.iter().for_each(warn);
            remarks.iter().for_each(warn);
            Ok(config)
        }
    }
}

fn warn(text: impl Display) {
    complain(format_args!("warning: {text}"));
}

/// Why there is no configuration.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    Faults(#[from] Faults),
    #[error(transparent)]
    User(#[from] UserError),
    #[error(transparent)]
    TwoSources(#[from] TwoSources),
}

impl Refusal {
    fn code(&self) -> ExitCode {
        match self {
            Self::Faults(faults) => exit_code_of(faults),
            Self::User(_) | Self::TwoSources(_) => ExitCode::from(BAD_USE),
        }
    }

    fn complain(&self) {
        match self {
            Self::Faults(faults) => complain_of_faults(faults),
            Self::User(_) | Self::TwoSources(_) => complain(format_args!("pnet-nat: {self}")),
        }
    }
}

/// Reads it as the relay would: with the rights of `[runtime] user`, and without root's right to read any
/// file. What is to be said of this host beside the warnings goes to `remarks`.
fn check(source: &Source, remarks: &mut Vec<String>) -> Result<(Config, Vec<Warning>), Refusal> {
    let _prepared = sandbox::prepare();
    let read = match source.user()? {
        None => source.load(),
        Some(name) => match User::find(&name)?.act(|| source.load()) {
            Err(UserError::NotRoot(user)) => {
                remarks.push(format!(
                    "whether {user:?} may read the files is not checked; only root can: run check as root"
                ));
                source.load()
            }
            read => read?,
        },
    };
    let (config, warnings) = read?;
    remarks.extend(sandbox::movable_links(&config.files).iter().map(ToString::to_string));
    Ok((config, warnings))
}

fn summary(config: &Config, full: bool) -> String {
    let listen: Vec<_> = config.listen.iter().map(IpAddr::to_string).collect();
    let on = if listen.is_empty() { String::new() } else { format!(", on {}", listen.join(", ")) };
    let parts = [
        format!(
            "The configuration has no faults. The NAT table{on}:\n\n{}\n",
            nat_table(config, full)
        ),
        for_clients(config),
        client::profinet(config),
    ];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n")
}

/// What clients of P-NET enter; empty where there is nothing for them.
fn for_clients(config: &Config) -> String {
    let is_p_net = |net: &Net| !matches!(net.kind, NetKind::ProfinetDevice { .. });
    if !config.table.nets().iter().any(is_p_net) {
        return String::new();
    }
    let has_remote_nets = config.table.nets().iter().any(|net| net.kind.is_remote());
    let local = if has_remote_nets {
        "A row of Nettype IPRange is for programs on this side, which send without a password.\n"
    } else {
        ""
    };
    let who = if config.listen.is_empty() { "local program" } else { "remote client" };
    let remarks = client::remarks_on_servers(config).chain(remarks_on_clients(config));
    let remarks: Vec<_> = remarks.map(|remark| remark + "\n").collect();
    let toml = client::toml(config).map_or_else(
        || "The relay listens on no IPv4 address, and an IPNetTable has no other.\n".to_owned(),
        |toml| format!("The same as a file for `pnet-nat translate`:\n\n{toml}"),
    );
    format!(
        "What a {who} enters in its IPNetTable:\n\n{}\n\n\
         Router: the node address of the router on the client's own net, as the client has it.\n{local}{}\n\
         {toml}",
        client::ip_net_table(config),
        remarks.concat(),
    )
}

/// PAS 5.2.6: the public port of each server.
pub(super) fn nat_table(config: &Config, full: bool) -> Table {
    let mut table = plain_table(["Public port", "Server", "Node", "Net"]);
    let follows =
        |a: &Mapping, b: &Mapping| !full && a.net == b.net && a.node_address + 1 == b.node_address;
    for run in config.table.mappings().chunk_by(follows) {
        let (first, last) = (&run[0], &run[run.len() - 1]);
        let name = config.table.net(first.net).name.clone();
        table.add_row([
            public_ports(first, last),
            servers(first.server, last.server),
            nodes(first, last),
            name,
        ]);
    }
    table
}

/// Nets whose `allow` includes the net's own subnet, but only in a wider network: that does not let in
/// clients inside the subnet.
fn remarks_on_clients(config: &Config) -> impl Iterator<Item = String> {
    let nets = config.table.mappings().chunk_by(|a, b| a.net == b.net);
    nets.filter_map(|mappings| {
        let net = config.table.net(mappings[0].net);
        let IpAddr::V4(server) = mappings[0].server.ip() else { return None };
        let subnet = match net.kind {
            NetKind::UdpRange { .. } => IpNet::from(Ipv4Net::new_assert(server, 24).trunc()),
            NetKind::Server | NetKind::Remote { .. } | NetKind::ProfinetDevice { .. } => {
                return None;
            }
        };
        let is_wider = |allowed: &&IpNet| allowed.prefix_len() > 0 && allowed.contains(&subnet);
        let wider = net.allow.iter().find(is_wider)?;
        let is_named = net.allow.iter().any(|allowed| subnet.contains(allowed));
        (!is_named).then(|| {
            format!(
                "{}: {wider} does not let in clients from the plant's own subnet; if there are some, \
                 add \"{subnet}\" to `allow`.",
                net.name
            )
        })
    })
}

/// The node addresses of a run; a PROFINET device has none.
fn nodes(first: &Mapping, last: &Mapping) -> String {
    match first.node_address {
        0 => "–".to_owned(),
        node => span(node, last.node_address),
    }
}

/// The ports of consecutive nodes: `20001-20004`, or in a remote net `127.17.2.1-4:34378`.
fn public_ports(first: &Mapping, last: &Mapping) -> String {
    match first.local_address.zip(last.local_address) {
        None => span(first.public_port, last.public_port),
        Some((from, to)) => {
            servers((from, first.public_port).into(), (to, last.public_port).into())
        }
    }
}

fn span<T: PartialEq + ToString>(first: T, last: T) -> String {
    let (single, first, last) = (first == last, first.to_string(), last.to_string());
    if single { first } else { format!("{first}-{last}") }
}

/// Consecutive servers, which differ in their last octet, `172.17.17.1-4:34379`, or in their port,
/// `203.0.113.5:20001-20004`.
fn servers(first: SocketAddr, last: SocketAddr) -> String {
    match (first.ip(), last.ip()) {
        (IpAddr::V4(from), IpAddr::V4(to)) if from != to => {
            format!("{from}-{}:{}", to.octets()[3], first.port())
        }
        (from, to) if from == to && first.port() != last.port() => {
            format!("{first}-{}", last.port())
        }
        _ => first.to_string(),
    }
}
