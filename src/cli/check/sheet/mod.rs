//! The client's sheet: what whoever sets up a client enters, as CSV, Markdown, or a page to hand out.
//!
//! One row a net, in the field names of PAS 8, Table 4. Invariant: it names passwords and never has one.

mod html;

use std::net::IpAddr;

use super::client::{Row, rows};
use crate::cli::output::plain_table;
use crate::config::{Config, each_run};
use crate::nat::Mapping;
use crate::pnet::ip_net_table::Nettype;

/// The format of the sheet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(in crate::cli) enum SheetFormat {
    /// A row a line, for a spreadsheet.
    Csv,
    /// Markdown, which is plain text too.
    Md,
    /// One page that needs nothing else, to print or to send.
    Html,
}

const COLUMNS: [&str; 9] =
    ["Net", "IPAddr", "UDPPort", "UsePW", "Router", "Nettype", "Nodes", "Password", "Test command"];

/// What the columns mean to whoever fills in an IPNetTable. Text for all formats that have sentences.
const NOTES: [&str; 4] = [
    "Each net is one row of the client's IPNetTable. Its index, the IPNetID, is the client's choice: 1 to \
     124.",
    "Router: the node address of the router on the client's own net, as the client has it. In a UDPRange net it \
     is never 0. In an IPRange net it is 0 where the client is in that net itself.",
    "Password: its name at the router. The 8 octets come by another way. They are compared as they are: upper \
     and lower case differ.",
    "Test command: run it at the client's place, with the 8 octets in the file that it names, which \
     only you may read (mode 600). docs/client.md has each step.",
];

/// The sheet for the clients of this configuration.
pub(in crate::cli) fn sheet(config: &Config, format: SheetFormat) -> String {
    let lines: Vec<_> = rows(config).map(|row| line(&row, &config.listen)).collect();
    match format {
        SheetFormat::Csv => csv(&lines),
        SheetFormat::Md => markdown(&lines),
        SheetFormat::Html => html::page(&lines),
    }
}

/// The cells of a row.
type Line = [String; COLUMNS.len()];

fn line(row: &Row<'_>, listen: &[IpAddr]) -> Line {
    let router = match row.nettype {
        Nettype::IpRange => "the client's, or 0",
        _ => "the client's, never 0",
    };
    let passwords: Vec<_> = match row.use_password {
        true => row.net.credentials.iter().map(|credential| credential.name.clone()).collect(),
        false => vec!["none".to_owned()],
    };
    [
        row.net.name.clone(),
        row.local_subnet.map_or_else(|| address(listen), |subnet| subnet.to_string()),
        row.udp_port.to_string(),
        u8::from(row.use_password).to_string(),
        router.to_owned(),
        row.nettype.to_string(),
        nodes(row.mappings),
        passwords.join(", "),
        test_command(row, listen),
    ]
}

fn address(listen: &[IpAddr]) -> String {
    if listen.iter().any(IpAddr::is_unspecified) {
        return "the router's public address".to_owned();
    }
    listen.iter().map(IpAddr::to_string).collect::<Vec<_>>().join(" or ")
}

/// Node addresses as `pnet-nat request` takes them: `1-4,33`.
fn nodes(mappings: &[Mapping]) -> String {
    let nodes: Vec<_> = mappings.iter().map(|mapping| mapping.node_address.into()).collect();
    each_run(&nodes).collect::<Vec<_>>().join(",")
}

/// A command that asks the net's nodes, or one of them where a command has only one port.
fn test_command(row: &Row<'_>, listen: &[IpAddr]) -> String {
    let first = &row.mappings[0];
    let public = listen.iter().find(|address| !address.is_unspecified());
    let to = first.local_address.as_ref().or(public);
    let to = to.map_or_else(|| "ROUTER".to_owned(), IpAddr::to_string);
    let password = row.net.credentials.first().filter(|_| row.use_password);
    let password =
        password.map(|credential| format!(" --password-file {}-{}", row.net.name, credential.name));
    match &password {
        Some(password) if row.only.is_none() => {
            let nodes = nodes(row.mappings);
            let start_port = row.udp_port;
            format!("pnet-nat request --to {to} --start-port {start_port} --node {nodes}{password}")
        }
        _ => {
            let (port, node) = (first.public_port, first.node_address);
            let password = password.unwrap_or_default();
            format!("pnet-nat request --to {to} --port {port} --node {node}{password}")
        }
    }
}

/// RFC 4180.
fn csv(lines: &[Line]) -> String {
    let header = COLUMNS.map(str::to_owned);
    let lines = [&header].into_iter().chain(lines);
    let line = |line: &Line| line.each_ref().map(|cell| csv_cell(cell)).join(",") + "\r\n";
    lines.map(line).collect()
}

/// Nothing in a sheet begins like a formula, and nothing has a line break.
fn csv_cell(cell: &str) -> String {
    match cell.contains([',', '"']) {
        true => format!("\"{}\"", cell.replace('"', "\"\"")),
        false => cell.to_owned(),
    }
}

fn markdown(lines: &[Line]) -> String {
    let mut table = plain_table(COLUMNS);
    for line in lines {
        let mut line = line.clone();
        let [.., command] = &mut line;
        *command = format!("`{command}`");
        table.add_row(line);
    }
    let notes: String = NOTES.iter().map(|note| format!("- {note}\n")).collect();
    format!("# Set up a P-NET client\n\n{table}\n\n{notes}")
}

#[cfg(test)]
mod tests;
