//! Every metric family: its name, its help text, and the source of its samples. No other place in
//! the program names a metric.
//!
//! Label values are names from the configuration, node addresses and labels of enums. They never
//! contain a client's address or a password.

use std::sync::Arc;
use std::time::{Duration, Instant};

use prometheus::proto::{
    Bucket, Counter, Gauge, Histogram, LabelPair, Metric, MetricFamily, MetricType,
};

use super::metric_family;
use crate::COMMIT;
use crate::datapath::{KernelDrops, LastReload, OffloadState};
use crate::nat::{CloseReason, Direction, Net, NetKind, RESPONSE_BUCKETS};
use crate::observe::totals::{DirectionTotals, NetTotals, NodeTotals};
use crate::sandbox::{Layer, Sandbox, State};

/// A family that has samples for each net.
pub(super) struct NetFamily {
    pub(super) name: &'static str,
    pub(super) help: &'static str,
    pub(super) kind: MetricType,
    pub(super) samples: fn(&NetSums<'_>) -> Vec<Metric>,
}

/// The sums from which the families of one net are made.
pub(super) struct NetSums<'a> {
    /// The value of the label `net`.
    pub(super) label: &'a str,
    /// For each node, the value of the label `node` and the node's sums.
    pub(super) nodes: Vec<(String, NodeTotals)>,
    /// The net itself. `None` for strays, which belong to no net.
    pub(super) net: Option<(&'a Net, NetTotals)>,
    /// The checksum of the net's configuration. `None` for strays.
    pub(super) config_hash: Option<&'a str>,
    /// Asks the kernel about every public socket of the net. This is slow, so only the family that
    /// needs the figures calls it.
    pub(super) kernel_drops: Box<dyn Fn() -> KernelDrops + 'a>,
    /// The relay's start as Unix time, in seconds.
    pub(super) started_at: f64,
}

impl NetSums<'_> {
    /// Converts a time since the relay's start to Unix time. `None` becomes 0.
    fn unix_time(&self, moment: Option<Duration>) -> f64 {
        moment.map_or(0.0, |moment| self.started_at + moment.as_secs_f64())
    }
}

pub(super) const NET_FAMILIES: &[NetFamily] = &[
    NetFamily {
        name: "pnet_nat_received_datagrams_total",
        help: "Datagrams taken from the kernel.",
        kind: MetricType::COUNTER,
        samples: |sums| directions(sums, |direction| direction.received),
    },
    NetFamily {
        name: "pnet_nat_forwarded_datagrams_total",
        help: "Datagrams passed on.",
        kind: MetricType::COUNTER,
        samples: |sums| directions(sums, |direction| direction.forwarded),
    },
    NetFamily {
        name: "pnet_nat_forwarded_bytes_total",
        help: "UDP payload of the datagrams passed on.",
        kind: MetricType::COUNTER,
        samples: |sums| directions(sums, |direction| direction.forwarded_bytes),
    },
    NetFamily {
        name: "pnet_nat_dropped_datagrams_total",
        help: "Datagrams not passed on, by reason. Received = forwarded + dropped.",
        kind: MetricType::COUNTER,
        samples: dropped,
    },
    NetFamily {
        name: "pnet_nat_accepted_requests_total",
        help: "Requests accepted, by the credential whose password they carried.",
        kind: MetricType::COUNTER,
        samples: accepted,
    },
    NetFamily {
        name: "pnet_nat_flows",
        help: "Flows open now: clients that talk to a node.",
        kind: MetricType::GAUGE,
        samples: |sums| of_net(sums, |labels, _, totals| vec![gauge(labels, totals.flows as f64)]),
    },
    NetFamily {
        name: "pnet_nat_flows_opened_total",
        help: "Flows opened.",
        kind: MetricType::COUNTER,
        samples: |sums| {
            of_net(sums, |labels, _, totals| vec![counter(labels, totals.flows_opened)])
        },
    },
    NetFamily {
        name: "pnet_nat_flows_closed_total",
        help: "Flows ended, by reason.",
        kind: MetricType::COUNTER,
        samples: flows_closed,
    },
    NetFamily {
        name: "pnet_nat_flow_limit",
        help: "Flows that may be open at once.",
        kind: MetricType::GAUGE,
        samples: |sums| {
            of_net(sums, |labels, net, _| vec![gauge(labels, f64::from(net.max_flows))])
        },
    },
    NetFamily {
        name: "pnet_nat_config_hash",
        help: "Always 1; the label hash is the same at all relays that configure the net alike. \
               Passwords are not in it.",
        kind: MetricType::GAUGE,
        samples: |sums| {
            let labelled = |hash: &&str| gauge(&[("net", sums.label), ("hash", hash)], 1.0);
            sums.config_hash.iter().map(labelled).collect()
        },
    },
    NetFamily {
        name: "pnet_nat_response_seconds",
        help: "Time from a request passed on to its response passed on.",
        kind: MetricType::HISTOGRAM,
        samples: response_times,
    },
    NetFamily {
        name: "pnet_nat_last_response_timestamp_seconds",
        help: "Unix time of the node's last response; 0: none since the start.",
        kind: MetricType::GAUGE,
        samples: last_responses,
    },
    NetFamily {
        name: "pnet_nat_unanswered_since_timestamp_seconds",
        help: "Unix time since which the node keeps everybody waiting who asks it for an answer; 0: \
               nobody waits.",
        kind: MetricType::GAUGE,
        samples: unanswered_since,
    },
    NetFamily {
        name: "pnet_nat_kernel_dropped_datagrams_total",
        help: "Datagrams that the kernel dropped on a net's public sockets, or, of net none, on \
               upstream sockets: overflow, a buffer was full; prefilter, a filter refused them. While \
               one is on, the kernel has one figure for both, which is overflow when the buffer \
               is full just as it is read.",
        kind: MetricType::COUNTER,
        samples: kernel_drops,
    },
];

