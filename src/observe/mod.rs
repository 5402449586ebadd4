//! What the relay reports about its work: sums over the workers' counters, who was refused, metrics,
//! and the drop report.
//!
//! A datagram never gets a log line of its own. The relay counts what strangers send, and
//! [`DropReport`] writes the numbers into the log from time to time.

mod drop_report;
pub mod metrics;
pub mod refusals;
pub mod totals;

pub use drop_report::DropReport;
