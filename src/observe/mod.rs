//! What the relay tells of itself: the audit log, the report of drops, warnings, sums over the
//! workers' counters, metrics.
//!
//! A datagram never makes a line of its own. What strangers send is counted, and [`DropReport`] says
//! now and then how much it was.

pub(crate) mod audit;
mod drop_report;
pub mod metrics;
pub mod totals;
pub(crate) mod warnings;

pub use drop_report::DropReport;
