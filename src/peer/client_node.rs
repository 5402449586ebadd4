//! A client node on its UDP socket: sends what [`endpoint::client`](crate::pnet::endpoint::client) hands
//! out, and passes on what comes, with the reports of the network about what did not arrive.
//!
//! One socket serves all nodes, as in a P-NET client, so a router sees one client endpoint. It is
//! not connected: so answers from a wrong port are seen, and the reports of one node do not hit another.

use std::io::{self, ErrorKind, IoSliceMut};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::os::fd::AsRawFd;
use std::time::Instant;

use arrayvec::ArrayVec;
use nix::cmsg_space;
use nix::sys::socket::{
    ControlMessageOwned, MsgFlags, SockaddrStorage, recvmsg, setsockopt, sockopt,
};
use tokio::io::Interest;
use tokio::net::UdpSocket;

use super::until;
use crate::pnet::endpoint::client::{Arep, Client, EndpointId, Undelivered};
use crate::pnet::wire::MAX_DATAGRAM;

/// Datagrams and reports that are taken from the socket before the client sends again.
const MOST_AT_ONCE: usize = 64;

/// A datagram that is to be sent, and where to.
type Outgoing = (SocketAddr, ArrayVec<u8, MAX_DATAGRAM>);

/// A client node with its socket.
#[derive(Debug)]
pub struct ClientNode {
    socket: UdpSocket,
    client: Client,
    started: Instant,
    /// What the socket had no room for.
    outgoing: Option<Outgoing>,
}

