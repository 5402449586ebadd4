//! A flow: one client's address and port in exchange with one server node.

use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use super::ids::{ListenerId, MappingId, UpstreamId};
use super::offload::{Lent, SharedFlow};
use super::protocol::Conversation;
use super::time::Nanos;

/// A request without an answer for longer than this counts as lost. Its answer is not due any more,
/// and the next response time is measured from a later request.
pub(super) const LOST_AFTER: Nanos = 10_000_000_000;

/// What a request finds its flow by: the client's address and port, and the router's.
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
    /// Who answers: see [`Table::answers_from`](super::table::Table::answers_from). It stays the same
    /// as long as the flow is open; the index of its mapping may change.
    pub server: SocketAddr,
    /// In the table of its era, as the credentials are.
    pub mapping: MappingId,
    pub upstream: UpstreamId,
    pub upstream_port: u16,
    /// The credential of the latest request: its answer carries the same password.
    pub credential: Option<u16>,
    /// Those of earlier requests, the latest first. Nearly always empty.
    pub earlier_credentials: Box<[u16]>,
    /// When the client was last noted as a known one; 0: never.
    pub noted: Nanos,
    pub opened: Nanos,
    /// When the last datagram passed, in either direction, without those of a faster datapath; see
    /// [`last_used`](Self::last_used).
    pub used: Nanos,
    pub answers: Answers,
    /// Without what a faster datapath has carried.
    pub traffic: FlowTraffic,
    pub offload: Offload,
    /// What its protocol has to remember of it.
    pub conversation: Conversation,
    /// The number of the reload whose rules it stands under.
    pub era: u32,
    /// The bucket of its requests, if the net limits them for each flow.
    pub paid_until: Nanos,
    /// When it was closed for requests because the port of its socket is wanted; 0: never. Answers
    /// to earlier requests still pass.
    pub left: Nanos,
}

/// Whether a faster datapath carries a flow too.
#[derive(Debug)]
pub(super) enum Offload {
    /// It may be offered.
    Open,
    /// It stays here until the next reload.
    Declined,
    Carried(Lent<SharedFlow>),
}

/// The answers that a flow waits for.
///
/// An answer does not say which request it belongs to, and a lost answer looks like a late one. So
/// an answer is counted for an old request as long as there is one. Then the number of answers that
/// are due is never too low.
#[derive(Debug, Default)]
pub(super) struct Answers {
    /// When the oldest request without an answer was sent; 0: there is none. While a faster datapath
    /// carries the flow, this stands in [`SharedFlow::unanswered`].
    unanswered: Nanos,
    /// Requests that want an answer.
    asked: u64,
    /// Answers, and requests that are given up.
    answered: u64,
    /// The number of requests before the time `noted`, which is at least `LOST_AFTER` after the time
    /// when the number before it was noted.
    asked_before: u64,
    noted: Nanos,
}

/// What has passed through a flow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FlowTraffic {
    /// Requests that were accepted.
    pub requests: u64,
    /// Datagrams of the server that were passed on.
    pub responses: u64,
    /// The UDP payload of both, as the client sends and gets it.
    pub octets: u64,
}

/// What logs and the API show of a flow.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlowRecord {
    /// The client's address and port.
    pub client: SocketAddr,
    /// The address of the router that the client sends to.
    pub public_address: IpAddr,
    /// Its public port and the server behind it.
    pub mapping: MappingId,
    /// Index, in the net's list, of the latest request's credential; none without a password.
    pub credential: Option<usize>,
    /// The router's port towards the server.
    pub upstream_port: u16,
    /// How long it has been open.
    pub age: Duration,
    /// How long ago the last datagram passed.
    pub idle: Duration,
    /// What has passed through it.
    pub traffic: FlowTraffic,
}

impl FlowTraffic {
    #[inline]
    pub(super) fn request(&mut self, octets: usize) {
        self.requests += 1;
        self.octets += octets as u64;
    }

    #[inline]
    pub(super) fn response(&mut self, octets: usize) {
        self.responses += 1;
        self.octets += octets as u64;
    }

    fn add(&mut self, other: Self) {
        self.requests += other.requests;
        self.responses += other.responses;
        self.octets += other.octets;
    }
}

impl Offload {
    /// What a faster datapath has carried.
    #[inline]
    pub(super) fn shared(&self) -> Option<&SharedFlow> {
        match self {
            Self::Open | Self::Declined => None,
            Self::Carried(shared) => Some(shared),
        }
    }
}

/// What a faster datapath has carried, if there is one.
fn carried(shared: Option<&SharedFlow>) -> FlowTraffic {
    shared.map(SharedFlow::traffic).unwrap_or_default()
}

