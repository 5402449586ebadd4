//! Opens UDP sockets with the options that the relay needs: public ones, which clients send to, and
//! upstream ones, which talk to the servers.
//!
//! No socket that carries datagrams is ever connected. So no ICMP error reaches a socket, and a
//! dead server can neither close a flow nor make the next healthy send fail (N-7).

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::os::fd::AsRawFd;
use std::sync::Arc;

use libc::c_int;
use nix::errno::Errno;
use nix::sys::socket::{setsockopt, sockopt};
use socket2::{Domain, Protocol, Socket, Type};

use crate::datapath::kernel_filter::reuseport;
use crate::datapath::socket::port_pool::{Port, Ports};
use crate::listen::CallError;

/// Octets of send buffer that the relay asks the kernel for, for each upstream socket; `sysctl
/// net.core.wmem_max` limits it. While the kernel asks for the hardware address of a node that is
/// switched off, requests to that node fill up to 208 KiB of the buffer. A send buffer is that long
/// by default, so the socket could then serve no other node.
const SEND_BUFFER: usize = 4 << 20;

/// More octets than a datagram takes of a receive buffer, with the kernel's own bookkeeping
/// included.
const A_DATAGRAM: u32 = 2304;

/// Opens the public sockets of one address, one for each worker, in the order of the workers. The
/// kernel spreads clients over them as `reuseport` tells it to.
pub(in crate::datapath) fn public(
    address: SocketAddr,
    workers: usize,
    receive_buffer: usize,
) -> Result<Vec<Socket>, CallError> {
    let share = |socket: &Socket| {
        socket.set_reuse_port(true).map_err(CallError::of("setsockopt SO_REUSEPORT"))
    };
    let bind = |socket: &Socket| socket.bind(&address.into()).map_err(CallError::of("bind"));
    // The first socket binds alone. So a port that another program uses is noticed even when that
    // program is willing to share it. The socket shares its port afterwards.
    let first = udp(address.is_ipv4(), receive_buffer)?;
    tell_local_address(&first, address.ip())?;
    bind(&first)?;
    let mut sockets = vec![first];
    if workers > 1 {
        share(&sockets[0])?;
    }
    for _ in 1..workers {
        let socket = udp(address.is_ipv4(), receive_buffer)?;
        tell_local_address(&socket, address.ip())?;
        share(&socket)?;
        bind(&socket)?;
        sockets.push(socket);
    }
    if workers > 1 {
        let failed = CallError::of("setsockopt SO_ATTACH_REUSEPORT_CBPF");
        reuseport::by_client(&sockets[0], workers).map_err(failed)?;
    }
    Ok(sockets)
}

/// Opens an upstream socket on one of these ports.
pub(in crate::datapath) fn upstream(
    ipv4: bool,
    receive_buffer: usize,
    ports: &Arc<Ports>,
) -> io::Result<(Socket, Port)> {
    let socket = udp(ipv4, receive_buffer)?;
    let sized = socket.set_send_buffer_size(SEND_BUFFER);
    sized.map_err(CallError::of("setsockopt SO_SNDBUF"))?;
    leave_groups_alone(&socket, ipv4).map_err(CallError::of("setsockopt MULTICAST_ALL"))?;
    let port = ports.bind(&socket, any(ipv4)).map_err(CallError::of("bind"))?;
    Ok((socket, port))
}

/// Whether an address is one of this machine's own. The source address that the kernel picks
/// towards such an address is that address itself. Sends nothing.
pub(in crate::datapath) fn is_own(address: SocketAddr, ports: &Arc<Ports>) -> io::Result<bool> {
    if address.ip().is_loopback() {
        return Ok(true); // any loopback address leads to all others
    }
    Ok(source_towards(address, ports)? == address.ip())
}

/// The source address that the kernel picks towards an address. Sends nothing.
pub(in crate::datapath) fn source_towards(
    address: SocketAddr,
    ports: &Arc<Ports>,
) -> io::Result<IpAddr> {
    let socket = Socket::new(Domain::for_address(address), Type::DGRAM, Some(Protocol::UDP))?;
    let port = ports.bind(&socket, any(address.is_ipv4()))?;
    let (socket, _) = &(socket, port); // closed in this order
    socket.connect(&address.into())?;
    let own = socket.local_addr()?.as_socket();
    own.map(|own| own.ip()).ok_or_else(|| io::ErrorKind::AddrNotAvailable.into())
}

/// Whether the kernel cuts a message into datagrams when it is asked to (UDP_SEGMENT, since Linux
/// 4.18).
pub(in crate::datapath) fn cuts_messages() -> bool {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP));
    socket.is_ok_and(|socket| setsockopt(&socket, sockopt::UdpGsoSegment, &0).is_ok())
}

