//! Why the system does not give a socket to listen on: which call failed, and what to do about it.
//!
//! Told by who asks: some of it passes by itself, and is worth another try.

use std::fmt::{self, Display, Formatter};
use std::fs;
use std::io;
use std::net::{IpAddr, Ipv6Addr, SocketAddr, TcpListener};
use std::sync::LazyLock;

use nix::errno::Errno;
use socket2::{Domain, Protocol, Socket, Type};
use tokio::net::UdpSocket;

/// Connections that wait to be accepted, at most; the kernel has a bound of its own, net.core.somaxconn.
const BACKLOG: i32 = 1024;

/// Ports from here on need no capability (`sysctl net.ipv4.ip_unprivileged_port_start`). Read once:
/// a confined process cannot look it up.
static UNPRIVILEGED_PORTS: LazyLock<u16> = LazyLock::new(|| {
    let text = fs::read_to_string("/proc/sys/net/ipv4/ip_unprivileged_port_start");
    text.ok().and_then(|text| text.trim().parse().ok()).unwrap_or(1024)
});

/// A call that failed.
#[derive(Debug, thiserror::Error)]
#[error("{call}: {error}")]
pub(crate) struct CallError {
    call: &'static str,
    error: io::Error,
}

impl CallError {
    /// For `map_err`: the error of this call.
    pub(crate) fn of<E: Into<io::Error>>(call: &'static str) -> impl Fn(E) -> Self {
        move |error| Self { call, error: error.into() }
    }
}

impl From<CallError> for io::Error {
    fn from(error: CallError) -> Self {
        Self::new(error.error.kind(), error)
    }
}

/// A socket that cannot be had.
#[derive(Debug, thiserror::Error)]
pub struct ListenError {
    protocol: &'static str,
    address: SocketAddr,
    /// Where the address comes from, as its user knows it.
    setting: &'static str,
    obstacle: Obstacle,
}

#[derive(Debug)]
enum Obstacle {
    InUse,
    NotOurs,
    /// The kernel still asks whether another machine has the address.
    Tentative,
    /// Another machine has it.
    Duplicate,
    /// The first port that needs no capability.
    Privileged(u16),
    OutOfDescriptors,
    Other(CallError),
}

impl ListenError {
    /// What a call for a socket of this protocol on this address has failed with.
    pub(crate) fn new(
        protocol: &'static str,
        address: SocketAddr,
        setting: &'static str,
        failed: CallError,
    ) -> Self {
        let unprivileged = *UNPRIVILEGED_PORTS;
        let errno = failed.error.raw_os_error().map(Errno::from_raw);
        let obstacle = match (failed.call, errno) {
            ("bind", Some(Errno::EADDRINUSE)) => Obstacle::InUse,
            ("bind", Some(Errno::EADDRNOTAVAIL)) => not_available(address.ip()),
            ("bind", Some(Errno::EACCES)) if address.port() < unprivileged => {
                Obstacle::Privileged(unprivileged)
            }
            (_, Some(Errno::EMFILE)) => Obstacle::OutOfDescriptors,
            _ => Obstacle::Other(failed),
        };
        Self { protocol, address, setting, obstacle }
    }

    /// Whether another socket has the port.
    pub fn is_in_use(&self) -> bool {
        matches!(self.obstacle, Obstacle::InUse)
    }

    /// Whether it may pass by itself, so that another try may succeed.
    pub fn may_pass(&self) -> bool {
        match &self.obstacle {
            Obstacle::Privileged(_) | Obstacle::OutOfDescriptors => false,
            Obstacle::Other(failed) => may_pass(&failed.error),
            _ => true,
        }
    }

    /// Whether it passes within seconds.
    pub fn passes_soon(&self) -> bool {
        matches!(self.obstacle, Obstacle::Tentative)
    }
}

impl ListenError {
    /// The same for another port, where the address as a whole cannot be bound.
    #[cfg(feature = "relay")]
    pub(crate) fn at(&self, address: SocketAddr) -> Option<Self> {
        let obstacle = match self.obstacle {
            Obstacle::NotOurs => Obstacle::NotOurs,
            Obstacle::Tentative => Obstacle::Tentative,
            Obstacle::Duplicate => Obstacle::Duplicate,
            _ => return None,
        };
        let Self { protocol, setting, .. } = *self;
        Some(Self { protocol, address, setting, obstacle })
    }

