//! A client node: its Route Endpoints, the requests that they send, and which datagrams answer them.
//!
//! Without I/O or clock, as the server is. The caller gives the time since any moment of its choice,
//! sends what [`Client::poll_transmit`] hands out, and passes on what comes. Invariants: a response that
//! is handed out belongs to the request of its endpoint and never to an earlier one, and nothing that
//! others send makes the client allocate.
//!
//! ```
//! use std::time::Duration;
//!
//! use pnet_nat::pnet::endpoint::client::{
//!     Arep, Attributes, Client, DestinationRoute, Outcome, Request, Source, Way,
//! };
//! use pnet_nat::pnet::ip_net_table::Destination;
//! use pnet_nat::pnet::wire::{Elements, IpNetId, MAX_DATAGRAM, NodeAddress, Password};
//!
//! let password = Some(Password::new(*b"PNETPASS"));
//! let mut client = Client::new(Arep::new(Source::FIGURE_10));
//! let endpoint = client.reserve(Attributes::new(DestinationRoute {
//!     way: Way { address: "203.0.113.5:20004".parse()?, password },
//!     ip_net_id: IpNetId::new(11).unwrap(),
//!     node: Destination::Node(NodeAddress::new(4).unwrap()),
//!     beyond: Elements::from_iter([2, 33]),
//! }))?;
//! client.request(endpoint, &Request::Data { control_status: 0, data_octets: b"abc" })?;
//!
//! let mut octets = [0; MAX_DATAGRAM];
//! while let Some(transmit) = client.poll_transmit(Duration::ZERO, &mut octets) {
//!     // Send octets[..transmit.length] to transmit.to.
//! #   assert_eq!(transmit.to, "203.0.113.5:20004".parse()?);
//! }
//! // What comes from the socket goes to client.receive(), until client.next_timeout().
//! # let response = b"\x02\0\0\0\x7D\x07\x06\x01\x8B\x84\x82\xA1\x80\x00\x03xyzPNETPASS";
//! client.receive(Duration::from_millis(20), "203.0.113.5:20004".parse()?, response)?;
//! assert_eq!(client.poll_finished(), Some(endpoint));
//! let Some(Outcome::Answered(response)) = client.take_outcome(endpoint) else { panic!() };
//! assert_eq!(response.data_octets, b"xyz");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod addresses;
mod arep;
mod destination;
mod outcome;
mod receive;
mod route_endpoint;
mod segments;
mod sources;
#[cfg(test)]
mod tests;
mod transmit;

use std::collections::VecDeque;

use addresses::{Addresses, Past};
pub use arep::{Arep, ArepRole, MAX_PDU, Source};
pub use destination::{DestinationRoute, NoWay, Way};
pub use outcome::{Ignored, Loss, Outcome, RequestError, Response, Undelivered};
use route_endpoint::Work;
pub use route_endpoint::{
    Attributes, Capabilities, Priority, Progress, RepRole, RepState, RouteEndpoint,
};
use segments::Segments;
pub use segments::{FlatAddressing, Request};
use sources::Sources;
pub use transmit::Transmit;

/// The most endpoints that can be reserved at the same time. About as many addresses are left, so that
/// one rests before it is used again, and a late response finds nobody.
pub const MAX_ENDPOINTS: usize = 64;

/// A Route Endpoint of a client, as long as it is reserved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EndpointId(u64);

/// All [`MAX_ENDPOINTS`] are reserved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("all {MAX_ENDPOINTS} endpoints are in use")]
pub struct NoneFree;

/// An attribute is set while a request is on the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a request is on the way, or the endpoint is not in use")]
pub struct NotIdle;

/// A client with its endpoints.
#[derive(Clone, Debug)]
pub struct Client {
    arep: Arep,
    /// The oldest comes first.
    endpoints: Vec<(EndpointId, RouteEndpoint)>,
    addresses: Addresses,
    sources: Sources,
    next_id: u64,
    next_ticket: u64,
    /// Whose outcome nobody has been told of.
    finished: VecDeque<EndpointId>,
}

impl Client {
    /// A client whose requests have these attributes in common.
    pub fn new(arep: Arep) -> Self {
        Self {
            arep,
            endpoints: Vec::with_capacity(MAX_ENDPOINTS),
            addresses: Addresses::default(),
            sources: Sources::default(),
            next_id: 0,
            next_ticket: 0,
            finished: VecDeque::with_capacity(MAX_ENDPOINTS),
        }
    }

    /// AR-Get: what all requests have in common.
    pub fn arep(&self) -> &Arep {
        &self.arep
    }

    /// The role of the endpoint that they leave from.
    pub fn arep_role(&self) -> ArepRole {
        ArepRole::Client
    }

    /// AR-Set. Fails while a request is on the way.
    pub fn set_arep(&mut self, arep: Arep) -> Result<(), NotIdle> {
        if self.endpoints.iter().any(|(_, endpoint)| endpoint.work.is_some()) {
            return Err(NotIdle);
        }
        self.arep = arep;
        Ok(())
    }

    /// Reserve REP.
    pub fn reserve(&mut self, attributes: Attributes) -> Result<EndpointId, NoneFree> {
        if self.endpoints.len() == MAX_ENDPOINTS {
            return Err(NoneFree);
        }
        let id = EndpointId(self.next_id);
        let address = self.addresses.take(id).ok_or(NoneFree)?;
        self.next_id += 1;
        self.endpoints.push((id, RouteEndpoint::new(address, attributes)));
        Ok(id)
    }

