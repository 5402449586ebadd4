//! The conditions of a rule: what is known of a request, and whether it meets them.

use std::net::IpAddr;

use ipnet::IpNet;
use serde_json::Value;

/// A request of a client to a public port.
#[derive(Clone, Copy, Debug)]
pub(in crate::cli::probe) struct Arriving<'a> {
    pub(in crate::cli::probe) is_ipv4: bool,
    pub(in crate::cli::probe) port: u16,
    /// The interfaces that it may come in by; empty: that is not known.
    pub(in crate::cli::probe) interfaces: &'a [String],
    /// The networks that the client may be in.
    pub(in crate::cli::probe) clients: &'a [IpNet],
}

/// Whether a condition is met.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Met {
    Yes,
    No,
    Open,
}

impl Met {
    fn of(is_met: bool) -> Self {
        if is_met { Self::Yes } else { Self::No }
    }

    pub(super) fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::No, _) | (_, Self::No) => Self::No,
            (Self::Yes, Self::Yes) => Self::Yes,
            _ => Self::Open,
        }
    }

    fn or(self, other: Self) -> Self {
        match (self, other) {
            (Self::Yes, _) | (_, Self::Yes) => Self::Yes,
            (Self::No, Self::No) => Self::No,
            _ => Self::Open,
        }
    }

    fn not(self) -> Self {
        match self {
            Self::Yes => Self::No,
            Self::No => Self::Yes,
            Self::Open => Self::Open,
        }
    }
}

/// Whether a datagram meets a match.
pub(super) fn matches(content: &Value, arriving: Arriving<'_>) -> Met {
    let met = test(&content["left"], &content["right"], arriving);
    match content["op"].as_str() {
        Some("==" | "in") => met,
        Some("!=") => met.not(),
        _ => Met::Open,
    }
}

/// Whether what is on the left has this value, or one of these.
pub(super) fn test(left: &Value, right: &Value, arriving: Arriving<'_>) -> Met {
    if let Some(values) = right.as_array().or(right["set"].as_array()) {
        let met = values.iter().map(|value| test(left, value, arriving));
        return met.fold(Met::No, Met::or);
    }
    let right = if right["elem"].is_object() { &right["elem"]["val"] } else { right };
    let payload = &left["payload"];
    let protocol = payload["protocol"].as_str().unwrap_or_default();
    let field = payload["field"].as_str().or(left["meta"]["key"].as_str()).unwrap_or_default();
    let is_udp = || Met::of(right == "udp" || *right == 17);
    match (protocol, field) {
        ("ip", _) if !arriving.is_ipv4 => Met::No,
        ("ip6", _) if arriving.is_ipv4 => Met::No,
        ("ip", "protocol") | ("ip6", "nexthdr") | ("", "l4proto") => is_udp(),
        ("", "nfproto") => Met::of(right == if arriving.is_ipv4 { "ipv4" } else { "ipv6" }),
        ("udp" | "th", "dport") => port(right, arriving.port),
        ("udp" | "th" | "", "sport") => Met::Open,
        ("tcp" | "icmp" | "icmpv6" | "sctp" | "dccp" | "udplite" | "esp" | "ah", _) => Met::No,
        ("", "iifname" | "iif") => interface(right, arriving.interfaces),
        ("ip" | "ip6", "saddr") => client(right, arriving.clients),
        _ if left["ct"]["key"] == "state" => {
            if right.is_string() {
                Met::of(right == "new")
            } else {
                Met::Open
            }
        }
        _ => Met::Open,
    }
}

fn port(right: &Value, port: u16) -> Met {
    let port = u64::from(port);
    if let Some(number) = right.as_u64() {
        return Met::of(number == port);
    }
    match (right["range"][0].as_u64(), right["range"][1].as_u64()) {
        (Some(first), Some(last)) => Met::of((first..=last).contains(&port)),
        _ => Met::Open,
    }
}

fn interface(right: &Value, interfaces: &[String]) -> Met {
    let Some(name) = right.as_str().filter(|_| !interfaces.is_empty()) else { return Met::Open };
    let is_it = |interface: &String| match name.strip_suffix('*') {
        Some(start) => interface.starts_with(start),
        None => interface == name,
    };
    let those = interfaces.iter().filter(|interface| is_it(interface)).count();
    match those {
        0 => Met::No,
        all if all == interfaces.len() => Met::Yes,
        _ => Met::Open,
    }
}

fn client(right: &Value, clients: &[IpNet]) -> Met {
    let prefix = &right["prefix"];
    let network = match (prefix["addr"].as_str(), prefix["len"].as_u64()) {
        (Some(address), Some(length)) => format!("{address}/{length}").parse().ok(),
        _ => right.as_str().and_then(|text| Some(IpNet::from(text.parse::<IpAddr>().ok()?))),
    };
    let Some(network): Option<IpNet> = network else { return Met::Open };
    let of_this_family = |it: &&IpNet| it.addr().is_ipv4() == network.addr().is_ipv4();
    let mut clients = clients.iter().filter(of_this_family).peekable();
    if clients.peek().is_none() {
        return Met::Open;
    }
    let clients: Vec<_> = clients.collect();
    if clients.iter().all(|it| network.contains(*it)) {
        Met::Yes
    } else if clients.iter().any(|it| network.contains(*it) || it.contains(&network)) {
        Met::Open
    } else {
        Met::No
    }
}
