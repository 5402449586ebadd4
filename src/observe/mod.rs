//! What the relay reports about its work: sums over the workers' counters, who was refused, metrics, the
//! drop report, events, and a history of a day.
//!
//! A datagram never gets a log line of its own. The relay counts what strangers send, and
//! [`DropReport`] writes the numbers into the log from time to time.

mod drop_report;
pub mod events;
pub mod history;
mod journal;
pub mod metrics;
mod observer;
pub mod refusals;
pub mod totals;

pub use drop_report::DropReport;
pub use journal::Journal;
pub use observer::Observer;
