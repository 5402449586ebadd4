//! What stands around the core: sockets and the log.

use super::flow::FlowRecord;
use super::ids::UpstreamId;
use super::reason::CloseReason;

/// What the core asks of the world around it. Called when flows open and close, not for each
/// datagram.
pub trait Shell {
    /// Opens the upstream socket `id` for IPv4 or IPv6 servers and tells its local port; none when
    /// no socket can be had.
    fn open_upstream(&mut self, id: UpstreamId, ipv4: bool) -> Option<u16>;
    /// Closes the upstream socket `id`.
    fn close_upstream(&mut self, id: UpstreamId);
    /// A flow was opened (N-10).
    fn flow_opened(&mut self, flow: &FlowRecord);
    /// A flow was closed (N-10).
    fn flow_closed(&mut self, flow: &FlowRecord, reason: CloseReason);
}