impl Answers {
    /// Notes a request that wants an answer. `shared` is what a faster datapath has carried.
    pub(super) fn asked(&mut self, now: Nanos, shared: Option<&SharedFlow>) {
        let age = now.saturating_sub(self.noted);
        if age >= LOST_AFTER {
            let FlowTraffic { requests, responses, .. } = carried(shared);
            let so_far = self.asked + requests;
            let before = if age >= 2 * LOST_AFTER { so_far } else { self.asked_before };
            self.answered += before.saturating_sub(self.answered + responses);
            (self.asked_before, self.noted) = (so_far, now);
        }
        self.asked += 1;
        match shared {
            Some(shared) => shared.asked(now),
            None if self.unanswered == 0 || now - self.unanswered >= LOST_AFTER => {
                self.unanswered = now;
            }
            None => {}
        }
    }

    /// Notes an answer. Returns how long the oldest request without one has waited for it.
    pub(super) fn came(&mut self, now: Nanos, shared: Option<&SharedFlow>) -> Option<Duration> {
        self.answered += u64::from(self.due(shared) > 0);
        if let Some(shared) = shared {
            return shared.came(now);
        }
        match std::mem::take(&mut self.unanswered) {
            0 => None,
            asked => Some(Duration::from_nanos(now - asked)),
        }
    }

    /// How many answers may still come, or more.
    fn due(&self, shared: Option<&SharedFlow>) -> u64 {
        let FlowTraffic { requests, responses, .. } = carried(shared);
        (self.asked + requests).saturating_sub(self.answered + responses)
    }
}

impl Flow {
    /// Notes the credential of a request. Answers to earlier requests may still come with others.
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

    /// The credentials that an answer may have, that of the latest request first.
    #[inline]
    pub(super) fn credentials(&self) -> impl Iterator<Item = u16> {
        self.credential.into_iter().chain(self.earlier_credentials.iter().copied())
    }

    /// Whether an answer may still come.
    pub(super) fn awaits_answers(&self, now: Nanos) -> bool {
        let idle = now.saturating_sub(self.last_used());
        self.answers.due(self.offload.shared()) > 0 && idle < LOST_AFTER
    }

    /// When the last datagram passed, in either direction (RFC 4787 REQ-6).
    #[inline]
    pub(super) fn last_used(&self) -> Nanos {
        self.used.max(self.offload.shared().map_or(0, SharedFlow::last_used))
    }

    /// Notes a request that wants an answer.
    #[inline]
    pub(super) fn note_request(&mut self, now: Nanos) {
        self.answers.asked(now, self.offload.shared());
    }

    /// Notes an answer. Returns how long the oldest request without one has waited for it.
    #[inline]
    pub(super) fn note_answer(&mut self, now: Nanos) -> Option<Duration> {
        self.answers.came(now, self.offload.shared())
    }

    /// From now on a faster datapath carries the flow, too.
    pub(super) fn carried_by(&mut self, shared: Lent<SharedFlow>) {
        shared.begin(std::mem::take(&mut self.answers.unanswered));
        self.offload = Offload::Carried(shared);
    }

    /// From now on it does not any more. Takes over what it has counted.
    pub(super) fn carried_no_more(&mut self) {
        self.used = self.last_used();
        let before = std::mem::replace(&mut self.offload, Offload::Open);
        let Some(shared) = before.shared() else { return };
        let passed = shared.traffic();
        self.traffic.add(passed);
        self.answers.asked += passed.requests;
        self.answers.answered += passed.responses;
        self.answers.unanswered = shared.unanswered.load(Relaxed);
    }

    fn traffic(&self) -> FlowTraffic {
        let mut traffic = self.traffic;
        traffic.add(carried(self.offload.shared()));
        traffic
    }

    pub(super) fn record(&self, now: Nanos) -> FlowRecord {
        FlowRecord {
            client: self.endpoints.client,
            public_address: self.endpoints.public_address,
            mapping: self.mapping,
            credential: self.credential.map(usize::from),
            upstream_port: self.upstream_port,
            age: Duration::from_nanos(now - self.opened),
            idle: Duration::from_nanos(now.saturating_sub(self.last_used())),
            traffic: self.traffic(),
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
                        answers.asked(now, None);
                        under_way.push(now);
                        asked.push(now);
                    }
                    Event::Came(_) if under_way.is_empty() => {}
                    Event::Came(index) => {
                        under_way.remove(index.index(under_way.len()));
                        answers.came(now, None);
                    }
                }
                prop_assert!(answers.due(None) >= under_way.len() as u64, "{answers:?} {under_way:?}");
                let newest = asked.iter().filter(|&&at| now - at < 4 * LOST_AFTER).count();
                let idle = asked.last().is_none_or(|&at| now - at >= LOST_AFTER);
                prop_assert!(idle || answers.due(None) <= newest as u64, "bounded");
            }
        }
    }

    #[test]
    fn an_answer_is_that_to_an_old_request_as_long_as_there_is_one() {
        let mut answers = Answers::default();
        for asked in [1, 10 * SECOND - 10_000_000, 10 * SECOND + 1] {
            answers.asked(asked, None);
        }
        answers.came(10 * SECOND + 10_000_000, None);
        assert!(answers.due(None) >= 1, "{answers:?}: two were asked within the last second");
    }
}
