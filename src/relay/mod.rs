//! The NAT itself, pure: table, flows, upstream sockets, throttle, drop reasons, counters.
//!
//! Time and randomness come in as arguments; there is no socket, no clock and no lock here.

#[cfg(test)]
mod attackers;
mod budget;
mod chance;
mod check;
mod core;
mod counters;
mod flow;
mod flows;
#[cfg(test)]
mod handover;
mod ids;
mod known;
mod last_sender;
mod queue;
mod rate;
mod reason;
mod reload;
mod response_times;
mod rules;
mod shell;
#[cfg(test)]
mod silence;
#[cfg(test)]
mod simulation;
mod sketch;
mod sources;
mod table;
mod throttle;
mod throttled;
mod transition;
mod upstream;
mod wheel;

pub use budget::Budget;
pub use chance::Chance;
pub use core::{Arrival, Core, ToClient, ToServer};
pub use counters::{Counter, Counters, DirectionCounters, NetCounters, NodeCounters};
pub use flow::FlowRecord;
pub use ids::{FlowId, ListenerId, UpstreamId};
pub use last_sender::LastSender;
pub use rate::RequestRate;
pub use reason::{CloseReason, Direction, DropReason};
pub use reload::Succession;
pub use response_times::{FINE_BOUNDS, FINE_BUCKETS, RESPONSE_BUCKETS, ResponseTimes};
pub use rules::Rules;
pub use shell::Shell;
pub use sketch::SourceSketch;
pub use table::{Credential, Limits, Mapping, MappingId, Net, NetId, NetKind, Table};
pub use throttled::{ThrottleScope, Throttled};
pub use transition::Transition;
