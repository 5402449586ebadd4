//! What a remote client enters in its IPNetTable: the rows as a table, and as the TOML that `translate`
//! reads.
//!
//! The relay knows its own side alone. In the TOML, what only the client knows is an example, and says so.

use std::fmt::Write;
use std::net::{IpAddr, Ipv4Addr};

use comfy_table::Table;

use crate::cli::output::plain_table;
use crate::config::{Config, ip_net_as_toml};
use crate::nat::{Mapping, Net, NetKind, Record};
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

/// A row that leads to a net, as far as the relay knows it.
pub(super) struct Row<'a> {
    pub(super) net: &'a Net,
    pub(super) nettype: Nettype,
    /// The subnet of a remote net; none: the relay's public address.
    pub(super) local_subnet: Option<Ipv4Addr>,
    pub(super) udp_port: u16,
    pub(super) use_password: bool,
    /// The node, if the row reaches only this one.
    pub(super) only: Option<u8>,
}

/// PAS 8, Table 4: the row that leads to each net.
pub(super) fn ip_net_table(config: &Config) -> Table {
    let mut table = plain_table(["Net", "IPAddr", "UDPPort", "UsePW", "Router", "Nettype"]);
    let address = public_address(&config.listen);
    for row in rows(config) {
        table.add_row([
            row.net.name.clone(),
            row.local_subnet.map_or(address.clone(), |subnet| subnet.to_string()),
            row.udp_port.to_string(),
            u8::from(row.use_password).to_string(),
            "the client's".to_owned(),
            row.nettype.to_string(),
        ]);
    }
    table
}

/// The same rows in a whole table for `translate`; none where no row has an IPv4 address, since an
/// IPNetTable has no other.
pub(super) fn toml(config: &Config) -> Option<String> {
    let public = PublicAddress::of(&config.listen);
    let mut rows =
        rows(config).filter(|row| row.local_subnet.is_some() || public.is_some()).peekable();
    rows.peek()?;
    let mut ids = (1..=IpNetId::LAST_ROW.get()).filter_map(IpNetId::new);
    let mut text = format!(
        "# Only the client knows its node address, its own net and its router: these are examples.\n\
         node_address = {EXAMPLE_NODE}\n\n# the client's own net\n{}",
        ip_net_as_toml(ids.next()?, &EXAMPLE_OWN)
    );
    for (id, row) in ids.zip(rows.by_ref()) {
        let (ip_address, remark) = match (row.local_subnet, &public) {
            (Some(subnet), _) => (subnet, "; a remote net, for programs on this side"),
            (None, Some(PublicAddress { address, remark })) => (*address, remark.as_str()),
            (None, None) => continue,
        };
        let fields = Fields {
            nettype: row.nettype,
            ip_address,
            udp_port: row.udp_port,
            use_password: row.use_password,
            router: EXAMPLE_ROUTER,
            allow_without_password: !row.use_password && row.nettype == Nettype::UdpRange,
        };
        let only = row.only.map_or(String::new(), |node| format!(", node {node} only"));
        let toml = ip_net_as_toml(id, &fields);
        // A String takes all that is written to it.
        let _ = write!(text, "\n# {}{only}{remark}\n{toml}", row.net.name);
    }
    match rows.count() {
        0 => {}
        more => {
            let _ = writeln!(text, "\n# {more} more nets need a second table: one has 124 rows.");
        }
    }
    Some(text)
}

/// The relay's public address for the TOML, and what is to be said of it.
struct PublicAddress {
    address: Ipv4Addr,
    remark: String,
}

impl PublicAddress {
    /// None without an IPv4 address.
    fn of(listen: &[IpAddr]) -> Option<Self> {
        let mut addresses = listen.iter().filter_map(|address| match address {
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
        Some(Self { address, remark })
    }
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

/// The row of each net that a row can reach.
pub(super) fn rows(config: &Config) -> impl Iterator<Item = Row<'_>> {
    let nets = config.table.mappings().chunk_by(|a, b| a.net == b.net);
    nets.filter_map(|mappings| {
        let (first, net) = (&mappings[0], config.table.net(mappings[0].net));
        let local_subnet = match first.local_address {
            Some(IpAddr::V4(local)) => Some(Ipv4Addr::from_bits(local.to_bits() & 0xffff_ff00)),
            _ => None,
        };
        let (nettype, udp_port) = match net.kind {
            NetKind::Remote { .. } => (Nettype::IpRange, first.public_port),
            NetKind::UdpRange { .. } | NetKind::Server => (Nettype::UdpRange, udp_port(first)?),
            NetKind::ProfinetDevice { .. } => return None, // no P-NET node
        };
        Some(Row {
            net,
            nettype,
            local_subnet,
            udp_port,
            use_password: !net.kind.is_remote() && !net.credentials.is_empty(),
            only: (net.kind == NetKind::Server).then_some(first.node_address),
        })
    })
}

/// What clients of PROFINET devices need to know; empty where there is no device.
pub(super) fn profinet(config: &Config) -> String {
    let address = public_address(&config.listen);
    let devices = config.table.mappings().iter().filter_map(|mapping| {
        let net = config.table.net(mapping.net);
        let NetKind::ProfinetDevice { records } = net.kind else { return None };
        let records: Vec<_> = records.iter().map(Record::label).collect();
        let (name, port) = (&net.name, mapping.public_port);
        Some(format!("{name}: port {port}; records {}\n", records.join(", ")))
    });
    let devices: String = devices.collect();
    if devices.is_empty() {
        return devices;
    }
    format!(
        "PROFINET devices, at {address}. What clients may read there, and they may do nothing else:\n\n{devices}"
    )
}

/// Public port - node address, where that is the UDPPort of a legal row (A15).
fn udp_port(mapping: &Mapping) -> Option<u16> {
    let start = mapping.public_port.checked_sub(mapping.node_address.into());
    start.filter(|port| (1..=LAST_START_PORT).contains(port))
}

fn public_address(listen: &[IpAddr]) -> String {
    if listen.iter().any(IpAddr::is_unspecified) {
        return "your public address".to_owned();
    }
    listen.iter().map(IpAddr::to_string).collect::<Vec<_>>().join(" or ")
}
