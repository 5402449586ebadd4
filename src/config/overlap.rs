//! What nets must not share: names, public ports, servers, and the ports of broadcasts. And no server may
//! be the router itself.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::hash::Hash;
use std::net::{IpAddr, SocketAddr};

use super::changes::runs;
use super::net::{Claim, Draft, PublicPort};
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

/// A port of every address is shared with the same port of a single one.
fn refuse_shared_ports(drafts: &[Draft<'_>]) {
    for ((later, earlier), public) in shared(drafts, |draft| &draft.public_ports) {
        let ports: Vec<_> = public.iter().map(|public| public.port).collect();
        let (what, remedy) = match public[0] {
            PublicPort { address: Some(address), port } if drafts[earlier].net.kind.is_remote() => {
                (
                    format!("{}{}", SocketAddr::new(address, port), and_more(&public)),
                    "give each remote net a local subnet of its own",
                )
            }
            _ => (format!("public port {}", runs(&ports)), "move one of the two to free ports"),
        };
        drafts[later]
            .public_ports
            .entry
            .fault(format!("{what} belongs to {} too", drafts[earlier].label()), remedy);
    }
}

/// How many more there are than the first.
fn and_more<T>(values: &[T]) -> String {
    match values.len() - 1 {
        0 => String::new(),
        more => format!(" (and {more} more)"),
    }
}

fn refuse_shared_servers(drafts: &[Draft<'_>]) {
    for ((later, earlier), servers) in shared(drafts, |draft| &draft.servers) {
        let more = and_more(&servers);
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
        for PublicPort { port, .. } in &draft.public_ports.values {
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
    let public: HashSet<PublicPort> =
        drafts.iter().flat_map(|draft| draft.public_ports.values.iter().copied()).collect();
    let own: HashSet<&IpAddr> = listen.iter().collect();
    // Listening on every address includes loopback. Other addresses of this host are not known here.
    let everywhere = listen.iter().any(IpAddr::is_unspecified);
    let is_ours = |server: &SocketAddr| {
        let ip = server.ip();
        let is_here = own.contains(&ip) || everywhere && ip.is_loopback();
        let at = |address| public.contains(&PublicPort { address, port: server.port() });
        is_here && at(None) || at(Some(ip))
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

/// What a net may claim.
trait Claimed: Copy {
    type Key: Eq + Hash;
    /// Another claim with one of these keys is in the way of this one.
    fn clashes(self) -> impl Iterator<Item = Self::Key>;
    /// Under these keys, later claims find this one.
    fn keys(self) -> impl Iterator<Item = Self::Key>;
}

impl Claimed for SocketAddr {
    type Key = Self;

    fn clashes(self) -> impl Iterator<Item = Self> {
        [self].into_iter()
    }

    fn keys(self) -> impl Iterator<Item = Self> {
        [self].into_iter()
    }
}

/// A public port: at every address, at some address, or at this one.
#[derive(PartialEq, Eq, Hash)]
enum At {
    Every(u16),
    Some(u16),
    One(IpAddr, u16),
}

impl Claimed for PublicPort {
    type Key = At;

    fn clashes(self) -> impl Iterator<Item = At> {
        let other = match self.address {
            None => At::Some(self.port),
            Some(address) => At::One(address, self.port),
        };
        [At::Every(self.port), other].into_iter()
    }

    fn keys(self) -> impl Iterator<Item = At> {
        match self.address {
            None => vec![At::Every(self.port)],
            Some(address) => vec![At::Some(self.port), At::One(address, self.port)],
        }
        .into_iter()
    }
}

/// What two nets both claim, by (index of the later net, index of the earlier one).
fn shared<'a, T: Claimed + 'a>(
    drafts: &'a [Draft<'a>],
    claim: impl Fn(&'a Draft<'a>) -> &'a Claim<'a, T>,
) -> BTreeMap<(usize, usize), Vec<T>> {
    let mut first = HashMap::new();
    let mut shared: BTreeMap<_, Vec<T>> = BTreeMap::new();
    for (index, draft) in drafts.iter().enumerate() {
        for &value in &claim(draft).values {
            if let Some(&earlier) = value.clashes().find_map(|key| first.get(&key)) {
                shared.entry((index, earlier)).or_default().push(value);
            }
            for key in value.keys() {
                first.entry(key).or_insert(index);
            }
        }
    }
    shared
}
