//! From a request to its datagrams, when they are sent, and when they are given up.

use std::net::SocketAddr;
use std::time::Duration;

use super::addresses::Past;
use super::{
    Arep, Attributes, Client, EndpointId, Loss, Outcome, RepState, RequestError, RouteEndpoint,
    Source, Undelivered,
};
use crate::pnet::wire::{
    Datagram, DatagramRepr, DlRoute, DlRouteError, MAX_DATA, MAX_DATAGRAM, NCNA, RouteBuf,
};

/// Octets of control-status and data-field-format.
const CONTROL: usize = 2;
/// Any endpoint address: it does not change the length of a route.
const ANY_ADDRESS: u8 = 1;

/// A datagram that is to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transmit {
    /// Whose request it is.
    pub endpoint: EndpointId,
    /// Where it goes.
    pub to: SocketAddr,
    /// Its length in octets.
    pub length: usize,
    /// Whether the request was sent before, and had no response in time.
    pub is_retry: bool,
}

impl Client {
    /// Writes the next datagram that may be sent, if there is one. Requests of high priority come first,
    /// then older ones. At most MaxOutstandingRequests wait for their response.
    pub fn poll_transmit(
        &mut self,
        now: Duration,
        octets: &mut [u8; MAX_DATAGRAM],
    ) -> Option<Transmit> {
        let index = self.next_to_send()?;
        let (id, endpoint) = &mut self.endpoints[index];
        let (id, confirmation) = (*id, endpoint.confirmation());
        let source = self.sources.get(&endpoint.attributes.destination, self.arep.source);
        let work = endpoint.work.as_mut()?;
        let way = &endpoint.attributes.destination.way;
        let address = if confirmation { endpoint.address } else { NCNA };
        let route =
            route(&endpoint.attributes, source, address).expect("`request` has tried it out");
        let datagram = DatagramRepr {
            header: self.arep.header,
            route: route.as_route(),
            control_status: work.segments.control_status,
            data_field_flags: 0,
            data_octets: &work.segments.data(),
            password: way.password.clone(), // R-3, PAS 7
        };
        let length = datagram.emit(octets).expect("`request` has seen to its size");
        let transmit = Transmit { endpoint: id, to: way.address, length, is_retry: work.tries > 0 };
        work.began.get_or_insert(now);
        work.segment_began.get_or_insert(now);
        endpoint.retries = endpoint.retries.saturating_add(u32::from(work.tries > 0));
        work.tries = work.tries.saturating_add(1);
        endpoint.address_was_used = true;
        if confirmation {
            work.waits_until = Some(now.saturating_add(self.arep.response_timeout));
        } else {
            work.segments.sent();
            self.segment_is_done(index, Outcome::Sent);
        }
        Some(transmit)
    }

    /// The request that is to be sent next, if the window is open.
    fn next_to_send(&self) -> Option<usize> {
        let works = || {
            let endpoints = self.endpoints.iter().enumerate();
            endpoints.filter_map(|(index, (_, it))| Some((index, it, it.work.as_ref()?)))
        };
        let waiting = works().filter(|(.., work)| work.waits_until.is_some()).count();
        if waiting >= self.arep.max_outstanding_requests {
            return None;
        }
        let to_send = works().filter(|(.., work)| work.waits_until.is_none());
        let first = to_send.max_by_key(|(_, endpoint, work)| {
            (endpoint.attributes.priority, std::cmp::Reverse(work.ticket))
        });
        first.map(|(index, ..)| index)
    }

    /// Goes on with the next segment. After the last one, the request has this outcome.
    pub(super) fn segment_is_done(&mut self, index: usize, outcome: Outcome) {
        let (id, endpoint) = &mut self.endpoints[index];
        let (id, address) = (*id, endpoint.address);
        let Some(work) = &mut endpoint.work else { return };
        endpoint.progress.delivered = work.segments.delivered;
        if work.segments.is_complete() {
            return self.finish(id, outcome, Past::Answered);
        }
        work.waits_until = None;
        work.segment_began = None;
        work.tries = 0;
        work.noticed = None;
        self.addresses.note(address, Past::Answered);
        endpoint.renew_address(id, &mut self.addresses);
    }