/// Octets of receive buffer that a socket got. The kernel counts twice as many octets as it grants
/// for payload, because of its own bookkeeping.
pub(in crate::datapath) fn receive_buffer(socket: &Socket) -> io::Result<usize> {
    Ok(socket.recv_buffer_size()? / 2)
}

/// Datagrams that the kernel dropped on a socket since it was opened, because a filter refused
/// them, the buffer was full or memory was short. The second value tells whether the buffer is full
/// now: whether it has no room for another datagram.
pub(in crate::datapath) fn kernel_drops(socket: &Socket) -> io::Result<(u32, bool)> {
    let mut figures = [0_u32; libc::SK_MEMINFO_DROPS as usize + 1];
    let mut len = size_of_val(&figures) as libc::socklen_t;
    // SAFETY: the kernel writes at most `len` octets to `figures`, which is that long.
    let result = unsafe {
        libc::getsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_MEMINFO,
            figures.as_mut_ptr().cast(),
            &mut len,
        )
    };
    if result < 0 {
        Err(io::Error::last_os_error())
    } else {
        let figure = |name: libc::c_int| figures[name as usize];
        let room =
            figure(libc::SK_MEMINFO_RCVBUF).saturating_sub(figure(libc::SK_MEMINFO_RMEM_ALLOC));
        Ok((figure(libc::SK_MEMINFO_DROPS), room < A_DATAGRAM))
    }
}

fn any(ipv4: bool) -> IpAddr {
    if ipv4 { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() }
}

fn udp(ipv4: bool, receive_buffer: usize) -> Result<Socket, CallError> {
    let domain = if ipv4 { Domain::IPV4 } else { Domain::IPV6 };
    let socket = Socket::new(domain, Type::DGRAM.nonblocking(), Some(Protocol::UDP))
        .map_err(CallError::of("socket"))?;
    if !ipv4 {
        // A separate IPv4 socket serves IPv4.
        socket.set_only_v6(true).map_err(CallError::of("setsockopt IPV6_V6ONLY"))?;
    }
    let sized = socket.set_recv_buffer_size(receive_buffer);
    sized.map_err(CallError::of("setsockopt SO_RCVBUF"))?;
    if ipv4 {
        stay_whole(&socket).map_err(CallError::of("setsockopt IP_MTU_DISCOVER"))?;
    }
    Ok(socket)
}

/// Keeps out what is sent to multicast groups. A socket of the relay is never a member of one, but
/// by default it would get what other programs on this machine have joined.
fn leave_groups_alone(socket: &Socket, ipv4: bool) -> io::Result<()> {
    let (level, name) = if ipv4 {
        (libc::IPPROTO_IP, libc::IP_MULTICAST_ALL)
    } else {
        (libc::IPPROTO_IPV6, libc::IPV6_MULTICAST_ALL)
    };
    match set_option(socket, level, name, 0) {
        Err(Errno::ENOPROTOOPT) => Ok(()), // IPv6: since Linux 4.20
        outcome => Ok(outcome?),
    }
}

/// Has IPv4 datagrams leave with "don't fragment", whatever path MTU somebody claims. The longest
/// datagram makes a packet of 135 octets, which every link in use takes. Then the kernel need not
/// choose the number that fragments are put together by (RFC 6864, 4.1).
fn stay_whole(socket: &Socket) -> io::Result<()> {
    let (name, probe) = (libc::IP_MTU_DISCOVER, libc::IP_PMTUDISC_PROBE);
    Ok(set_option(socket, libc::IPPROTO_IP, name, probe)?)
}

fn set_option(socket: &Socket, level: c_int, name: c_int, value: c_int) -> nix::Result<()> {
    // SAFETY: the kernel reads an integer, of the length given.
    let result = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            level,
            name,
            (&raw const value).cast(),
            size_of_val(&value) as libc::socklen_t,
        )
    };
    Errno::result(result).map(drop)
}

/// A socket on all addresses has to learn which address a request came to, so that the answer
/// leaves from there.
fn tell_local_address(socket: &Socket, bound: IpAddr) -> Result<(), CallError> {
    match bound {
        IpAddr::V4(Ipv4Addr::UNSPECIFIED) => setsockopt(socket, sockopt::Ipv4PacketInfo, &true)
            .map_err(CallError::of("setsockopt IP_PKTINFO")),
        IpAddr::V6(Ipv6Addr::UNSPECIFIED) => setsockopt(socket, sockopt::Ipv6RecvPacketInfo, &true)
            .map_err(CallError::of("setsockopt IPV6_RECVPKTINFO")),
        _ => Ok(()),
    }
}
