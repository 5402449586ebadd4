//! Addresses and networks in the file, and the remedy where a text is neither.
//!
//! Host names are never resolved: the addresses of a name change, and the relay asks no name server. An
//! IPv4 address that is mapped into IPv6 (`::ffff:192.0.2.1`) is read as the IPv4 address.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

use ipnet::{IpNet, Ipv4Net};

use super::report::quoted;
use super::toml_table::Entry;

/// Words that people write for "every address".
const EVERYWHERE: [&str; 6] = ["any", "all", "*", "everywhere", "world", "internet"];

/// An address that the relay listens on.
pub(super) fn listener(entry: &Entry<'_>) -> Option<IpAddr> {
    let text = entry.text()?;
    let Ok(address) = text.parse::<IpAddr>() else {
        let remedy = match text.split_once('%') {
            Some(_) => LINK_LOCAL_LISTENER.into(),
            None if is_everywhere(text) => "write \"0.0.0.0\" for IPv4, \"::\" for IPv6".into(),
            None => {
                format!("{}write an address of this host, like \"192.0.2.1\"", not_a_name(text))
            }
        };
        entry.fault(format!("{} cannot be read: not an IP address", quoted(text)), remedy);
        return None;
    };
    let address = address.to_canonical();
    if is_link_local(address) {
        entry.fault(
            format!("{address} is link-local: the same on every interface"),
            LINK_LOCAL_LISTENER,
        );
        return None;
    }
    if !address.is_unspecified() && !is_a_host(address) {
        let kind = if address.is_multicast() { "a multicast group" } else { "not a host address" };
        entry.fault(format!("{address} is {kind}"), "name an address of this host, or \"0.0.0.0\"");
        return None;
    }
    Some(address)
}

const LINK_LOCAL_LISTENER: &str =
    "name another address of the interface, or \"::\", which includes link-local addresses";

/// The address of a host, IPv4 or IPv6.
pub(super) fn address(entry: &Entry<'_>) -> Option<IpAddr> {
    let text = entry.text()?;
    if let Ok(address) = text.parse::<IpAddr>() {
        return Some(address.to_canonical());
    }
    let remedy = match text.parse::<SocketAddr>() {
        Ok(endpoint) => format!("write it without the port: \"{}\"", endpoint.ip()),
        Err(_) => not_a_name(text) + &entry.like(),
    };
    entry.fault(format!("{} cannot be read: not an IP address", quoted(text)), remedy);
    None
}

/// An address and a port.
pub(super) fn endpoint(entry: &Entry<'_>) -> Option<SocketAddr> {
    let text = entry.text()?;
    if let Ok(address) = text.parse::<SocketAddr>() {
        return Some(match address.ip().to_canonical() {
            IpAddr::V4(v4) => (v4, address.port()).into(),
            IpAddr::V6(_) => address,
        });
    }
    let (problem, remedy) = if let Ok(address) = text.parse::<IpAddr>() {
        let example = SocketAddr::new(address.to_canonical(), entry.example_port());
        ("the port is missing", format!("write it like \"{example}\""))
    } else if text.contains('%') {
        let remedy =
            "the zone is the interface's number, like \"[fe80::7%2]:34379\"; `ip link` shows it";
        ("not an address and port", remedy.into())
    } else {
        ("not an address and port", not_a_name(text) + &entry.like())
    };
    entry.fault(format!("{} cannot be read: {problem}", quoted(text)), remedy);
    None
}

/// An IPv4 address, as an IPNetTable has them.
pub(super) fn ipv4(entry: &Entry<'_>) -> Option<Ipv4Addr> {
    let text = entry.text()?;
    if let Ok(address) = text.parse::<Ipv4Addr>() {
        return Some(address);
    }
    let before_prefix = text.split('/').next().unwrap_or(text);
    let remedy = match (before_prefix.parse::<Ipv4Addr>(), text.parse::<SocketAddr>()) {
        (Ok(address), _) => format!("write \"{address}\": its mask is always 255.255.255.0"),
        (_, Ok(endpoint)) if endpoint.is_ipv4() => {
            format!("write it without the port: \"{}\"", endpoint.ip())
        }
        _ => not_a_name(text) + &entry.like(),
    };
    entry.fault(format!("{} cannot be read: not an IPv4 address", quoted(text)), remedy);
    None
}

/// A network, or a single address.
pub(super) fn network(entry: &Entry<'_>) -> Option<IpNet> {
    let text = entry.text()?;
    let parsed = match text.parse::<IpAddr>() {
        Ok(address) => Ok(IpNet::from(address.to_canonical())),
        Err(_) => text.parse::<IpNet>(),
    };
    let Ok(network) = parsed else {
        let problem = format!("{} cannot be read: not a network", quoted(text));
        entry.fault(problem, instead_of_network(text));
        return None;
    };
    if network != network.trunc() {
        let (alone, all) = (IpNet::from(network.addr()), network.trunc());
        let remedy = format!("write \"{all}\" for the network, \"{alone}\" for the one address");
        entry.fault(format!("{network} has bits set beyond its prefix"), remedy);
        return None;
    }
    if let IpNet::V6(v6) = network
        && let Some(v4) = v6.network().to_ipv4_mapped()
    {
        let v4 = Ipv4Net::new(v4, v6.prefix_len().saturating_sub(96)).map(|v4| v4.trunc());
        let v4 = v4.map_or_else(|_| "0.0.0.0/0".into(), |v4| v4.to_string());
        entry.fault("IPv4 clients are compared as IPv4", format!("write \"{v4}\""));
        return None;
    }
    Some(network)
}

fn instead_of_network(text: &str) -> String {
    if is_everywhere(text) {
        return "write \"0.0.0.0/0\" for every IPv4 address, \"::/0\" for every IPv6 one".into();
    }
    let (address, rest) = text.split_once('/').unwrap_or((text, ""));
    if let (Ok(address), Ok(mask)) = (address.parse::<Ipv4Addr>(), rest.parse::<Ipv4Addr>())
        && let Ok(network) = Ipv4Net::with_netmask(address, mask)
    {
        return format!("write \"{}\"", network.trunc());
    }
    if let Ok(address) = address.parse::<IpAddr>() {
        let most = if address.is_ipv4() { 32 } else { 128 };
        return format!("the prefix after / is a number from 0 to {most}: \"{address}/{most}\"");
    }
    if let Ok(endpoint) = text.parse::<SocketAddr>() {
        return format!("write it without the port: \"{}\"", endpoint.ip());
    }
    format!("{}write it like \"198.51.100.0/24\" or \"198.51.100.7/32\"", not_a_name(text))
}

fn is_everywhere(text: &str) -> bool {
    EVERYWHERE.iter().any(|word| text.trim().eq_ignore_ascii_case(word))
}

/// The beginning of a remedy for a text that may be meant as a host name.
fn not_a_name(text: &str) -> String {
    let is_name = text.chars().any(|c| c.is_ascii_alphabetic()) && !text.contains("::");
    if is_name { "names are not looked up; ".into() } else { String::new() }
}

/// Whether a host can have this address.
pub(super) fn is_a_host(address: IpAddr) -> bool {
    let reserved =
        matches!(address, IpAddr::V4(v4) if v4.octets()[0] == 0 || v4.octets()[0] >= 240);
    !(reserved || address.is_unspecified() || address.is_multicast())
}

/// Whether an address needs its interface to be unambiguous.
pub(super) fn is_link_local(address: IpAddr) -> bool {
    matches!(address, IpAddr::V6(v6) if Ipv6Addr::is_unicast_link_local(&v6))
}
