//! Why the system refuses a socket to listen on: which call failed, and what to do about it.
//!
//! The caller reports the error. Some errors pass by themselves, so the caller may want to try
//! again.

use std::fmt::{self, Display, Formatter};
use std::fs;
use std::io;
use std::net::{IpAddr, Ipv6Addr, SocketAddr, TcpListener};
use std::sync::LazyLock;

use nix::errno::Errno;
use socket2::{Domain, Protocol, Socket, Type};
use tokio::net::UdpSocket;

/// The largest number of connections that wait to be accepted. The kernel also has a limit,
/// `net.core.somaxconn`.
const BACKLOG: i32 = 1024;

/// The first port that needs no capability (`sysctl net.ipv4.ip_unprivileged_port_start`). It is
/// read once, because a confined process cannot read it.
static UNPRIVILEGED_PORTS: LazyLock<u16> = LazyLock::new(|| {
    let text = fs::read_to_string("/proc/sys/net/ipv4/ip_unprivileged_port_start");
    text.ok().and_then(|text| text.trim().parse().ok()).unwrap_or(1024)
});

/// A system call that failed, with its error.
#[derive(Debug, thiserror::Error)]
#[error("{call}: {error}")]
pub(crate) struct CallError {
    call: &'static str,
    error: io::Error,
}

impl CallError {
    /// For `map_err`: adds the name of the call to its error.
    pub(crate) fn of<E: Into<io::Error>>(call: &'static str) -> impl Fn(E) -> Self {
        move |error| Self { call, error: error.into() }
    }
}

impl From<CallError> for io::Error {
    fn from(error: CallError) -> Self {
        Self::new(error.error.kind(), error)
    }
}

/// A socket that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub struct ListenError {
    protocol: &'static str,
    address: SocketAddr,
    /// The setting that the address comes from, under the name that the user knows.
    setting: &'static str,
    obstacle: Obstacle,
}

#[derive(Debug)]
enum Obstacle {
    InUse,
    NotOurs,
    /// The kernel still checks whether another machine has the address.
    Tentative,
    /// Another machine has the address.
    Duplicate,
    /// Only a process with a capability may use the port. The number is the first port that needs
    /// none.
    Privileged(u16),
    OutOfDescriptors,
    Other(CallError),
}

impl ListenError {
    /// The error of a call that failed, for a socket of this protocol on this address.
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

    /// Whether another socket uses the port.
    pub fn is_in_use(&self) -> bool {
        matches!(self.obstacle, Obstacle::InUse)
    }

    /// Whether the obstacle may pass by itself, so that another try may succeed.
    pub fn may_pass(&self) -> bool {
        match &self.obstacle {
            Obstacle::Privileged(_) | Obstacle::OutOfDescriptors => false,
            Obstacle::Other(failed) => may_pass(&failed.error),
            _ => true,
        }
    }

    /// Whether the obstacle passes within seconds.
    pub fn passes_soon(&self) -> bool {
        matches!(self.obstacle, Obstacle::Tentative)
    }
}

impl ListenError {
    /// The same error for another port, if the address cannot be bound at any port.
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

    /// What the obstacle is and what to do about it, without the address.
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

/// Whether an error of the system may pass by itself. A resource that ran out may become available
/// again, and a socket or an address that is in the way may go.
pub fn may_pass(error: &io::Error) -> bool {
    let short = [Errno::ENFILE, Errno::ENOMEM, Errno::ENOBUFS, Errno::EAGAIN, Errno::ENOSPC];
    let in_the_way = [Errno::EADDRINUSE, Errno::EADDRNOTAVAIL, Errno::EINTR];
    let errno = error.raw_os_error().map(Errno::from_raw);
    errno.is_some_and(|errno| short.contains(&errno) || in_the_way.contains(&errno))
}

/// An error followed by its causes, as one text.
#[cfg(feature = "relay")]
pub(crate) fn chain(error: &dyn std::error::Error) -> String {
    match error.source() {
        Some(cause) => format!("{error}: {}", chain(cause)),
        None => error.to_string(),
    }
}

/// Reads in advance what a confined process cannot read.
#[cfg(feature = "relay")]
pub(crate) fn look_up() {
    LazyLock::force(&UNPRIVILEGED_PORTS);
}

/// Opens a UDP socket for the async runtime. `setting` names the setting that the address comes
/// from.
pub fn udp(address: SocketAddr, setting: &'static str) -> Result<UdpSocket, ListenError> {
    let open = || {
        let socket = open(address, Type::DGRAM, Protocol::UDP)?;
        socket.bind(&address.into()).map_err(CallError::of("bind"))?;
        UdpSocket::from_std(socket.into()).map_err(CallError::of("epoll_ctl"))
    };
    open().map_err(|failed| ListenError::new("UDP", address, setting, failed))
}

/// Opens a TCP listener that never blocks. `setting` names the setting that the address comes from.
pub fn tcp(address: SocketAddr, setting: &'static str) -> Result<TcpListener, ListenError> {
    let open = || {
        let socket = open(address, Type::STREAM, Protocol::TCP)?;
        // Old connections to this port do not prevent the bind.
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

/// Why an address cannot be bound that the kernel reports as not available.
fn not_available(ip: IpAddr) -> Obstacle {
    let IpAddr::V6(ip) = ip else { return Obstacle::NotOurs };
    // The path is below /proc/self, because a confined process can read that.
    let list = fs::read_to_string("/proc/self/net/if_inet6").unwrap_or_default();
    state_of(ip, &list)
}

/// The state of one address in the kernel's list of IPv6 addresses. The list has a line for each
/// address, with its flags in the fifth column.
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
            let (text, passes) = told(20001, call, errno);
            let expected = format!(
                "cannot listen on UDP 198.51.100.1:20001: {call}: {}",
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

    /// A connection that finds the backlog full is tried again only a second later.
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
            (Errno::EADDRINUSE, "UDP port 198.51.100.1:20001 is in use", true),
            (Errno::EADDRNOTAVAIL, "198.51.100.1 is no address of this host, or not yet", true),
            (Errno::EMFILE, "cannot listen on UDP 198.51.100.1:20001: no file descriptor", false),
        ] {
            let (told, may_pass) = told(20001, "bind", errno);
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
        // An address that is usable now may not have been there when it was bound.
        assert!(state("2001:db8:1::3").contains("is no address of this host"));
    }
}
