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
    FINE_BUCKETS, MappingId, NetId, NodeCounters, RESPONSE_BUCKETS, SourceSketch, Table,
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
pub struct ResponseTotals([BucketTotals; FINE_BUCKETS]);

/// Answers that took about the same time.
#[derive(Clone, Copy, Debug, Default)]
pub struct BucketTotals {
    /// The number of answers.
    pub answers: u64,
    /// The sum of their times.
    pub sum: Duration,
}

impl Default for ResponseTotals {
    fn default() -> Self {
        Self([BucketTotals::default(); FINE_BUCKETS])
    }
}

impl ResponseTotals {
    /// Counts one answer that took `elapsed`.
    pub fn observe(&mut self, elapsed: Duration) {
        let bound = FINE_BOUNDS.partition_point(|&bound| u128::from(bound) < elapsed.as_nanos());
        let bucket = &mut self.0[bound];
        bucket.answers += 1;
        bucket.sum = bucket.sum.saturating_add(elapsed);
    }

    /// The number of measured times.
    pub fn count(&self) -> u64 {
        self.0.iter().map(|bucket| bucket.answers).sum()
    }

    /// The sum of all times.
    pub fn sum(&self) -> Duration {
        self.0.iter().map(|bucket| bucket.sum).sum()
    }

    /// The mean time. It is `None` before the first answer.
    pub fn mean(&self) -> Option<Duration> {
        let seconds = self.sum().as_secs_f64() / self.count() as f64;
        Duration::try_from_secs_f64(seconds).ok()
    }

    /// The number of answers in each bucket of [`RESPONSE_BUCKETS`], not cumulative. The last
    /// bucket holds the answers beyond all bounds.
    pub fn coarse(&self) -> [u64; RESPONSE_BUCKETS.len() + 1] {
        let mut coarse = [0; RESPONSE_BUCKETS.len() + 1];
        for (upper, bucket) in self.buckets() {
            let upper = upper.map_or(f64::INFINITY, |upper| upper.as_secs_f64());
            coarse[RESPONSE_BUCKETS.partition_point(|&bound| bound < upper)] += bucket.answers;
        }
        coarse
    }

    /// Each bucket with its upper bound. The last bucket has no bound.
    pub fn buckets(&self) -> impl Iterator<Item = (Option<Duration>, BucketTotals)> {
        let bounds = FINE_BOUNDS.map(|bound| Some(Duration::from_nanos(bound)));
        bounds.into_iter().chain([None]).zip(self.0)
    }

    /// The time within which this share of the answers came. The share is 0 to 1. The result is
    /// `None` before the first answer. The time is the mean of a bucket, so only its first two
    /// digits are accurate. The result is rounded to them.
    pub fn quantile(&self, share: f64) -> Option<Duration> {
        let rank = share * self.count() as f64;
        let mut below = 0;
        let (upper, bucket) = self.buckets().find(|(_, bucket)| {
            below += bucket.answers;
            bucket.answers > 0 && below as f64 >= rank
        })?;
        let mean = bucket.sum.as_nanos() / u128::from(bucket.answers);
        // At this moment a worker may have counted an answer but not yet added its time.
        let mean = u64::try_from(mean).unwrap_or(u64::MAX);
        Some(two_digits(upper.map_or(mean, |upper| mean.min(upper.as_nanos() as u64))))
    }
}

/// Rounds nanoseconds to two significant digits.
fn two_digits(nanos: u64) -> Duration {
    let unit = 10_u64.pow(nanos.checked_ilog10().unwrap_or(0).saturating_sub(1));
    Duration::from_nanos((nanos + unit / 2) / unit * unit)
}

/// The counts of one server node, or of several together.
#[derive(Clone, Debug, Default)]
pub struct NodeTotals {
    directions: [DirectionTotals; Direction::ALL.len()],
    /// Response times.
    pub response_times: ResponseTotals,
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

    fn sum<'a>(nodes: impl Iterator<Item = &'a NodeCounters>) -> Self {
        let mut totals = Self::default();
        for node in nodes {
            for (direction, sum) in Direction::ALL.into_iter().zip(&mut totals.directions) {
                sum.add(node.direction(direction));
            }
            let times = &mut totals.response_times;
            for (total, (answers, nanos)) in times.0.iter_mut().zip(node.response_times.buckets()) {
                total.answers += answers;
                total.sum += Duration::from_nanos(nanos);
            }
            totals.last_response = totals.last_response.max(moment(&node.last_response));
            totals.last_request = totals.last_request.max(moment(&node.last_request));
            let since = moment(&node.unanswered_since);
            totals.unanswered_since = totals.unanswered_since.into_iter().chain(since).min();
        }
        totals
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
