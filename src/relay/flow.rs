//! A flow: one client endpoint that talks to one server node.

use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};

use super::ids::{ListenerId, UpstreamId};
use super::table::MappingId;

/// A request that waited unanswered for longer is taken as lost: its answer is not due any more, and
/// the response time of the next one counts from the request after it.
const LOST_AFTER: Duration = Duration::from_secs(10);

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
    pub answers: Answers,
}

/// The answers that a flow waits for.
#[derive(Debug)]
pub(super) struct Answers {
    /// The oldest request that has none yet.
    unanswered: Option<Instant>,
    /// How many may still come, to requests since `due_since`. One that was lost looks like one
    /// that is late, so this is an upper bound.
    due: u32,
    due_since: Instant,
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
    pub(super) fn new(now: Instant) -> Self {
        Self { unanswered: None, due: 0, due_since: now }
    }

    /// A request went out that wants an answer.
    pub(super) fn asked(&mut self, now: Instant) {
        if self.due == 0 || now - self.due_since >= LOST_AFTER {
            (self.due, self.due_since) = (0, now);
        }
        self.due = self.due.saturating_add(1);
        self.unanswered = self.unanswered.filter(|&since| now - since < LOST_AFTER).or(Some(now));
    }

    /// An answer came; returns how long the oldest request without one has waited.
    pub(super) fn came(&mut self, now: Instant) -> Option<Duration> {
        self.due = self.due.saturating_sub(1);
        self.unanswered.take().map(|asked| now.saturating_duration_since(asked))
    }
}

impl Flow {
    /// Whether an answer may still come.
    pub(super) fn awaits_answers(&self, now: Instant) -> bool {
        let silence = now.saturating_duration_since(self.last_used);
        self.answers.due > 0 && silence < LOST_AFTER
    }

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