impl ClientNode {
    /// Makes a client on any free port. It sends to addresses of the family of `to` alone.
    pub async fn bind(arep: Arep, to: IpAddr) -> io::Result<Self> {
        let any: IpAddr = match to {
            IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
            IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let socket = UdpSocket::bind((any, 0)).await?;
        // Without this option, the kernel tells a socket that is not connected nothing of what the
        // network reports.
        match any {
            IpAddr::V4(_) => setsockopt(&socket, sockopt::Ipv4RecvErr, &true)?,
            IpAddr::V6(_) => setsockopt(&socket, sockopt::Ipv6RecvErr, &true)?,
        }
        socket.set_broadcast(true)?;
        Ok(Self { socket, client: Client::new(arep), started: Instant::now(), outgoing: None })
    }

    /// Endpoints, requests and their outcomes.
    pub fn client(&mut self) -> &mut Client {
        &mut self.client
    }

    /// Sends and receives until a request has come to an end, and returns its endpoint. Waits for ever if
    /// none is on the way. Nothing is lost when the future is dropped.
    ///
    /// Fails when the socket does.
    pub async fn finished(&mut self) -> io::Result<EndpointId> {
        loop {
            self.transmit().await?;
            if let Some(finished) = self.client.poll_finished() {
                return Ok(finished);
            }
            let timeout = self.client.next_timeout();
            let timeout = timeout.and_then(|timeout| self.started.checked_add(timeout));
            tokio::select! {
                ready = self.socket.ready(Interest::READABLE | Interest::ERROR) => {
                    ready?;
                    self.receive();
                    self.take_reports();
                }
                () = until(timeout.map(Into::into)) => {
                    // An answer may have come in time, and not been looked at yet.
                    self.receive();
                    self.take_reports();
                    self.client.handle_timeout(self.started.elapsed());
                }
            }
        }
    }

    /// Sends what may be sent.
    async fn transmit(&mut self) -> io::Result<()> {
        let mut octets = [0; MAX_DATAGRAM];
        loop {
            if self.outgoing.is_none() {
                let now = self.started.elapsed();
                let Some(transmit) = self.client.poll_transmit(now, &mut octets) else {
                    return Ok(());
                };
                let octets = octets[..transmit.length].iter().copied().collect();
                self.outgoing = Some((transmit.to, octets));
            }
            while self.send() == Err(ErrorKind::WouldBlock) {
                self.socket.writable().await?;
            }
            self.outgoing = None;
        }
    }

    /// Sends the datagram that is to be sent. What the system refuses counts as not delivered. Fails only
    /// when there is no room for it now.
    fn send(&mut self) -> Result<(), ErrorKind> {
        let mut tried = 0;
        while let Some((to, octets)) = &self.outgoing {
            let (to, error) = match self.socket.try_send_to(octets, *to) {
                Ok(_) => return Ok(()),
                Err(error) => (*to, error.kind()),
            };
            if error == ErrorKind::WouldBlock {
                return Err(error);
            }
            // The error may be the report of a datagram that was sent before.
            tried += 1;
            if tried == 1 {
                self.take_reports();
            } else {
                let octets = octets.clone();
                self.client.undelivered(to, &octets, Undelivered::from(error));
                return Ok(());
            }
        }
        Ok(())
    }

    /// Takes datagrams.
    fn receive(&mut self) {
        // The buffer has one octet more than the longest datagram. So a longer datagram is seen as
        // too long, and is not cut.
        let mut octets = [0; MAX_DATAGRAM + 1];
        for _ in 0..MOST_AT_ONCE {
            match self.socket.try_recv_from(&mut octets) {
                Ok((length, from)) => {
                    let now = self.started.elapsed();
                    // What is ignored tells the client why a request was lost.
                    let _ = self.client.receive(now, from, &octets[..length]);
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(_) => {} // `take_reports` has more of it
            }
        }
    }

    /// Takes what the network reported.
    fn take_reports(&mut self) {
        let mut octets = [0; MAX_DATAGRAM];
        for _ in 0..MOST_AT_ONCE {
            let report = self.socket.try_io(Interest::ERROR, || report(&self.socket, &mut octets));
            let Ok((to, length, why)) = report else { break };
            if let Some(to) = to {
                self.client.undelivered(to, &octets[..length], why);
            }
        }
        let _ = self.socket.take_error(); // all that it stands for was in the reports
    }
}

/// The next report in the kernel's list: where a datagram was sent to, how many octets of it are quoted,
/// and what happened.
fn report(
    socket: &UdpSocket,
    octets: &mut [u8],
) -> io::Result<(Option<SocketAddr>, usize, Undelivered)> {
    let mut room = [IoSliceMut::new(octets)];
    let mut control = cmsg_space!(libc::sock_extended_err, libc::sockaddr_in6);
    let flags = MsgFlags::MSG_ERRQUEUE | MsgFlags::MSG_DONTWAIT;
    let message =
        recvmsg::<SockaddrStorage>(socket.as_raw_fd(), &mut room, Some(&mut control), flags)?;
    let number = message.cmsgs()?.find_map(|control| match control {
        ControlMessageOwned::Ipv4RecvErr(error, _) | ControlMessageOwned::Ipv6RecvErr(error, _) => {
            Some(error.ee_errno)
        }
        _ => None,
    });
    let number = number.and_then(|number| i32::try_from(number).ok()).unwrap_or(0);
    let why = io::Error::from_raw_os_error(number).kind().into();
    Ok((message.address.as_ref().and_then(socket_address), message.bytes, why))
}

fn socket_address(address: &SockaddrStorage) -> Option<SocketAddr> {
    let v4 = address.as_sockaddr_in().map(|v4| SocketAddr::V4((*v4).into()));
    v4.or_else(|| address.as_sockaddr_in6().map(|v6| SocketAddr::V6((*v6).into())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_network_says_is_told_in_words() {
        for (number, words) in [
            (libc::ECONNREFUSED, "nothing listens there"),
            (libc::EHOSTUNREACH, "the host there cannot be reached"),
            (libc::ENETUNREACH, "network unreachable"),
            (libc::EACCES, "a firewall forbids it"),
            (libc::EPERM, "a firewall forbids it"),
            (libc::EINVAL, "it did not arrive: invalid input parameter"),
        ] {
            let error = io::Error::from_raw_os_error(number);
            assert_eq!(Undelivered::from(error.kind()).to_string(), words);
        }
    }
}
