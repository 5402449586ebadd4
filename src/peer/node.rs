//! A simulated P-NET server node on its Normal and Secure UDP ports.
//!
//! The node has no IPNetTable and forwards nothing. It also plays the nodes that lie behind it on a
//! request's route. [`NodeSettings::answer`] checks and answers a request without a socket. The
//! rest of the code only receives and sends. Invariant: the node answers only a confirmed request
//! to its own node address, and on the Secure port only one with its password.

use std::io;
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use arrayvec::ArrayVec;
use tokio::net::UdpSocket;

use crate::listen::{self, ListenError};
use crate::pnet::wire::{
    Datagram, DatagramRepr, DlRoute, DlRouteError, Header, Indication, MAX_DATA, MAX_DATAGRAM,
    NCNA, Password, RouteBuf,
};

/// Makes the data of a response from the node address and the data of the request.
pub type Reply = fn(node_address: u8, request: &[u8]) -> ArrayVec<u8, MAX_DATA>;

/// The [`Reply`] that sends the request's data back.
pub fn echo(_node_address: u8, request: &[u8]) -> ArrayVec<u8, MAX_DATA> {
    request.iter().copied().take(MAX_DATA).collect()
}

/// The settings of a simulated node.
#[derive(Clone, Debug)]
pub struct NodeSettings {
    /// The IP address. Its last octet is the node address (R-12, PAS 7).
    pub address: Ipv4Addr,
    /// The Normal port, which takes requests without a password. 0 means any free port.
    pub normal_port: u16,
    /// The Secure port, which takes only requests with the node's password. 0 means any
    /// free port.
    pub secure_port: u16,
    /// The header with which every datagram begins.
    pub header: Header,
    /// The password for the Secure port.
    pub password: Password,
    /// How long each port works on a request. Other requests wait in the port's socket until then.
    pub delay: Duration,
    /// Makes the data of the answers.
    pub reply: Reply,
}

/// The datagrams of a node so far. When no request is being handled, received = answered + refused.
#[derive(Debug, Default)]
pub struct NodeCounts {
    received: AtomicU64,
    answered: AtomicU64,
    refused: AtomicU64,
}

impl NodeCounts {
    /// Datagrams taken from both ports.
    pub fn received(&self) -> u64 {
        self.received.load(Relaxed)
    }

    /// Responses sent.
    pub fn answered(&self) -> u64 {
        self.answered.load(Relaxed)
    }

    /// Datagrams that got no response.
    pub fn refused(&self) -> u64 {
        self.refused.load(Relaxed)
    }
}

/// A simulated server node whose ports are open (R-2, PAS 7).
#[derive(Debug)]
pub struct ServerNode {
    settings: NodeSettings,
    normal: UdpSocket,
    secure: UdpSocket,
    counts: Arc<NodeCounts>,
}

impl ServerNode {
    /// Opens the node's ports. The node answers nothing before [`serve`](Self::serve).
    pub fn bind(mut settings: NodeSettings) -> Result<Self, ListenError> {
        let normal = bind(settings.address, &mut settings.normal_port)?;
        let secure = bind(settings.address, &mut settings.secure_port)?;
        Ok(Self { settings, normal, secure, counts: Arc::default() })
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
    pub async fn serve(self) -> io::Result<()> {
        tokio::try_join!(
            self.serve_port(&self.normal, Port::Normal),
            self.serve_port(&self.secure, Port::Secure),
        )
        .map(|_| ())
    }

    async fn serve_port(&self, socket: &UdpSocket, port: Port) -> io::Result<()> {
        // The buffer has one octet more than the longest datagram. So a longer datagram is seen as
        // too long, and is not cut.
        let mut request = [0; MAX_DATAGRAM + 1];
        let mut response = [0; MAX_DATAGRAM];
        loop {
            let (length, client) = socket.recv_from(&mut request).await?;
            self.counts.received.fetch_add(1, Relaxed);
            let answer = self.settings.answer(port, &request[..length], &mut response);
            let outcome = match answer {
                None => &self.counts.refused,
                Some(length) => {
                    if !self.settings.delay.is_zero() {
                        tokio::time::sleep(self.settings.delay).await;
                    }
                    // The response leaves from the port that received the request (A14).
                    match socket.send_to(&response[..length], client).await {
                        Ok(_) => &self.counts.answered,
                        Err(_) => &self.counts.refused,
                    }
                }
            };
            outcome.fetch_add(1, Relaxed);
        }
    }
}

/// The port that a request came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Port {
    Normal,
    Secure,
}

impl NodeSettings {
    /// The node address: the last octet of the IP address (R-12, PAS 7).
    pub fn node_address(&self) -> u8 {
        self.address.octets()[3]
    }

    /// Writes the response to a request and returns its length. `None` when the node does not
    /// answer.
    fn answer(&self, port: Port, octets: &[u8], response: &mut [u8]) -> Option<usize> {
        let request = Datagram::parse(octets, self.header).ok()?;
        let route = request.route();
        // A broadcast gets no answer, so BNA and SNA are ignored too (R-33, PAS 5.4.1.2 a).
        if route.node_address() != Some(self.node_address()) {
            return None;
        }
        let open = match port {
            Port::Normal => true,
            Port::Secure => self.password.matches(request.password()?).into(), // PAS 7
        };
        if !open {
            return None;
        }
        // Only a confirmed request gets an answer, so a response never does (R-28, PAS 5.7.1.6).
        let indication = Indication::parse(&request).filter(|indication| indication.confirm)?;
        let response_octets = (self.reply)(self.node_address(), indication.dlsdu);
        let route = self.response_route(route.ip_net_id(), indication.dl_route).ok()?;
        DatagramRepr {
            route: route.as_route(),
            data_octets: &response_octets,
            // Control-status and password stay as they came (password: R-39, PAS 9).
            ..DatagramRepr::parse(&request)
        }
        .emit(response)
        .ok()
    }

    /// The route of the response: the way back to the requester, then the way to the responder.
    /// NCNA comes last, because a response is unconfirmed (R-34, PAS 6.1.1.1.1.5 to 7; R-30, PAS
    /// Table 1). The IPNetID is that of the request: the node has no IPNetTable that could give
    /// another one.
    fn response_route(
        &self,
        ip_net_id: Option<u8>,
        indicated: DlRoute,
    ) -> Result<RouteBuf, DlRouteError> {
        let DlRoute { source: requester, destination: beyond } = indicated;
        let responder = [&beyond[..], &[NCNA]].concat();
        DlRoute::new(&requester, &responder)?
            .sent_by(ip_net_id, self.node_address())? // R-27, PAS 5.7.1.5
            .to_route()
    }
}

fn bind(address: Ipv4Addr, port: &mut u16) -> Result<UdpSocket, ListenError> {
    let socket = listen::udp((address, *port).into(), "--listen")?;
    if let Ok(address) = socket.local_addr() {
        *port = address.port();
    }
    Ok(socket)
}
