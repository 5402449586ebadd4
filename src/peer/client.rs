//! A remote client. It asks the server nodes behind a NAT router, one request at a time.
//!
//! One UDP socket serves all nodes, as in a P-NET client, so the router sees one client endpoint
//! . The client neither repeats nor divides a request. Invariant: a returned answer belongs
//! to the request that was just sent, and never to an earlier one.

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

/// The client uses the endpoints 1 to this one in rotation. A response comes back to the endpoint
/// that asked. So the client can tell a late answer to a request that it gave up from the answer to
/// the next one.
const LAST_ENDPOINT: u8 = 125;

/// A UDP Range net as its client knows it: one row of the IPNetTable (PAS 8).
#[derive(Clone, Debug)]
pub struct Target {
    /// IPAddr: the NAT router's public address.
    pub address: IpAddr,
    /// UDPPort: public port = start port + node address (R-10, PAS 8 d).
    pub start_port: u16,
    /// The password, if UsePW is set.
    pub password: Option<Password>,
    /// The header with which every datagram begins.
    pub header: Header,
    /// The IPNetID of the net: the index of its row.
    pub ip_net_id: u8,
    /// The IPNetID of the client's own net.
    pub own_ip_net_id: u8,
    /// The client's node address in its own net.
    pub own_node_address: u8,
}

impl Target {
    /// The net behind this address. IPNetIDs and the client's node address are those of PAS
    /// Figure 10.
    pub fn new(address: IpAddr, start_port: u16, password: Option<Password>) -> Self {
        let header = Header::default();
        let (ip_net_id, own_ip_net_id, own_node_address) = (11, 11, 3);
        Self { address, start_port, password, header, ip_net_id, own_ip_net_id, own_node_address }
    }

    /// The public address and port of a node (R-10, PAS 8 d). With a start port above 65410, the
    /// highest node addresses have no port: the number wraps around.
    pub fn socket_address(&self, node_address: u8) -> SocketAddr {
        SocketAddr::new(self.address, self.start_port.wrapping_add(node_address.into()))
    }

    /// Writes a request whose answer goes to this endpoint, and returns its length in octets. Fails
    /// when the route or the data is too long.
    pub fn emit_request(
        &self,
        request: &Request<'_>,
        endpoint: u8,
        octets: &mut [u8],
    ) -> Result<usize, ExchangeError> {
        let destination = [&[self.ip_net_id, request.node_address], request.beyond].concat();
        // The client's own address comes first in the source route (R-27, PAS 5.7.1.5).
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

/// A request to a node.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// The server node on the IP net.
    pub node_address: u8,
    /// The rest of the destination route, behind that node: ports and node addresses.
    pub beyond: &'a [u8],
    /// The control-status.
    pub control_status: u8,
    /// The data, at most 63 octets.
    pub data_octets: &'a [u8],
}

/// The answer of a node.
#[derive(Clone, Debug)]
pub struct Answer {
    /// The destination elements as they came. The first two may differ from those of the request
    ///
    pub destinations: Elements,
    /// The source elements as they came.
    pub sources: Elements,
    /// The control-status.
    pub control_status: u8,
    /// The data.
    pub data_octets: ArrayVec<u8, MAX_DATA>,
}

/// Why an exchange failed.
#[derive(Debug, thiserror::Error)]
pub enum ExchangeError {
    /// No answer to the request came in time.
    #[error("no answer within {}", humantime::format_duration(*waited))]
    NoAnswer {
        /// How long the client waited.
        waited: Duration,
    },
    /// Before the time was up, the network reported that the request did not arrive.
    #[error("{}", in_words(.0))]
    Undelivered(io::Error),
    /// The elements do not form a valid P-NET-route.
    #[error("no route to the node: {0}")]
    Route(#[from] DlRouteError),
    /// The request does not fit into a datagram.
    #[error("the request is too large: {0}")]
    Emit(#[from] EmitError),
    /// The system refused.
    #[error("{to}: {reason}")]
    Socket {
        /// The destination of the request.
        to: SocketAddr,
        /// The error that the system gave.
        reason: io::Error,
    },
}

fn undelivered(error: io::Error) -> ExchangeError {
    ExchangeError::Undelivered(error)
}

/// Describes the error of an ICMP message or of the system itself about a request that did not
/// arrive.
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
    /// Makes a client on any free port.
    pub async fn bind(target: Target) -> io::Result<Self> {
        let any: IpAddr = match target.address {
            IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
            IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let socket = UdpSocket::bind((any, 0)).await?;
        // Without this option, the kernel would not report that a host or a network cannot be
        // reached.
        match any {
            IpAddr::V4(_) => setsockopt(&socket, sockopt::Ipv4RecvErr, &true)?,
            IpAddr::V6(_) => setsockopt(&socket, sockopt::Ipv6RecvErr, &true)?,
        }
        Ok(Self { socket, target, endpoint: 0 })
    }

    /// Sends one request and waits for its answer. Returns the answer, and the time from sending
    /// the request to receiving the answer. Other datagrams that come in the meantime are ignored.
    /// Fails at once when the network reports that the request did not arrive.
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
        // The kernel tells a connected socket when nothing listens at the other end. The next
        // request connects the socket again.
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

    /// Discards errors that belong to an earlier request. The kernel's list of such errors takes
    /// buffer space away from answers.
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
        // The buffer has one octet more than the longest datagram. So a longer datagram is seen as
        // too long, and is not cut.
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
    /// The answer of this node to this endpoint, if the octets are one. The other two destination
    /// elements may be new: a server gives a dynamic client IPNetID 125 and a node address that the
    /// server chooses (R-40, PAS 9).
    fn recognise(&self, octets: &[u8], node_address: u8, endpoint: u8) -> Option<Answer> {
        let response = Datagram::parse(octets, self.header).ok()?;
        let destinations: Elements = response.route().destinations().collect();
        let sources: Elements = response.route().sources().collect();
        let to_us = matches!(destinations[..], [_, _, last] if last == endpoint);
        // A response is unconfirmed (R-34, PAS 6.1.1.1.1.5).
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
