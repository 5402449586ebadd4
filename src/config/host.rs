//! How this host reaches the servers: whether an address is the host's own, and from which address
//! datagrams to it would leave.
//!
//! To find out, a UDP socket is connected. That sends nothing, but gives the socket the source address
//! that the kernel would use. The confinement allows no other way to ask. Loopback is never asked about.

use std::collections::HashSet;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};

use crate::nat::Table;

use super::net::Draft;

/// The routes of a host.
pub(super) trait Host {
    /// The source address of datagrams to `to`; none when nothing is known of the host.
    fn source_towards(&self, to: SocketAddr) -> Option<io::Result<IpAddr>>;
}

/// The host that this process runs on.
#[derive(Debug)]
pub(super) struct ThisHost;

impl Host for ThisHost {
    fn source_towards(&self, to: SocketAddr) -> Option<io::Result<IpAddr>> {
        Some(source_towards(to))
    }
}

/// The address from which datagrams to `to` would leave. Sends nothing.
pub(crate) fn source_towards(to: SocketAddr) -> io::Result<IpAddr> {
    let any: IpAddr = match to.ip() {
        IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
    };
    let socket = UdpSocket::bind((any, 0))?;
    socket.connect(to)?;
    Ok(socket.local_addr()?.ip())
}

/// A host of which nothing is known: only the text is checked.
#[derive(Debug)]
pub(super) struct Unknown;

impl Host for Unknown {
    fn source_towards(&self, _: SocketAddr) -> Option<io::Result<IpAddr>> {
        None
    }
}

/// Refuses servers that are the relay itself, and servers that are reached by the Internet side. Warns of
/// servers that no interface leads to. Servers of the table in force are not checked: a change of their
/// route must not delay the withdrawal of a password.
pub(super) fn check(
    drafts: &[Draft<'_>],
    listen: &[IpAddr],
    host: &dyn Host,
    in_force: Option<&Table>,
) {
    let is_served = |server: &&SocketAddr| {
        in_force.is_some_and(|table| table.mapping_of_server(**server).is_some())
    };
    let public = drafts.iter().flat_map(|draft| &draft.public_ports.values);
    let everywhere = public.filter(|public| public.address.is_none());
    let public_ports: HashSet<u16> = everywhere.map(|public| public.port).collect();
    for draft in drafts {
        let mut new = draft.servers.values.iter().filter(|server| !is_served(server)).peekable();
        // All servers of a net are in one subnet, and so have one route.
        let Some(first) = new.peek().copied().filter(|server| !server.ip().is_loopback()) else {
            continue;
        };
        let is_own = |server: &&SocketAddr| {
            let hears = |own: &IpAddr| own.is_unspecified() && own.is_ipv4() == server.is_ipv4();
            public_ports.contains(&server.port())
                && listen.iter().any(hears)
                && matches!(host.source_towards(**server), Some(Ok(own)) if own == server.ip())
        };
        if let Some(own) = new.find(is_own) {
            draft.servers.entry.fault(
                format!("server {own} is this router itself, on a public port"),
                "enter the server's own address; datagrams to this one would loop",
            );
        } else {
            check_route(draft, *first, listen, host);
        }
    }
}

fn check_route(draft: &Draft<'_>, server: SocketAddr, listen: &[IpAddr], host: &dyn Host) {
    let entry = &draft.servers.entry;
    let Some(source) = host.source_towards(server) else { return };
    let Ok(source) = source else {
        entry.warn(
            format!("no route leads to {}", server.ip()),
            "correct the address, or bring up the interface towards the plant",
        );
        return;
    };
    if is_near(source, server.ip()) || draft.servers_beyond_gateway {
        return;
    }
    if is_public(source, listen, host) {
        entry.fault_that_passes(
            format!("the route to {} leaves by the Internet side, from {source}", server.ip()),
            "passwords would leave in clear text: correct the address, or bring up the interface towards \
             the plant; if the servers are behind that gateway, set `servers_beyond_gateway = true`",
        );
    } else {
        entry.warn(
            format!(
                "no interface of this host is in the subnet of {}: the route starts at {source}",
                server.ip()
            ),
            "correct the address, or set `servers_beyond_gateway = true` if a gateway leads there",
        );
    }
}

/// Whether this address of the host is in the server's subnet.
fn is_near(source: IpAddr, server: IpAddr) -> bool {
    match (source, server) {
        (IpAddr::V4(source), IpAddr::V4(server)) => source.octets()[..3] == server.octets()[..3],
        (IpAddr::V6(source), IpAddr::V6(server)) => source.octets()[..8] == server.octets()[..8],
        _ => false,
    }
}

/// Whether clients reach this address of the host: `listen` names it, or it is the address towards the
/// Internet. Addresses reserved for documentation stand for the Internet.
fn is_public(source: IpAddr, listen: &[IpAddr], host: &dyn Host) -> bool {
    if listen.contains(&source) {
        return true;
    }
    let hears = |own: &IpAddr| own.is_unspecified() && own.is_ipv4() == source.is_ipv4();
    let far: [IpAddr; 2] = match source {
        IpAddr::V4(_) => [Ipv4Addr::new(192, 0, 2, 1).into(), Ipv4Addr::new(203, 0, 113, 1).into()],
        IpAddr::V6(_) => {
            [1, 2].map(|last| Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, last).into())
        }
    };
    let is_theirs = |far: IpAddr| matches!(host.source_towards((far, 9).into()), Some(Ok(theirs)) if theirs == source);
    listen.iter().any(hears) && far.into_iter().all(is_theirs)
}
