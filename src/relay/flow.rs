//! A flow: one client endpoint that talks to one server node.

use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use super::ids::{ListenerId, UpstreamId};
use super::table::MappingId;

/// A request that waited unanswered for longer is taken as lost: its answer is not due any more, and
/// the response time of the next one counts from the request after it.
const LOST_AFTER: Nanos = 10_000_000_000;

/// Nanoseconds since the router's start, and one more: 0 stands for never. Half the room of an
/// `Instant`, and quicker to compare.
pub(super) type Nanos = u64;

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
    pub opened: Nanos,
    /// The last datagram of either direction (RFC 4787 REQ-6).
    pub last_used: Nanos,
    pub answers: Answers,
    /// Until when its requests are paid for, where they are limited.
    pub paid_until: Nanos,
}

/// The answers that a flow waits for.
#[derive(Debug, Default)]
pub(super) struct Answers {
    /// When the oldest request went out that has none yet; 0: there is none.
    unanswered: Nanos,
    /// How many may still come, to requests since `due_since`. One that was lost looks like one
    /// that is late, so this is an upper bound.
    due: u32,
    due_since: Nanos,
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

impl Answers {
    /// A request went out that wants an answer.
    pub(super) fn asked(&mut self, now: Nanos) {
        if self.due == 0 || now - self.due_since >= LOST_AFTER {
            (self.due, self.due_since) = (0, now);
        }
        self.due = self.due.saturating_add(1);
        if self.unanswered == 0 || now - self.unanswered >= LOST_AFTER {
            self.unanswered = now;
        }
    }

    /// An answer came; returns how long the oldest request without one has waited.
    pub(super) fn came(&mut self, now: Nanos) -> Option<Duration> {
        self.due = self.due.saturating_sub(1);
        match std::mem::take(&mut self.unanswered) {
            0 => None,
            asked => Some(Duration::from_nanos(now - asked)),
        }
    }
}

impl Flow {
    /// Whether an answer may still come.
    pub(super) fn awaits_answers(&self, now: Nanos) -> bool {
        self.answers.due > 0 && now - self.last_used < LOST_AFTER
    }

    pub(super) fn record(&self, now: Nanos) -> FlowRecord {
        FlowRecord {
            client: self.endpoints.client,
            public_address: self.endpoints.public_address,
            mapping: self.mapping,
            credential: self.credential.map(usize::from),
            upstream_port: self.upstream_port,
            age: Duration::from_nanos(now - self.opened),
            idle: Duration::from_nanos(now - self.last_used),
        }
    }
}
