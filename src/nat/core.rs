//! The NAT router of one worker: takes a datagram, says where it goes or why it does not.
//!
//! Nothing is remembered of a sender before its password was right, and every datagram is counted
//! once as received and once as forwarded or dropped. The caller does the sending and reports it.

use std::collections::BTreeSet;
use std::hash::BuildHasher;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Instant;

use foldhash::fast::FixedState;

use super::chance::Chance;
use super::counters::Counters;
use super::effects::Effects;
use super::flow::{Answers, Endpoints, Flow, FlowRecord};
use super::flow_table::Flows;
use super::idle_wheel::Wheel;
use super::ids::{FlowId, ListenerId, MappingId, UpstreamId};
use super::protocol::{self, Request};
use super::reason::{CloseReason, Direction, DropReason};
use super::reload::GoingOver;
use super::rules::Rules;
use super::table::Table;
use super::throttle::Throttle;
use super::time::Nanos;
use super::upstream_ports::{Owner, Upstreams};

/// The same for all workers, whose sketches are merged. A stranger who makes sources collide only
/// makes the log's estimate of their number smaller.
const SOURCE_HASH: FixedState = FixedState::with_seed(0);

/// Flows that are looked at in one go, where there is something to do about all of them: datagrams
/// have their turns in between. So few in tests that a handful of flows takes several.
pub(super) const AT_ONCE: usize = if cfg!(test) { 2 } else { 256 };

/// How long answers are waited for on a socket whose port is wanted for something else.
const LAST_ANSWERS: Nanos = 2_000_000_000;

/// How often a client with an open flow is noted as known: often enough not to be forgotten.
const NOTED_AGAIN: Nanos = 3_600_000_000_000;

/// How a request arrived.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// The socket it came to.
    pub listener: ListenerId,
    /// The element of the NAT table that the socket stands for.
    pub mapping: MappingId,
    /// The address of this host that it was sent to; the answer has to leave from there. An
    /// unspecified one when it was sent to a broadcast or multicast address.
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
    /// Whose answer is due once it is sent; none when it wants no answer.
    pub asks: Option<FlowId>,
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
    pub(super) flows: Flows,
    /// When each flow may be idle.
    pub(super) wheel: Wheel,
    /// The number of the last reload.
    pub(super) era: u32,
    pub(super) going_over: Option<GoingOver>,
    pub(super) upstreams: Upstreams,
    /// Flows that take last answers over sockets that are about to be closed, and some that are gone.
    pub(super) leaving: Vec<FlowId>,
    pub(super) throttle: Throttle,
    start: Instant,
}

impl Core {
    /// A core without flows, whose `counters` are those of the rules' table. `start` is when the
    /// router started.
    pub fn new(rules: Rules, counters: Arc<Counters>, start: Instant, chance: Chance) -> Self {
        let Chance { hash, choice } = chance;
        let throttle = Throttle::new(&rules.limits, hash.clone());
        let capacity = rules.most_flows();
        Self {
            rules,
            counters,
            flows: Flows::new(hash.clone(), capacity),
            wheel: Wheel::new(capacity),
            era: 0,
            going_over: None,
            upstreams: Upstreams::new(hash, choice, capacity),
            leaving: Vec::new(),
            throttle,
            start,
        }
    }

    /// Judges a request. When it may pass, `octets` hold what the server is to get, and the caller
    /// sends them and reports with [`request_sent`](Self::request_sent) or
    /// [`send_failed`](Self::send_failed), before a flow can be closed.
    #[inline]
    pub fn request(
        &mut self,
        now: Instant,
        arrival: &Arrival,
        octets: &mut [u8],
        effects: &mut impl Effects,
    ) -> Result<ToServer, DropReason> {
        let now = self.nanos(now);
        let verdict = self.judge_request(now, arrival, octets, effects);
        let node = self.counters.node(arrival.mapping).direction(Direction::Request);
        node.received.add(1);
        if let Err(reason) = verdict {
            node.dropped(reason).add(1);
            self.note_source(reason, now, arrival.mapping, arrival.client.ip());
        }
        verdict
    }

