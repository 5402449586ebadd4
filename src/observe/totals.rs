//! The one place that adds up the workers' counters: for a node, for all nodes of a net, and for a
//! net. Metrics, admin API, log and demo all read these sums.
//!
//! The workers go on counting while the sums are made. So figures that belong together may differ
//! by some datagrams. Each figure on its own never decreases, except `flows`.

use std::sync::Arc;
use std::time::Duration;

use strum::VariantArray;

use crate::nat::{
    CloseReason, Counter, Counters, Direction, DirectionCounters, DropReason, FINE_BOUNDS,
    FINE_BUCKETS, MappingId, NetId, NodeCounters, RESPONSE_BUCKETS, ResponseTimes, SourceSketch,
    Table,
};

/// Datagrams of one direction.
#[derive(Clone, Debug, Default)]
pub struct DirectionTotals {
    /// Datagrams taken from the kernel.
    pub received: u64,
    /// Datagrams handed back to the kernel.
    pub forwarded: u64,
    /// Octets of UDP payload in the forwarded datagrams.
    pub forwarded_bytes: u64,
    dropped: [u64; DropReason::COUNT],
}

impl DirectionTotals {
    /// The datagrams dropped for this reason.
    pub fn dropped(&self, reason: DropReason) -> u64 {
        self.dropped[reason as usize]
    }

    /// The datagrams dropped for any reason.
    pub fn dropped_total(&self) -> u64 {
        self.dropped.iter().sum()
    }

    fn add(&mut self, counters: &DirectionCounters) {
        self.received += counters.received.get();
        self.forwarded += counters.forwarded.get();
        self.forwarded_bytes += counters.forwarded_bytes.get();
        for &reason in DropReason::VARIANTS {
            self.dropped[reason as usize] += counters.dropped(reason).get();
        }
    }
}

/// Response times. Each is the time from a forwarded request to its forwarded response.
#[derive(Clone, Debug)]
pub struct ResponseTotals {
    answers: [u64; FINE_BUCKETS],
    count: u64,
    sum: Duration,
}

/// Answers that took about the same time.
#[derive(Clone, Copy, Debug)]
pub struct BucketTotals {
    /// The longest of these times. `None`: there is no longest.
    pub upper: Option<Duration>,
    /// Each of these times, rounded to two digits.
    pub about: Duration,
    /// The number of answers.
    pub answers: u64,
}

impl Default for ResponseTotals {
    fn default() -> Self {
        Self { answers: [0; FINE_BUCKETS], count: 0, sum: Duration::ZERO }
    }
}

impl ResponseTotals {
    /// Counts one answer that took `elapsed`.
    pub fn observe(&mut self, elapsed: Duration) {
        let nanos = u64::try_from(elapsed.as_nanos()).unwrap_or(u64::MAX);
        self.answers[ResponseTimes::bucket(nanos)] += 1;
        self.count += 1;
        self.sum = self.sum.saturating_add(elapsed);
    }

    /// The number of measured times.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The sum of all times.
    pub fn sum(&self) -> Duration {
        self.sum
    }

    /// The mean time. It is `None` before the first answer.
    pub fn mean(&self) -> Option<Duration> {
        let seconds = self.sum.as_secs_f64() / self.count() as f64;
        Duration::try_from_secs_f64(seconds).ok()
    }

    /// The number of answers in each bucket of [`RESPONSE_BUCKETS`], not cumulative. The last
    /// bucket holds the answers beyond all bounds.
    pub fn coarse(&self) -> [u64; RESPONSE_BUCKETS.len() + 1] {
        let mut coarse = [0; RESPONSE_BUCKETS.len() + 1];
        for BucketTotals { upper, answers, .. } in self.filled_buckets() {
            let upper = upper.map_or(f64::INFINITY, |upper| upper.as_secs_f64());
            coarse[RESPONSE_BUCKETS.partition_point(|&bound| bound < upper)] += answers;
        }
        coarse
    }

    /// The buckets with answers, shortest times first.
    pub fn filled_buckets(&self) -> impl Iterator<Item = BucketTotals> {
        let all = if self.count > 0 { &self.answers[..] } else { &[] };
        let filled = all.iter().enumerate().filter(|(_, answers)| **answers > 0);
        filled.map(|(index, &answers)| {
            let upper = FINE_BOUNDS.get(index).copied().map(Duration::from_nanos);
            BucketTotals { upper, about: about(index), answers }
        })
    }

