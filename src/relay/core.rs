//! The NAT router of one worker: takes a datagram, says where it goes or why it does not.
//!
//! Nothing is remembered of a sender before its password was right, and every datagram is counted
//! once as received and once as forwarded or dropped. The caller does the sending and reports it.

use std::collections::HashMap;
use std::hash::BuildHasher;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Instant;

use foldhash::fast::{FixedState, RandomState};
use slab::Slab;

use crate::wire;

use super::check::{self, Request};
use super::counters::Counters;
use super::flow::{Answers, Endpoints, Flow, FlowRecord};
use super::ids::{FlowId, ListenerId, UpstreamId};
use super::reason::{CloseReason, Direction, DropReason};
use super::rules::Rules;
use super::shell::Shell;
use super::table::MappingId;
use super::throttle::Throttle;
use super::upstream::{Owner, Upstreams};

/// The same for all workers, whose sketches are merged. A stranger who makes sources collide only
/// makes the log's estimate of their number smaller.
const SOURCE_HASH: FixedState = FixedState::with_seed(0);

/// How a request arrived.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// The socket it came to.
    pub listener: ListenerId,
    /// The element of the NAT table that the socket stands for.
    pub mapping: MappingId,
    /// The address it was sent to; the answer has to leave from there.
    pub public_address: IpAddr,
    /// Who sent it.
    pub client: SocketAddr,
}

/// Where a request goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ToServer {
    /// The socket to send on.
    pub via: UpstreamId,
    /// The server's address and port.
    pub server: SocketAddr,
}

/// Where a response goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ToClient {
    /// The socket to send on.
    pub via: ListenerId,
    /// The address to send from.
    pub public_address: IpAddr,
    /// The client's address and port.
    pub client: SocketAddr,
    /// What the datagram is counted under.
    pub mapping: MappingId,
}

/// The flows of one worker and what decides over them.
#[derive(Debug)]
pub struct Core {
    pub(super) rules: Rules,
    pub(super) counters: Arc<Counters>,
    pub(super) flows: Slab<Flow>,
    pub(super) by_endpoints: HashMap<Endpoints, FlowId, RandomState>,
    upstreams: Upstreams,
    pub(super) throttle: Throttle,
    start: Instant,
}

impl Core {
    /// A core without flows, whose `counters` are those of the rules' table. `start` is when the router started; `random` decides which open
    /// socket a new client shares.
    pub fn new(
        rules: Rules,
        counters: Arc<Counters>,
        start: Instant,
        random: fastrand::Rng,
    ) -> Self {
        let throttle = Throttle::new(&rules.limits, start);
        Self {
            rules,
            counters,
            flows: Slab::new(),
            by_endpoints: HashMap::default(),
            upstreams: Upstreams::new(random),
            throttle,
            start,
        }
    }

    /// Judges a request. When it may pass, `octets` hold what the server is to get, and the caller
    /// sends them and reports with [`sent`](Self::sent) or [`send_failed`](Self::send_failed).
    #[inline]
    pub fn request(
        &mut self,
        now: Instant,
        arrival: &Arrival,
        octets: &mut [u8],
        shell: &mut impl Shell,
    ) -> Result<ToServer, DropReason> {
        let verdict = self.judge_request(now, arrival, octets, shell);
        let node = self.counters.node(arrival.mapping).direction(Direction::Request);
        node.received.add(1);
        if let Err(reason) = verdict {
            node.dropped(reason).add(1);
            let net = self.counters.net(self.rules.table.mapping(arrival.mapping).net);
            net.sources(reason).note(SOURCE_HASH.hash_one(arrival.client.ip()));
        }
        verdict
    }

    /// Judges what came from a server to an upstream socket; otherwise as [`request`](Self::request).
    #[inline]
    pub fn response(
        &mut self,
        now: Instant,
        via: UpstreamId,
        server: SocketAddr,
        octets: &mut [u8],
    ) -> Result<ToClient, DropReason> {
        let flow = self.upstreams.flow(via, server);
        let verdict = match flow {
            Some(id) => self.judge_response(now, id, octets),
            None => Err(DropReason::UnknownFlow),
        };
        let mapping = match flow {
            Some(id) => Some(self.flows[id.key()].mapping),
            None => self.rules.table.mapping_of_server(server),
        };
        let node = mapping.map_or(&self.counters.stray, |mapping| self.counters.node(mapping));
        let node = node.direction(Direction::Response);
        node.received.add(1);
        if let Err(reason) = verdict {
            node.dropped(reason).add(1);
        }
        verdict
    }

