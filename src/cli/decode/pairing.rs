//! Which answer belongs to which request.
//!
//! The datagrams of P-NET have no number, so the pair is told by both ends and by the route, which the
//! answer has the other way round. A client that waits for several answers of one node gives each
//! request a source element of its own. Where it asks again on the same route, an answer counts for the
//! latest request, since the earlier one is mostly lost. Invariant: at most [`MOST`] requests are open.

use std::hash::BuildHasher;
use std::mem;
use std::net::SocketAddr;
use std::time::{Duration, SystemTime};

use foldhash::fast::RandomState;
use hashbrown::HashTable;
use hashbrown::hash_table::Entry;
use slab::Slab;

use crate::pnet::wire::{Datagram, Elements, Indication, NCNA, RouteFormat};

/// Requests that wait for their answer.
const MOST: usize = 1 << 16;
/// How long a request waits, by the clock of the capture: as long as the relay counts on an answer.
pub(super) const PATIENCE: Duration = Duration::from_secs(10);

/// A request without an answer so far.
#[derive(Clone, Debug)]
pub(super) struct Request {
    pub(super) packet: u64,
    pub(super) time: Option<SystemTime>,
    pub(super) client: SocketAddr,
    pub(super) server: SocketAddr,
    /// None in a route of another format than those over IP.
    pub(super) ip_net_id: Option<u8>,
    pub(super) node_address: u8,
    /// The destination elements after the node.
    beyond: Elements,
    /// The source elements after the client's node.
    endpoint: Elements,
}

/// The request that an answer belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Asked {
    pub(super) packet: u64,
    /// From the request to the answer.
    pub(super) elapsed: Option<Duration>,
    pub(super) server: SocketAddr,
    /// The answer comes from another port than was asked. Such a request stays open: neither client nor
    /// relay takes the answer.
    pub(super) from_another_port: bool,
}

/// The open requests.
#[derive(Debug, Default)]
pub(super) struct Pairing {
    requests: Slab<Open>,
    /// The latest open request of each kind. The port of the server is not part of the hash.
    by_ends: HashTable<usize>,
    hasher: RandomState,
    /// The oldest and the latest request.
    ends: Option<[usize; 2]>,
    asked: u64,
}

/// An open request in its two lists: all by age, and those that the same answer would do for.
#[derive(Debug)]
struct Open {
    request: Request,
    number: u64,
    older: Option<usize>,
    newer: Option<usize>,
    /// The request before it with the same ends and the same route, and its number. It may have gone.
    before: Option<(usize, u64)>,
}

impl Request {
    /// The request that this datagram is; none if it asks for no answer (R-28, PAS 5.7.1.6).
    pub(super) fn of(
        datagram: &Datagram<'_>,
        packet: u64,
        time: Option<SystemTime>,
        [from, to]: [SocketAddr; 2],
    ) -> Option<Self> {
        let confirm = Indication::parse(datagram)?.confirm;
        let [(node_address, beyond), (_, endpoint)] = ends(datagram)?;
        let ip_net_id = datagram.route().ip_net_id();
        let request = Self {
            packet,
            time,
            client: from,
            server: to,
            ip_net_id,
            node_address,
            beyond,
            endpoint,
        };
        confirm.then_some(request)
    }

    /// The request that this datagram would answer.
    fn answered_by(
        datagram: &Datagram<'_>,
        packet: u64,
        time: Option<SystemTime>,
        [from, to]: [SocketAddr; 2],
    ) -> Option<Self> {
        // The first elements at the client's end may have changed (R-40, PAS 9).
        let [(_, endpoint), (node_address, mut beyond)] = ends(datagram)?;
        // The mark of an unconfirmed datagram, which a response is (R-34, PAS 6.1.1.1.1.5).
        if beyond.last() == Some(&NCNA) {
            beyond.pop();
        }
        Some(Self {
            packet,
            time,
            client: to,
            server: from,
            ip_net_id: None,
            node_address,
            beyond,
            endpoint,
        })
    }

    fn hash(&self, hasher: &RandomState) -> u64 {
        let Self { client, server, node_address, beyond, endpoint, .. } = self;
        hasher.hash_one((client, server.ip(), node_address, &beyond[..], &endpoint[..]))
    }

    /// Whether the same answer would do for both, but for the port that it comes from.
    fn is_like(&self, other: &Self) -> bool {
        self.client == other.client
            && self.server.ip() == other.server.ip()
            && self.node_address == other.node_address
            && self.beyond == other.beyond
            && self.endpoint == other.endpoint
    }
}

