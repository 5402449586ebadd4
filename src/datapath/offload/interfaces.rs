//! At which interfaces the programs run, and what happens when interfaces, addresses or routes change.

use std::collections::BTreeSet;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::os::fd::{AsRawFd, OwnedFd};
use std::sync::{Arc, Weak};
use std::thread;
use std::time::Duration;

use nix::errno::Errno;
use nix::ifaddrs::{InterfaceAddress, getifaddrs};
use nix::net::if_::InterfaceFlags;
use nix::sys::socket::{
    AddressFamily, MsgFlags, NetlinkAddr, SockFlag, SockProtocol, SockType, bind, recv, socket,
};

use super::Offload;
use crate::config::Config;
use crate::datapath::socket::port_pool::Ports;
use crate::datapath::socket::sys::options;

/// The kinds of interfaces whose frames have hardware addresses (`ARPHRD_ETHER`, `ARPHRD_LOOPBACK`).
const ETHERNET: u16 = 1;
const LOOPBACK: u16 = 772;
/// Changes come in groups; those within this time are followed together.
const PAUSE: Duration = Duration::from_millis(200);

/// An interface.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Interface {
    pub(super) index: u32,
    pub(super) name: String,
}

/// What the interfaces of a configuration are found by.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Wanted {
    listen: Vec<IpAddr>,
    /// One node of each net.
    servers: Vec<SocketAddr>,
}

impl Wanted {
    pub(super) fn of(config: &Config) -> Self {
        let table = &config.table;
        let first = |net| Some(table.mapping(table.mappings_of(net).next()?).server);
        let servers = table.net_ids().filter_map(first).filter(SocketAddr::is_ipv4).collect();
        Self { listen: config.listen.clone(), servers }
    }

    /// The interfaces as they are now: those that have a public address, and those that lead to the nodes.
    /// A public address on lo or a dummy interface is reached by a route, through any of them. Interfaces
    /// whose frames have no hardware addresses are left out: tunnels.
    pub(super) fn interfaces(&self, ports: &Arc<Ports>) -> io::Result<BTreeSet<Interface>> {
        let all: Vec<_> = getifaddrs()?.collect();
        let towards =
            self.servers.iter().flat_map(|&server| options::source_towards(server, ports));
        let wanted: BTreeSet<IpAddr> = self.listen.iter().copied().chain(towards).collect();
        let address = |entry: &InterfaceAddress| Some(entry.address?.as_sockaddr_in()?.ip());
        let is_routed = |entry: &InterfaceAddress| {
            let lo_or_dummy = InterfaceFlags::IFF_LOOPBACK | InterfaceFlags::IFF_NOARP;
            let is_tunnel = entry.flags.contains(InterfaceFlags::IFF_POINTOPOINT);
            let is_it =
                |address: Ipv4Addr| !address.is_loopback() && self.listen.contains(&address.into());
            entry.flags.intersects(lo_or_dummy) && !is_tunnel && address(entry).is_some_and(is_it)
        };
        let any = wanted.iter().any(IpAddr::is_unspecified) || all.iter().any(is_routed);
        let has_it = |name: &str| {
            all.iter().filter(|entry| entry.interface_name == name).any(|entry| {
                address(entry).is_some_and(|address| any || wanted.contains(&address.into()))
            })
        };
        let links = all.iter().filter_map(|entry| {
            let link = *entry.address?.as_link_addr()?;
            Some((entry.interface_name.clone(), link.hatype(), link.ifindex()))
        });
        let wanted_ones = links.filter(|(name, kind, _)| match *kind {
            ETHERNET => has_it(name),
            LOOPBACK => wanted.iter().any(|address| address.is_ipv4() && address.is_loopback()),
            _ => false,
        });
        Ok(wanted_ones.map(|(name, _, index)| Interface { index: index as u32, name }).collect())
    }
}

/// Where the kernel tells of changes.
#[derive(Debug)]
pub(in crate::datapath) struct Changes(OwnedFd);

impl Changes {
    pub(super) fn new() -> io::Result<Self> {
        let groups = libc::RTMGRP_LINK
            | libc::RTMGRP_IPV4_IFADDR
            | libc::RTMGRP_IPV4_ROUTE
            | 1 << (libc::RTNLGRP_IPV4_RULE - 1);
        let (family, protocol) = (AddressFamily::Netlink, SockProtocol::NetlinkRoute);
        let socket = socket(family, SockType::Raw, SockFlag::SOCK_CLOEXEC, protocol)?;
        bind(socket.as_raw_fd(), &NetlinkAddr::new(0, groups as u32))?;
        Ok(Self(socket))
    }

    /// Follows the changes as long as there is a router.
    pub(super) fn follow(self, offload: &Weak<Offload>, ports: &Arc<Ports>) {
        loop {
            if let Err(error) = self.wait_for_group() {
                tracing::warn!(%error, "cannot hear of changes of interfaces");
                return;
            }
            let Some(offload) = offload.upgrade() else { return };
            offload.follow_interfaces(ports);
            drop(offload);
            #[expect(
                clippy::disallowed_methods,
                reason = "what comes meanwhile waits in the socket"
            )]
            thread::sleep(PAUSE);
        }
    }

    /// Waits for a change and takes all that the kernel has told by then. What changed does not matter, nor
    /// that the kernel had no room to tell all of it.
    fn wait_for_group(&self) -> io::Result<()> {
        let mut told = [0; 8192];
        let mut flags = MsgFlags::empty();
        loop {
            match recv(self.0.as_raw_fd(), &mut told, flags) {
                Ok(_) | Err(Errno::ENOBUFS) => flags = MsgFlags::MSG_DONTWAIT,
                Err(Errno::EINTR) => {}
                Err(Errno::EAGAIN) => return Ok(()),
                Err(error) => return Err(error.into()),
            }
        }
    }
}