    /// Counts a datagram that the system took.
    #[inline]
    pub fn sent(&self, mapping: MappingId, direction: Direction, octets: usize) {
        let node = self.counters.node(mapping).direction(direction);
        node.forwarded.add(1);
        node.forwarded_bytes.add(octets as u64);
    }

    /// Counts a datagram that the system refused.
    pub fn send_failed(&self, mapping: MappingId, direction: Direction) {
        self.counters.node(mapping).direction(direction).dropped(DropReason::SendFailed).add(1);
    }

    /// Closes flows that have been idle for their net's time-out, and sockets that nothing needs
    /// any more. To be called about once a second.
    pub fn expire(&mut self, now: Instant, shell: &mut impl Shell) {
        let idle = |flow: &Flow| {
            let net = self.rules.table.net(self.rules.table.mapping(flow.mapping).net);
            now.saturating_duration_since(flow.last_used) >= net.idle_timeout
        };
        let expired: Vec<_> =
            self.flows.iter().filter(|(_, flow)| idle(flow)).map(|(key, _)| key).collect();
        for key in expired {
            self.close(key, CloseReason::Idle, now, shell);
        }
        self.upstreams.expire(now, shell);
    }

    /// Closes every flow.
    pub fn shut_down(&mut self, now: Instant, shell: &mut impl Shell) {
        let open: Vec<_> = self.flows.iter().map(|(key, _)| key).collect();
        for key in open {
            self.close(key, CloseReason::Shutdown, now, shell);
        }
    }

    /// Whether a request has no answer yet that may still come.
    pub fn awaits_answers(&self, now: Instant) -> bool {
        self.flows.iter().any(|(_, flow)| flow.awaits_answers(now))
    }

    /// Whether no flow is open and no socket waits to be closed, so that nothing will expire.
    pub fn is_idle(&self) -> bool {
        self.flows.is_empty() && self.upstreams.is_empty()
    }

    /// The open flows.
    pub fn flows(&self, now: Instant) -> impl Iterator<Item = FlowRecord> {
        self.flows.iter().map(move |(_, flow)| flow.record(now))
    }

    /// Panics where the tables do not agree with each other.
    #[cfg(test)]
    pub(super) fn check_invariants(&self, now: Instant) {
        assert_eq!(self.flows.len(), self.by_endpoints.len());
        let mut by_net = vec![0; self.rules.table.nets().len()];
        for (key, flow) in &self.flows {
            let mapping = self.rules.table.mapping(flow.mapping);
            assert_eq!(self.by_endpoints[&flow.endpoints].key(), key);
            assert_eq!(
                self.upstreams.flow(flow.upstream, mapping.server).map(FlowId::key),
                Some(key),
                "an answer finds its flow"
            );
            assert!(flow.opened <= flow.last_used && flow.last_used <= now);
            by_net[usize::from(mapping.net.0)] += 1;
        }
        for (index, open) in (0..).zip(by_net) {
            assert_eq!(self.counters.net(super::NetId(index)).flows.get(), open);
        }
        self.upstreams.check_invariants(self.flows.len());
    }

    /// The checks of a request, in their order: first what costs a stranger's datagram least, then
    /// who sent it, then the password, and only then what it asks for.
    #[inline]
    fn judge_request(
        &mut self,
        now: Instant,
        arrival: &Arrival,
        octets: &mut [u8],
        shell: &mut impl Shell,
    ) -> Result<ToServer, DropReason> {
        let mapping = self.rules.table.mapping(arrival.mapping);
        let net = self.rules.table.net(mapping.net);
        let request = Request::parse(octets, self.rules.table.header, net)?;

        // An open flow is judged by its password alone, so that wrong passwords under a client's
        // address cannot lock the client out.
        let endpoints = arrival.endpoints();
        let open = self.by_endpoints.get(&endpoints).copied();
        if open.is_none() && !net.allows(arrival.client.ip()) {
            return Err(DropReason::SourceNotAllowed);
        }
        if open.is_none() && !self.throttle.admits(now, arrival.client) {
            return Err(DropReason::Throttled);
        }
        let credential = match request.password {
            None => None, // Request::parse let it pass: the net allows it (A4)
            Some(password) => {
                let credential = net.credential(&password);
                if credential.is_none() {
                    if open.is_none() {
                        self.throttle.wrong_password(now, arrival.client);
                    }
                    return Err(DropReason::PasswordWrong);
                }
                credential
            }
        };
        request.is_for(mapping.node_address)?;

        let id = match open {
            Some(id) => id,
            None => self.open(now, arrival, credential, shell)?,
        };
        let flow = &mut self.flows[id.key()];
        flow.credential = credential;
        if request.confirmed {
            flow.answers.asked(now);
        }
        flow.last_used = now;
        if let Some(index) = credential {
            let net = self.rules.table.net(mapping.net);
            self.counters.net(mapping.net).accepted[usize::from(index)].add(1);
            if let Some(device) = &net.credentials[usize::from(index)].device_password {
                wire::replace_password(octets, device);
            }
        }
        Ok(ToServer { via: flow.upstream, server: mapping.server })
    }

