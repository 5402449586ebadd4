//! A flow: one client endpoint that talks to one server node.

use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};

use super::ids::{ListenerId, UpstreamId};
use super::table::MappingId;

/// What a flow is found by when a request comes: the client's endpoint and the router's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Endpoints {
    pub client: SocketAddr,
    pub public_address: IpAddr,
    pub listener: ListenerId,
}

/// The state of a flow.
#[derive(Debug)]
pub(super) struct Flow {
    pub endpoints: Endpoints,
    pub mapping: MappingId,
    pub upstream: UpstreamId,
    pub upstream_port: u16,
    /// The credential of the latest request: its answer carries the same password.
    pub credential: Option<u16>,
    pub opened: Instant,
    /// The last datagram of either direction (RFC 4787 REQ-6).
    pub last_used: Instant,
    /// The oldest request that has no answer yet.
    pub unanswered: Option<Instant>,
    /// Answers that may still come, to requests since `due_since`. One that was lost looks like one
    /// that is late, so this is an upper bound.
    pub due: u32,
    pub due_since: Instant,
}

/// What logs and the API tell of a flow.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlowRecord {
    /// The client's address and port.
    pub client: SocketAddr,
    /// The public address that the client sends to.
    pub public_address: IpAddr,
    /// The public port and the server behind it.
    pub mapping: MappingId,
    /// Index of the credential of the latest request in its net's list; none without a password.
    pub credential: Option<usize>,
    /// The router's own port towards the server.
    pub upstream_port: u16,
    /// How long it has been open.
    pub age: Duration,
    /// How long nothing has passed.
    pub idle: Duration,
}

impl Flow {
    pub(super) fn record(&self, now: Instant) -> FlowRecord {
        FlowRecord {
            client: self.endpoints.client,
            public_address: self.endpoints.public_address,
            mapping: self.mapping,
            credential: self.credential.map(usize::from),
            upstream_port: self.upstream_port,
            age: now.saturating_duration_since(self.opened),
            idle: now.saturating_duration_since(self.last_used),
        }
    }
}
