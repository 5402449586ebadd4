//! Who was refused of late: what the workers remember, as one list.

use std::collections::HashMap;
use std::sync::Arc;

use crate::nat::{Counters, NetId, Refusal, Table, net_key};

/// What the workers remember of refused datagrams.
#[derive(Debug, Default)]
pub struct Refusals {
    /// The sum over the workers for each sender, net, node and reason, newest first. Nets that are
    /// not in the table any more are left out.
    pub list: Vec<(NetId, Refusal)>,
    /// Refused datagrams that are not in the list, because their senders found no place in it.
    pub not_listed: u64,
}

impl Refusals {
    /// The sum over `workers`, whose counters belong to this table.
    pub fn of(workers: &[Arc<Counters>], table: &Table) -> Self {
        let mut sums = HashMap::new();
        for refusal in workers.iter().flat_map(|worker| worker.refusals.list()) {
            let sum = sums.entry(refusal.refused).or_insert(Refusal { count: 0, ..refusal });
            sum.count += refusal.count;
            sum.first = sum.first.min(refusal.first);
            sum.last = sum.last.max(refusal.last);
        }
        let name = |id: NetId| (net_key(&table.net(id).name), id);
        let nets: HashMap<_, _> = table.net_ids().map(name).collect();
        let named = |sum: Refusal| Some((*nets.get(&sum.refused.net)?, sum));
        let mut list: Vec<_> = sums.into_values().filter_map(named).collect();
        list.sort_unstable_by_key(|(_, refusal)| std::cmp::Reverse(refusal.last));
        let not_listed = workers.iter().map(|worker| worker.refusals.not_listed.get()).sum();
        Self { list, not_listed }
    }
}

#[cfg(test)]
mod tests {
    use foldhash::fast::FixedState;

    use super::*;
    use crate::config::fixture::{SECTION, config};
    use crate::datapath::Router;
    use crate::nat::{Direction, DropReason, Refused, Writer};

    #[test]
    fn workers_are_added_up_and_nets_that_are_gone_are_left_out() {
        let router = Router::idle(config(), 2);
        let active = router.active_config();
        let table = &active.config.table;
        let sender = "198.51.100.9".parse().unwrap();
        for (worker, node, now) in [(0, 1, 7), (1, 33, 9), (1, 1, 5), (0, 1, 8)] {
            let (net, direction) = (net_key("section-1"), Direction::Request);
            let reason = DropReason::PasswordWrong;
            let refused = Refused { sender, net, node, direction, reason };
            let refusals = &active.counters[worker].refusals;
            refusals.note(&Writer::of_worker(), now, &refused, &FixedState::default());
        }
        let found = Refusals::of(&active.counters, table);
        let of =
            |(net, it): &(NetId, Refusal)| (*net, it.refused.node, it.count, it.first, it.last);
        let rows: Vec<_> = found.list.iter().map(of).collect();
        assert_eq!(rows, [(SECTION, 33, 1, 9, 9), (SECTION, 1, 3, 5, 8)]);
        let nets = vec![table.nets()[1].clone()];
        let other = Table::new(table.header, nets, Vec::new());
        assert!(Refusals::of(&active.counters, &other).list.is_empty());
    }
}
