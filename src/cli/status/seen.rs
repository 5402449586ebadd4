//! What the API tells, as far as the tables show it.

use std::collections::BTreeMap;

use anyhow::Context;
use serde::Deserialize;
use serde_json::Value;

/// One look at a relay.
#[derive(Debug, Deserialize)]
pub(super) struct Seen {
    pub(super) status: Status,
    /// By label.
    pub(super) drop_reasons: BTreeMap<String, String>,
    pub(super) nets: Vec<Net>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Status {
    pub(super) version: String,
    pub(super) ready: bool,
    pub(super) uptime_seconds: f64,
    pub(super) reload: Reload,
    pub(super) public_ports: u64,
    pub(super) wrong_password_sources: u32,
    pub(super) wrong_password_sources_at_most: u32,
    pub(super) stray_responses: Datagrams,
    pub(super) sandbox: Vec<Layer>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Reload {
    pub(super) successful: bool,
    pub(super) in_force_seconds: f64,
}

#[derive(Debug, Deserialize)]
pub(super) struct Layer {
    pub(super) layer: String,
    pub(super) state: String,
    pub(super) why: Option<String>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Net {
    pub(super) name: String,
    pub(super) flows: u64,
    pub(super) max_flows: u64,
    pub(super) answering_nodes: u64,
    pub(super) silent_nodes: Vec<u8>,
    pub(super) never_asked_nodes: u64,
    #[serde(flatten)]
    pub(super) traffic: Traffic,
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

impl Seen {
    /// Takes what is known out of an answer.
    pub(super) fn read(answer: Value) -> anyhow::Result<Self> {
        serde_json::from_value(answer).context("the relay has another version of the API")
    }

    /// How often datagrams were dropped, by reason, most frequent first.
    pub(super) fn dropped(&self) -> Vec<(&str, u64)> {
        let mut sums: BTreeMap<&str, u64> = BTreeMap::new();
        let of_nets =
            self.nets.iter().flat_map(|net| [&net.traffic.request, &net.traffic.response]);
        for datagrams in of_nets.chain([&self.status.stray_responses]) {
            for (reason, count) in &datagrams.dropped_datagrams {
                *sums.entry(reason).or_default() += count;
            }
        }
        let mut sums: Vec<_> = sums.into_iter().collect();
        sums.sort_by_key(|&(_, count)| std::cmp::Reverse(count));
        sums
    }
}

impl Traffic {
    /// Datagrams dropped in both directions.
    pub(super) fn dropped(&self) -> u64 {
        let directions = [&self.request, &self.response];
        directions.iter().flat_map(|direction| direction.dropped_datagrams.values()).sum()
    }
}
