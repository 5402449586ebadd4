//! A remote client for one exchange at a time, with one net behind a NAT router.
//!
//! [`ClientNode`] does the work. Invariant: a returned answer belongs to the request that was just sent,
//! and never to an earlier one.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use super::ClientNode;
use crate::pnet::endpoint::client::{
    self, Arep, Attributes, DestinationRoute, EndpointId, Loss, Outcome, RequestError, Response,
    Source, Way,
};
use crate::pnet::ip_net_table::{Destination, NotADestination};
use crate::pnet::wire::{DlRouteError, Elements, Header, IpNetId, Password};

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
    pub ip_net_id: IpNetId,
    /// The client itself.
    pub source: Source,
}

impl Target {
    /// The net behind this address. IPNetIDs and the client's node address are those of PAS
    /// Figure 10.
    pub fn new(address: IpAddr, start_port: u16, password: Option<Password>) -> Self {
        let (header, source) = (Header::default(), Source::FIGURE_10);
        Self { address, start_port, password, header, ip_net_id: source.ip_net_id, source }
    }

    /// The public address and port of a node (R-10, PAS 8 d). With a start port above 65410, the
    /// highest node addresses have no port: the number wraps around.
    pub fn socket_address(&self, node_address: u8) -> SocketAddr {
        SocketAddr::new(self.address, self.start_port.wrapping_add(node_address.into()))
    }

    /// The route of a request. Fails when it names no node, and when it is too long.
    pub fn route(&self, request: &Request<'_>) -> Result<DestinationRoute, ExchangeError> {
        let beyond: Elements = request
            .beyond
            .try_into()
            .map_err(|_| RequestError::Route(DlRouteError::TooLong(request.beyond.len())))?;
        let address = self.socket_address(request.node_address);
        let way = Way { address, password: self.password.clone() };
        let node = Destination::try_from(request.node_address)?;
        Ok(DestinationRoute { way, ip_net_id: self.ip_net_id, node, beyond })
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

/// Why an exchange failed.
#[derive(Debug, thiserror::Error)]
pub enum ExchangeError {
    /// No answer to the request came in time, or the network reported that the request did not arrive.
    #[error(transparent)]
    Lost(#[from] Loss),
    /// A broadcast has no answer.
    #[error("nobody answers a broadcast")]
    Unconfirmed,
    /// The request has no such node.
    #[error(transparent)]
    Node(#[from] NotADestination),
    /// The request does not fit into a package.
    #[error(transparent)]
    Request(#[from] RequestError),
    /// The system refused.
    #[error("the client's socket failed: {0}")]
    Socket(#[from] io::Error),
}

/// A client with its socket.
#[derive(Debug)]
pub struct Client {
    target: Target,
    node: ClientNode,
    /// That of the last exchange. It may still wait, if nobody waited for the end of that exchange.
    endpoint: Option<EndpointId>,
}

impl Client {
    /// Makes a client on any free port.
    pub async fn bind(target: Target) -> io::Result<Self> {
        let arep = Arep { header: target.header, ..Arep::new(target.source) };
        let node = ClientNode::bind(arep, target.address).await?;
        Ok(Self { target, node, endpoint: None })
    }

    /// Sends one request and waits for its answer. Returns the answer, and the time from sending
    /// the request to receiving the answer. Other datagrams that come in the meantime are ignored.
    /// Fails at once when the network reports that the request did not arrive.
    pub async fn exchange(
        &mut self,
        request: &Request<'_>,
        wait: Duration,
    ) -> Result<(Response, Duration), ExchangeError> {
        let route = self.target.route(request)?;
        if route.names_broadcast() {
            return Err(ExchangeError::Unconfirmed);
        }
        let endpoint = self.reserve(Attributes::new(route), wait);
        let Request { control_status, data_octets, .. } = *request;
        let request = client::Request::Data { control_status, data_octets };
        self.node.client().request(endpoint, &request)?;
        while self.node.finished().await? != endpoint {}
        match self.node.client().take_outcome(endpoint) {
            Some(Outcome::Answered(answer)) => {
                let round_trip = answer.round_trip;
                Ok((answer, round_trip))
            }
            Some(Outcome::Lost(loss)) => Err(loss.into()),
            Some(Outcome::Sent) | None => Err(ExchangeError::Unconfirmed),
        }
    }

    fn reserve(&mut self, attributes: Attributes, wait: Duration) -> EndpointId {
        let client = self.node.client();
        if let Some(last) = self.endpoint.take() {
            client.free(last);
        }
        let arep = Arep { response_timeout: wait, ..client.arep().clone() };
        client.set_arep(arep).expect("nothing is on the way");
        let endpoint = client.reserve(attributes).expect("no other endpoint is reserved");
        self.endpoint = Some(endpoint);
        endpoint
    }
}
