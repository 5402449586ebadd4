//! A line about dropped datagrams of one net and reason.

use std::net::IpAddr;
use std::time::Duration;

use tracing::warn;

use crate::config::runs;
use crate::datapath::ActiveConfig;
use crate::nat::{DropReason, LastSender, NetId, SourceSketch};

/// A line.
#[derive(Debug)]
pub(super) struct Line {
    pub(super) who: Who,
    /// Datagrams.
    pub(super) count: u64,
    /// How long it took to drop them.
    pub(super) time: Duration,
}

/// Who sent what a line tells of.
#[derive(Debug)]
pub(super) enum Who {
    /// This sender, to or from these nodes.
    One(IpAddr, Vec<u16>),
    /// All that have no lines of their own. `newest` is one of them that sent in the last window.
    Others { named: Vec<IpAddr>, newest: Option<IpAddr> },
}

impl Line {
    /// Writes it.
    pub(super) fn write(self, active: &ActiveConfig, net: NetId, reason: DropReason) {
        let Self { who, count, time } = self;
        let name = &active.config.table.net(net).name;
        let (what, seconds) = (reason.counted(count), time.as_secs_f64().ceil());
        match who {
            Who::One(sender, nodes) => warn!(
                net = %name, reason = %reason.label(), count, sources = 1, last_sender = %sender,
                nodes = (!nodes.is_empty()).then(|| runs(&nodes)),
                "{what} from {sender} in {seconds} s"
            ),
            Who::Others { named, newest } => {
                let estimate = take_sources(active, net, reason);
                let is_most = estimate == SourceSketch::MOST;
                let named_sources = if is_most { 0 } else { named.len() as u64 };
                // The sketch only estimates. The true number lies between one source and `count`.
                let sources = u64::from(estimate).saturating_sub(named_sources).clamp(1, count);
                let senders = active.counters.iter();
                let senders = senders.map(|worker| worker.net(net).last_sender(reason));
                let last_sender = LastSender::latest(senders);
                let last_sender = last_sender.filter(|sender| !named.contains(sender)).or(newest);
                let other = if named.is_empty() { "" } else { "other " };
                let from = match (sources, last_sender) {
                    (1, Some(sender)) => sender.to_string(),
                    (1, None) => format!("1 {other}source"),
                    _ if is_most => {
                        format!("{sources} {other}sources or more")
                    }
                    _ => format!("{sources} {other}sources"),
                };
                let last = last_sender.filter(|_| sources > 1);
                let last =
                    last.map(|sender| format!(", the last one {sender}")).unwrap_or_default();
                warn!(
                    net = %name, reason = %reason.label(), count, sources,
                    last_sender = last_sender.map(tracing::field::display),
                    "{what} from {from} in {seconds} s{last}"
                );
            }
        }
    }
}

/// Lets the number of sources begin again, for the next line about others.
pub(super) fn forget_sources(active: &ActiveConfig, net: NetId, reason: DropReason) {
    take_sources(active, net, reason);
}

fn take_sources(active: &ActiveConfig, net: NetId, reason: DropReason) -> u32 {
    let sketches = active.counters.iter().map(|worker| worker.net(net).sources(reason));
    SourceSketch::take_estimate(sketches)
}
