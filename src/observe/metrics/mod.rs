//! The metrics that Prometheus scrapes. They are sums over the workers' counters, made into text
//! when a scraper asks for them.
//!
//! A large table makes hundreds of thousands of series. So the text comes as an iterator: each step
//! makes one family of one net, when the reader wants more. Memory use stays flat. When a scraper
//! stops reading, only this work stops, and the relay goes on.

mod families;
#[cfg(test)]
mod tests;

use std::iter;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{SystemTime, UNIX_EPOCH};

use prometheus::TextEncoder;
use prometheus::core::Collector;
use prometheus::process_collector::ProcessCollector;
use prometheus::proto::{Metric, MetricFamily, MetricType};

use self::families::{
    NET_FAMILIES, NetFamily, NetSums, ROUTER_FAMILIES, RouterFamily, RouterState,
};
use crate::datapath::{ActiveConfig, Router};
use crate::logging;
use crate::nat::NetId;
use crate::observe::totals::{NetTotals, NodeTotals};
use crate::sandbox::Sandbox;

/// The content type of the text that [`Metrics::chunks`] makes.
pub const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// The labels of strays: datagrams on upstream sockets that come from no server of the table.
const STRAY_NET: &str = "none";
const STRAY_NODE: &str = "0";

/// The metrics of one relay.
#[derive(Clone, Debug)]
pub struct Metrics {
    router: Arc<Router>,
    sandbox: Sandbox,
    /// Unix time of the relay's start, in microseconds, by the clock as it was set at the last
    /// scrape. A machine whose clock has no battery learns the right time long after the start.
    started_at: Arc<AtomicU64>,
}

impl Metrics {
    /// The metrics of `router`, in a process that `sandbox` describes.
    pub fn new(router: Arc<Router>, sandbox: Sandbox) -> Self {
        let started_at = Arc::new(AtomicU64::new(started_at(&router)));
        Self { router, sandbox, started_at }
    }

    /// All metrics in Prometheus' text format, piece by piece. Each piece is summed up and encoded
    /// when the caller takes it. All pieces describe the configuration that is in force when this
    /// is called.
    pub fn chunks(&self) -> impl Iterator<Item = String> + Send + use<> {
        self.look_at_the_clock();
        let (active, started_at) = (self.router.active_config(), self.started_at());
        let state = RouterState {
            last_reload: self.router.last_reload(),
            started: self.router.started(),
            started_at,
            audit_lines_left_out: self.router.audit().left_out(),
            log_lines_lost: logging::lines_lost(),
            offload: self.router.offload(),
        };
        let router = ROUTER_FAMILIES.iter().map(move |family| router_family(family, &state));
        let layers = iter::once(families::sandbox_layers(&self.sandbox));
        let process = iter::once_with(|| ProcessCollector::for_self().collect()).flatten();
        NET_FAMILIES
            .iter()
            .flat_map(move |family| net_family(Arc::clone(&active), started_at, family))
            .chain(router.chain(layers).chain(process).filter_map(|family| encode(&family)))
    }

    /// Keeps the known time of the start while the clock is off by at most a second. So the
    /// timestamps do not change slightly with each scrape.
    fn look_at_the_clock(&self) {
        let now = started_at(&self.router);
        if now.abs_diff(self.started_at.load(Relaxed)) > 1_000_000 {
            self.started_at.store(now, Relaxed);
        }
    }

    fn started_at(&self) -> f64 {
        self.started_at.load(Relaxed) as f64 / 1e6
    }
}

/// The text of one family, net by net. Strays come last.
fn net_family(
    active: Arc<ActiveConfig>,
    started_at: f64,
    family: &'static NetFamily,
) -> impl Iterator<Item = String> {
    let nets = active.config.table.net_ids().map(Some).chain([None]);
    let mut headed = false;
    nets.filter_map(move |net| {
        let sums = match net {
            Some(net) => net_sums(&active, started_at, net),
            None => stray_sums(&active, started_at),
        };
        let samples = (family.samples)(&sums);
        let mut text = encode(&metric_family(family.name, family.help, family.kind, samples))?;
        if headed {
            text.drain(..header_len(&text));
        }
        headed = true;
        Some(text)
    })
}

fn net_sums(active: &ActiveConfig, started_at: f64, id: NetId) -> NetSums<'_> {
    let (table, workers) = (&active.config.table, &active.counters);
    let net = table.net(id);
    let node = |mapping| {
        let node_address = table.mapping(mapping).node_address.to_string();
        (node_address, NodeTotals::of_node(workers, mapping))
    };
    NetSums {
        label: &net.name,
        nodes: table.mappings_of(id).map(node).collect(),
        net: Some((net, NetTotals::of_net(workers, table, id))),
        config_hash: Some(active.config_hash(id)),
        kernel_drops: Box::new(move || active.kernel_drops(id)),
        started_at,
    }
}

fn stray_sums(active: &ActiveConfig, started_at: f64) -> NetSums<'_> {
    NetSums {
        label: STRAY_NET,
        nodes: vec![(STRAY_NODE.to_owned(), NodeTotals::of_strays(&active.counters))],
        net: None,
        config_hash: None,
        kernel_drops: Box::new(|| active.upstream_kernel_drops()),
        started_at,
    }
}

fn router_family(family: &RouterFamily, state: &RouterState) -> MetricFamily {
    metric_family(family.name, family.help, family.kind, vec![(family.sample)(state)])
}

/// Unix time of the relay's start in microseconds, by the clock as it is set now.
fn started_at(router: &Router) -> u64 {
    let started_at = SystemTime::now() - router.started().elapsed();
    let since_epoch = started_at.duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since_epoch.as_micros()).unwrap_or(u64::MAX)
}

fn metric_family(name: &str, help: &str, kind: MetricType, samples: Vec<Metric>) -> MetricFamily {
    let mut family = MetricFamily::default();
    family.set_name(name.to_owned());
    family.set_help(help.to_owned());
    family.set_field_type(kind);
    family.set_metric(samples);
    family
}

/// The text of a family. `None` when the family has no samples: the encoder refuses that.
fn encode(family: &MetricFamily) -> Option<String> {
    TextEncoder::new().encode_to_string(std::slice::from_ref(family)).ok()
}

/// The length of the HELP and TYPE lines in octets.
fn header_len(text: &str) -> usize {
    text.split_inclusive('\n').take_while(|line| line.starts_with('#')).map(str::len).sum()
}
