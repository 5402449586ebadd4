//! All that the relay has counted up to a moment, for one configuration.

use tokio::task::yield_now;

use crate::datapath::ActiveConfig;
use crate::nat::{Direction, DropReason};
use crate::observe::history::Step;
use crate::observe::totals::{NodeTotals, ResponseTotals};

/// After so many nodes the runtime looks at its sockets again.
const NODES_AT_ONCE: usize = 64;

/// Sums over all nodes, since the start.
#[derive(Clone, Debug, Default)]
pub(super) struct Counted {
    requests: u64,
    answers: u64,
    dropped: u64,
    wrong_passwords: u64,
    times: ResponseTotals,
}

impl Counted {
    /// What was counted up to now.
    pub(super) async fn of(active: &ActiveConfig) -> Self {
        let (table, mut totals) = (&active.config.table, NodeTotals::default());
        for (done, mapping) in (1..).zip(table.mapping_ids()) {
            totals.add_node(&active.counters, mapping);
            if done % NODES_AT_ONCE == 0 {
                yield_now().await;
            }
        }
        let of_kernel = table.net_ids().map(|net| active.kernel_drops_seen(net));
        let of_kernel = of_kernel.chain([active.upstream_kernel_drops()]);
        let of_kernel: u64 = of_kernel.map(|drops| drops.overflow + drops.prefilter).sum();
        let strays = NodeTotals::of_strays(&active.counters);
        let of_relay = [&totals, &strays].into_iter().flat_map(|totals| {
            Direction::ALL.map(|direction| totals.direction(direction).dropped_total())
        });
        let [requests, responses] = Direction::ALL.map(|direction| totals.direction(direction));
        Self {
            requests: requests.forwarded,
            answers: responses.forwarded,
            dropped: of_kernel + of_relay.sum::<u64>(),
            wrong_passwords: requests.dropped(DropReason::PasswordWrong),
            times: totals.response_times,
        }
    }

    /// What was counted since an earlier moment, by the same configuration.
    pub(super) fn since(&self, earlier: &Self) -> Step {
        Step {
            requests: self.requests.saturating_sub(earlier.requests),
            answers: self.answers.saturating_sub(earlier.answers),
            dropped: self.dropped.saturating_sub(earlier.dropped),
            wrong_passwords: self.wrong_passwords.saturating_sub(earlier.wrong_passwords),
            times: self.times.since(&earlier.times),
            ..Step::default()
        }
    }
}
