//! What this host has to offer: its addresses, and ports that are free.
//!
//! Nothing is sent. A connected UDP socket tells which address the kernel would send from.

use std::fmt::{self, Display};
use std::fs;
use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, UdpSocket};

use nix::ifaddrs::getifaddrs;
use nix::net::if_::InterfaceFlags;

use super::answers::{Nodes, Subnet, subnet_of};
use crate::config::{ADMIN_LISTEN, source_towards};
use crate::datapath::{USUAL_PORT_RANGE, port_range};
use crate::pnet::wire::{LAST_START_PORT, SECURE_PORT};

/// The usual port of the admin server.
pub(super) const ADMIN_PORT: u16 = ADMIN_LISTEN.port();

/// Start ports that are offered, in this order.
fn start_ports() -> impl Iterator<Item = u16> {
    (20_000..=LAST_START_PORT).step_by(200)
}

/// The IPv4 addresses of this host but those of loopback, with the names of their interfaces.
#[derive(Debug, Default)]
pub(super) struct Host(Vec<(String, Ipv4Addr)>);

impl Display for Host {
    /// `203.0.113.5 (wan0), 172.17.17.250 (plant0)`
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str("of loopback alone");
        }
        let each = self.0.iter().map(|(interface, address)| format!("{address} ({interface})"));
        f.write_str(&each.collect::<Vec<_>>().join(", "))
    }
}

impl Host {
    /// The host that this process runs on. What cannot be read is not offered.
    pub(super) fn this() -> Self {
        let Ok(interfaces) = getifaddrs() else { return Self::default() };
        let addresses = interfaces.filter_map(|interface| {
            let address = interface.address?.as_sockaddr_in()?.ip();
            let is_loopback = interface.flags.contains(InterfaceFlags::IFF_LOOPBACK);
            (!is_loopback).then_some((interface.interface_name, address))
        });
        Self(addresses.collect())
    }

    /// The address towards the Internet; an address that is reserved for documentation stands for that.
    pub(super) fn public(&self) -> Option<IpAddr> {
        let source = source_towards((Ipv4Addr::new(192, 0, 2, 1), 9).into());
        source.ok().filter(|address| !address.is_unspecified())
    }

    /// The subnet of another interface than those that clients come in by, a private one.
    pub(super) fn subnet(&self, listen: &[IpAddr]) -> Option<Subnet> {
        let public = listen.iter().copied().chain(self.public());
        let public: Vec<_> = public
            .filter_map(|address| match address {
                IpAddr::V4(address) => Some(subnet_of(address)),
                IpAddr::V6(_) => None,
            })
            .collect();
        let others = self.0.iter().filter(|(_, address)| address.is_private());
        others.map(|(_, address)| subnet_of(*address)).find(|subnet| !public.contains(subnet))
    }
}

/// The first block outside the ports that Linux lends to other programs in which no node's port is in use;
/// the first one where there is none.
pub(super) fn free_block(listen: &[IpAddr], nodes: &Nodes) -> u16 {
    let lent = fs::read_to_string("/proc/sys/net/ipv4/ip_local_port_range").ok();
    let lent = lent.and_then(|lent| port_range(&lent)).unwrap_or(USUAL_PORT_RANGE);
    let is_lent = |start: u16| start + 127 >= *lent.start() && start <= *lent.end();
    let is_used = |start: u16| {
        let ports = nodes.iter().map(|node| start + node);
        ports.into_iter().any(|port| listen.iter().any(|address| is_taken((*address, port).into())))
    };
    start_ports().find(|start| !is_lent(*start) && !is_used(*start)).unwrap_or(20_000)
}

/// Whether a program has this UDP port. An address that is not this host's is nobody's yet.
fn is_taken(address: SocketAddr) -> bool {
    UdpSocket::bind(address).is_err_and(|error| error.kind() == ErrorKind::AddrInUse)
}

/// A subnet of loopback where no node runs.
pub(super) fn free_loopback_subnet() -> Subnet {
    let mut subnets = (17..=99).map(|third| Ipv4Addr::new(127, 17, third, 0));
    let is_free = |subnet: &Ipv4Addr| {
        let [a, b, c, _] = subnet.octets();
        !is_taken((Ipv4Addr::new(a, b, c, 1), SECURE_PORT).into())
    };
    Subnet(subnets.find(is_free).unwrap_or(Ipv4Addr::new(127, 17, 17, 0)))
}

/// A free port for the admin server, where another program has the usual one.
pub(super) fn admin_port() -> Option<u16> {
    let is_taken = |port: &u16| {
        let tried = TcpListener::bind((Ipv4Addr::LOCALHOST, *port));
        tried.is_err_and(|error| error.kind() == ErrorKind::AddrInUse)
    };
    (ADMIN_PORT..ADMIN_PORT + 100).find(|port| !is_taken(port)).filter(|port| *port != ADMIN_PORT)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::NodeRange;

    fn host(addresses: &[[u8; 4]]) -> Host {
        Host(addresses.iter().map(|address| ("eth".to_owned(), (*address).into())).collect())
    }

    #[test]
    fn the_plant_is_offered_where_clients_do_not_come_in() {
        let host = host(&[[203, 0, 113, 5], [10, 1, 2, 9], [172, 17, 17, 250]]);
        let listen = |address: [u8; 4]| host.subnet(&[address.into()]);
        assert_eq!(listen([10, 1, 2, 9]), Some(Subnet([172, 17, 17, 0].into())));
        assert_ne!(listen([172, 17, 17, 250]), Some(Subnet([172, 17, 17, 0].into())));
        assert_eq!(self::host(&[[203, 0, 113, 5]]).subnet(&[]), None, "never a public one");
    }

    #[test]
    fn a_block_in_use_is_passed_over() {
        let listen: IpAddr = [127, 63, 17, 9].into(); // no scenario's
        let nodes = Nodes::of(&[NodeRange(1..=4)]);
        let first = free_block(&[listen], &nodes);
        let _held = UdpSocket::bind((listen, first + 4)).unwrap();
        let second = free_block(&[listen], &nodes);
        assert!(second > first, "{first} {second}");
        assert_eq!(free_block(&[listen], &Nodes::of(&[NodeRange(5..=5)])), first);
    }
}
