//! What the core asks of the world around it: sockets, the system's routes, and the audit log.

use std::net::{IpAddr, SocketAddr};

use super::flow::FlowRecord;
use super::ids::{ListenerId, MappingId, NetId, UpstreamId};
use super::offload::{Lent, Offer, SharedFlow};
use super::reason::CloseReason;
use super::table::Table;
use super::throttled::Throttled;
use super::upstream_ports::SocketKind;

/// What the core asks of the world around it. It is called when a flow opens or closes and when
/// throttling begins or ends, not for each datagram. Where nothing is said, a method does nothing.
pub trait Effects {
    /// Opens the upstream socket `id` of this kind and returns its local port; none when
    /// no socket is free. A client of `net`, of this table, needs it, but it may serve clients of
    /// other nets too.
    fn open_upstream(
        &mut self,
        table: &Table,
        id: UpstreamId,
        net: NetId,
        kind: SocketKind,
    ) -> Option<u16>;

    /// Closes the upstream socket `id`.
    fn close_upstream(&mut self, id: UpstreamId);

    /// Whether an upstream socket of any worker has this port. By default, none has.
    fn has_upstream_port(&self, _port: u16) -> bool {
        false
    }

    /// Whether this address is one of the router's own. Asked before a flow is opened, and only
    /// about clients whose port an [upstream socket has](Self::has_upstream_port). By default, it
    /// is not.
    fn is_own_address(&mut self, _address: SocketAddr) -> bool {
        false
    }

    /// Whether the system could send an answer to this client: not if the address is a subnet's
    /// broadcast address, or no route leads there. Asked before a flow is opened. By default, it
    /// could.
    fn can_answer(
        &mut self,
        _listener: ListenerId,
        _public_address: IpAddr,
        _client: SocketAddr,
    ) -> bool {
        true
    }

    /// Has a faster datapath carry a flow of this table, too, if there is one and it can. Until the flow is
    /// recalled, what passes is counted where the return value leads to. By default, there is none.
    fn offload(&mut self, _table: &Table, _offer: &Offer<'_>) -> Option<Lent<SharedFlow>> {
        None
    }

    /// Has the faster datapath let go of the flow with this place. Once this returns, it takes up no datagram
    /// of the flow any more.
    fn recall(&mut self, _place: u32) {}

    /// A flow of this table was opened (N-10).
    fn flow_opened(&mut self, _table: &Table, _flow: &FlowRecord) {}

    /// A flow was closed (N-10). Its table may not be in force any more.
    fn flow_closed(&mut self, _table: &Table, _flow: &FlowRecord, _reason: CloseReason) {}

    /// A sender, or an address as a whole, sent too many wrong passwords, and a request of it to this
    /// public port of the table was refused for the first time. Strangers cause this, and one with
    /// many addresses causes it often.
    fn throttling_begun(&mut self, _table: &Table, _throttled: &Throttled, _mapping: MappingId) {}

    /// Throttling is over: all wrong passwords are forgiven, or others took the place in the table.
    fn throttling_ended(&mut self, _throttled: &Throttled) {}
}
