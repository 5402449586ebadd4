//! A request, from a client to a server node: the checks that it has to pass, in their order.

use std::net::SocketAddr;
use std::time::Instant;

use super::{Arrival, Core};
use crate::nat::effects::Effects;
use crate::nat::flow::Offload;
use crate::nat::ids::{FlowId, NetId, UpstreamId};
use crate::nat::payload::Payload;
use crate::nat::protocol::{self, Request};
use crate::nat::reason::{Direction, DropReason};
use crate::nat::time::Nanos;

/// How often a client with an open flow is noted as known: often enough that it stays known.
const NOTED_AGAIN: Nanos = 3_600_000_000_000;

/// Where a request goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ToServer {
    /// The socket to send on.
    pub via: UpstreamId,
    /// The server's address and port.
    pub server: SocketAddr,
    /// The flow that waits for the answer once the request is sent; none when no answer is wanted.
    pub asks: Option<FlowId>,
}

impl Core {
    /// Judges a request. If it may pass, `payload` is what the server is to receive. The caller
    /// then sends them and reports with [`request_sent`](Self::request_sent) or
    /// [`send_failed`](Self::send_failed), before the next call that may close a flow.
    #[inline]
    pub fn request(
        &mut self,
        now: Instant,
        arrival: &Arrival,
        payload: &mut Payload<'_>,
        effects: &mut impl Effects,
    ) -> Result<ToServer, DropReason> {
        let now = self.nanos(now);
        let verdict = self.judge_request(now, arrival, payload, effects);
        let node = self.counters.node(arrival.mapping).direction(Direction::Request);
        node.received.add(&self.writer, 1);
        if let Err(reason) = verdict {
            node.dropped(reason).add(&self.writer, 1);
            let (mapping, client) = (arrival.mapping, arrival.client.ip());
            self.note_source(reason, now, mapping, Direction::Request, client);
        }
        verdict
    }

    /// The checks of a request, in their order: first those that cost least for a stranger's
    /// datagram, then who sent it, then the password, and only then what it asks for.
    #[inline]
    fn judge_request(
        &mut self,
        now: Nanos,
        arrival: &Arrival,
        payload: &mut Payload<'_>,
        effects: &mut impl Effects,
    ) -> Result<ToServer, DropReason> {
        if !arrival.is_unicast() {
            return Err(DropReason::NotUnicast); // or every router that receives it would pass it on
        }
        let mapping = self.rules.table.mapping(arrival.mapping);
        let net = self.rules.table.net(mapping.net);
        let request = Request::parse(payload, self.rules.table.header, net)?;

        // A request of an open flow is judged by its password alone, so that wrong passwords under
        // a client's address cannot lock the client out.
        let open = self.flows.of_request(&arrival.endpoints());
        let open = open.filter(|&id| self.settle(id, now, effects));
        if open.is_none() {
            self.check_sender(now, arrival, mapping.net, effects)?;
        }
        let credential = self.check_password(now, arrival, mapping.net, &request, open, effects)?;
        let conversation = open.map(|id| &self.flows.get(id).conversation);
        request.is_for(mapping.node_address, conversation, now)?;
        if open.is_none() && arrival.comes_back(effects) {
            return Err(DropReason::Loop);
        }
        let paid_until = self.take_request(now, mapping.net, open)?;
        let id = match open {
            Some(id) => id,
            None => self.open(now, arrival, credential, effects)?,
        };
        let flow = self.flows.get_mut(id);
        match flow.offload {
            Offload::Carried(_) if flow.credential != credential => self.recall(id, effects),
            Offload::Open if open.is_some() && flow.credential == credential => {
                self.offer(id, effects);
            }
            _ => {}
        }
        let flow = self.flows.get_mut(id);
        flow.paid_until = paid_until;
        flow.asked_with(credential);
        flow.used = now;
        let mut server = mapping.server;
        if let Some(port) = request.note(&mut flow.conversation, now) {
            server.set_port(port);
        }
        let asks = request.wants_answer().then_some(id);
        let octets = payload.len();
        if let Some(index) = credential.map(usize::from) {
            if flow.noted == 0 || now - flow.noted >= NOTED_AGAIN {
                flow.noted = now;
                self.rules.known.note(mapping.net, arrival.client.ip(), now);
            }
            self.counters.accepted(mapping.net)[index].add(&self.writer, 1);
            let net = self.rules.table.net(mapping.net);
            protocol::for_server(payload, net, &net.credentials[index])?;
        }
        flow.traffic.request(octets);
        Ok(ToServer { via: flow.upstream, server, asks })
    }

    /// Who may send to a net without an open flow.
    #[inline]
    fn check_sender(
        &mut self,
        now: Nanos,
        arrival: &Arrival,
        net: NetId,
        effects: &mut impl Effects,
    ) -> Result<(), DropReason> {
        if arrival.is_loop(effects) {
            return Err(DropReason::Loop);
        }
        if arrival.is_unanswerable() {
            return Err(DropReason::Unanswerable);
        }
        let client = arrival.client;
        if !self.rules.table.allows(net, client.ip()) {
            return Err(DropReason::SourceNotAllowed);
        }
        // Wrong passwords under the address of a known client cannot lock it out either.
        let is_known = || self.rules.known.includes(net, client.ip(), now);
        self.throttle.admits(now, client, is_known).map_err(|begun| {
            if let Some(begun) = begun {
                effects.throttling_begun(&self.rules.table, &begun, arrival.mapping);
            }
            DropReason::Throttled
        })
    }

    /// The credential of the request: that of its password, or in a remote net the one whose
    /// password it gets. None for a request without a password.
    #[inline]
    fn check_password(
        &mut self,
        now: Nanos,
        arrival: &Arrival,
        net: NetId,
        request: &Request<'_>,
        open: Option<FlowId>,
        effects: &mut impl Effects,
    ) -> Result<Option<u16>, DropReason> {
        let Some(password) = request.password() else {
            // Request::parse let it pass: the net is remote, or allows it (A4).
            return Ok(self.rules.table.net(net).kind.is_remote().then_some(0));
        };
        let credential = self.rules.table.net(net).credential(password);
        if credential.is_none() {
            if open.is_none() {
                self.throttle.wrong_password(now, arrival.client, effects);
            }
            return Err(DropReason::PasswordWrong);
        }
        Ok(credential)
    }

    /// Takes one request from what the flow and the net may send, and returns until when the flow
    /// has paid then. The flow comes first, so that one that asks too much takes nothing from the
    /// others. Strangers do not get this far, so they use nothing up.
    #[inline]
    fn take_request(
        &self,
        now: Nanos,
        net: NetId,
        open: Option<FlowId>,
    ) -> Result<Nanos, DropReason> {
        let paid_until = match self.rules.table.net(net).max_flow_requests {
            None => 0,
            Some(rate) => {
                let paid_until = open.map_or(0, |id| self.flows.get(id).paid_until);
                rate.gcra.take(paid_until, now).ok_or(DropReason::RequestLimit)?
            }
        };
        if self.rules.budget.take_request(net, now) {
            Ok(paid_until)
        } else {
            Err(DropReason::RequestLimit)
        }
    }
}