/// A family with one sample for the whole relay.
pub(super) struct RouterFamily {
    pub(super) name: &'static str,
    pub(super) help: &'static str,
    pub(super) kind: MetricType,
    pub(super) sample: fn(&RouterState) -> Metric,
}

/// The state from which the families of the relay are made.
pub(super) struct RouterState {
    pub(super) last_reload: Arc<LastReload>,
    pub(super) started: Instant,
    /// `started` as Unix time, in seconds.
    pub(super) started_at: f64,
    pub(super) audit_lines_left_out: u64,
    pub(super) log_lines_lost: u64,
    pub(super) offload: OffloadState,
}

impl RouterState {
    fn unix_time_of_success(&self) -> f64 {
        self.started_at + self.last_reload.success_at.duration_since(self.started).as_secs_f64()
    }
}

pub(super) const ROUTER_FAMILIES: &[RouterFamily] = &[
    RouterFamily {
        name: "pnet_nat_config_last_reload_successful",
        help: "1: the configuration that was last read is in force; 0: it has a fault and none of it \
               is, or not all of it is.",
        kind: MetricType::GAUGE,
        sample: |state| gauge(&[], f64::from(state.last_reload.successful())),
    },
    RouterFamily {
        name: "pnet_nat_config_last_reload_success_timestamp_seconds",
        help: "Unix time when the configuration in force came into force.",
        kind: MetricType::GAUGE,
        sample: |state| gauge(&[], state.unix_time_of_success()),
    },
    RouterFamily {
        name: "pnet_nat_audit_lines_left_out_total",
        help: "Lines of the audit log beyond what [log] audit_lines allows.",
        kind: MetricType::COUNTER,
        sample: |state| counter(&[], state.audit_lines_left_out),
    },
    RouterFamily {
        name: "pnet_nat_log_lines_lost_total",
        help: "Lines of the log that stderr did not take, or not fast enough.",
        kind: MetricType::COUNTER,
        sample: |state| counter(&[], state.log_lines_lost),
    },
    RouterFamily {
        name: "pnet_nat_kernel_offload",
        help: "1: the kernel carries open flows by itself; 0: all stay on the relay's sockets.",
        kind: MetricType::GAUGE,
        sample: |state| gauge(&[], f64::from(state.offload.why_not.is_none())),
    },
    RouterFamily {
        name: "pnet_nat_kernel_flows",
        help: "Flows that the kernel carries now, of those in pnet_nat_flows.",
        kind: MetricType::GAUGE,
        sample: |state| gauge(&[], state.offload.flows as f64),
    },
    RouterFamily {
        name: "pnet_nat_build_info",
        help: "Always 1; the labels tell what runs.",
        kind: MetricType::GAUGE,
        sample: |_| gauge(&[("version", env!("CARGO_PKG_VERSION")), ("commit", COMMIT)], 1.0),
    },
];

fn directions(sums: &NetSums<'_>, value: fn(&DirectionTotals) -> u64) -> Vec<Metric> {
    each_direction(sums, |labels, _, totals| vec![counter(labels, value(totals))])
}

/// Gives a sample for every drop reason of the direction, even at 0. If a series only appeared with
/// its first drop, `increase()` would not show that drop.
fn dropped(sums: &NetSums<'_>) -> Vec<Metric> {
    each_direction(sums, |&[net, node, way], direction, totals| {
        // Strays are none of PROFINET's: a device that is known has its own figures.
        let kind = sums.net.as_ref().map_or(NetKind::Server, |(net, _)| net.kind);
        let reasons = kind.drop_reasons(direction).iter();
        reasons
            .map(|&reason| {
                let labels = [net, node, way, ("reason", reason.label())];
                counter(&labels, totals.dropped(reason))
            })
            .collect()
    })
}

