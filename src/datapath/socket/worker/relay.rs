//! Carries datagrams through a worker: from a public socket to a server, and back.

use std::os::fd::AsFd;
use std::time::Instant;

use crate::datapath::kernel_filter::request;
use crate::datapath::socket::effects::WorkerEffects;
use crate::datapath::socket::event_key::EventKey;
use crate::datapath::socket::flood_guard::FloodGuard;
use crate::datapath::socket::public::Listener;
use crate::datapath::socket::receive_quota::ReceiveQuota;
use crate::datapath::socket::stray_guard::StrayGuard;
use crate::datapath::socket::sys::batch::{Batch, Destination, Linux, Tag};
use crate::nat::{Arrival, Core, Direction, DropReason, ListenerId, UpstreamId};

/// What decides about datagrams, and what it needs for that.
pub(super) struct Relay {
    pub(super) core: Core,
    pub(super) effects: WorkerEffects,
    pub(super) quota: ReceiveQuota,
    pub(super) floods: FloodGuard,
    pub(super) strays: StrayGuard,
}

impl Relay {
    /// Checks what waits on a public socket, and queues what may pass. Returns how many datagrams
    /// were received.
    pub(super) fn requests<const SLOT: usize>(
        &mut self,
        batch: &mut Batch<Linux, SLOT>,
        id: ListenerId,
        now: Instant,
    ) -> usize {
        self.make_room(batch, now);
        // The socket may be closed already, or may not be in its place yet.
        let Some(listener) = self.effects.public.get(id) else { return 0 };
        let most = self.quota.most(EventKey::Public(id));
        let received = batch.receive(listener.socket.as_fd(), most, listener.destination());
        let mut received = match received {
            Ok(received) => received,
            Err(error) => {
                let what = "cannot receive on a public socket";
                self.effects.warnings.note_of(listener.net, self.core.table(), &error, what);
                return 0;
            }
        };
        let (mapping, address) = (listener.mapping, listener.address.ip());
        let mut refused = 0;
        while let Some(mut incoming) = received.next_datagram() {
            let arrival = Arrival {
                listener: id,
                mapping,
                // Without a control message, the address is the one that the socket is bound to. On
                // a socket of all addresses it is then the unspecified address, which is no unicast
                // address.
                public_address: incoming.to.unwrap_or(address),
                client: incoming.from,
            };
            let payload = &mut incoming.payload;
            let verdict = self.core.request(now, &arrival, payload, &mut self.effects);
            match verdict {
                Ok(to) => {
                    let octets = payload.len();
                    let direction = Direction::Request;
                    let tag = Tag { mapping, direction, octets, asks: to.asks };
                    received.queue(EventKey::Upstream(to.via).key(), None, to.server, tag);
                }
                Err(reason) => refused += usize::from(request::is_refused_by_filter(reason)),
            }
        }
        if refused > 0
            && let Some(listener) = self.effects.public.get(id)
        {
            self.floods.note(id, listener, self.core.table(), now, refused);
        }
        received.count()
    }

    /// Does the same with what servers sent to an upstream socket.
    pub(super) fn responses<const SLOT: usize>(
        &mut self,
        batch: &mut Batch<Linux, SLOT>,
        id: UpstreamId,
        now: Instant,
    ) -> usize {
        self.make_room(batch, now);
        let Some(socket) = self.effects.upstream.get(id) else { return 0 };
        let most = self.quota.most(EventKey::Upstream(id));
        let mut received = match batch.receive(socket, most, Destination::Bound) {
            Ok(received) => received,
            Err(error) => {
                self.effects.warnings.note(&error, "cannot receive from the servers");
                return 0;
            }
        };
        let mut strays = 0;
        while let Some(mut incoming) = received.next_datagram() {
            let payload = &mut incoming.payload;
            match self.core.response(now, id, incoming.from, payload) {
                Ok(to) => {
                    let octets = payload.len();
                    let (mapping, direction) = (to.mapping, Direction::Response);
                    let tag = Tag { mapping, direction, octets, asks: None };
                    let own = self.effects.public.get(to.via).and_then(Listener::own_address);
                    let from = own.is_none().then_some(to.public_address);
                    received.queue(EventKey::Public(to.via).key(), from, to.client, tag);
                }
                Err(reason) => strays += usize::from(reason == DropReason::UnknownFlow),
            }
        }
        if strays > 0 {
            self.strays.note(&self.effects.upstream, id, self.core.table(), now, strays);
        }
        received.count()
    }

    fn make_room<const SLOT: usize>(&mut self, batch: &mut Batch<Linux, SLOT>, now: Instant) {
        if batch.is_full() {
            self.flush(batch, now);
        }
    }

    /// Sends what is queued, and counts it.
    pub(super) fn flush<const SLOT: usize>(
        &mut self,
        batch: &mut Batch<Linux, SLOT>,
        now: Instant,
    ) {
        let WorkerEffects { public, upstream, warnings, .. } = &mut self.effects;
        let (public, upstream) = (&*public, &*upstream);
        batch.flush(
            |key| match EventKey::from_key(key) {
                EventKey::Public(id) => Some(public.get(id)?.socket.as_fd()),
                EventKey::Upstream(id) => upstream.get(id),
                EventKey::Wake | EventKey::Tick => None,
            },
            |tag, outcome| match outcome {
                Ok(()) => match tag.direction {
                    Direction::Request => {
                        self.core.request_sent(now, tag.mapping, tag.asks, tag.octets);
                    }
                    Direction::Response => self.core.response_sent(tag.mapping, tag.octets),
                },
                Err(error) => {
                    self.core.send_failed(tag.mapping, tag.direction);
                    let what = match tag.direction {
                        Direction::Request => "cannot send to a server",
                        Direction::Response => "cannot send to a client",
                    };
                    let table = self.core.table();
                    let net = table.mapping(tag.mapping).net;
                    warnings.note_of(net, table, &error, what);
                }
            },
        );
    }
}
