//! `/api/v1/nets`: each net and node, and what happened there.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Instant;

use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use ipnet::IpNet;
use serde::{Deserialize, Serialize, Serializer};

use super::config::{Element, NetRules};
use super::json_list;
use super::traffic::Traffic;
use crate::admin::Shared;
use crate::datapath::ActiveConfig;
use crate::nat::{CloseReason, MappingId, NetId, NetKind, Table};
use crate::observe::totals::{NetTotals, NodeTotals, Presence};

/// Query of [`nets`].
#[derive(Deserialize)]
pub(in crate::admin) struct NetsQuery {
    /// Only the net with this name.
    net: Option<String>,
    /// false: without the lists of nodes, which are most of the answer.
    nodes: Option<bool>,
}

/// `GET /api/v1/nets?net=&nodes=`
pub(in crate::admin) async fn nets(
    State(shared): State<Shared>,
    Query(query): Query<NetsQuery>,
) -> Response {
    let (started, active) = (shared.router.started(), shared.router.active_config());
    let table = Arc::clone(&active.config.table);
    let is_asked_for =
        |id: &NetId| query.net.as_ref().is_none_or(|name| table.net(*id).name == *name);
    let nets: Vec<NetId> = table.net_ids().filter(is_asked_for).collect();
    if query.net.is_some() && nets.is_empty() {
        return (StatusCode::NOT_FOUND, "no net has this name\n").into_response();
    }
    let with_nodes = query.nodes.unwrap_or(true);
    let net = move |net| {
        let mut net = NetState::of(&active, started, net);
        net.nodes = net.nodes.filter(|_| with_nodes);
        serde_json::to_string(&net)
    };
    json_list("nets", nets.into_iter().map(net), &shared.turn)
}

/// A net and what happened there.
#[derive(Serialize)]
struct NetState<'a> {
    #[serde(flatten)]
    rules: NetRules<'a>,
    /// The same at all relays that configure the net alike.
    config_hash: &'a str,
    /// The /24 of all servers of a UDP Range net (PAS 7).
    subnet: Option<IpNet>,
    flows: u64,
    flows_opened: u64,
    flows_closed: BTreeMap<&'static str, u64>,
    /// By credential.
    accepted_requests: BTreeMap<&'a str, u64>,
    kernel_dropped_datagrams: BTreeMap<&'static str, u64>,
    /// About how many addresses have sent wrong passwords since the start.
    wrong_password_sources: u32,
    answering_nodes: usize,
    /// Their node addresses.
    silent_nodes: Vec<u8>,
    never_asked_nodes: usize,
    /// The sum of all nodes.
    #[serde(flatten)]
    traffic: Traffic,
    /// Absent with `nodes=false`.
    #[serde(skip_serializing_if = "Option::is_none")]
    nodes: Option<Vec<NodeState>>,
}

impl<'a> NetState<'a> {
    fn of(active: &'a ActiveConfig, started: Instant, id: NetId) -> Self {
        let table = &active.config.table;
        let net = table.net(id);
        let totals = NetTotals::of_net(&active.counters, table, id);
        let node = |mapping| NodeState::of(active, started, mapping);
        let nodes: Vec<_> = table.mappings_of(id).map(node).collect();
        let count = |state: Presence| nodes.iter().filter(|node| node.presence == state).count();
        let silent = nodes.iter().filter(|node| node.presence == Presence::Silent);
        let closed = |reason: CloseReason| (reason.label(), totals.flows_closed(reason));
        let credentials = net.credentials.iter().map(|credential| credential.name.as_str());
        Self {
            rules: NetRules::of(net),
            config_hash: active.config_hash(id),
            subnet: subnet(table, id),
            flows: totals.flows,
            flows_opened: totals.flows_opened,
            flows_closed: CloseReason::ALL.into_iter().map(closed).collect(),
            accepted_requests: credentials.zip(totals.accepted.iter().copied()).collect(),
            kernel_dropped_datagrams: active.kernel_drops(id).by_cause().into(),
            wrong_password_sources: totals.wrong_password_sources,
            answering_nodes: count(Presence::Answering),
            silent_nodes: silent.map(|node| node.element.node).collect(),
            never_asked_nodes: count(Presence::NeverAsked),
            traffic: Traffic::of(&NodeTotals::of_net(&active.counters, table, id)),
            nodes: Some(nodes),
        }
    }
}

fn subnet(table: &Table, id: NetId) -> Option<IpNet> {
    let NetKind::UdpRange { .. } = table.net(id).kind else { return None };
    let mut servers = table.mappings_of(id).map(|mapping| table.mapping(mapping).server.ip());
    let IpAddr::V4(first) = servers.next()? else { return None };
    let subnet = IpNet::new(first.into(), 24).ok()?.trunc();
    servers.all(|server| subnet.contains(&server)).then_some(subnet)
}

/// A server node and what happened there.
#[derive(Serialize)]
struct NodeState {
    #[serde(flatten)]
    element: Element,
    #[serde(rename = "state", serialize_with = "label")]
    presence: Presence,
    #[serde(flatten)]
    traffic: Traffic,
    /// Time since the last request that expects an answer; null: there was none.
    last_request_age_seconds: Option<f64>,
    /// Time since the last response; null: there was none.
    last_response_age_seconds: Option<f64>,
}

fn label<S: Serializer>(presence: &Presence, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(presence.label())
}

impl NodeState {
    fn of(active: &ActiveConfig, started: Instant, mapping: MappingId) -> Self {
        let totals = NodeTotals::of_node(&active.counters, mapping);
        let now = started.elapsed();
        let age = |last| now.saturating_sub(last).as_secs_f64();
        Self {
            element: Element::of(active.config.table.mapping(mapping)),
            presence: totals.contact.presence(now),
            traffic: Traffic::of(&totals),
            last_request_age_seconds: totals.contact.last_request.map(age),
            last_response_age_seconds: totals.contact.last_response.map(age),
        }
    }
}
