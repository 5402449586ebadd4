//! What a worker does for its core: it opens sockets, asks for the system's routes, writes the audit
//! log and tells who is throttled.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use crate::datapath::offload::Carrier;
use crate::datapath::throttlings::Throttlings;
use crate::logging::audit::Audit;
use crate::logging::warnings::RateLimitedWarnings;
use crate::nat::{
    CloseReason, Effects, FlowRecord, Lent, ListenerId, MappingId, NetId, Offer, SharedFlow,
    SocketKind, Table, Throttled, UpstreamId,
};

use super::public::Listeners;
use super::sys::options;
use super::upstream::UpstreamSockets;
use super::way_back;

/// The sockets of a worker, and the way to the audit log.
pub(super) struct WorkerEffects {
    /// The sockets at which requests arrive, and from which answers leave.
    pub public: Listeners,
    /// The sockets towards the servers.
    pub upstream: UpstreamSockets,
    pub audit: Arc<Audit>,
    pub throttlings: Arc<Throttlings>,
    pub warnings: RateLimitedWarnings,
    /// Has the kernel carry flows, where it does.
    pub carrier: Option<Carrier>,
}

impl Effects for WorkerEffects {
    fn open_upstream(
        &mut self,
        table: &Table,
        id: UpstreamId,
        net: NetId,
        kind: SocketKind,
    ) -> Option<u16> {
        if !self.upstream.may_open(kind) {
            return None; // counted as upstream_exhausted, which the drop report tells
        }
        let opened = self.upstream.open(id, kind);
        let what = "cannot open an upstream socket";
        opened.inspect_err(|error| self.warnings.note_of(net, table, error, what)).ok()
    }

    fn close_upstream(&mut self, id: UpstreamId) {
        self.upstream.close(id);
    }

    fn has_upstream_port(&self, port: u16) -> bool {
        self.upstream.ports().is_taken(port)
    }

    fn is_own_address(&mut self, address: SocketAddr) -> bool {
        // The system has no route to an address that it refuses.
        options::is_own(address, self.upstream.ports()).unwrap_or(false)
    }

    fn can_answer(
        &mut self,
        listener: ListenerId,
        public_address: IpAddr,
        client: SocketAddr,
    ) -> bool {
        let listener = self.public.get(listener);
        listener.is_none_or(|listener| way_back::exists(listener, public_address, client))
    }

    fn offload(&mut self, _: &Table, offer: &Offer<'_>) -> Option<Lent<SharedFlow>> {
        self.carrier.as_mut()?.carry(offer, self.upstream.ports())
    }

    fn recall(&mut self, place: u32) {
        if let Some(carrier) = &mut self.carrier {
            carrier.let_go(place);
        }
    }

    fn flow_opened(&mut self, table: &Table, flow: &FlowRecord) {
        self.audit.flow_opened(table, flow);
    }

    fn flow_closed(&mut self, table: &Table, flow: &FlowRecord, reason: CloseReason) {
        self.audit.flow_closed(table, flow, reason);
    }

    fn throttling_begun(&mut self, table: &Table, throttled: &Throttled, mapping: MappingId) {
        self.audit.throttling_begun(table, throttled, mapping);
        self.throttlings.note(table, throttled, mapping);
    }

    fn throttling_ended(&mut self, throttled: &Throttled) {
        self.audit.throttling_ended(throttled);
    }
}