    /// Judges what came from a server to an upstream socket, which the caller sends and reports with
    /// [`response_sent`](Self::response_sent); otherwise as [`request`](Self::request).
    #[inline]
    pub fn response(
        &mut self,
        now: Instant,
        via: UpstreamId,
        server: SocketAddr,
        octets: &mut [u8],
    ) -> Result<ToClient, DropReason> {
        // One that has to go is closed in its turn; nothing comes through it until then.
        let flow = self.flows.of_response(via, server).filter(|&id| self.take_along(id).is_ok());
        let verdict = match flow {
            Some(id) => self.judge_response(self.nanos(now), id, octets),
            None => Err(DropReason::UnknownFlow),
        };
        let mapping = match flow {
            Some(id) => Some(self.flows.get(id).mapping),
            None => self.rules.table.mapping_of_server(server),
        };
        let node = mapping.map_or(&*self.counters.stray, |mapping| self.counters.node(mapping));
        let node = node.direction(Direction::Response);
        node.received.add(1);
        if let Err(reason) = verdict {
            node.dropped(reason).add(1);
            if let Some(mapping) = mapping {
                self.note_source(reason, self.nanos(now), mapping, server.ip());
            }
        }
        verdict
    }

    #[inline]
    fn note_source(&self, reason: DropReason, now: Nanos, mapping: MappingId, sender: IpAddr) {
        let net = self.counters.net(self.rules.table.mapping(mapping).net);
        net.note_source(reason, now, sender, SOURCE_HASH.hash_one(sender));
    }

    /// Counts a request that the system took. What it `asks` is due from here on: a node is silent
    /// when it was asked and did not answer. To be called before anything else is judged.
    #[inline]
    pub fn request_sent(
        &mut self,
        now: Instant,
        mapping: MappingId,
        asks: Option<FlowId>,
        octets: usize,
    ) {
        let now = self.nanos(now);
        let node = self.counters.node(mapping);
        node.direction(Direction::Request).forwarded(octets);
        if let Some(id) = asks {
            node.asked(now);
            if let Some(flow) = self.flows.find_mut(id) {
                flow.answers.asked(now);
            }
        }
    }

    /// Counts a response that the system took.
    #[inline]
    pub fn response_sent(&self, mapping: MappingId, octets: usize) {
        self.counters.node(mapping).direction(Direction::Response).forwarded(octets);
    }

    /// Counts a datagram that the system refused.
    pub fn send_failed(&self, mapping: MappingId, direction: Direction) {
        self.counters.node(mapping).direction(direction).dropped(DropReason::SendFailed).add(1);
    }

    /// Closes flows that have been idle for their net's time-out, and sockets that nothing needs
    /// any more, and tells whose throttling is over. To be called about once a second; it does some
    /// of what there is to do, and tells whether it is to be called again at once.
    pub fn expire(&mut self, now: Instant, effects: &mut impl Effects) -> bool {
        self.close_left(now, effects);
        let now = self.nanos(now);
        if self.upstreams.expire(now, effects) {
            return true;
        }
        for _ in 0..AT_ONCE {
            let Some(id) = self.wheel.next(now) else {
                self.throttle.expire(now, effects);
                return false;
            };
            if self.settle(id, now, effects) {
                match self.idle_at(id) {
                    at if at <= now => self.close(id, CloseReason::Idle, now, effects),
                    at => self.wheel.put_back(id, at),
                }
            }
        }
        true
    }

    /// When a flow will have been idle for too long.
    pub(super) fn idle_at(&self, id: FlowId) -> Nanos {
        let (flow, table) = (self.flows.get(id), &self.rules.table);
        let time_out = table.net(table.mapping(flow.mapping).net).idle_timeout.as_nanos();
        flow.last_used.saturating_add(Nanos::try_from(time_out).unwrap_or(Nanos::MAX))
    }

    /// Closes every flow.
    pub fn shut_down(&mut self, now: Instant, effects: &mut impl Effects) {
        let now = self.nanos(now);
        let ids: Vec<_> = self.flows.iter().map(|(id, _)| id).collect();
        for id in ids {
            if self.settle(id, now, effects) {
                self.close(id, CloseReason::Shutdown, now, effects);
            }
        }
    }

    /// Whether a request has no answer yet that may still come.
    pub fn awaits_answers(&self, now: Instant) -> bool {
        let now = self.nanos(now);
        let awaits = |flow: &Flow| flow.awaits_answers(now) && self.place(flow).is_some();
        self.flows.iter().any(|(_, flow)| awaits(flow))
    }