fn accepted(sums: &NetSums<'_>) -> Vec<Metric> {
    of_net(sums, |&[label], net, totals| {
        let credentials = net.credentials.iter().zip(&totals.accepted);
        credentials
            .map(|(credential, &n)| counter(&[label, ("credential", &credential.name)], n))
            .collect()
    })
}

fn flows_closed(sums: &NetSums<'_>) -> Vec<Metric> {
    of_net(sums, |&[label], _, totals| {
        let sample = |reason: CloseReason| {
            counter(&[label, ("reason", reason.label())], totals.flows_closed(reason))
        };
        CloseReason::ALL.map(sample).into()
    })
}

fn kernel_drops(sums: &NetSums<'_>) -> Vec<Metric> {
    let causes = (sums.kernel_drops)().by_cause();
    let sample = |(cause, drops)| counter(&[("net", sums.label), ("cause", cause)], drops);
    causes.map(sample).into()
}

fn response_times(sums: &NetSums<'_>) -> Vec<Metric> {
    each_node(sums, |labels, totals| {
        let times = &totals.response_times;
        let mut cumulative = 0;
        let bucket = |(&bound, n): (&f64, &u64)| {
            cumulative += n;
            let mut bucket = Bucket::default();
            bucket.set_upper_bound(bound);
            bucket.set_cumulative_count(cumulative);
            bucket
        };
        let mut histogram = Histogram::default();
        histogram.set_bucket(RESPONSE_BUCKETS.iter().zip(&times.coarse()).map(bucket).collect());
        histogram.set_sample_count(times.count());
        histogram.set_sample_sum(times.sum().as_secs_f64());
        let mut metric = labelled(labels);
        metric.set_histogram(histogram);
        metric
    })
}

fn last_responses(sums: &NetSums<'_>) -> Vec<Metric> {
    each_node(sums, |labels, totals| gauge(labels, sums.unix_time(totals.contact.last_response)))
}

fn unanswered_since(sums: &NetSums<'_>) -> Vec<Metric> {
    each_node(sums, |labels, totals| gauge(labels, sums.unix_time(totals.contact.waiting_since())))
}

/// The name of the family that [`sandbox_layers`] makes.
pub(super) const SANDBOX_LAYER: &str = "pnet_nat_sandbox_layer";

/// The family that tells how the process is confined.
pub(super) fn sandbox_layers(sandbox: &Sandbox) -> MetricFamily {
    let sample = |(layer, state): (Layer, &State)| {
        gauge(&[("layer", layer.label())], f64::from(*state == State::On))
    };
    metric_family(
        SANDBOX_LAYER,
        "Whether this layer of confinement is in force as a whole.",
        MetricType::GAUGE,
        sandbox.layers().map(sample).collect(),
    )
}

type Label<'a> = (&'a str, &'a str);

/// The samples for each node and direction. Strays are included, so that the law of the counters
/// (received = forwarded + dropped) can be checked over all series.
fn each_direction(
    sums: &NetSums<'_>,
    samples: impl Fn(&[Label<'_>; 3], Direction, &DirectionTotals) -> Vec<Metric>,
) -> Vec<Metric> {
    let mut all = Vec::new();
    for (node, totals) in &sums.nodes {
        for direction in Direction::ALL {
            let labels = [("net", sums.label), ("node", node), ("direction", direction.label())];
            all.extend(samples(&labels, direction, totals.direction(direction)));
        }
    }
    all
}

/// One sample for each node of a net. There are none for strays.
fn each_node(
    sums: &NetSums<'_>,
    sample: impl Fn(&[Label<'_>; 2], &NodeTotals) -> Metric,
) -> Vec<Metric> {
    let nodes = sums.nodes.iter().filter(|_| sums.net.is_some());
    nodes.map(|(node, totals)| sample(&[("net", sums.label), ("node", node)], totals)).collect()
}

/// The samples of the net itself. There are none for strays.
fn of_net(
    sums: &NetSums<'_>,
    samples: impl Fn(&[Label<'_>; 1], &Net, &NetTotals) -> Vec<Metric>,
) -> Vec<Metric> {
    let net = sums.net.as_ref();
    net.map(|(net, totals)| samples(&[("net", sums.label)], net, totals)).unwrap_or_default()
}

fn counter(labels: &[Label<'_>], value: u64) -> Metric {
    let mut counter = Counter::default();
    counter.set_value(value as f64);
    let mut metric = labelled(labels);
    metric.set_counter(counter);
    metric
}

fn gauge(labels: &[Label<'_>], value: f64) -> Metric {
    let mut gauge = Gauge::default();
    gauge.set_value(value);
    let mut metric = labelled(labels);
    metric.set_gauge(gauge);
    metric
}

fn labelled(labels: &[Label<'_>]) -> Metric {
    let pair = |&(name, value): &Label<'_>| {
        let mut pair = LabelPair::default();
        pair.set_name(name.to_owned());
        pair.set_value(value.to_owned());
        pair
    };
    Metric::from_label(labels.iter().map(pair).collect())
}
