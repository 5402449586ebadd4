//! A simulated P-NET server node on its Normal and Secure UDP ports.
//!
//! [`Server`] judges what comes and makes the responses; a [`Service`] makes their data. This file
//! has the sockets, and the [`Faults`] that the node is to make. It also plays the nodes that lie
//! behind it on a request's route.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::sync::Arc;

use arrayvec::ArrayVec;
use fastrand::Rng;
use tokio::net::UdpSocket;
use tokio::time::Instant;

use super::counts::NodeCounts;
use super::faults::{Fate, Faults};
use super::until;
use crate::listen::{self, ListenError};
use crate::pnet::endpoint::{Port, Requester, Server, Service};
use crate::pnet::ip_net_table::{Fields, IllegalTable, IpNetTable, Nettype};
use crate::pnet::wire::{
    Header, IpNetId, MAX_DATAGRAM, NORMAL_PORT, NodeAddress, Password, SECURE_PORT,
};

/// The most responses that wait for their time. Further ones are lost.
const MOST_WAITING: usize = 4096;

/// The settings of a simulated node.
#[derive(Clone, Debug)]
pub struct NodeSettings {
    /// The IP address. Its last octet is the node address (R-12, PAS 7).
    pub address: Ipv4Addr,
    /// The Normal port, which takes requests without a password. 0 means any free port.
    pub normal_port: u16,
    /// The Secure port, which takes only requests with a password of the node. 0 means
    /// any free port.
    pub secure_port: u16,
    /// The header with which every datagram begins.
    pub header: Header,
    /// The passwords, of which each opens the Secure port.
    pub passwords: Vec<Password>,
    /// The table of the nets whose clients the node knows. `None` stands for a device that
    /// was never set up: it knows its own subnet, as net 1, at the Normal port.
    pub table: Option<IpNetTable>,
    /// What the node does wrong.
    pub faults: Faults,
}

impl NodeSettings {
    /// A node at this address and the usual ports, with these passwords.
    pub fn new(address: Ipv4Addr, passwords: Vec<Password>) -> Self {
        Self {
            address,
            normal_port: NORMAL_PORT,
            secure_port: SECURE_PORT,
            header: Header::default(),
            passwords,
            table: None,
            faults: Faults::default(),
        }
    }

    /// The node address: the last octet of the IP address (R-12, PAS 7).
    pub fn node_address(&self) -> u8 {
        self.address.octets()[3]
    }
}

/// Why a node cannot begin.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// The last octet of its address is no node address (R-12, PAS 7).
    #[error("the last number of {0} is no node address: these are 1 to 125")]
    Address(Ipv4Addr),
    /// The rows of its table are not legal for this node.
    #[error("node {node}: {fault}")]
    Table {
        /// The node address.
        node: NodeAddress,
        /// What is wrong.
        fault: IllegalTable,
    },
    /// A port cannot be had.
    #[error(transparent)]
    Listen(#[from] ListenError),
}

/// A simulated server node whose ports are open (R-2, PAS 7).
pub struct ServerNode {
    settings: NodeSettings,
    server: Server,
    service: Box<dyn Service + Send>,
    sockets: Sockets,
    counts: Arc<NodeCounts>,
    /// The responses that wait for their time, the next one first.
    waiting: BinaryHeap<Reverse<Waiting>>,
    dice: Rng,
    started: Instant,
}

impl std::fmt::Debug for ServerNode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ServerNode").field("settings", &self.settings).finish_non_exhaustive()
    }
}

struct Sockets {
    normal: UdpSocket,
    secure: UdpSocket,
    /// Where responses leave from that are to come from a wrong port.
    other: Option<UdpSocket>,
}

impl Sockets {
    /// The response leaves from the port that received the request (A14), unless it is to be wrong.
    fn of(&self, port: Port) -> &UdpSocket {
        match (&self.other, port) {
            (Some(other), _) => other,
            (None, Port::Normal) => &self.normal,
            (None, Port::Secure) => &self.secure,
        }
    }
}

#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Waiting {
    due: Instant,
    port: Port,
    to: SocketAddrV4,
    octets: ArrayVec<u8, MAX_DATAGRAM>,
}

impl ServerNode {
    /// Opens the node's ports. The node answers nothing before [`serve`](Self::serve).
    pub fn bind(
        mut settings: NodeSettings,
        service: impl Service + Send + 'static,
    ) -> Result<Self, NodeError> {
        let node = NodeAddress::new(settings.node_address());
        let node = node.ok_or(NodeError::Address(settings.address))?;
        let sockets = Sockets {
            normal: bind(settings.address, &mut settings.normal_port)?,
            secure: bind(settings.address, &mut settings.secure_port)?,
            other: match settings.faults.answer_from_other_port {
                true => Some(bind(settings.address, &mut 0)?),
                false => None,
            },
        };
        let table = match &settings.table {
            Some(table) => IpNetTable::new(node, table.rows()),
            None => IpNetTable::new(node, [own_subnet(&settings)]),
        };
        let table = table.map_err(|fault| NodeError::Table { node, fault })?;
        Ok(Self {
            server: Server::new(table, settings.header, settings.passwords.clone()),
            service: Box::new(service),
            sockets,
            counts: Arc::default(),
            waiting: BinaryHeap::new(),
            dice: Rng::new(),
            started: Instant::now(),
            settings,
        })
    }

