//! One net of the NAT table: a `[[udp_range_net]]` or a `[[server]]`, with the rules that all nets share.
//!
//! A net with faults is still a [`Draft`] of all that could be read, so that the nets can be compared
//! with each other.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::Duration;

use ipnet::IpNet;

use crate::nat::{Net, NetKind, RequestRate};
use crate::pnet::wire::{BNA, LAST_NODE, LAST_START_PORT, NORMAL_PORT, SECURE_PORT, SNA};

use super::address::{endpoint, is_a_host, is_link_local, network};
use super::credentials::{Passwords, passwords};
use super::defaults;
use super::node_range::nodes;
use super::report::{SourceSpan, quoted};
use super::toml_table::{Entry, LONGEST, Section};

/// the node addresses of broadcasts, whose public ports stay closed.
const BROADCASTS: [u16; 2] = [BNA as u16, SNA as u16];
/// RFC 4787 REQ-5: a mapping lives at least this long.
const SHORT_IDLE_TIMEOUT: Duration = Duration::from_secs(120);
/// Lower ports need a privilege to bind.
const FIRST_UNPRIVILEGED_PORT: u16 = 1024;
/// More flows would take hundreds of megabytes.
pub(super) const MOST_FLOWS: u32 = 1_000_000;

/// Where clients reach a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct PublicPort {
    /// The one address; none: every address of `[public] listen`.
    pub(super) address: Option<IpAddr>,
    pub(super) port: u16,
}

/// What no other net may have: public ports or servers, and the key that they come from.
#[derive(Debug)]
pub(super) struct Claim<'a, T> {
    pub(super) entry: Entry<'a>,
    /// One for each of the net's nodes, in their order; empty when they could not be read.
    pub(super) values: Vec<T>,
}

/// A net as far as it could be read.
#[derive(Debug)]
pub(super) struct Draft<'a> {
    pub(super) place: SourceSpan,
    pub(super) name: Entry<'a>,
    pub(super) net: Net,
    pub(super) nodes: Vec<u8>,
    pub(super) public_ports: Claim<'a, PublicPort>,
    pub(super) servers: Claim<'a, SocketAddr>,
    pub(super) allowed: Allowed<'a>,
    /// The servers may be reached by a gateway, even by the one towards the Internet.
    pub(super) servers_beyond_gateway: bool,
}

/// The first network of each family that a net's `allow` names.
#[derive(Debug, Default)]
pub(super) struct Allowed<'a> {
    pub(super) ipv4: Option<Entry<'a>>,
    pub(super) ipv6: Option<Entry<'a>>,
}

impl Draft<'_> {
    /// The net and its line, for a fault of another net.
    pub(super) fn label(&self) -> String {
        let SourceSpan { line, key } = &self.place;
        format!("{key} \"{}\" (line {line})", self.net.name)
    }

    /// the ports of a range on which nothing may listen.
    pub(super) fn silent_ports(&self) -> Vec<u16> {
        match self.net.kind {
            NetKind::UdpRange { start_port } => {
                BROADCASTS.iter().filter_map(|node| start_port.checked_add(*node)).collect()
            }
            NetKind::Server | NetKind::Remote { .. } | NetKind::ProfinetDevice { .. } => Vec::new(),
        }
    }
}

impl PublicPort {
    /// A port at every address of `[public] listen`.
    pub(super) fn everywhere(port: u16) -> Self {
        Self { address: None, port }
    }
}

/// The rules of a net, and the networks of its `allow` with their places in the file.
pub(super) struct Rules<'a> {
    pub(super) net: Net,
    pub(super) networks: Vec<(Entry<'a>, IpNet)>,
}

