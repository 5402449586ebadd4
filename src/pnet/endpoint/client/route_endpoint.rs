//! The Route Endpoint of PAS 6.1.1.1 as a client has it: a proxy for what is in a server.

use std::time::Duration;

use super::segments::Segments;
use super::{DestinationRoute, FlatAddressing, Loss, Outcome};

/// What a Route Endpoint is for (PAS 6.1.1.1.1.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RepRole {
    /// It sends requests and receives their responses. All endpoints of a client are proxies.
    Proxy,
    /// It receives requests and sends the responses. This is what a server has.
    RealContainer,
}

/// REP State (PAS 6.1.1.1.1.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RepState {
    /// NOT IN USE: nobody has reserved it.
    NotInUse,
    /// IDLE RESERVED: it may send a request. A request that is lost leads back here.
    IdleReserved,
    /// WAITING FOR RESPONSE: its request is on the way, or about to be.
    WaitingForResponse,
    /// RESPONSE RECEIVED: there is a response to be taken.
    ResponseReceived,
}

/// Which of two requests is sent first (PAS 6.1.1.1.1.4). It does not go with the request, and says
/// nothing to the server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Priority {
    /// As soon as none of high priority is left.
    #[default]
    Normal,
    /// Before all others.
    High,
}

/// What the endpoint in the server can do (PAS 6.1.1.1.1.9). It is noted for who makes the data of the
/// requests, since the standard does not give the form of a bit address.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Capabilities {
    /// Whether a request may address a single bit.
    pub bit_addressing: bool,
}

/// The attributes that the user of an endpoint chooses (R-44, PAS 6.1.1.1).
#[derive(Clone, Debug)]
pub struct Attributes {
    /// Where its requests go.
    pub destination: DestinationRoute,
    /// Whether they go before others.
    pub priority: Priority,
    /// Whether a response is wanted. For a broadcast none is, whatever this says.
    pub confirmation: bool,
    /// What the endpoint in the server can do.
    pub capabilities: Capabilities,
    /// Flat addressing: the endpoint in the server is one memory area, read and written with these
    /// codes. `None` for a container of single objects.
    pub flat_addressing: Option<FlatAddressing>,
}

impl Attributes {
    /// Confirmed requests of normal priority to single objects.
    pub fn new(destination: DestinationRoute) -> Self {
        Self {
            destination,
            priority: Priority::default(),
            confirmation: true,
            capabilities: Capabilities::default(),
            flat_addressing: None,
        }
    }
}

/// Progress (PAS 6.1.1.1.1.8): how much of a request has been delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Segments that were answered.
    pub delivered: u32,
    /// All segments of the request, at least one.
    pub total: u32,
}

impl Progress {
    /// From 0 at the beginning to 1 when all are delivered.
    pub fn fraction(self) -> f64 {
        f64::from(self.delivered) / f64::from(self.total)
    }
}

/// A Route Endpoint that is reserved.
#[derive(Clone, Debug)]
pub struct RouteEndpoint {
    pub(super) address: u8,
    /// Whether a request has left from this address.
    pub(super) address_was_used: bool,
    pub(super) attributes: Attributes,
    pub(super) progress: Progress,
    pub(super) retries: u32,
    pub(super) work: Option<Work>,
    pub(super) outcome: Option<Outcome>,
}

/// A request that is on its way.
#[derive(Clone, Debug)]
pub(super) struct Work {
    pub(super) segments: Segments,
    /// Lower ones are older.
    pub(super) ticket: u64,
    /// Until when the client waits for a response. `None` as long as the segment is to be sent.
    pub(super) waits_until: Option<Duration>,
    /// When the first segment was sent for the first time.
    pub(super) began: Option<Duration>,
    /// When the segment was sent for the first time.
    pub(super) segment_began: Option<Duration>,
    /// How often the segment was sent.
    pub(super) tries: u32,
    /// What was seen of it on the network, for the case that it is lost.
    pub(super) noticed: Option<Loss>,
}

impl RouteEndpoint {
    pub(super) fn new(address: u8, attributes: Attributes) -> Self {
        Self {
            address,
            address_was_used: false,
            attributes,
            progress: Progress { delivered: 0, total: 1 },
            retries: 0,
            work: None,
            outcome: None,
        }
    }

    /// Endpoint Address, 1 to 125: the last source element of a request, by which its response comes
    /// back. Nothing else in a response tells which request it answers. So each request, and each
    /// segment, leaves from an address that has not been used for a while.
    pub fn address(&self) -> u8 {
        self.address
    }

    /// Role.
    pub fn role(&self) -> RepRole {
        RepRole::Proxy
    }

    /// REP State.
    pub fn state(&self) -> RepState {
        match (&self.work, &self.outcome) {
            (Some(_), _) => RepState::WaitingForResponse,
            (None, Some(Outcome::Answered(_))) => RepState::ResponseReceived,
            (None, _) => RepState::IdleReserved,
        }
    }

    /// The attributes that the user chose.
    pub fn attributes(&self) -> &Attributes {
        &self.attributes
    }

    /// Confirmation: whether a response is waited for. Never for a broadcast (PAS 6.1.1.1.1.5).
    pub fn confirmation(&self) -> bool {
        self.attributes.confirmation && !self.attributes.destination.names_broadcast()
    }

    /// Progress of the last request.
    pub fn progress(&self) -> Progress {
        self.progress
    }

    /// How often the last request was sent again, all segments together.
    pub fn retries(&self) -> u32 {
        self.retries
    }
}