    /// What is in the way and what to do about it, without the address.
    pub(crate) fn why(&self) -> String {
        match &self.obstacle {
            Obstacle::InUse => {
                let sockets = if self.protocol == "TCP" { "ss -ltnp" } else { "ss -lunp" };
                format!("in use; stop what uses it ({sockets}), or choose another port")
            }
            Obstacle::NotOurs => format!(
                "no address of this host, or not yet; wait for its interface, or correct {} (ip \
                 address shows what there is)",
                self.setting
            ),
            Obstacle::Tentative => "tentative: the kernel still asks whether another machine has \
                it; wait a second or two (ip address shows it)"
                .to_owned(),
            Obstacle::Duplicate => "not to be used: another machine on the link has it \
                (dadfailed); take it from one of the two, and set it anew here (ip address shows it)"
                .to_owned(),
            Obstacle::Privileged(from) => format!(
                "needs CAP_NET_BIND_SERVICE, like all ports below {from} here; it is given up after \
                 the start: choose a higher port, or restart with that capability"
            ),
            Obstacle::OutOfDescriptors => "no file descriptor is left; raise the hard limit (ulimit \
                -Hn, LimitNOFILE=, --ulimit nofile=)"
                .to_owned(),
            Obstacle::Other(failed) => failed.to_string(),
        }
    }
}

impl Display for ListenError {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { protocol, address, obstacle, .. } = self;
        let why = self.why();
        match obstacle {
            Obstacle::InUse => write!(f, "{protocol} port {address} is {why}"),
            Obstacle::NotOurs | Obstacle::Tentative | Obstacle::Duplicate => {
                write!(f, "{} is {why}", address.ip())
            }
            Obstacle::Privileged(_) => write!(f, "{protocol} port {address} {why}"),
            Obstacle::OutOfDescriptors | Obstacle::Other(_) => {
                write!(f, "cannot listen on {protocol} {address}: {why}")
            }
        }
    }
}

/// Whether an error of the system may pass by itself: what is short may be there again, who is in
/// the way may go.
pub fn may_pass(error: &io::Error) -> bool {
    let short = [Errno::ENFILE, Errno::ENOMEM, Errno::ENOBUFS, Errno::EAGAIN, Errno::ENOSPC];
    let in_the_way = [Errno::EADDRINUSE, Errno::EADDRNOTAVAIL, Errno::EINTR];
    let errno = error.raw_os_error().map(Errno::from_raw);
    errno.is_some_and(|errno| short.contains(&errno) || in_the_way.contains(&errno))
}

/// An error and what caused it.
#[cfg(feature = "relay")]
pub(crate) fn chain(error: &dyn std::error::Error) -> String {
    match error.source() {
        Some(cause) => format!("{error}: {}", chain(cause)),
        None => error.to_string(),
    }
}

/// Looks up what only an unconfined process can read.
#[cfg(feature = "relay")]
pub(crate) fn look_up() {
    LazyLock::force(&UNPRIVILEGED_PORTS);
}

/// A UDP socket on this address, which `setting` names, for the async runtime.
pub fn udp(address: SocketAddr, setting: &'static str) -> Result<UdpSocket, ListenError> {
    let open = || {
        let socket = open(address, Type::DGRAM, Protocol::UDP)?;
        socket.bind(&address.into()).map_err(CallError::of("bind"))?;
        UdpSocket::from_std(socket.into()).map_err(CallError::of("epoll_ctl"))
    };
    open().map_err(|failed| ListenError::new("UDP", address, setting, failed))
}

/// A TCP listener on this address, which `setting` names. It never blocks.
pub fn tcp(address: SocketAddr, setting: &'static str) -> Result<TcpListener, ListenError> {
    let open = || {
        let socket = open(address, Type::STREAM, Protocol::TCP)?;
        // What is left of old connections is no hindrance.
        socket.set_reuse_address(true).map_err(CallError::of("setsockopt SO_REUSEADDR"))?;
        socket.bind(&address.into()).map_err(CallError::of("bind"))?;
        socket.listen(BACKLOG).map_err(CallError::of("listen"))?;
        Ok(socket.into())
    };
    open().map_err(|failed| ListenError::new("TCP", address, setting, failed))
}

fn open(address: SocketAddr, kind: Type, protocol: Protocol) -> Result<Socket, CallError> {
    let socket = Socket::new(Domain::for_address(address), kind.nonblocking(), Some(protocol));
    socket.map_err(CallError::of("socket"))
}

/// Why an address cannot be bound that the kernel says is not there.
fn not_available(ip: IpAddr) -> Obstacle {
    let IpAddr::V6(ip) = ip else { return Obstacle::NotOurs };
    // Through /proc/self, which a confined process can read.
    let list = fs::read_to_string("/proc/self/net/if_inet6").unwrap_or_default();
    state_of(ip, &list)
}

