//! Datagrams and response times of a node, of a net, or of what belongs to no net.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::nat::{Direction, RESPONSE_BUCKETS};
use crate::observe::totals::{BucketTotals, DirectionTotals, NodeTotals, ResponseTotals};

/// Datagrams and response times since the start.
#[derive(Serialize)]
pub(super) struct Traffic {
    request: DirectionState,
    response: DirectionState,
    response_time_mean_seconds: Option<f64>,
    response_time_median_seconds: Option<f64>,
    response_time_p99_seconds: Option<f64>,
    /// How many answers fell into each bucket; not cumulative.
    response_time_buckets: [u64; RESPONSE_BUCKETS.len() + 1],
    /// The same with finer buckets, for clients that add up nets or take differences. Empty buckets are
    /// left out.
    response_times: Vec<ResponseTimes>,
}

/// Answers whose times are the same when they are rounded to two digits.
#[derive(Serialize)]
struct ResponseTimes {
    /// Null: no bound.
    up_to_seconds: Option<f64>,
    answers: u64,
    /// The sum of the rounded times.
    sum_seconds: f64,
}

impl ResponseTimes {
    fn of(times: &ResponseTotals) -> Vec<Self> {
        let bucket = |BucketTotals { upper, about, answers }| Self {
            up_to_seconds: upper.map(|upper| upper.as_secs_f64()),
            answers,
            sum_seconds: (about.as_nanos() * u128::from(answers)) as f64 / 1e9,
        };
        times.filled_buckets().map(bucket).collect()
    }
}

impl Traffic {
    pub(super) fn of(totals: &NodeTotals) -> Self {
        let times = &totals.response_times;
        Self {
            request: DirectionState::of(totals, Direction::Request),
            response: DirectionState::of(totals, Direction::Response),
            response_time_mean_seconds: times.mean().map(|mean| mean.as_secs_f64()),
            response_time_median_seconds: times.quantile(0.5).map(|median| median.as_secs_f64()),
            response_time_p99_seconds: times.quantile(0.99).map(|p99| p99.as_secs_f64()),
            response_time_buckets: times.coarse(),
            response_times: ResponseTimes::of(times),
        }
    }
}

#[derive(Serialize)]
pub(super) struct DirectionState {
    received_datagrams: u64,
    forwarded_datagrams: u64,
    forwarded_bytes: u64,
    /// By reason; reasons at 0 are left out.
    dropped_datagrams: BTreeMap<&'static str, u64>,
}

impl DirectionState {
    pub(super) fn of(node: &NodeTotals, direction: Direction) -> Self {
        let totals: &DirectionTotals = node.direction(direction);
        let reasons = direction.drop_reasons();
        let dropped = reasons.map(|reason| (reason.label(), totals.dropped(reason)));
        Self {
            received_datagrams: totals.received,
            forwarded_datagrams: totals.forwarded,
            forwarded_bytes: totals.forwarded_bytes,
            dropped_datagrams: dropped.filter(|&(_, n)| n > 0).collect(),
        }
    }
}
