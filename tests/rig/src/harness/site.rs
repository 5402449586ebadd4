//! A /24 of loopback for one scenario, and sockets in it that play servers and clients.
//!
//! On Linux, all of 127/8 belongs to loopback. So the nodes' Secure ports, the relays' public ports
//! and the admin servers of one scenario never conflict with those of another scenario or of
//! another test run.

use std::fs;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::process;
use std::process::Command;
use std::sync::atomic::{AtomicU8, AtomicU32, Ordering::Relaxed};
use std::time::Duration;

use socket2::Socket;

use super::{PATIENCE, Process, eventually, folder, pnet_nat, request, response};

/// The block lies below the ports that Linux gives out, so that no socket has one of them by
/// chance.
const START_PORT: u16 = 20000;
///
const SECURE_PORT: u16 = 34379;
/// The last octets of a site's addresses. The nodes have 1 to 125.
const PUBLIC: u8 = 200;
const FIRST_CLIENT: u8 = 201;
const CLAIM: u8 = 254;

/// A loopback subnet that no other scenario uses.
#[derive(Debug)]
pub struct Site {
    subnet: [u8; 3],
    next_client: AtomicU8,
    /// This socket claims the subnet: no second socket in any process can be bound to its address
    /// and port.
    _claim: UdpSocket,
}

impl Site {
    /// Takes a subnet that is free.
    pub fn claim() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        loop {
            let index = process::id().wrapping_mul(37).wrapping_add(NEXT.fetch_add(1, Relaxed));
            let [.., high, low] = index.to_be_bytes();
            let subnet = [127, 64 + high % 64, low];
            let claim = Ipv4Addr::new(subnet[0], subnet[1], subnet[2], CLAIM);
            match UdpSocket::bind((claim, START_PORT)) {
                Ok(claim) => {
                    return Self { subnet, next_client: FIRST_CLIENT.into(), _claim: claim };
                }
                Err(error) => assert_eq!(error.kind(), io::ErrorKind::AddrInUse, "{claim}"),
            }
        }
    }

    /// The address of the subnet that ends with this octet.
    pub fn address(&self, last: u8) -> Ipv4Addr {
        let [a, b, c] = self.subnet;
        Ipv4Addr::new(a, b, c, last)
    }

    /// The relay's own address.
    pub fn public_address(&self) -> Ipv4Addr {
        self.address(PUBLIC)
    }

    /// The start port of the net.
    pub fn start_port(&self) -> u16 {
        START_PORT
    }

    /// The public address and port of a node.
    pub fn public(&self, node_address: u8) -> SocketAddr {
        (self.public_address(), START_PORT + u16::from(node_address)).into()
    }

    /// A server node: a socket on its Secure port.
    pub fn node(&self, node_address: u8) -> Peer {
        Peer::bind((self.address(node_address), SECURE_PORT).into())
    }

    /// `pnet-nat node` for the nodes 1 to 4.
    pub fn simulated_nodes(&self, delay: &str) -> Process {
        self.simulated_nodes_as(delay, pnet_nat)
    }

    /// The same, with a command that contains these arguments, and possibly more.
    pub fn simulated_nodes_as(
        &self,
        delay: &str,
        command: impl FnOnce(&[&str]) -> Command,
    ) -> Process {
        let folder = folder("");
        let listen = format!("{}-4", self.address(1));
        let password = folder.path().join("secrets/section-1");
        let password = password.to_str().unwrap();
        let arguments =
            ["node", "--listen", &listen, "--password-file", password, "--delay", delay];
        let nodes = Process::start(command(&arguments));
        eventually("the nodes are there", || (nodes.stdout().lines().count() == 4).then_some(()));
        nodes
    }

    /// A client with its own address.
    pub fn client(&self) -> Peer {
        let last = self.next_client.fetch_add(1, Relaxed);
        assert!(last < CLAIM, "a site has room for {} clients", CLAIM - FIRST_CLIENT);
        Peer::bind((self.address(last), 0).into())
    }
}