/// Node and elements behind it, of the destination and of the source. Over IP, the IPNetID before them is
/// left out: each end numbers its nets as it likes.
fn ends(datagram: &Datagram<'_>) -> Option<[(u8, Elements); 2]> {
    let route = datagram.route();
    let node = match route.format() {
        RouteFormat::Extended | RouteFormat::Ip => 1,
        RouteFormat::Simple | RouteFormat::Complex => 0,
        RouteFormat::Immediate => return None,
    };
    let mut destinations = route.destinations().skip(node);
    let mut sources = route.sources().skip(node);
    Some([(destinations.next()?, destinations.collect()), (sources.next()?, sources.collect())])
}

impl Pairing {
    /// Takes the oldest request out if it has waited too long.
    pub(super) fn overdue(&mut self, now: Option<SystemTime>) -> Option<Request> {
        let [oldest, _] = self.ends?;
        let asked = self.requests[oldest].request.time?;
        let waited = now?.duration_since(asked).ok()?;
        (waited > PATIENCE).then(|| self.remove(oldest))
    }

    /// Takes the oldest request out.
    pub(super) fn next(&mut self) -> Option<Request> {
        self.ends.map(|[oldest, _]| self.remove(oldest))
    }

    /// Adds a request. Returns the oldest one if there was no room.
    pub(super) fn ask(&mut self, request: Request) -> Option<Request> {
        let evicted = if self.requests.len() < MOST { None } else { self.next() };
        self.asked += 1;
        let (hash, number) = (request.hash(&self.hasher), self.asked);
        let older = self.ends.map(|[_, latest]| latest);
        let open = Open { request, number, older, newer: None, before: None };
        let index = self.requests.insert(open);
        if let Some(latest) = older {
            self.requests[latest].newer = Some(index);
        }
        self.ends = Some([self.ends.map_or(index, |[oldest, _]| oldest), index]);

        let (requests, hasher) = (&self.requests, &self.hasher);
        let request = &requests[index].request;
        let is_same = |&other: &usize| is_same(&requests[other].request, request);
        let hash_of = |&other: &usize| requests[other].request.hash(hasher);
        let before = match self.by_ends.entry(hash, is_same, hash_of) {
            Entry::Occupied(mut latest) => {
                let before = mem::replace(latest.get_mut(), index);
                Some((before, requests[before].number))
            }
            Entry::Vacant(place) => {
                place.insert(index);
                None
            }
        };
        self.requests[index].before = before;
        evicted
    }

    /// The request that this datagram answers, if it answers one.
    pub(super) fn answer(
        &mut self,
        datagram: &Datagram<'_>,
        packet: u64,
        time: Option<SystemTime>,
        ends: [SocketAddr; 2],
    ) -> Option<Asked> {
        if self.requests.is_empty() {
            return None;
        }
        let answer = Request::answered_by(datagram, packet, time, ends)?;
        let (hash, requests) = (answer.hash(&self.hasher), &self.requests);
        let same = self.by_ends.find(hash, |&other| is_same(&requests[other].request, &answer));
        let found = same
            .or_else(|| self.by_ends.find(hash, |&other| requests[other].request.is_like(&answer)));
        let index = *found?;
        let Request { packet, time: asked, server, .. } = requests[index].request;
        let elapsed = time.zip(asked).and_then(|(now, then)| now.duration_since(then).ok());
        let from_another_port = server != answer.server;
        if !from_another_port {
            self.remove(index);
        }
        Some(Asked { packet, elapsed, server, from_another_port })
    }

    fn remove(&mut self, index: usize) -> Request {
        let Open { request, older, newer, before, .. } = self.requests.remove(index);
        if let Some(older) = older {
            self.requests[older].newer = newer;
        }
        if let Some(newer) = newer {
            self.requests[newer].older = older;
        }
        self.ends = self.ends.and_then(|[oldest, latest]| {
            let oldest = if oldest == index { newer } else { Some(oldest) };
            let latest = if latest == index { older } else { Some(latest) };
            Some([oldest?, latest?])
        });
        // Only the latest of its kind is in the table.
        let hash = request.hash(&self.hasher);
        if let Ok(mut entry) = self.by_ends.find_entry(hash, |&other| other == index) {
            let is_open =
                |(index, number)| self.requests.get(index).is_some_and(|it| it.number == number);
            match before.filter(|&before| is_open(before)) {
                Some((before, _)) => *entry.get_mut() = before,
                None => drop(entry.remove()),
            }
        }
        request
    }
}

/// Whether the same answer would do for both.
fn is_same(one: &Request, other: &Request) -> bool {
    one.server == other.server && one.is_like(other)
}

#[cfg(test)]
mod tests;
