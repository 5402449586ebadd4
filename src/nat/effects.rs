//! What stands around the core: sockets and the log.

use std::net::SocketAddr;

use super::core::Arrival;
use super::flow::FlowRecord;
use super::ids::{MappingId, NetId, UpstreamId};
use super::reason::CloseReason;
use super::table::Table;
use super::throttle::Throttled;

/// What the core asks of the world around it. Called when flows open and close and when throttling
/// begins and ends, not for each datagram.
pub trait Effects {
    /// Opens the upstream socket `id` for IPv4 or IPv6 servers and tells its local port; none when
    /// no socket can be had. A client of this net needs it; it may serve others' too.
    fn open_upstream(&mut self, id: UpstreamId, net: NetId, ipv4: bool) -> Option<u16>;
    /// Closes the upstream socket `id`.
    fn close_upstream(&mut self, id: UpstreamId);
    /// Whether an upstream socket, of whichever worker, has this port.
    fn has_upstream_port(&self, _port: u16) -> bool {
        false
    }
    /// Whether this address is one of the router's own. Asked of those that
    /// [have an upstream port](Self::has_upstream_port), when a flow is about to be opened.
    fn is_own_address(&mut self, _address: SocketAddr) -> bool {
        false
    }
    /// Whether the system could send an answer to this client: no where its address is a subnet's
    /// broadcast, or no route leads there. Asked when a flow is about to be opened.
    fn can_answer(&mut self, _arrival: &Arrival) -> bool {
        true
    }
    /// A flow of this table was opened (N-10).
    fn flow_opened(&mut self, table: &Table, flow: &FlowRecord);
    /// A flow was closed (N-10), of a table that may not be in force any more.
    fn flow_closed(&mut self, table: &Table, flow: &FlowRecord, reason: CloseReason);
    /// A sender, or an address, sent too many wrong passwords: its request to this public port was
    /// the first to be refused. A stranger brings this about, and one with many addresses often.
    fn throttling_begun(&mut self, _throttled: &Throttled, _mapping: MappingId) {}
    /// All wrong passwords of a sender, or of an address, are forgiven, or it was pushed out by others.
    fn throttling_ended(&mut self, _throttled: &Throttled) {}
}
