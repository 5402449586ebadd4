//! What a core shares with a faster datapath, which carries datagrams of a flow without asking it.
//!
//! Such a datapath keeps verdicts that the core has given, and makes none of its own. The core offers it a
//! flow about which nothing needs judgement for each datagram, and recalls the flow when that ends.

use std::fmt;
use std::net::{IpAddr, SocketAddr};
use std::ops::Deref;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use super::flow::{FlowTraffic, LOST_AFTER};
use super::ids::{MappingId, NetId};
use super::protocol::{Header, Password};
use super::time::Nanos;

/// A flow that a faster datapath may carry: every datagram of it that is well formed, names the node and has
/// the password may pass, in both directions.
#[derive(Clone, Copy, Debug)]
pub struct Offer<'a> {
    /// The client's address and port.
    pub client: SocketAddr,
    /// The router's address, to which the client sends.
    pub public_address: IpAddr,
    /// The router's port towards the client.
    pub public_port: u16,
    /// The router's port towards the server.
    pub upstream_port: u16,
    /// The server's address and port.
    pub server: SocketAddr,
    /// The node that requests have to name.
    pub node_address: u8,
    /// The header that datagrams begin with.
    pub header: Header,
    /// The password of requests and answers.
    pub password: &'a Password,
    /// What the datagrams are counted for.
    pub mapping: MappingId,
    /// The net of the mapping.
    pub net: NetId,
    /// Index of the password in the list of the net.
    pub credential: u16,
}

/// What has passed through a flow by the faster datapath. Times are nanoseconds since the relay's start, plus
/// one; 0: never.
#[derive(Debug, Default)]
#[repr(C, align(64))]
pub struct SharedFlow {
    /// Requests. All of them want answers; others are not carried.
    pub(crate) requests: AtomicU64,
    /// Responses.
    pub(crate) responses: AtomicU64,
    /// The UDP payload of both.
    pub(crate) octets: AtomicU64,
    /// When the last of both passed.
    pub(crate) last_used: AtomicU64,
    /// When the oldest request without an answer was sent; 0: there is none. This holds for requests and
    /// answers of both datapaths.
    pub(crate) unanswered: AtomicU64,
}

impl SharedFlow {
    /// After this time, a request without an answer counts as lost.
    pub(crate) const LOST_AFTER: Nanos = LOST_AFTER;

    /// Begins anew, with a request that has no answer yet, or without.
    pub(super) fn begin(&self, unanswered: Nanos) {
        let Self { requests, responses, octets, last_used, .. } = self;
        let figures = [requests, responses, octets, last_used];
        figures.iter().for_each(|figure| figure.store(0, Relaxed));
        self.unanswered.store(unanswered, Relaxed);
    }

    pub(super) fn asked(&self, now: Nanos) {
        let unanswered = self.unanswered.load(Relaxed);
        if unanswered == 0 || now.saturating_sub(unanswered) >= LOST_AFTER {
            self.unanswered.store(now, Relaxed);
        }
    }

    pub(super) fn came(&self, now: Nanos) -> Option<Duration> {
        match self.unanswered.swap(0, Relaxed) {
            0 => None,
            asked => Some(Duration::from_nanos(now.saturating_sub(asked))),
        }
    }

    pub(crate) fn traffic(&self) -> FlowTraffic {
        let Self { requests, responses, octets, .. } = self;
        let [requests, responses, octets] =
            [requests, responses, octets].map(|figure| figure.load(Relaxed));
        FlowTraffic { requests, responses, octets }
    }

    pub(super) fn last_used(&self) -> Nanos {
        self.last_used.load(Relaxed)
    }
}

/// Who lends places in memory that a faster datapath writes to.
pub trait Lender<T>: fmt::Debug + Send + Sync {
    /// What is at a place.
    fn get(&self, place: u32) -> &T;
    /// Takes a place back.
    fn take_back(&self, place: u32);
}

/// A place that was lent. It is given back when it is dropped.
#[derive(Debug)]
pub struct Lent<T: 'static> {
    lender: Arc<dyn Lender<T>>,
    place: u32,
}

impl<T> Lent<T> {
    /// A place of this lender.
    pub fn new(lender: Arc<dyn Lender<T>>, place: u32) -> Self {
        Self { lender, place }
    }

    /// The number of the place.
    pub fn place(&self) -> u32 {
        self.place
    }
}

impl<T> Deref for Lent<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.lender.get(self.place)
    }
}

impl<T> Drop for Lent<T> {
    fn drop(&mut self) {
        self.lender.take_back(self.place);
    }
}

/// A value that many hold: memory of this program, or a place that was lent.
#[derive(Debug)]
pub enum Held<T: 'static> {
    /// Memory of this program.
    Own(Arc<T>),
    /// Memory that a faster datapath writes to.
    Lent(Arc<Lent<T>>),
}

impl<T> Held<T> {
    /// The number of the place, if it was lent.
    pub fn place(&self) -> Option<u32> {
        match self {
            Self::Own(_) => None,
            Self::Lent(lent) => Some(lent.place()),
        }
    }
}

impl<T: Default> Default for Held<T> {
    fn default() -> Self {
        Self::Own(Arc::default())
    }
}

impl<T> Clone for Held<T> {
    fn clone(&self) -> Self {
        match self {
            Self::Own(own) => Self::Own(Arc::clone(own)),
            Self::Lent(lent) => Self::Lent(Arc::clone(lent)),
        }
    }
}

impl<T> Deref for Held<T> {
    type Target = T;

    #[inline]
    fn deref(&self) -> &T {
        match self {
            Self::Own(own) => own,
            Self::Lent(lent) => lent,
        }
    }
}
