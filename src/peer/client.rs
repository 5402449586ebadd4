//! A remote client: asks the server nodes behind a NAT router, one request at a time.
//!
//! One UDP socket serves all nodes, as in a P-NET client, so the router sees one client endpoint
//! . It neither repeats a request nor divides one. Invariant: what it returns answers the
//! request just sent, and no earlier one.

use std::io::{self, ErrorKind, IoSliceMut};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::os::fd::AsRawFd;
use std::time::{Duration, Instant};

use arrayvec::ArrayVec;
use nix::sys::socket::{MsgFlags, SockaddrStorage, recvmsg, setsockopt, sockopt};
use tokio::net::UdpSocket;

use crate::pnet::wire::{
    Datagram, DatagramRepr, DlRoute, DlRouteError, Elements, EmitError, Header, MAX_DATA,
    MAX_DATAGRAM, NCNA, Password,
};

/// Endpoints rotate through 1..=this, so that the answer to a request given up is told from the
/// answer to the next one: a response comes back to the endpoint that asked.
const LAST_ENDPOINT: u8 = 125;

/// A UDP Range net as its client knows it: one row of the IPNetTable (PAS 8).
#[derive(Clone, Debug)]
pub struct Target {
    /// IPAddr: the NAT router's public address.
    pub address: IpAddr,
    /// UDPPort: public port = start port + node address (R-10, PAS 8 d).
    pub start_port: u16,
    /// UsePW, and what it is.
    pub password: Option<Password>,
    /// What every datagram begins with.
    pub header: Header,
    /// Index of the row.
    pub ip_net_id: u8,
    /// IPNetID of the client's own net.
    pub own_ip_net_id: u8,
    /// The client's node address in its own net.
    pub own_node_address: u8,
}

impl Target {
    /// The net behind this address, with the IPNetIDs and the client of PAS Figure 10.
    pub fn new(address: IpAddr, start_port: u16, password: Option<Password>) -> Self {
        let header = Header::default();
        let (ip_net_id, own_ip_net_id, own_node_address) = (11, 11, 3);
        Self { address, start_port, password, header, ip_net_id, own_ip_net_id, own_node_address }
    }

    /// Where requests to a node go (R-10, PAS 8 d). A start port over 65410 leaves no port to the
    /// highest node addresses; they wrap.
    pub fn socket_address(&self, node_address: u8) -> SocketAddr {
        SocketAddr::new(self.address, self.start_port.wrapping_add(node_address.into()))
    }

    /// Writes a request that asks for its answer at this endpoint, and gives the number of octets.
    /// Fails when the route or the data is too long.
    pub fn emit_request(
        &self,
        request: &Request<'_>,
        endpoint: u8,
        octets: &mut [u8],
    ) -> Result<usize, ExchangeError> {
        let destination = [&[self.ip_net_id, request.node_address], request.beyond].concat();
        // R-27, PAS 5.7.1.5: the client's own address goes first in the source route.
        let route = DlRoute::new(&destination, &[endpoint])?
            .sent_by(Some(self.own_ip_net_id), self.own_node_address)?
            .to_route()?;
        let request = DatagramRepr {
            header: self.header,
            route: route.as_route(),
            control_status: request.control_status,
            data_field_flags: 0,
            data_octets: request.data_octets,
            // R-3, PAS 7.
            password: self.password.clone(),
        };
        Ok(request.emit(octets)?)
    }
}

/// What to ask of a node.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// The server node on the IP net.
    pub node_address: u8,
    /// The rest of the destination route, behind that node: ports and node addresses.
    pub beyond: &'a [u8],
    /// Control-status.
    pub control_status: u8,
    /// The data, at most 63 octets.
    pub data_octets: &'a [u8],
}

/// What a node answered.
#[derive(Clone, Debug)]
pub struct Answer {
    /// Destination elements as they came; the first two need not be those of the request.
    pub destinations: Elements,
    /// Source elements as they came.
    pub sources: Elements,
    /// Control-status.
    pub control_status: u8,
    /// The data.
    pub data_octets: ArrayVec<u8, MAX_DATA>,
}

