//! A response, from a server node to a client: the checks that it has to pass, in their order.

use std::net::{IpAddr, SocketAddr};
use std::time::Instant;

use super::Core;
use crate::nat::ids::{FlowId, ListenerId, MappingId, UpstreamId};
use crate::nat::payload::Payload;
use crate::nat::protocol::{self, Response};
use crate::nat::reason::{Direction, DropReason};
use crate::nat::table::any_port;
use crate::nat::time::Nanos;

/// Where a response goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ToClient {
    /// The socket to send on.
    pub via: ListenerId,
    /// The address to send from.
    pub public_address: IpAddr,
    /// The client's address and port.
    pub client: SocketAddr,
    /// The mapping that the datagram is counted for.
    pub mapping: MappingId,
}

impl Core {
    /// Judges what a server sent to an upstream socket. If it may pass, `payload` is what the
    /// client is to receive. The caller then sends them and reports with
    /// [`response_sent`](Self::response_sent) or [`send_failed`](Self::send_failed).
    #[inline]
    pub fn response(
        &mut self,
        now: Instant,
        via: UpstreamId,
        server: SocketAddr,
        payload: &mut Payload<'_>,
    ) -> Result<ToClient, DropReason> {
        // A flow for which the new rules have no place is closed later; until then it takes
        // nothing.
        let flow = self.flows.of_response(via, server);
        let flow = flow.or_else(|| self.flows.of_response(via, any_port(server)));
        let flow = flow.filter(|&id| self.take_along(id).is_ok());
        let verdict = match flow {
            Some(id) => self.judge_response(self.nanos(now), id, server.port(), payload),
            None => Err(DropReason::UnknownFlow),
        };
        let mapping = match flow {
            Some(id) => Some(self.flows.get(id).mapping),
            None => self.rules.table.mapping_of_server(server),
        };
        let node = mapping.map_or(&*self.counters.stray, |mapping| self.counters.node(mapping));
        let node = node.direction(Direction::Response);
        node.received.add(&self.writer, 1);
        if let Err(reason) = verdict {
            node.dropped(reason).add(&self.writer, 1);
            if let Some(mapping) = mapping {
                let now = self.nanos(now);
                self.note_source(reason, now, mapping, Direction::Response, server.ip());
            }
        }
        verdict
    }

    /// The checks of a response of this flow, in their order.
    #[inline]
    fn judge_response(
        &mut self,
        now: Nanos,
        id: FlowId,
        port: u16,
        payload: &mut Payload<'_>,
    ) -> Result<ToClient, DropReason> {
        let (header, flow) = (self.rules.table.header, self.flows.get_mut(id));
        let Response { password, is_answer } =
            protocol::response(payload, header, &mut flow.conversation, port, now)?;
        let mapping = self.rules.table.mapping(flow.mapping);
        let net = self.rules.table.net(mapping.net);
        match password {
            Some(password) => {
                // A16. Any password that the flow asked with is right: the answer may be to an
                // earlier request than the latest.
                let credentials =
                    flow.credentials().map(|index| &net.credentials[usize::from(index)]);
                let credential = { credentials }
                    .find(|credential| credential.at_server().matches(&password).into())
                    .ok_or(DropReason::PasswordMismatch)?;
                protocol::for_client(payload, net, credential);
            }
            None if net.require_response_password => return Err(DropReason::PasswordMismatch),
            None => {}
        }
        flow.used = now; // N-3
        flow.traffic.response(payload.len());
        let node = self.counters.node(flow.mapping);
        node.answered(&self.writer, now);
        if is_answer && let Some(response_time) = flow.note_answer(now) {
            node.response_times.observe(&self.writer, response_time);
        }
        Ok(ToClient {
            via: flow.endpoints.listener,
            public_address: flow.endpoints.public_address,
            client: flow.endpoints.client,
            mapping: flow.mapping,
        })
    }
}