    /// Whether no flow is open, no socket waits to be closed and nobody is throttled, so that nothing
    /// will expire.
    pub fn is_idle(&self) -> bool {
        self.flows.len() == 0 && self.upstreams.is_empty() && self.throttle.is_quiet()
    }

    /// The table in force.
    pub fn table(&self) -> &Arc<Table> {
        &self.rules.table
    }

    /// The open flows.
    pub fn flows(&self, now: Instant) -> impl Iterator<Item = FlowRecord> {
        let now = self.nanos(now);
        self.flows.iter().filter_map(move |(_, flow)| self.record(flow, now))
    }

    /// Whether answers of this server may go to this client.
    #[cfg(test)]
    pub(super) fn takes_answers(&self, client: SocketAddr, server: SocketAddr) -> bool {
        let is_its = |flow: &Flow| flow.endpoints.client == client && self.place(flow).is_some();
        self.flows.iter().any(|(_, flow)| flow.server == server && is_its(flow))
    }

    /// Panics where the tables do not agree with each other.
    #[cfg(test)]
    pub(super) fn check_invariants(&self, now: Instant) {
        let now = self.nanos(now);
        let mut by_net = std::collections::BTreeMap::<&str, u64>::new();
        for (id, flow) in self.flows.iter() {
            let table = &self.rules_of(flow).0.table;
            let mapping = table.mapping(flow.mapping);
            assert_eq!(flow.server, mapping.server);
            let found = self.flows.of_request(&flow.endpoints);
            assert_eq!(found == Some(id), flow.left == 0, "a request finds its flow");
            let found = self.flows.of_response(flow.upstream, flow.server);
            assert_eq!(found, Some(id), "an answer finds its flow");
            assert!(flow.opened <= flow.last_used && flow.last_used <= now);
            *by_net.entry(&table.net(mapping.net).name).or_default() += u64::from(flow.left == 0);
        }
        let table = &self.rules.table;
        for (net, id) in table.nets().iter().zip(table.net_ids()) {
            let open = by_net.get(&*net.name).copied().unwrap_or_default();
            assert_eq!(self.counters.net(id).flows.get(), open);
        }
        self.upstreams.check_invariants(self.flows.len());
    }

    /// A time as flows keep it.
    #[inline]
    pub(super) fn nanos(&self, now: Instant) -> Nanos {
        let nanos = now.saturating_duration_since(self.start).as_nanos();
        u64::try_from(nanos).unwrap_or(u64::MAX).saturating_add(1)
    }