    /// The node's settings, with the ports that the node got.
    pub fn settings(&self) -> &NodeSettings {
        &self.settings
    }

    /// The node's counts. They go on counting while the node serves.
    pub fn counts(&self) -> Arc<NodeCounts> {
        Arc::clone(&self.counts)
    }

    /// Answers requests until a socket fails.
    pub async fn serve(mut self) -> io::Result<()> {
        // A buffer has one octet more than the longest datagram. So a longer datagram is seen as
        // too long, and is not cut.
        let (mut normal, mut secure) = ([0; MAX_DATAGRAM + 1], [0; MAX_DATAGRAM + 1]);
        loop {
            let next = self.waiting.peek().map(|Reverse(waiting)| waiting.due);
            let Sockets { normal: normal_socket, secure: secure_socket, .. } = &self.sockets;
            let (port, from, octets) = tokio::select! {
                received = normal_socket.recv_from(&mut normal) => {
                    let (length, from) = received?;
                    (Port::Normal, from, &normal[..length])
                }
                received = secure_socket.recv_from(&mut secure) => {
                    let (length, from) = received?;
                    (Port::Secure, from, &secure[..length])
                }
                () = until(next) => {
                    self.send_due().await;
                    continue;
                }
            };
            self.counts.count_received();
            if let SocketAddr::V4(from) = from {
                self.handle(port, from, octets).await; // the sockets are of IPv4
            }
        }
    }

    async fn handle(&mut self, port: Port, from: SocketAddrV4, octets: &[u8]) {
        let indicated = match self.server.receive(self.started.elapsed(), port, from, octets) {
            Ok(indicated) => indicated,
            Err(reason) => return self.counts.count_refused(reason),
        };
        let data = self.service.serve(&indicated);
        let Some(requester) = indicated.requester else { return self.counts.count_unconfirmed() };
        let Some(data) = data else { return self.counts.count_unserved() };
        let requester = self.perhaps_with_wrong_password(requester);
        let mut response = [0; MAX_DATAGRAM];
        let Ok(length) = requester.respond(&data, &mut response) else {
            return self.counts.count_unserved();
        };
        let response = &response[..length];
        let Fate { copies, delay } = self.settings.faults.fate(&mut self.dice);
        if copies == 0 || self.waiting.len() + copies > MOST_WAITING {
            return self.counts.count_lost();
        }
        if delay.is_zero() {
            self.send(port, requester.address(), response, copies).await;
            return;
        }
        for _ in 0..copies {
            self.waiting.push(Reverse(Waiting {
                due: Instant::now() + delay,
                port,
                to: requester.address(),
                octets: response.try_into().expect("a response fits into a datagram"),
            }));
        }
    }

    fn perhaps_with_wrong_password(&self, requester: Requester) -> Requester {
        match self.settings.faults.wrong_password {
            true => requester.with_wrong_password(),
            false => requester,
        }
    }

    async fn send_due(&mut self) {
        let now = Instant::now();
        while self.waiting.peek().is_some_and(|Reverse(waiting)| waiting.due <= now)
            && let Some(Reverse(waiting)) = self.waiting.pop()
        {
            self.send(waiting.port, waiting.to, &waiting.octets, 1).await;
        }
    }

    async fn send(&mut self, port: Port, to: SocketAddrV4, octets: &[u8], copies: usize) {
        for _ in 0..copies {
            match self.sockets.of(port).send_to(octets, to).await {
                Ok(_) => self.counts.count_answered(),
                Err(_) => self.counts.count_lost(),
            }
        }
    }
}

/// The row of a device that was never set up, at the Normal port that the node has.
fn own_subnet(settings: &NodeSettings) -> (IpNetId, Fields) {
    let fields = Fields {
        nettype: Nettype::IpRange,
        ip_address: settings.address,
        udp_port: settings.normal_port,
        ..Fields::UNUSED
    };
    (IpNetId::FIRST, fields)
}

fn bind(address: Ipv4Addr, port: &mut u16) -> Result<UdpSocket, ListenError> {
    let socket = listen::udp((address, *port).into(), "--listen")?;
    if let Ok(address) = socket.local_addr() {
        *port = address.port();
    }
    Ok(socket)
}