impl<'a> Allowed<'a> {
    pub(super) fn of(networks: Vec<(Entry<'a>, IpNet)>) -> Self {
        let mut allowed = Self::default();
        for (entry, network) in networks {
            let first =
                if network.addr().is_ipv4() { &mut allowed.ipv4 } else { &mut allowed.ipv6 };
            first.get_or_insert(entry);
        }
        allowed
    }
}

/// public port = start port + node address, server = subnet + node address.
pub(super) fn udp_range_net(mut section: Section<'_>) -> Draft<'_> {
    let place = section.place.clone();
    let name = section.key("name", "\"section-1\"").required();
    let start_port_entry = section.key("start_port", "20000").required();
    let start_port = start_port(&start_port_entry);
    let subnet_entry = section.key("subnet", "\"172.17.17.0\"").required();
    let subnet = subnet(&subnet_entry);
    let nodes = nodes(&section.key("nodes", "[\"1-4\", 33]").required());
    let server_port = section.key("server_port", "34379");
    let server_port = server_port.integer(1..=u16::MAX).inspect(|&port| {
        refuse_normal_port(&server_port, port);
    });
    let server_port = server_port.unwrap_or(SECURE_PORT);
    let kind = NetKind::UdpRange { start_port: start_port.unwrap_or_default() };
    let beyond = section.key("servers_beyond_gateway", "true");
    let Rules { net, networks } = rules(&mut section, &name, kind);
    section.finish();

    let allowed = Allowed::of(networks);
    let public_ports = start_port.map(|start| {
        nodes.iter().map(|&node| PublicPort::everywhere(start + u16::from(node))).collect()
    });
    let servers = subnet.map(|[a, b, c, _]| {
        let server = |&node: &u8| SocketAddr::from(([a, b, c, node], server_port));
        nodes.iter().map(server).collect()
    });
    let public_ports = Claim { entry: start_port_entry, values: public_ports.unwrap_or_default() };
    warn_of_privileged_ports(&public_ports);
    let servers = Claim { entry: subnet_entry, values: servers.unwrap_or_default() };
    let servers_beyond_gateway = beyond.boolean().unwrap_or(false);
    Draft { place, name, net, nodes, public_ports, servers, allowed, servers_beyond_gateway }
}

/// A single server outside any range.
pub(super) fn server(mut section: Section<'_>) -> Draft<'_> {
    let place = section.place.clone();
    let name = section.key("name", "\"press\"").required();
    let port_entry = section.key("public_port", "20200").required();
    let port = port_entry.integer(1..=u16::MAX);
    let address_entry = section.key("address", "\"172.17.18.7:34379\"").required();
    let address = endpoint(&address_entry);
    let node_entry = section.key("node", "7").required();
    let node = node_entry.integer(1..=LAST_NODE);
    let beyond = section.key("servers_beyond_gateway", "true");
    let Rules { net, networks } = rules(&mut section, &name, NetKind::Server);
    section.finish();

    let allowed = Allowed::of(networks);

    if let (Some(port), Some(node)) = (port, node) {
        warn_of_unreachable(&port_entry, port, node);
    }
    if let Some(address) = address {
        check_server_address(&address_entry, address, node);
    }
    let public_ports =
        Claim { entry: port_entry, values: port.map(PublicPort::everywhere).into_iter().collect() };
    warn_of_privileged_ports(&public_ports);
    let servers = Claim { entry: address_entry, values: address.into_iter().collect() };
    let nodes = node.into_iter().collect();
    let servers_beyond_gateway = beyond.boolean().unwrap_or(false);
    Draft { place, name, net, nodes, public_ports, servers, allowed, servers_beyond_gateway }
}

/// The keys that all nets share.
pub(super) fn rules<'a>(section: &mut Section<'a>, name: &Entry<'_>, kind: NetKind) -> Rules<'a> {
    let allow = section.key("allow", "[\"198.51.100.0/24\"]").required();
    let has_passwords = !matches!(kind, NetKind::ProfinetDevice { .. });
    let idle_timeout = match has_passwords {
        true => idle_timeout(&section.key("idle_timeout", "\"5m\"")),
        false => defaults::CALL_TIMEOUT,
    };
    let max_flows = section.key("max_flows", "4096");
    let max_requests = section.key("max_requests_per_second", "200");
    let max_flow_requests = section.key("max_flow_requests_per_second", "20");
    let passwords = if has_passwords { passwords(section, kind) } else { Passwords::NONE };
    let networks = allow.list().into_iter().filter_map(|element| {
        let network = network(&element)?;
        Some((element, network))
    });
    let networks: Vec<_> = networks.collect();
    let net = Net {
        name: super::name::name(name).unwrap_or_default(),
        kind,
        allow: networks.iter().map(|(_, network)| *network).collect(),
        credentials: passwords.credentials,
        allow_without_password: passwords.may_be_missing,
        require_response_password: passwords.are_in_responses,
        idle_timeout,
        max_flows: max_flows.integer(1..=MOST_FLOWS).unwrap_or(defaults::NET_MAX_FLOWS),
        max_requests: request_rate(&max_requests),
        max_flow_requests: request_rate(&max_flow_requests),
    };
    Rules { net, networks }
}

/// Refuses a network of all addresses, and says why.
pub(super) fn refuse_everybody(entry: &Entry<'_>, network: &IpNet, why: &str) {
    if network.prefix_len() == 0 {
        entry.fault(
            format!("{} is every address: {why}", quoted(&network.to_string())),
            "name the networks that need it, like \"198.51.100.0/28\"",
        );
    }
}

fn request_rate(entry: &Entry<'_>) -> Option<RequestRate> {
    entry.integer(1..=RequestRate::MOST).map(RequestRate::new)
}

pub(super) fn start_port(entry: &Entry<'_>) -> Option<u16> {
    let start_port = entry.integer(1..=u16::MAX)?;
    if start_port > LAST_START_PORT {
        entry.fault(
            format!("{start_port} + {LAST_NODE} is over {}", u16::MAX),
            format!("choose a start port up to {LAST_START_PORT}"),
        );
        return None;
    }
    if start_port == NORMAL_PORT {
        entry.warn(
            format!("node 1 gets port {SECURE_PORT}, on which P-NET servers themselves listen"),
            "choose another start port, unless clients already have this one",
        );
    }
    Some(start_port)
}

/// the mask is 255.255.255.0.
pub(super) fn subnet(entry: &Entry<'_>) -> Option<[u8; 4]> {
    let text = entry.text()?;
    let Ok(subnet) = text.parse::<Ipv4Addr>() else {
        let network = text.split('/').next().unwrap_or(text).parse::<Ipv4Addr>();
        let remedy = network.map_or_else(
            |_| entry.like(),
            |network| format!("write \"{network}\": its mask is always 255.255.255.0"),
        );
        entry.fault(format!("{} cannot be read: not an IPv4 address", quoted(text)), remedy);
        return None;
    };
    let [a, b, c, last] = subnet.octets();
    if last != 0 {
        entry.fault(
            format!("{subnet} is not a subnet: its mask is 255.255.255.0"),
            format!("write \"{a}.{b}.{c}.0\""),
        );
    }
    let first = Ipv4Addr::new(a, b, c, 1);
    if !is_a_host(first.into()) {
        entry.fault(format!("{first} is not a host address"), "name the subnet of the servers");
        return None;
    }
    Some([a, b, c, 0])
}

fn check_server_address(entry: &Entry<'_>, address: SocketAddr, node: Option<u8>) {
    refuse_normal_port(entry, address.port());
    if address.port() == 0 || !is_a_host(address.ip()) {
        entry.fault(format!("no server can be at {address}"), "name the server's address and port");
    }
    let zone = matches!(address, SocketAddr::V6(v6) if v6.scope_id() != 0);
    if is_link_local(address.ip()) && !zone {
        entry.fault(
            format!("{} is link-local: the same on every interface", address.ip()),
            format!(
                "add the interface's number, which `ip link` shows: \"[{}%2]:{}\"; or name \
                 another address of the server",
                address.ip(),
                address.port()
            ),
        );
    } else if zone && !is_link_local(address.ip()) {
        let without = SocketAddr::new(address.ip(), address.port());
        entry.fault("only link-local addresses have a zone", format!("write \"{without}\""));
    }
    if let (IpAddr::V4(ip), Some(node)) = (address.ip(), node)
        && ip.octets()[3] != node
    {
        //
        entry.warn(
            format!("the last octet of {ip} is not its node address, {node}"),
            "correct `address` or `node`; otherwise the server ignores every package",
        );
    }
}

fn refuse_normal_port(entry: &Entry<'_>, port: u16) {
    //
    if port == NORMAL_PORT {
        entry.fault(
            format!("{NORMAL_PORT} is the port for packages without a password"),
            format!("send to the servers' Secure port, {SECURE_PORT}"),
        );
    }
}

pub(super) fn warn_of_privileged_ports(ports: &Claim<'_, PublicPort>) {
    if let Some(PublicPort { port, .. }) =
        ports.values.iter().find(|public| public.port < FIRST_UNPRIVILEGED_PORT)
    {
        ports.entry.warn(
            format!("public port {port} is below {FIRST_UNPRIVILEGED_PORT}"),
            "run pnet-nat with CAP_NET_BIND_SERVICE, or choose higher ports",
        );
    }
}

fn warn_of_unreachable(entry: &Entry<'_>, port: u16, node: u8) {
    let no_row =
        format!("no IPNetTable row leads to node {node}: its UDPPort would be {port} - {node}");
    let last = LAST_START_PORT + u16::from(node);
    if port <= u16::from(node) {
        entry.warn(no_row, format!("choose a public port over {node}"));
    } else if port > last {
        let problem = format!("{no_row}, which is over {LAST_START_PORT}");
        entry.warn(problem, format!("choose a public port up to {last}")); // A15
    }
}

fn idle_timeout(entry: &Entry<'_>) -> Duration {
    let timeout =
        entry.duration(Duration::from_millis(1)..=LONGEST).unwrap_or(defaults::IDLE_TIMEOUT);
    if timeout < SHORT_IDLE_TIMEOUT {
        entry.warn(
            format!("{} is short: answers may be lost", humantime::format_duration(timeout)),
            "choose \"2m\" or more (RFC 4787 REQ-5)",
        );
    }
    timeout
}