/// Why an exchange came to nothing.
#[derive(Debug, thiserror::Error)]
pub enum ExchangeError {
    /// Nothing that answers the request came in time.
    #[error("no answer within {}", humantime::format_duration(*waited))]
    NoAnswer {
        /// How long the client waited.
        waited: Duration,
    },
    /// The network says that the request did not arrive, before the time is up.
    #[error("{}", in_words(.0))]
    Undelivered(io::Error),
    /// The elements make no P-NET-route.
    #[error("no route to the node: {0}")]
    Route(#[from] DlRouteError),
    /// The request does not fit into a datagram.
    #[error("the request is too large: {0}")]
    Emit(#[from] EmitError),
    /// The system refused.
    #[error("{to}: {reason}")]
    Socket {
        /// Where the request went.
        to: SocketAddr,
        /// What the system said.
        reason: io::Error,
    },
}

fn undelivered(error: io::Error) -> ExchangeError {
    ExchangeError::Undelivered(error)
}

/// What an ICMP message, or the system itself, says of a request that did not arrive.
fn in_words(error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::ConnectionRefused => "nothing listens there".to_owned(),
        ErrorKind::HostUnreachable => "the host there cannot be reached".to_owned(),
        ErrorKind::NetworkUnreachable => "there is no way to that network".to_owned(),
        ErrorKind::PermissionDenied => "a firewall forbids it".to_owned(),
        _ => format!("it did not arrive: {error}"),
    }
}

/// A client with its socket.
#[derive(Debug)]
pub struct Client {
    socket: UdpSocket,
    target: Target,
    endpoint: u8,
}

impl Client {
    /// A client on any free port.
    pub async fn bind(target: Target) -> io::Result<Self> {
        let any: IpAddr = match target.address {
            IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
            IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let socket = UdpSocket::bind((any, 0)).await?;
        // Else a host or network that cannot be reached would be kept from us.
        match any {
            IpAddr::V4(_) => setsockopt(&socket, sockopt::Ipv4RecvErr, &true)?,
            IpAddr::V6(_) => setsockopt(&socket, sockopt::Ipv6RecvErr, &true)?,
        }
        Ok(Self { socket, target, endpoint: 0 })
    }

    /// Sends one request and waits for its answer; returns it with the time from the sending of the
    /// one to the arrival of the other. Whatever else comes meanwhile is passed over. Fails at once
    /// when the network says that the request did not arrive.
    pub async fn exchange(
        &mut self,
        request: &Request<'_>,
        wait: Duration,
    ) -> Result<(Answer, Duration), ExchangeError> {
        self.endpoint = self.endpoint % LAST_ENDPOINT + 1;
        let mut octets = [0; MAX_DATAGRAM];
        let length = self.target.emit_request(request, self.endpoint, &mut octets)?;
        let to = self.target.socket_address(request.node_address);
        let failed = |reason| ExchangeError::Socket { to, reason };
        // A connected socket is told when nothing listens there; the next request connects it anew.
        self.socket.connect(to).await.map_err(undelivered)?;
        self.forget_errors().map_err(failed)?;

        let sent = Instant::now();
        self.socket.send(&octets[..length]).await.map_err(undelivered)?;
        let (answer, arrived) = tokio::time::timeout(wait, self.receive(to, request.node_address))
            .await
            .map_err(|_| ExchangeError::NoAnswer { waited: wait })?
            .map_err(undelivered)?;
        Ok((answer, arrived - sent))
    }

    /// What the network says of an earlier request is not of the next one. The kernel's list of such
    /// messages takes room from answers.
    fn forget_errors(&self) -> io::Result<()> {
        let (mut octets, flags) =
            ([0; MAX_DATAGRAM], MsgFlags::MSG_ERRQUEUE | MsgFlags::MSG_DONTWAIT);
        loop {
            let mut room = [IoSliceMut::new(&mut octets)];
            let descriptor = self.socket.as_raw_fd();
            if recvmsg::<SockaddrStorage>(descriptor, &mut room, None, flags).is_err() {
                break;
            }
        }
        self.socket.take_error().map(drop)
    }

    async fn receive(&self, from: SocketAddr, node_address: u8) -> io::Result<(Answer, Instant)> {
        // One octet more than fits: a longer datagram shows as too long instead of being cut.
        let mut octets = [0; MAX_DATAGRAM + 1];
        loop {
            let (length, sender) = self.socket.recv_from(&mut octets).await?;
            let arrived = Instant::now();
            if sender != from {
                continue;
            }
            if let Some(answer) =
                self.target.recognise(&octets[..length], node_address, self.endpoint)
            {
                return Ok((answer, arrived));
            }
        }
    }
}

impl Target {
    /// The answer of this node to this endpoint, if that is what the octets are. The other two
    /// destination elements may be new: a server gives a dynamic client IPNetID 125 and a node
    /// address of its own choice (R-40, PAS 9).
    fn recognise(&self, octets: &[u8], node_address: u8, endpoint: u8) -> Option<Answer> {
        let response = Datagram::parse(octets, self.header).ok()?;
        let destinations: Elements = response.route().destinations().collect();
        let sources: Elements = response.route().sources().collect();
        let to_us = matches!(destinations[..], [_, _, last] if last == endpoint);
        // R-34, PAS 6.1.1.1.1.5: a response is unconfirmed.
        let from_node = matches!(sources[..], [_, node, .., NCNA] if node == node_address);
        // R-39, PAS 9.
        let password_came_back = match (&self.password, response.password()) {
            (Some(sent), Some(came)) => sent.matches(came).into(),
            (None, None) => true,
            _ => false,
        };
        (to_us && from_node && password_came_back).then(|| Answer {
            destinations,
            sources,
            control_status: response.control_status(),
            data_octets: response.data_octets().iter().copied().collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_network_says_is_told_in_words() {
        for (number, words) in [
            (libc::ECONNREFUSED, "nothing listens there"),
            (libc::EHOSTUNREACH, "the host there cannot be reached"),
            (libc::ENETUNREACH, "there is no way to that network"),
            (libc::EACCES, "a firewall forbids it"),
            (libc::EPERM, "a firewall forbids it"),
        ] {
            let error = undelivered(io::Error::from_raw_os_error(number));
            assert_eq!(error.to_string(), words);
        }
    }
}