    /// The checks of a request, in their order: first what costs a stranger's datagram least, then
    /// who sent it, then the password, and only then what it asks for.
    #[inline]
    fn judge_request(
        &mut self,
        now: Nanos,
        arrival: &Arrival,
        octets: &mut [u8],
        effects: &mut impl Effects,
    ) -> Result<ToServer, DropReason> {
        if arrival.public_address.is_unspecified() {
            return Err(DropReason::NotUnicast); // or each that has it would carry it out
        }
        let mapping = self.rules.table.mapping(arrival.mapping);
        let net = self.rules.table.net(mapping.net);
        let request = Request::parse(octets, self.rules.table.header, net)?;

        // An open flow is judged by its password alone, so that wrong passwords under a client's
        // address cannot lock the client out.
        let endpoints = arrival.endpoints();
        let open = self.flows.of_request(&endpoints);
        let open = open.filter(|&id| self.settle(id, now, effects));
        let net = self.rules.table.net(mapping.net);
        if open.is_none() && arrival.is_loop(effects) {
            return Err(DropReason::Loop);
        }
        if open.is_none() && arrival.is_unanswerable() {
            return Err(DropReason::Unanswerable);
        }
        if open.is_none() && !self.rules.table.allows(mapping.net, arrival.client.ip()) {
            return Err(DropReason::SourceNotAllowed);
        }
        // Nor can they keep a client that was right of late from opening another flow.
        let known = || self.rules.known.includes(mapping.net, arrival.client.ip(), now);
        let (client, throttle) = (arrival.client, &mut self.throttle);
        if open.is_none() && !throttle.admits(now, client, arrival.mapping, known, effects) {
            return Err(DropReason::Throttled);
        }
        let credential = match request.password {
            None => None, // Request::parse let it pass: the net allows it (A4)
            Some(password) => {
                let credential = net.credential(&password);
                if credential.is_none() {
                    if open.is_none() {
                        self.throttle.wrong_password(now, arrival.client, effects);
                    }
                    return Err(DropReason::PasswordWrong);
                }
                credential
            }
        };
        request.is_for(mapping.node_address)?;
        if open.is_none() && arrival.comes_back(effects) {
            return Err(DropReason::Loop);
        }

        // Only now, so that a stranger uses nothing up; and a flow before its net, so that one that
        // asks too much uses nothing up of the others'.
        let paid_until = match net.max_flow_requests {
            None => 0,
            Some(rate) => {
                let paid_until = open.map_or(0, |id| self.flows.get(id).paid_until);
                rate.take(paid_until, now).ok_or(DropReason::RequestLimit)?
            }
        };
        if !self.rules.budget.take_request(mapping.net, now) {
            return Err(DropReason::RequestLimit);
        }
        let id = match open {
            Some(id) => id,
            None => self.open(now, arrival, credential, effects)?,
        };
        let flow = self.flows.get_mut(id);
        flow.paid_until = paid_until;
        flow.asked_with(credential);
        if credential.is_some() && (flow.noted == 0 || now - flow.noted >= NOTED_AGAIN) {
            flow.noted = now;
            self.rules.known.note(mapping.net, arrival.client.ip(), now);
        }
        flow.last_used = now;
        if let Some(index) = credential {
            let net = self.rules.table.net(mapping.net);
            self.counters.accepted(mapping.net)[usize::from(index)].add(1);
            if let Some(device) = &net.credentials[usize::from(index)].device_password {
                protocol::replace_password(octets, device);
            }
        }
        let asks = request.confirmed.then_some(id);
        Ok(ToServer { via: flow.upstream, server: mapping.server, asks })
    }

    /// The checks of a response, in their order.
    #[inline]
    fn judge_response(
        &mut self,
        now: Nanos,
        id: FlowId,
        octets: &mut [u8],
    ) -> Result<ToClient, DropReason> {
        let password = protocol::response(octets, self.rules.table.header)?;
        let flow = self.flows.get_mut(id);
        let mapping = self.rules.table.mapping(flow.mapping);
        let net = self.rules.table.net(mapping.net);
        match password {
            Some(password) => {
                // A16; under the password of any request, for another one may have come since.
                let credentials =
                    flow.credentials().map(|index| &net.credentials[usize::from(index)]);
                let credential = { credentials }
                    .find(|credential| credential.at_server().matches(&password).into())
                    .ok_or(DropReason::PasswordMismatch)?;
                if credential.device_password.is_some() {
                    protocol::replace_password(octets, &credential.password);
                }
            }
            None if net.require_response_password => return Err(DropReason::PasswordMismatch),
            None => {}
        }
        flow.last_used = now; // N-3
        let node = self.counters.node(flow.mapping);
        node.answered(now);
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
        now: Nanos,
        arrival: &Arrival,
        credential: Option<u16>,
        effects: &mut impl Effects,
    ) -> Result<FlowId, DropReason> {
        let mapping = self.rules.table.mapping(arrival.mapping);
        if !effects.can_answer(arrival) {
            self.rules.budget.give_request(mapping.net);
            return Err(DropReason::Unanswerable);
        }
        if !self.rules.budget.take(mapping.net) {
            self.rules.budget.give_request(mapping.net);
            return Err(DropReason::FlowLimit); // N-8
        }
        let owner = Owner {
            client: arrival.client,
            public_address: arrival.public_address,
            public_port: mapping.public_port,
        };
        let budget = &self.rules.budget;
        let (upstream, upstream_port) =
            self.upstreams.assign(owner, &mapping, budget, effects).inspect_err(|_| {
                budget.give(mapping.net);
                budget.give_request(mapping.net);
            })?;
        let flow = Flow {
            endpoints: arrival.endpoints(),
            server: mapping.server,
            mapping: arrival.mapping,
            upstream,
            upstream_port,
            credential,
            earlier_credentials: Box::default(),
            noted: 0,
            opened: now,
            last_used: now,
            answers: Answers::default(),
            era: self.era,
            paid_until: 0,
            left: 0,
        };
        effects.flow_opened(&self.rules.table, &flow.record(now));
        let net = self.counters.net(mapping.net);
        net.flows.add(1);
        net.flows_opened.add(1);
        let id = self.flows.insert(flow);
        self.wheel.file(id, self.idle_at(id));
        Ok(id)
    }

