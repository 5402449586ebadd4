//! The NAT itself, without I/O: table, flows, upstream ports, throttle, drop reasons, counters.
//!
//! Time and randomness are arguments. There is no socket, no clock and no lock here. The way of a
//! datagram begins in `core`; what a protocol has to say about its octets is in `protocol`.

mod allowed_sources;
mod budget;
mod chance;
mod core;
mod counter;
mod counters;
mod effects;
mod flow;
mod flow_table;
mod gcra;
mod idle_wheel;
mod ids;
mod known_clients;
mod last_sender;
mod net;
mod offload;
mod payload;
mod protocol;
mod queue;
mod reason;
mod refusals;
mod response_times;
mod rules;
mod sequence_lock;
mod source_sketch;
mod table;
#[cfg(test)]
mod tests;
mod throttle;
mod throttled;
mod time;
mod transition;
mod upstream_ports;

pub use budget::Budget;
pub use chance::Chance;
pub use core::{Arrival, Core, Succession, ToClient, ToServer};
pub use counter::{Counter, Writer};
pub(crate) use counters::NODE_LAYOUT;
pub use counters::{Counters, DirectionCounters, NetCounters, NodeCounters, SharedCounters};
pub use effects::Effects;
pub use flow::{FlowRecord, FlowTraffic};
pub use gcra::RequestRate;
pub use ids::{FlowId, ListenerId, MappingId, NetId, UpstreamId};
pub use last_sender::LastSender;
pub use net::{Credential, Mapping, NO_NODE, Net, NetKind};
pub use offload::{Held, Lender, Lent, Offer, SharedFlow};
pub use payload::Payload;
#[cfg(test)]
pub(crate) use protocol::is_sound_call;
pub use protocol::{NoSuchRecord, Record, Records};
pub use reason::{CloseReason, Direction, DropReason};
pub use refusals::{Refusal, Refusals, Refused, net_key};
pub(crate) use response_times::RESPONSE_LAYOUT;
pub use response_times::{FINE_BOUNDS, FINE_BUCKETS, RESPONSE_BUCKETS, ResponseTimes};
pub use rules::Rules;
pub use source_sketch::SourceSketch;
pub use table::{Limits, Table};
pub use throttled::{ThrottleScope, Throttled};
pub use transition::Transition;
pub use upstream_ports::SocketKind;