/// One end of an exchange: a socket that sends and receives octets.
#[derive(Debug)]
pub struct Peer(UdpSocket);

impl Peer {
    /// Binds a socket. If the port is taken, waits: the system may have given it to another
    /// scenario's relay.
    pub fn bind(address: SocketAddr) -> Self {
        let socket = eventually("the port is free", || match UdpSocket::bind(address) {
            Ok(socket) => Some(socket),
            Err(error) if error.kind() == io::ErrorKind::AddrInUse => None,
            Err(error) => panic!("{address}: {error}"),
        });
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        socket.set_broadcast(true).unwrap();
        Self(socket)
    }

    /// The address and port of the socket.
    pub fn address(&self) -> SocketAddr {
        self.0.local_addr().unwrap()
    }

    /// Sends a datagram.
    pub fn send(&self, to: SocketAddr, octets: &[u8]) {
        assert_eq!(self.0.send_to(octets, to).unwrap(), octets.len());
    }

    /// The next datagram and its sender.
    #[track_caller]
    pub fn receive(&self) -> (Vec<u8>, SocketAddr) {
        let mut octets = [0; 2048];
        match self.0.recv_from(&mut octets) {
            Ok((length, from)) => (octets[..length].to_vec(), from),
            Err(error) => panic!("nothing came to {}: {error}", self.address()),
        }
    }

    /// The next datagram and its sender, if a datagram comes in time.
    pub fn receive_within(&self, time: Duration) -> Option<(Vec<u8>, SocketAddr)> {
        self.0.set_read_timeout(Some(time)).unwrap();
        let mut octets = [0; 2048];
        let came = self.0.recv_from(&mut octets);
        self.0.set_read_timeout(Some(PATIENCE)).unwrap();
        match came {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => None,
            came => came.map(|(length, from)| (octets[..length].to_vec(), from)).ok(),
        }
    }

    /// Receives the next datagram, which has to be this one, and returns its sender.
    #[track_caller]
    pub fn expect(&self, octets: &[u8]) -> SocketAddr {
        let (came, from) = self.receive();
        assert_eq!(came, octets, "the datagram that came to {}", self.address());
        from
    }

    /// A datagram that waits in the socket, if there is one.
    pub fn waiting(&self) -> Option<Vec<u8>> {
        self.0.set_nonblocking(true).unwrap();
        let mut octets = [0; 2048];
        let waiting = self.0.recv_from(&mut octets).map(|(length, _)| octets[..length].to_vec());
        self.0.set_nonblocking(false).unwrap();
        match waiting {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => None,
            waiting => Some(waiting.unwrap()),
        }
    }
}

impl From<Peer> for Socket {
    fn from(peer: Peer) -> Self {
        peer.0.into()
    }
}

/// Closes an IPv4 socket of the calling thread's network namespace, and waits until its port is
/// free. A process that another scenario starts at this moment has a copy of every socket for a
/// short time.
pub fn close(socket: impl Into<Socket>) {
    let socket = socket.into();
    let address = socket.local_addr().unwrap().as_socket_ipv4().unwrap();
    drop(socket);
    let octets = u32::from_ne_bytes(address.ip().octets());
    let place = format!(": {octets:08X}:{:04X} ", address.port());
    let is_free = |table| {
        let path = format!("/proc/thread-self/net/{table}");
        !fs::read_to_string(path).unwrap().contains(&place)
    };
    eventually("the port is free", || ["udp", "tcp"].into_iter().all(is_free).then_some(()));
}

/// Sends a request to a node and the answer back to the client. Both have to arrive unchanged, and
/// as the next datagram at their destination. Returns the relay's upstream port.
#[track_caller]
pub fn exchange(client: &Peer, public: SocketAddr, node: &Peer, node_address: u8) -> u16 {
    client.send(public, &request(node_address));
    let relay = node.expect(&request(node_address));
    node.send(relay, &response(node_address));
    assert_eq!(client.expect(&response(node_address)), public, "who answers");
    relay.port()
}
