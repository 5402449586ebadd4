//! Tells whether an answer could leave for a client. The kernel looks for the route and sends
//! nothing.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::os::fd::AsRawFd;

use nix::errno::Errno;
use nix::sys::socket::{ControlMessage, MsgFlags, SockaddrStorage, sendmsg};

use crate::datapath::socket::public::Listener;
use crate::datapath::socket::sys::address::{in_addr, in6_addr};

/// `MSG_PROBE` of the kernel, which libc lacks. With this flag, with `MSG_CONFIRM` and without
/// octets, the kernel finds the route of a datagram and then stops.
const MSG_PROBE: libc::c_int = 0x10;
const LOOK: MsgFlags =
    MsgFlags::from_bits_retain(libc::MSG_CONFIRM | libc::MSG_DONTWAIT | MSG_PROBE);

/// Whether a datagram could leave from this socket and this address to `to`. When the kernel does
/// not tell, the answer is yes.
pub(in crate::datapath) fn exists(listener: &Listener, from: IpAddr, to: SocketAddr) -> bool {
    let from = listener.own_address().is_none().then_some(from);
    // The reasons: a broadcast address, no route, a route that forbids it, or an address that is
    // not this machine's.
    let refusals = [Errno::EACCES, Errno::ENETUNREACH, Errno::EHOSTUNREACH, Errno::EINVAL];
    look(listener, from, to).map_or_else(|error| !refusals.contains(&error), |()| true)
}

fn look(listener: &Listener, from: Option<IpAddr>, to: SocketAddr) -> nix::Result<()> {
    let (v4, v6);
    let source = match from {
        None => None,
        Some(IpAddr::V4(address)) => {
            let unspecified = in_addr(Ipv4Addr::UNSPECIFIED);
            v4 = libc::in_pktinfo {
                ipi_ifindex: 0,
                ipi_spec_dst: in_addr(address),
                ipi_addr: unspecified,
            };
            Some(ControlMessage::Ipv4PacketInfo(&v4))
        }
        Some(IpAddr::V6(address)) => {
            v6 = libc::in6_pktinfo { ipi6_addr: in6_addr(address), ipi6_ifindex: 0 };
            Some(ControlMessage::Ipv6PacketInfo(&v6))
        }
    };
    let socket = listener.socket.socket().as_raw_fd();
    let to = SockaddrStorage::from(to);
    sendmsg(socket, &[io::IoSlice::new(&[])], source.as_slice(), LOOK, Some(&to)).map(drop)
}
