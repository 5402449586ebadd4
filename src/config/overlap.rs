//! What nets must not share: names, public ports, servers, and the ports of broadcasts. And no server may
//! be the router itself.

use std::collections::hash_map::Entry as Slot;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::hash::Hash;
use std::net::{IpAddr, SocketAddr};

use super::changes::runs;
use super::net::{Claim, Draft};
use super::toml_table::Entry;

/// Reports every conflict between two nets, once for each pair, and every loop.
pub(super) fn refuse_overlaps(drafts: &[Draft<'_>], listen: &[IpAddr]) {
    refuse_shared_names(drafts);
    refuse_shared_ports(drafts);
    refuse_shared_servers(drafts);
    refuse_broadcast_ports(drafts);
    refuse_loops(drafts, listen);
}

fn refuse_shared_names(drafts: &[Draft<'_>]) {
    let mut first: HashMap<&str, &Draft<'_>> = HashMap::new();
    for draft in drafts.iter().filter(|draft| !draft.net.name.is_empty()) {
        if let Some(other) = first.get(draft.net.name.as_str()) {
            let problem = format!("already the name of {}", other.label());
            draft.name.fault(problem, "give each net its own name");
        } else {
            first.insert(&draft.net.name, draft);
        }
    }
}

fn refuse_shared_ports(drafts: &[Draft<'_>]) {
    for ((later, earlier), ports) in shared(drafts, |draft| &draft.public_ports) {
        drafts[later].public_ports.entry.fault(
            format!("public port {} belongs to {} too", runs(&ports), drafts[earlier].label()),
            "move one of the two to free ports",
        );
    }
}

fn refuse_shared_servers(drafts: &[Draft<'_>]) {
    for ((later, earlier), servers) in shared(drafts, |draft| &draft.servers) {
        let more = match servers.len() - 1 {
            0 => String::new(),
            more => format!(" (and {more} more)"),
        };
        drafts[later].servers.entry.fault(
            format!("server {}{more} belongs to {} too", servers[0], drafts[earlier].label()),
            "give each server one public port only",
        );
    }
}

/// nothing listens at start port + 126 or + 127. Two blocks that share these ports are one fault.
fn refuse_broadcast_ports(drafts: &[Draft<'_>]) {
    let mut silent = HashMap::new();
    for range in drafts {
        for port in range.silent_ports() {
            silent.entry(port).or_insert(range);
        }
    }
    for draft in drafts {
        let mut told = HashSet::new();
        for port in &draft.public_ports.values {
            let Some(range) = silent.get(port) else { continue };
            if told.insert(&range.place.key) {
                draft.public_ports.entry.fault(
                    format!("public port {port} is a broadcast port of {}", range.label()),
                    "choose another: nothing may listen at start port + 126 or + 127",
                );
            }
        }
    }
}

fn refuse_loops(drafts: &[Draft<'_>], listen: &[IpAddr]) {
    let public_ports: HashSet<u16> =
        drafts.iter().flat_map(|draft| draft.public_ports.values.iter().copied()).collect();
    let own: HashSet<&IpAddr> = listen.iter().collect();
    // Listening on every address includes loopback. Other addresses of this host are not known here.
    let everywhere = listen.iter().any(IpAddr::is_unspecified);
    let is_ours = |server: &SocketAddr| {
        let ip = server.ip();
        let is_here = own.contains(&ip) || everywhere && ip.is_loopback();
        is_here && public_ports.contains(&server.port())
    };
    for draft in drafts {
        if let Some(server) = draft.servers.values.iter().find(|server| is_ours(server)) {
            draft.servers.entry.fault(
                format!("server {server} is a public port of this router"),
                "enter the server's own address; datagrams to this one would loop",
            );
        }
    }
}

/// A listener is reached only by clients of its address family: warns where one side has no counterpart.
pub(super) fn warn_of_deaf_listeners(drafts: &[Draft<'_>], listeners: &[(Entry<'_>, IpAddr)]) {
    for (family, example, is_of) in [
        ("IPv4", "0.0.0.0", IpAddr::is_ipv4 as fn(&IpAddr) -> bool),
        ("IPv6", "::", IpAddr::is_ipv6),
    ] {
        let mut listeners = listeners.iter().filter(|(_, address)| is_of(address)).peekable();
        let allowed = drafts.iter().filter_map(|draft| match family {
            "IPv4" => draft.allowed.ipv4.as_ref(),
            _ => draft.allowed.ipv6.as_ref(),
        });
        let mut allowed = allowed.peekable();
        match (listeners.peek(), allowed.peek()) {
            (None, Some(_)) => allowed.for_each(|element| {
                element.warn(
                    format!(
                        "no {family} client can reach the relay: `[public] listen` has no {family} address"
                    ),
                    format!("add \"{example}\", or one {family} address of this host, to `listen`"),
                );
            }),
            (Some(_), None) if !drafts.is_empty() => listeners.for_each(|(element, address)| {
                element.warn(
                    format!("no client can use {address}, since no `allow` has {family} networks"),
                    format!("add the clients' {family} networks to `allow`, or remove this address"),
                );
            }),
            _ => {}
        }
    }
}

/// What two nets both claim, by (index of the later net, index of the earlier one).
fn shared<'a, T: Copy + Eq + Hash + 'a>(
    drafts: &'a [Draft<'a>],
    claim: impl Fn(&'a Draft<'a>) -> &'a Claim<'a, T>,
) -> BTreeMap<(usize, usize), Vec<T>> {
    let mut first = HashMap::new();
    let mut shared: BTreeMap<_, Vec<T>> = BTreeMap::new();
    for (index, draft) in drafts.iter().enumerate() {
        for &value in &claim(draft).values {
            match first.entry(value) {
                Slot::Vacant(slot) => _ = slot.insert(index),
                Slot::Occupied(slot) => shared.entry((index, *slot.get())).or_default().push(value),
            }
        }
    }
    shared
}