    pub(super) fn close(
        &mut self,
        id: FlowId,
        reason: CloseReason,
        now: Nanos,
        effects: &mut impl Effects,
    ) {
        self.wheel.remove(id);
        let flow = self.flows.remove(id);
        self.upstreams.release(flow.upstream, flow.server, now);
        if flow.left == 0 {
            self.note_closed(&flow, reason, now, effects);
        }
        self.note_withdrawn(&flow);
    }

    /// Closes a flow for its client, whose next request opens another; answers to earlier ones still
    /// come through it.
    pub(super) fn leave(&mut self, id: FlowId, now: Nanos, effects: &mut impl Effects) {
        self.flows.leave(id);
        self.note_closed(self.flows.get(id), CloseReason::PortWanted, now, effects);
        self.flows.get_mut(id).left = now;
        self.leaving.push(id);
    }

    /// Closes sockets whose ports are wanted for something else as soon as their last answers are in,
    /// or are not waited for any longer. Tells whether there are others.
    pub fn close_left(&mut self, now: Instant, effects: &mut impl Effects) -> bool {
        if self.going_over.is_some() {
            return true; // flows without number may be on them
        }
        let now = self.nanos(now);
        let mut ended = Vec::new();
        let flows = &self.flows;
        self.leaving.retain(|&id| {
            let Some(flow) = flows.find(id).filter(|flow| flow.left > 0) else { return false };
            let ends = !flow.awaits_answers(now) || now - flow.left >= LAST_ANSWERS;
            let ends = ends && ended.len() < AT_ONCE;
            if ends {
                ended.push(id);
            }
            !ends
        });
        ended.into_iter().for_each(|id| self.close(id, CloseReason::PortWanted, now, effects));
        let used: BTreeSet<_> =
            self.leaving.iter().map(|&id| self.flows.get(id).upstream).collect();
        self.upstreams.close_left(|id| used.contains(&id), effects)
    }

    fn note_closed(
        &self,
        flow: &Flow,
        reason: CloseReason,
        now: Nanos,
        effects: &mut impl Effects,
    ) {
        let (rules, counters) = self.rules_of(flow);
        let net = rules.table.mapping(flow.mapping).net;
        rules.budget.give(net);
        let net = counters.net(net);
        net.flows.sub(1);
        net.flows_closed(reason).add(1);
        effects.flow_closed(&rules.table, &flow.record(now), reason);
    }
}

impl Arrival {
    /// Whether it is the relay's own request, as far as the datagram itself tells: what a host sends
    /// to one of its own addresses comes from there too.
    #[inline]
    fn is_loop(&self, effects: &impl Effects) -> bool {
        let ip = self.client.ip();
        effects.has_upstream_port(self.client.port())
            && (ip == self.public_address || ip.to_canonical().is_loopback())
    }

    /// The same whatever address translation has done to it. Asks the system, but hardly ever.
    fn comes_back(&self, effects: &mut impl Effects) -> bool {
        effects.has_upstream_port(self.client.port()) && effects.is_own_address(self.client)
    }

    fn endpoints(&self) -> Endpoints {
        Endpoints {
            client: self.client,
            public_address: self.public_address,
            listener: self.listener,
        }
    }

    /// Whether an answer could not even be sent: nothing listens on port 0, no host has such an
    /// address, and what leaves from a link's address does not leave the link.
    #[inline]
    fn is_unanswerable(&self) -> bool {
        let no_host = match self.client.ip().to_canonical() {
            IpAddr::V4(client) => {
                let [first, ..] = client.octets();
                first == 0 || first >= 224 // this network; multicast, reserved, broadcast
            }
            IpAddr::V6(client) => {
                let of_a_link = |address: IpAddr| matches!(address, IpAddr::V6(address) if address.is_unicast_link_local());
                client.is_unspecified()
                    || client.is_multicast()
                    || of_a_link(self.public_address) && !of_a_link(client.into())
            }
        };
        no_host || self.client.port() == 0
    }
}