    /// The time within which this share of the answers came. The share is 0 to 1. The result is
    /// `None` before the first answer. It is rounded to two digits, so its error is under 5 %; from
    /// 10 s on it is 10 s.
    pub fn quantile(&self, share: f64) -> Option<Duration> {
        if self.count == 0 {
            return None;
        }
        let rank = share * self.count as f64;
        let mut below = 0;
        let bucket = self.answers.iter().position(|&answers| {
            below += answers;
            answers > 0 && below as f64 >= rank
        });
        bucket.map(about)
    }

    /// Adds other times.
    pub fn add(&mut self, other: &Self) {
        for (sum, answers) in self.answers.iter_mut().zip(other.answers) {
            *sum += answers;
        }
        self.count += other.count;
        self.sum += other.sum;
    }

    /// The times since `earlier`, when these were the totals.
    pub fn since(&self, earlier: &Self) -> Self {
        let mut times = self.clone();
        for (answers, earlier) in times.answers.iter_mut().zip(earlier.answers) {
            *answers = answers.saturating_sub(earlier);
        }
        times.count = times.answers.iter().sum();
        times.sum = times.sum.saturating_sub(earlier.sum);
        times
    }

    fn add_node(&mut self, node: &ResponseTimes) {
        // Most nodes of a large table may never have been asked.
        if node.sum_nanos() == 0 {
            return;
        }
        for (sum, answers) in self.answers.iter_mut().zip(node.buckets()) {
            *sum += answers;
            self.count += answers;
        }
        self.sum += Duration::from_nanos(node.sum_nanos());
    }
}

/// The times of a bucket, rounded to two digits.
fn about(bucket: usize) -> Duration {
    let below = bucket.checked_sub(1).map_or(0, |below| FINE_BOUNDS[below]);
    let upper = FINE_BOUNDS.get(bucket).copied().unwrap_or(below);
    let middle = below.midpoint(upper);
    let unit = 10_u64.pow(middle.ilog10().saturating_sub(1));
    Duration::from_nanos((middle + unit / 2) / unit * unit)
}

/// The counts of one server node, or of several together.
#[derive(Clone, Debug, Default)]
pub struct NodeTotals {
    directions: [DirectionTotals; Direction::ALL.len()],
    /// Response times.
    pub response_times: ResponseTotals,
    /// When the node was asked and when it answered.
    pub contact: Contact,
}

/// When a server node was asked and when it answered, or several nodes together.
#[derive(Clone, Copy, Debug, Default)]
pub struct Contact {
    /// When the last response was forwarded, counted from the relay's start. `None`: never.
    pub last_response: Option<Duration>,
    /// When the last request that asks for an answer was accepted, counted from the relay's start.
    /// `None`: never.
    pub last_request: Option<Duration>,
    /// When the first request was accepted that still waits for an answer. `None`: no request
    /// waits.
    unanswered_since: Option<Duration>,
}

/// Whether a server node works, as far as its answers show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// The node answered when it was asked last.
    Answering,
    /// The node was asked, and has answered nobody for [`SILENCE`](Self::SILENCE).
    Silent,
    /// Nobody has asked the node for an answer since the start, or its first answer is still due.
    /// Nothing is known of the node yet.
    NeverAsked,
}

impl Presence {
    /// How long a node may leave all clients without an answer before it counts as silent.
    pub const SILENCE: Duration = Duration::from_secs(5);

    /// The name of this state in the API.
    pub fn label(self) -> &'static str {
        match self {
            Self::Answering => "answering",
            Self::Silent => "silent",
            Self::NeverAsked => "never_asked",
        }
    }
}

impl Contact {
    /// The times of the node behind a mapping, over all `workers`.
    pub fn of_node(workers: &[Arc<Counters>], mapping: MappingId) -> Self {
        let mut contact = Self::default();
        workers.iter().for_each(|worker| contact.add(worker.node(mapping)));
        contact
    }

    /// Whether the node works. `now` is counted from the relay's start.
    pub fn presence(&self, now: Duration) -> Presence {
        let waiting = self.waiting_since().map(|since| now.saturating_sub(since));
        if waiting > Some(Presence::SILENCE) {
            Presence::Silent
        } else if self.last_request.and(self.last_response).is_some() {
            Presence::Answering
        } else {
            Presence::NeverAsked
        }
    }

    /// Since when all clients wait that asked the node for an answer, counted from the relay's
    /// start. `None`: no client waits.
    pub fn waiting_since(&self) -> Option<Duration> {
        let since = self.unanswered_since.filter(|_| self.last_response < self.last_request)?;
        // Another worker may have forwarded a response after that time.
        Some(since.max(self.last_response.unwrap_or_default()))
    }

