//! A flow: one client endpoint that talks to one server node.

use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use super::ids::{ListenerId, MappingId, UpstreamId};
use super::time::Nanos;

/// A request that waited unanswered for longer is taken as lost: its answer is not due any more, and
/// the response time of the next one counts from the request after it.
const LOST_AFTER: Nanos = 10_000_000_000;

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
    /// As long as it lives, whatever its mapping is called.
    pub server: SocketAddr,
    /// Under the rules of its era, as the credential.
    pub mapping: MappingId,
    pub upstream: UpstreamId,
    pub upstream_port: u16,
    /// The credential of the latest request: its answer carries the same password.
    pub credential: Option<u16>,
    /// Those of earlier requests, the latest first. Hardly ever there is one.
    pub earlier_credentials: Box<[u16]>,
    /// When the client was last noted as one that is known; 0: never.
    pub noted: Nanos,
    pub opened: Nanos,
    /// The last datagram of either direction (RFC 4787 REQ-6).
    pub last_used: Nanos,
    pub answers: Answers,
    /// The number of the reload whose rules it stands under.
    pub era: u32,
    /// Until when its requests are paid for, where they are limited.
    pub paid_until: Nanos,
    /// When it was closed for its client, of whom it takes no requests any more: the port of its
    /// socket was wanted. The last answers still come through it. 0: never.
    pub left: Nanos,
}

/// The answers that a flow waits for.
///
/// An answer does not tell which request it belongs to, and one that was lost looks like one that is
/// late. So an answer is taken for that to an old request as long as there is one, and the count of
/// those that are due is never too low.
#[derive(Debug, Default)]
pub(super) struct Answers {
    /// When the oldest request went out that has none yet; 0: there is none.
    unanswered: Nanos,
    /// Due to requests of the `LOST_AFTER` that began then.
    newer: u32,
    newer_since: Nanos,
    /// Due to requests of the `LOST_AFTER` before.
    older: u32,
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
        let age = now - self.newer_since;
        if age >= 2 * LOST_AFTER {
            (self.older, self.newer, self.newer_since) = (0, 0, now);
        } else if age >= LOST_AFTER {
            self.older = std::mem::take(&mut self.newer);
            self.newer_since += LOST_AFTER;
        }
        self.newer = self.newer.saturating_add(1);
        if self.unanswered == 0 || now - self.unanswered >= LOST_AFTER {
            self.unanswered = now;
        }
    }

    /// An answer came; returns how long the oldest request without one has waited.
    pub(super) fn came(&mut self, now: Nanos) -> Option<Duration> {
        match self.older {
            0 => self.newer = self.newer.saturating_sub(1),
            _ => self.older -= 1,
        }
        match std::mem::take(&mut self.unanswered) {
            0 => None,
            asked => Some(Duration::from_nanos(now - asked)),
        }
    }

    /// How many may still come, at least.
    fn due(&self) -> u64 {
        u64::from(self.older) + u64::from(self.newer)
    }
}

impl Flow {
    /// Notes the credential of a request. Answers to earlier ones, under others, may still come.
    #[inline]
    pub(super) fn asked_with(&mut self, credential: Option<u16>) {
        if self.credential != credential {
            self.change_credential(credential);
        }
    }

    #[cold]
    fn change_credential(&mut self, credential: Option<u16>) {
        let Some(before) = std::mem::replace(&mut self.credential, credential) else { return };
        let earlier = &mut self.earlier_credentials;
        let place = |&other: &u16| other == before || Some(other) == credential;
        match earlier.iter().position(place) {
            Some(place) => {
                earlier[..=place].rotate_right(1);
                earlier[0] = before;
            }
            None => *earlier = [&[before], &**earlier].concat().into(),
        }
    }

    /// The credentials that an answer may carry, that of the latest request first.
    #[inline]
    pub(super) fn credentials(&self) -> impl Iterator<Item = u16> {
        self.credential.into_iter().chain(self.earlier_credentials.iter().copied())
    }

    /// Whether an answer may still come.
    pub(super) fn awaits_answers(&self, now: Nanos) -> bool {
        self.answers.due() > 0 && now - self.last_used < LOST_AFTER
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SECOND: Nanos = 1_000_000_000;

    #[derive(Clone, Copy, Debug)]
    enum Event {
        Asked,
        /// The answer to one of the requests under way.
        Came(prop::sample::Index),
    }

    fn events() -> impl Strategy<Value = Vec<(Nanos, Event)>> {
        let event = prop_oneof![
            3 => Just(Event::Asked),
            2 => any::<prop::sample::Index>().prop_map(Event::Came),
        ];
        // Close together, around the limit, and far apart.
        let pause =
            prop_oneof![0..SECOND, 4 * SECOND..6 * SECOND, 9 * SECOND..11 * SECOND, 0..40 * SECOND];
        prop::collection::vec((pause, event), 0..60)
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..Default::default() })]
        #[test]
        fn requests_under_way_are_never_counted_too_low(events in events()) {
            let mut answers = Answers::default();
            let mut under_way: Vec<Nanos> = Vec::new();
            let mut asked: Vec<Nanos> = Vec::new();
            let mut now = 1;
            for (pause, event) in events {
                now += pause;
                under_way.retain(|&at| now - at < LOST_AFTER);
                match event {
                    Event::Asked => {
                        answers.asked(now);
                        under_way.push(now);
                        asked.push(now);
                    }
                    Event::Came(_) if under_way.is_empty() => {}
                    Event::Came(index) => {
                        under_way.remove(index.index(under_way.len()));
                        answers.came(now);
                    }
                }
                prop_assert!(answers.due() >= under_way.len() as u64, "{answers:?} {under_way:?}");
                let newest = asked.iter().filter(|&&at| now - at < 3 * LOST_AFTER).count();
                let idle = asked.last().is_none_or(|&at| now - at >= LOST_AFTER);
                prop_assert!(idle || answers.due() <= newest as u64, "bounded");
            }
        }
    }

    #[test]
    fn an_answer_is_that_to_an_old_request_as_long_as_there_is_one() {
        let mut answers = Answers::default();
        for asked in [1, 10 * SECOND - 10_000_000, 10 * SECOND + 1] {
            answers.asked(asked);
        }
        answers.came(10 * SECOND + 10_000_000);
        assert!(answers.due() >= 1, "{answers:?}: two were asked within the last second");
    }
}
