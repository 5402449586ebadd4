//! The part of the API's answers that the tables show.

use std::collections::BTreeMap;

use anyhow::Context;
use serde::Deserialize;
use serde_json::Value;

use super::refused::Row;

/// The state of a relay at one moment.
#[derive(Debug, Deserialize)]
pub(super) struct Snapshot {
    pub(super) status: Status,
    /// Explanations by label.
    pub(super) drop_reasons: BTreeMap<String, String>,
    pub(super) nets: Vec<Net>,
    pub(super) refused: Vec<Row>,
    /// Whether only one net was asked for.
    #[serde(skip)]
    pub(super) is_one_net: bool,
}

#[derive(Debug, Deserialize)]
pub(super) struct Status {
    pub(super) version: String,
    pub(super) commit: Option<String>,
    pub(super) ready: bool,
    pub(super) uptime_seconds: f64,
    pub(super) reload: Reload,
    pub(super) public_ports: u64,
    pub(super) max_flows: u64,
    pub(super) wrong_password_sources: u32,
    pub(super) wrong_password_sources_at_most: u32,
    pub(super) stray_responses: Datagrams,
    pub(super) upstream_kernel_dropped_datagrams: BTreeMap<String, u64>,
    pub(super) sandbox: Vec<Layer>,
    pub(super) offload: Offload,
}

#[derive(Debug, Deserialize)]
pub(super) struct Reload {
    pub(super) successful: bool,
    pub(super) in_force_seconds: f64,
    pub(super) error: Option<String>,
    pub(super) faults: Vec<String>,
    pub(super) not_in_force: Vec<NotInForce>,
}

/// Something of the configuration that is not in force.
#[derive(Debug, Deserialize)]
pub(super) struct NotInForce {
    pub(super) what: String,
    pub(super) why: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct Layer {
    pub(super) layer: String,
    pub(super) state: String,
    pub(super) why: Option<String>,
}

/// Whether the kernel carries flows.
#[derive(Debug, Deserialize)]
pub(super) struct Offload {
    /// None: it does.
    pub(super) why: Option<String>,
    pub(super) flows: u64,
    pub(super) interfaces: Vec<String>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Net {
    pub(super) name: String,
    /// The same at all relays that configure the net alike.
    pub(super) config_hash: String,
    pub(super) flows: u64,
    pub(super) max_flows: u64,
    pub(super) answering_nodes: u64,
    pub(super) silent_nodes: Vec<u8>,
    pub(super) never_asked_nodes: u64,
    pub(super) wrong_password_sources: u32,
    pub(super) kernel_dropped_datagrams: BTreeMap<String, u64>,
    #[serde(flatten)]
    pub(super) traffic: Traffic,
    /// Empty where they are not asked for.
    #[serde(default)]
    pub(super) nodes: Vec<Node>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Node {
    pub(super) node: u8,
    pub(super) public_port: u16,
    pub(super) server: String,
    pub(super) state: String,
    #[serde(flatten)]
    pub(super) traffic: Traffic,
    pub(super) last_response_age_seconds: Option<f64>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Traffic {
    pub(super) request: Datagrams,
    pub(super) response: Datagrams,
    pub(super) response_time_median_seconds: Option<f64>,
    pub(super) response_time_p99_seconds: Option<f64>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Datagrams {
    pub(super) forwarded_datagrams: u64,
    pub(super) dropped_datagrams: BTreeMap<String, u64>,
}

impl Snapshot {
    /// Reads an answer about all nets, or about the one that was asked for.
    pub(super) fn read(answer: Value, is_one_net: bool) -> anyhow::Result<Self> {
        let seen: Self =
            serde_json::from_value(answer).context("the relay has another version of the API")?;
        Ok(Self { is_one_net, ..seen })
    }

    /// Dropped datagrams by reason, most frequent first: those of the relay and those of the kernel.
    /// Includes what belongs to no net, unless one net was asked for.
    pub(super) fn dropped(&self) -> Vec<(String, u64)> {
        let mut all = Vec::new();
        let mut add = |place: &str, counts: &BTreeMap<String, u64>| {
            all.extend(counts.iter().map(|(reason, &count)| (format!("{place}{reason}"), count)));
        };
        for net in &self.nets {
            add("", &net.traffic.request.dropped_datagrams);
            add("", &net.traffic.response.dropped_datagrams);
            add("kernel: ", &net.kernel_dropped_datagrams);
        }
        if !self.is_one_net {
            add("", &self.status.stray_responses.dropped_datagrams);
            add("kernel: upstream ", &self.status.upstream_kernel_dropped_datagrams);
        }
        let mut sums: BTreeMap<String, u64> = BTreeMap::new();
        for (reason, count) in all.into_iter().filter(|(_, count)| *count > 0) {
            *sums.entry(reason).or_default() += count;
        }
        let mut sums: Vec<_> = sums.into_iter().collect();
        sums.sort_by_key(|&(_, count)| std::cmp::Reverse(count));
        sums
    }

    /// About how many addresses have sent wrong passwords to these nets.
    pub(super) fn wrong_password_sources(&self) -> u32 {
        match self.nets.as_slice() {
            [net] if self.is_one_net => net.wrong_password_sources,
            _ => self.status.wrong_password_sources,
        }
    }
}

impl Traffic {
    /// Dropped datagrams of both directions.
    pub(super) fn dropped(&self) -> u64 {
        let directions = [&self.request, &self.response];
        directions.iter().flat_map(|direction| direction.dropped_datagrams.values()).sum()
    }
}
