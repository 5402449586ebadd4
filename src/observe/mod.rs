//! What is told of a router at work: sums over the workers' counters, metrics, the report of drops.
//!
//! A datagram never makes a line of its own. What strangers send is counted, and [`DropReport`] says
//! now and then how much it was.

mod drop_report;
pub mod metrics;
pub mod totals;

pub use drop_report::DropReport;