/// What the kernel's list of IPv6 addresses says of one: a line for each, its flags in the fifth
/// column.
fn state_of(ip: Ipv6Addr, list: &str) -> Obstacle {
    const DAD_FAILED: u8 = 0x08;
    const TENTATIVE: u8 = 0x40;
    let name = format!("{:032x}", ip.to_bits());
    let line = list.lines().find(|line| line.starts_with(&name));
    let flags = line.and_then(|line| line.split_whitespace().nth(4));
    match flags.and_then(|flags| u8::from_str_radix(flags, 16).ok()) {
        Some(flags) if flags & DAD_FAILED != 0 => Obstacle::Duplicate,
        Some(flags) if flags & TENTATIVE != 0 => Obstacle::Tentative,
        _ => Obstacle::NotOurs,
    }
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, TcpStream};
    use std::time::Duration;

    use super::*;

    fn told(port: u16, call: &'static str, errno: Errno) -> (String, bool) {
        let address = SocketAddr::new([198, 51, 100, 1].into(), port);
        let failed = CallError { call, error: errno.into() };
        let error = ListenError::new("UDP", address, "[public] listen", failed);
        (error.to_string(), error.may_pass())
    }

    #[test]
    fn a_call_that_fails_is_named() {
        for (call, errno, may_pass) in [
            ("bind", Errno::EPERM, false),
            ("bind", Errno::EACCES, false),
            ("bind", Errno::ENOMEM, true),
            ("socket", Errno::EPERM, false),
            ("socket", Errno::EACCES, false),
            ("socket", Errno::ENFILE, true),
            ("socket", Errno::ENOBUFS, true),
            ("socket", Errno::EAFNOSUPPORT, false),
            ("setsockopt SO_RCVBUF", Errno::EPERM, false),
            ("setsockopt SO_ATTACH_REUSEPORT_CBPF", Errno::ENOMEM, true),
        ] {
            let (text, passes) = told(40001, call, errno);
            let expected = format!(
                "cannot listen on UDP 198.51.100.1:40001: {call}: {}",
                io::Error::from(errno)
            );
            assert_eq!((text, passes), (expected, may_pass));
        }
    }

    #[test]
    fn only_a_low_port_that_bind_refuses_wants_the_capability() {
        let first = *UNPRIVILEGED_PORTS;
        let wants = |port, call, errno| told(port, call, errno).0.contains("CAP_NET_BIND_SERVICE");
        if let Some(low) = first.checked_sub(1) {
            assert!(wants(low, "bind", Errno::EACCES));
            assert!(!wants(low, "bind", Errno::EPERM));
            assert!(!wants(low, "socket", Errno::EACCES));
        }
        assert!(!wants(first, "bind", Errno::EACCES));
    }

    /// One that comes when no more may wait is heard again a second later.
    #[test]
    fn many_may_connect_at_a_time() {
        let listener = tcp((Ipv4Addr::LOCALHOST, 0).into(), "[admin] listen").unwrap();
        let address = listener.local_addr().unwrap();
        let most = fs::read_to_string("/proc/sys/net/core/somaxconn").unwrap();
        let many = most.trim().parse::<usize>().unwrap().min(300);
        let connect = |_| TcpStream::connect_timeout(&address, Duration::from_secs(10));
        let connected: Vec<_> = (0..many).map_while(|number| connect(number).ok()).collect();
        assert_eq!(connected.len(), many);
    }

    #[test]
    fn what_another_may_give_back_may_pass() {
        for (errno, text, passes) in [
            (Errno::EADDRINUSE, "UDP port 198.51.100.1:40001 is in use", true),
            (Errno::EADDRNOTAVAIL, "198.51.100.1 is no address of this host, or not yet", true),
            (Errno::EMFILE, "cannot listen on UDP 198.51.100.1:40001: no file descriptor", false),
        ] {
            let (told, may_pass) = told(40001, "bind", errno);
            assert!(told.starts_with(text), "{told}");
            assert_eq!(may_pass, passes, "{told}");
        }
        let udp = SocketAddr::from(([127, 0, 0, 1], 0));
        let taken = tcp(udp, "[admin] listen").unwrap();
        let error = tcp(taken.local_addr().unwrap(), "[admin] listen").unwrap_err();
        assert!(error.to_string().contains("is in use") && error.to_string().contains("ss -ltnp"));
    }

    #[test]
    fn an_address_that_is_not_certain_yet_is_told_from_one_that_is_not_there() {
        let list = "00000000000000000000000000000001 01 80 10 80       lo\n\
                    20010db8000100000000000000000001 02 40 00 c0     eth0\n\
                    20010db8000100000000000000000002 02 40 00 c8     eth0\n\
                    20010db8000100000000000000000003 02 40 00 80     eth0\n";
        let state = |ip: &str| {
            let obstacle = state_of(ip.parse().unwrap(), list);
            let (address, setting) = (SocketAddr::new(ip.parse().unwrap(), 1), "[public] listen");
            ListenError { protocol: "UDP", address, setting, obstacle }.to_string()
        };
        assert!(state("2001:db8:1::1").contains("is tentative"));
        assert!(state("2001:db8:1::2").contains("another machine on the link has it (dadfailed)"));
        assert!(state("2001:db8:1::4").contains("is no address of this host"));
        // One that is there now may not have been so when it was bound.
        assert!(state("2001:db8:1::3").contains("is no address of this host"));
    }
}