    /// When [`handle_timeout`](Self::handle_timeout) has something to do. `None` while nothing is waited
    /// for.
    pub fn next_timeout(&self) -> Option<Duration> {
        let works = self.endpoints.iter().filter_map(|(_, endpoint)| endpoint.work.as_ref());
        works.filter_map(|work| work.waits_until).min()
    }

    /// Sends requests again whose response is overdue, as often as MaxRetries and MaxRetryTime let it, or
    /// gives them up.
    pub fn handle_timeout(&mut self, now: Duration) {
        while let Some((id, loss)) = self.next_overdue(now) {
            if let Some(loss) = loss {
                self.finish(id, Outcome::Lost(loss), Past::GivenUp);
            }
        }
    }

    /// A request that is overdue, and why it is lost. One that is not lost is to be sent again.
    fn next_overdue(&mut self, now: Duration) -> Option<(EndpointId, Option<Loss>)> {
        let arep = &self.arep;
        let mut works =
            self.endpoints.iter_mut().filter_map(|(id, it)| Some((*id, it.work.as_mut()?)));
        let (id, work) =
            works.find(|(_, work)| work.waits_until.is_some_and(|until| until <= now))?;
        let age = now.saturating_sub(work.segment_began.unwrap_or(now));
        if work.tries <= arep.max_retries && age < arep.max_retry_time {
            work.waits_until = None;
            return Some((id, None));
        }
        let waited = arep.response_timeout.saturating_mul(work.tries);
        Some((id, Some(work.noticed.unwrap_or(Loss::NoAnswer { waited, sent: work.tries }))))
    }

    /// Notes that a datagram to `to` did not arrive, as the network or the system says. `octets` are what
    /// they quote of it. When these do not tell which request it was, every one that waits for a response
    /// from there is meant. A request that may not be sent again is at an end.
    pub fn undelivered(&mut self, to: SocketAddr, octets: &[u8], why: Undelivered) {
        let quoted = Datagram::parse(octets, self.arep.header).ok();
        let address = quoted.and_then(|datagram| datagram.route().sources().last());
        let is_meant = |endpoint: &RouteEndpoint| {
            endpoint.state() == RepState::WaitingForResponse
                && is_same_port(endpoint.attributes.destination.way.address, to)
                && address.is_none_or(|address| address == endpoint.address)
        };
        let mut lost = [None; super::MAX_ENDPOINTS];
        for ((id, endpoint), lost) in self.endpoints.iter_mut().zip(&mut lost) {
            if !is_meant(endpoint) {
                continue;
            }
            let Some(work) = endpoint.work.as_mut().filter(|work| work.tries > 0) else { continue };
            work.noticed = Some(Loss::Undelivered(why));
            *lost = (work.tries > self.arep.max_retries).then_some(*id);
        }
        for id in lost.into_iter().flatten() {
            self.finish(id, Outcome::Lost(Loss::Undelivered(why)), Past::GivenUp);
        }
    }
}

/// Whether two addresses are the same port of the same host. Of IPv6, they may differ in flow label and
/// scope.
pub(super) fn is_same_port(one: SocketAddr, other: SocketAddr) -> bool {
    (one.ip(), one.port()) == (other.ip(), other.port())
}

/// The route of a request: where it goes, and from whom (R-27, PAS 5.7.1.5).
fn route(attributes: &Attributes, source: Source, address: u8) -> Result<RouteBuf, DlRouteError> {
    let destination = &attributes.destination;
    let mut elements = destination.beyond.clone();
    for element in [destination.node.number(), destination.ip_net_id.get()] {
        let length = elements.len();
        elements.try_insert(0, element).map_err(|_| DlRouteError::TooLong(length + 1))?;
    }
    DlRoute::new(&elements, &[address])?
        .sent_by(Some(source.ip_net_id.get()), source.node_address.get())?
        .to_route()
}

/// How many data octets a request of such an endpoint may have.
pub(super) fn room_for_data(arep: &Arep, attributes: &Attributes) -> Result<usize, RequestError> {
    let route = route(attributes, arep.source, ANY_ADDRESS)?.as_route().as_bytes().len();
    let frame = route + CONTROL;
    let most = arep.max_pdu_size;
    let room =
        most.checked_sub(frame).ok_or(RequestError::PackageTooLong { octets: frame, most })?;
    Ok(room.min(arep.max_data_size).min(MAX_DATA))
}