    /// Free REP. A request that is on the way is given up. One that is not in use stays so.
    pub fn free(&mut self, id: EndpointId) {
        let Some(index) = self.endpoints.iter().position(|(other, _)| *other == id) else { return };
        let (_, endpoint) = self.endpoints.remove(index);
        if endpoint.work.is_some() {
            self.addresses.note(endpoint.address, Past::GivenUp);
        }
        self.addresses.free(endpoint.address);
        self.finished.retain(|other| *other != id);
    }

    /// Get REP Attribute: all of them. `None` for an endpoint that is not in use.
    pub fn get(&self, id: EndpointId) -> Option<&RouteEndpoint> {
        self.endpoints.iter().find(|(other, _)| *other == id).map(|(_, endpoint)| endpoint)
    }

    /// REP State.
    pub fn state(&self, id: EndpointId) -> RepState {
        self.get(id).map_or(RepState::NotInUse, RouteEndpoint::state)
    }

    /// Set REP Attribute. Fails while a request is on the way, and if the endpoint is not in use.
    pub fn set(&mut self, id: EndpointId, attributes: Attributes) -> Result<(), NotIdle> {
        match self.get_mut(id) {
            Some(endpoint) if endpoint.work.is_none() => {
                endpoint.attributes = attributes;
                Ok(())
            }
            _ => Err(NotIdle),
        }
    }

    /// REQUEST: has an endpoint send a request, as soon as the window is open. The outcome of the one
    /// before is dropped if nobody has taken it.
    ///
    /// Fails if the endpoint is not idle, and if the request does not fit into a package.
    pub fn request(&mut self, id: EndpointId, request: &Request<'_>) -> Result<(), RequestError> {
        let arep = &self.arep;
        let mut endpoints = self.endpoints.iter_mut();
        let found = endpoints.find(|(other, _)| *other == id);
        let (_, endpoint) = found.ok_or(RequestError::NotInUse)?;
        if endpoint.work.is_some() {
            return Err(RequestError::Busy);
        }
        let attributes = &endpoint.attributes;
        let room = transmit::room_for_data(arep, attributes)?;
        let segments = Segments::new(request, attributes.flat_addressing, room)?;
        if segments.reads() && !endpoint.confirmation() {
            return Err(RequestError::UnconfirmedRead);
        }
        self.sources.prepare(&attributes.destination, arep.source);
        endpoint.progress = Progress { delivered: 0, total: segments.total };
        endpoint.retries = 0;
        endpoint.outcome = None;
        endpoint.work = Some(Work {
            segments,
            ticket: self.next_ticket,
            waits_until: None,
            began: None,
            segment_began: None,
            tries: 0,
            noticed: None,
        });
        endpoint.renew_address(id, &mut self.addresses);
        self.next_ticket += 1;
        self.finished.retain(|other| *other != id);
        Ok(())
    }

    /// The next endpoint whose request has come to an end.
    pub fn poll_finished(&mut self) -> Option<EndpointId> {
        self.finished.pop_front()
    }

    /// What became of the last request of an endpoint, unless it is on the way, or was taken before. The
    /// endpoint is idle then.
    pub fn take_outcome(&mut self, id: EndpointId) -> Option<Outcome> {
        self.get_mut(id)?.outcome.take()
    }

    fn get_mut(&mut self, id: EndpointId) -> Option<&mut RouteEndpoint> {
        self.endpoints.iter_mut().find(|(other, _)| *other == id).map(|(_, endpoint)| endpoint)
    }

    fn finish(&mut self, id: EndpointId, outcome: Outcome, past: Past) {
        let Some(endpoint) = self.get_mut(id) else { return };
        endpoint.work = None;
        endpoint.outcome = Some(outcome);
        let address = endpoint.address;
        self.addresses.note(address, past);
        self.finished.push_back(id); // once a request, so there is room
    }
}

impl RouteEndpoint {
    /// Moves on to another address, if a request has left from this one.
    fn renew_address(&mut self, id: EndpointId, addresses: &mut Addresses) {
        if !self.address_was_used {
            return;
        }
        // There are more addresses than endpoints.
        if let Some(address) = addresses.take(id) {
            addresses.free(self.address);
            self.address = address;
            self.address_was_used = false;
        }
    }
}

#[cfg(test)]
impl Client {
    /// The requests that wait for a response.
    fn outstanding(&self) -> usize {
        let works = self.endpoints.iter().filter_map(|(_, endpoint)| endpoint.work.as_ref());
        works.filter(|work| work.waits_until.is_some()).count()
    }

    fn check_invariants(&self) {
        assert!(self.outstanding() <= self.arep.max_outstanding_requests);
        assert!(self.finished.len() <= self.endpoints.len());
        for (id, endpoint) in &self.endpoints {
            let owned =
                self.endpoints.iter().filter(|(_, other)| other.address == endpoint.address);
            assert_eq!(owned.count(), 1, "{id:?}");
            let Progress { delivered, total } = endpoint.progress;
            assert!(delivered <= total && total > 0);
        }
    }
}