    fn add(&mut self, node: &NodeCounters) {
        self.last_response = self.last_response.max(moment(&node.last_response));
        self.last_request = self.last_request.max(moment(&node.last_request));
        let since = moment(&node.unanswered_since);
        self.unanswered_since = self.unanswered_since.into_iter().chain(since).min();
    }
}

impl NodeTotals {
    /// The sum over `workers` for the node behind a mapping.
    pub fn of_node(workers: &[Arc<Counters>], mapping: MappingId) -> Self {
        Self::sum(workers.iter().map(|worker| worker.node(mapping)))
    }

    /// The sum over `workers` for all nodes of a net.
    pub fn of_net(workers: &[Arc<Counters>], table: &Table, net: NetId) -> Self {
        Self::sum(
            table
                .mappings_of(net)
                .flat_map(|mapping| workers.iter().map(move |worker| worker.node(mapping))),
        )
    }

    /// The sum over `workers` for strays: datagrams on upstream sockets that come from no server of
    /// the table.
    pub fn of_strays(workers: &[Arc<Counters>]) -> Self {
        Self::sum(workers.iter().map(|worker| &*worker.stray))
    }

    /// The datagrams of one direction.
    pub fn direction(&self, direction: Direction) -> &DirectionTotals {
        &self.directions[direction as usize]
    }

    /// The datagrams of both directions that were dropped for this reason.
    pub fn dropped(&self, reason: DropReason) -> u64 {
        self.directions.iter().map(|direction| direction.dropped(reason)).sum()
    }

    /// Adds the counts of the node behind a mapping, over all `workers`.
    pub fn add_node(&mut self, workers: &[Arc<Counters>], mapping: MappingId) {
        workers.iter().for_each(|worker| self.add(worker.node(mapping)));
    }

    fn sum<'a>(nodes: impl Iterator<Item = &'a NodeCounters>) -> Self {
        let mut totals = Self::default();
        nodes.for_each(|node| totals.add(node));
        totals
    }

    fn add(&mut self, node: &NodeCounters) {
        for (direction, sum) in Direction::ALL.into_iter().zip(&mut self.directions) {
            sum.add(node.direction(direction));
        }
        self.response_times.add_node(&node.response_times);
        self.contact.add(node);
    }
}

/// About how many addresses have sent wrong passwords to any net. The largest possible value is
/// [`SourceSketch::MOST`].
pub fn wrong_password_sources(workers: &[Arc<Counters>], table: &Table) -> u32 {
    let of_worker =
        |worker| table.net_ids().map(move |net| &Counters::net(worker, net).wrong_password_sources);
    SourceSketch::estimate(workers.iter().flat_map(|worker| of_worker(&**worker)))
}

/// A time counted from the relay's start. The counter value 0 stands for never.
fn moment(nanos: &Counter) -> Option<Duration> {
    Some(nanos.get()).filter(|&nanos| nanos != 0).map(Duration::from_nanos)
}

/// The counts of a net that belong to no single node.
#[derive(Clone, Debug)]
pub struct NetTotals {
    /// Flows that are open now.
    pub flows: u64,
    /// Flows opened since the start.
    pub flows_opened: u64,
    flows_closed: [u64; CloseReason::ALL.len()],
    /// Accepted requests for each credential, in the order of the net's credentials.
    pub accepted: Vec<u64>,
    /// About how many addresses have sent wrong passwords. The largest possible value is
    /// [`SourceSketch::MOST`].
    pub wrong_password_sources: u32,
}

impl NetTotals {
    /// The sum over `workers` for a net.
    pub fn of_net(workers: &[Arc<Counters>], table: &Table, net: NetId) -> Self {
        let sum = |counter: &dyn Fn(&Counters) -> &Counter| {
            workers.iter().map(|worker| counter(worker).get()).sum()
        };
        let credentials = 0..table.net(net).credentials.len();
        Self {
            flows: sum(&|worker| &worker.net(net).flows),
            flows_opened: sum(&|worker| &worker.net(net).flows_opened),
            flows_closed: CloseReason::ALL
                .map(|reason| sum(&|worker| worker.net(net).flows_closed(reason))),
            accepted: credentials.map(|i| sum(&|worker| &*worker.accepted(net)[i])).collect(),
            wrong_password_sources: SourceSketch::estimate(
                workers.iter().map(|worker| &worker.net(net).wrong_password_sources),
            ),
        }
    }

    /// The flows that ended for this reason.
    pub fn flows_closed(&self, reason: CloseReason) -> u64 {
        self.flows_closed[reason as usize]
    }
}

#[cfg(test)]
mod tests;