    /// The checks of a response, in their order.
    #[inline]
    fn judge_response(
        &mut self,
        now: Instant,
        id: FlowId,
        octets: &mut [u8],
    ) -> Result<ToClient, DropReason> {
        let password = check::response(octets, self.rules.table.header)?;
        let flow = &mut self.flows[id.key()];
        let mapping = self.rules.table.mapping(flow.mapping);
        let net = self.rules.table.net(mapping.net);
        let credential = flow.credential.map(|index| &net.credentials[usize::from(index)]);
        match (password, credential) {
            (Some(password), Some(credential)) => {
                if !bool::from(credential.at_server().matches(&password)) {
                    return Err(DropReason::PasswordMismatch); // A16
                }
                if credential.device_password.is_some() {
                    wire::replace_password(octets, &credential.password);
                }
            }
            (Some(_), None) => return Err(DropReason::PasswordMismatch),
            (None, _) if net.require_response_password => return Err(DropReason::PasswordMismatch),
            (None, _) => {}
        }
        flow.last_used = now; // N-3
        let node = self.counters.node(flow.mapping);
        node.last_response.set(since(self.start, now));
        if let Some(response_time) = flow.answers.came(now) {
            node.response_times.observe(response_time);
        }
        Ok(ToClient {
            via: flow.endpoints.listener,
            public_address: flow.endpoints.public_address,
            client: flow.endpoints.client,
            mapping: flow.mapping,
        })
    }

    fn open(
        &mut self,
        now: Instant,
        arrival: &Arrival,
        credential: Option<u16>,
        shell: &mut impl Shell,
    ) -> Result<FlowId, DropReason> {
        let mapping = self.rules.table.mapping(arrival.mapping);
        if !self.rules.budget.take(mapping.net) {
            return Err(DropReason::FlowLimit); // N-8
        }
        let place = self.flows.vacant_entry();
        let id = FlowId::new(place.key());
        let owner = Owner {
            client: arrival.client,
            public_address: arrival.public_address,
            public_port: mapping.public_port,
        };
        let assigned = self.upstreams.assign(id, owner, mapping.server, shell);
        let Some((upstream, upstream_port)) = assigned else {
            self.rules.budget.give(mapping.net);
            return Err(DropReason::UpstreamExhausted);
        };
        let flow = place.insert(Flow {
            endpoints: arrival.endpoints(),
            mapping: arrival.mapping,
            upstream,
            upstream_port,
            credential,
            opened: now,
            last_used: now,
            answers: Answers::new(now),
        });
        shell.flow_opened(&flow.record(now));
        self.by_endpoints.insert(flow.endpoints, id);
        let net = self.counters.net(mapping.net);
        net.flows.add(1);
        net.flows_opened.add(1);
        Ok(id)
    }

    pub(super) fn close(
        &mut self,
        key: usize,
        reason: CloseReason,
        now: Instant,
        shell: &mut impl Shell,
    ) {
        let flow = self.flows.remove(key);
        let mapping = self.rules.table.mapping(flow.mapping);
        self.by_endpoints.remove(&flow.endpoints);
        self.upstreams.release(flow.upstream, mapping.server, now);
        self.rules.budget.give(mapping.net);
        let net = self.counters.net(mapping.net);
        net.flows.sub(1);
        net.flows_closed(reason).add(1);
        shell.flow_closed(&flow.record(now), reason);
    }
}

impl Arrival {
    fn endpoints(&self) -> Endpoints {
        Endpoints {
            client: self.client,
            public_address: self.public_address,
            listener: self.listener,
        }
    }
}

/// Nanoseconds from the router's start, at least 1: 0 stands for never.
fn since(start: Instant, now: Instant) -> u64 {
    let nanos = now.saturating_duration_since(start).as_nanos();
    u64::try_from(nanos).unwrap_or(u64::MAX).max(1)
}
