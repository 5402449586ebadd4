//! What a remote client enters in its IPNetTable: the rows as a table, and as the TOML that `translate`
//! reads.
//!
//! The relay knows its own side alone. In the TOML, what only the client knows is an example, and says so.

use std::fmt::Write;
use std::net::{IpAddr, Ipv4Addr};

use comfy_table::Table;

use crate::cli::output::plain_table;
use crate::config::{Config, ip_net_as_toml};
use crate::nat::{Mapping, Net, NetKind};
use crate::pnet::ip_net_table::{Fields, Nettype};
use crate::pnet::wire::{IpNetId, LAST_START_PORT, NORMAL_PORT};

/// Stands for an address that only the operator knows (RFC 5737).
const EXAMPLE_ADDRESS: Ipv4Addr = Ipv4Addr::new(203, 0, 113, 5);
/// The client's own net, in the example.
const EXAMPLE_OWN: Fields = Fields {
    nettype: Nettype::IpRange,
    ip_address: Ipv4Addr::new(192, 168, 1, 0),
    udp_port: NORMAL_PORT,
    ..Fields::UNUSED
};
/// The client's own node address and its router's, in the example.
const EXAMPLE_NODE: u8 = 4;
const EXAMPLE_ROUTER: u8 = 1;

/// PAS 8, Table 4: the row that leads to each net.
pub(super) fn ip_net_table(config: &Config) -> Table {
    let mut table = plain_table(["Net", "IPAddr", "UDPPort", "UsePW", "Router", "Nettype"]);
    let address = public_address(&config.listen);
    for (net, udp_port, _) in rows(config) {
        table.add_row([
            net.name.clone(),
            address.clone(),
            udp_port.to_string(),
            u8::from(uses_password(net)).to_string(),
            "the client's".to_owned(),
            Nettype::UdpRange.to_string(),
        ]);
    }
    table
}

/// The same rows in a whole table for `translate`; none without an IPv4 address, since an IPNetTable
/// has no other.
pub(super) fn toml(config: &Config) -> Option<String> {
    let mut addresses = config.listen.iter().filter_map(|address| match address {
        IpAddr::V4(v4) => Some(*v4),
        IpAddr::V6(_) => None,
    });
    let address = addresses.next()?;
    let others: String = addresses.map(|other| format!(" or {other}")).collect();
    let (address, remark) = match address.is_unspecified() {
        true => (EXAMPLE_ADDRESS, "; address: an example, enter your public one".to_owned()),
        false if others.is_empty() => (address, String::new()),
        false => (address, format!("; address: this{others}")),
    };
    let mut ids = (1..=IpNetId::LAST_ROW.get()).filter_map(IpNetId::new);
    let mut text = format!(
        "# Only the client knows its node address, its own net and its router: these are examples.\n\
         node_address = {EXAMPLE_NODE}\n\n# the client's own net\n{}",
        ip_net_as_toml(ids.next()?, &EXAMPLE_OWN)
    );
    let mut rows = rows(config);
    for (id, (net, udp_port, node)) in ids.zip(rows.by_ref()) {
        let fields = Fields {
            nettype: Nettype::UdpRange,
            ip_address: address,
            udp_port,
            use_password: uses_password(net),
            router: EXAMPLE_ROUTER,
            allow_without_password: !uses_password(net),
        };
        let only = node.map_or(String::new(), |node| format!(", node {node} only"));
        let row = ip_net_as_toml(id, &fields);
        // A String takes all that is written to it.
        let _ = write!(text, "\n# {}{only}{remark}\n{row}", net.name);
    }
    match rows.count() {
        0 => {}
        more => {
            let _ = writeln!(text, "\n# {more} more nets need a second table: one has 124 rows.");
        }
    }
    Some(text)
}

/// Nets that are a single server, which a row reaches at one node or cannot reach at all.
pub(super) fn remarks_on_servers(config: &Config) -> impl Iterator<Item = String> {
    let single = |mapping: &&Mapping| config.table.net(mapping.net).kind == NetKind::Server;
    config.table.mappings().iter().filter(single).map(|mapping| {
        let name = &config.table.net(mapping.net).name;
        let (port, node) = (mapping.public_port, mapping.node_address);
        match udp_port(mapping) {
            Some(_) => format!("{name}: its row reaches only node {node}."),
            None => {
                let extreme = if port > LAST_START_PORT { "high" } else { "low" };
                format!(
                    "{name}: no row reaches node {node}, because public port {port} is too {extreme}."
                )
            }
        }
    })
}

/// Each net that a row can reach, with the row's UDPPort, and the node if it is the only one.
fn rows(config: &Config) -> impl Iterator<Item = (&Net, u16, Option<u8>)> {
    let nets = config.table.mappings().chunk_by(|a, b| a.net == b.net);
    nets.filter_map(|mappings| {
        let net = config.table.net(mappings[0].net);
        let single = (net.kind == NetKind::Server).then_some(mappings[0].node_address);
        Some((net, udp_port(&mappings[0])?, single))
    })
}

/// Public port - node address, where that is the UDPPort of a legal row (A15).
fn udp_port(mapping: &Mapping) -> Option<u16> {
    let start = mapping.public_port.checked_sub(mapping.node_address.into());
    start.filter(|port| (1..=LAST_START_PORT).contains(port))
}

fn uses_password(net: &Net) -> bool {
    !net.credentials.is_empty()
}

fn public_address(listen: &[IpAddr]) -> String {
    if listen.iter().any(IpAddr::is_unspecified) {
        return "your public address".to_owned();
    }
    listen.iter().map(IpAddr::to_string).collect::<Vec<_>>().join(" or ")
}
