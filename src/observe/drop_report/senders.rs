//! Who sent the datagrams that were dropped since the last look, as far as the workers remember.

use std::collections::{BTreeMap, HashMap};
use std::net::IpAddr;

use crate::datapath::ActiveConfig;
use crate::nat::{DropReason, NO_NODE, NetId, Refused};
use crate::observe::refusals::Refusals;

/// What was counted at the last look.
#[derive(Debug, Default)]
pub(super) struct Senders(HashMap<Refused, u64>);

/// What one sender sent, for one net and reason.
#[derive(Clone, Debug, Default)]
pub(super) struct Sender {
    /// Datagrams.
    pub(super) count: u64,
    /// The nodes that they were for, or came from. A PROFINET device has no node address.
    pub(super) nodes: Vec<u16>,
    /// When the last one came, counted from the relay's start.
    pub(super) last: u64,
}

impl Senders {
    /// The senders of each net and reason since the last look.
    pub(super) fn since_last(
        &mut self,
        active: &ActiveConfig,
    ) -> HashMap<(NetId, DropReason), BTreeMap<IpAddr, Sender>> {
        let now = Refusals::of(&active.counters, &active.config.table).list;
        let mut senders: HashMap<_, BTreeMap<_, Sender>> = HashMap::new();
        let mut seen = HashMap::new();
        for (net, refusal) in now {
            let refused = refusal.refused;
            seen.insert(refused, refusal.count);
            let before = self.0.get(&refused).copied().unwrap_or_default();
            // A smaller count means that the sender had lost its place, and has another one.
            let count = refusal.count.checked_sub(before).unwrap_or(refusal.count);
            if count == 0 {
                continue;
            }
            let of_group = senders.entry((net, refused.reason)).or_default();
            let sender = of_group.entry(refused.sender).or_default();
            sender.count += count;
            sender.last = sender.last.max(refusal.last);
            let node = Some(refused.node).filter(|&node| node != NO_NODE);
            sender.nodes.extend(node.map(u16::from));
        }
        self.0 = seen;
        senders
    }
}
