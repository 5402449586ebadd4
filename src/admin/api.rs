//! `/api/v1`: nets, flows and configuration as JSON.
//!
//! The shapes below are the API. None holds a password: a credential is its name.

use std::collections::{BTreeMap, VecDeque};
use std::iter;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use axum::Json;
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use ipnet::IpNet;
use serde::ser::Error as _;
use serde::{Deserialize, Serialize, Serializer};

use super::Shared;
use super::turn::Turn;
use crate::COMMIT;
use crate::config::{Config, NotInForce};
use crate::datapath::{ActiveConfig, LastReload};
use crate::nat::{
    CloseReason, Credential, Direction, FlowRecord, Mapping, MappingId, Net, NetId, NetKind,
    RESPONSE_BUCKETS, RequestRate, SourceSketch, Table,
};
use crate::observe::totals::{
    self, BucketTotals, DirectionTotals, NetTotals, NodeTotals, Presence, ResponseTotals,
};
use crate::sandbox::{self, Layer};

const DEFAULT_FLOWS: usize = 1000;
/// A worker lists its flows between two datagrams, so a list has to be short.
const MOST_FLOWS: usize = 10_000;

/// What the kernel drops before the relay sees it, as the status page names it, in plain words:
/// by the causes of [`KernelDrops`](crate::datapath::KernelDrops).
const KERNEL_DROPS: [(&str, &str); 4] = [
    (
        "kernel: overflow",
        "Never seen by the relay: the receive buffer of a public port was full. Raise \
         `receive_buffer` and sysctl net.core.rmem_max, add workers.",
    ),
    (
        "kernel: prefilter",
        "Refused by the kernel for their length, header or password, while a public port was \
         flooded, or with `prefilter = \"always\"` from the start on.",
    ),
    (
        "kernel: upstream overflow",
        "Answers of servers that the relay never saw: the receive buffer of a socket towards the \
         plant was full. Raise `receive_buffer` and sysctl net.core.rmem_max, add workers.",
    ),
    (
        "kernel: upstream prefilter",
        "Refused by the kernel on a socket towards the plant, while it was flooded by senders that \
         are no server of the table. Who sends there? A firewall can keep them out.",
    ),
];

/// `GET /api/v1/status`
pub(super) async fn status(State(shared): State<Shared>) -> Response {
    Json(Status::of(&shared, &shared.router.last_reload())).into_response()
}

/// `GET /api/v1/drop-reasons`
pub(super) async fn drop_reasons() -> Response {
    let reasons = Direction::ALL.iter().flat_map(|direction| direction.drop_reasons());
    let reasons = reasons.map(|reason| (reason.label(), reason.explanation()));
    let reasons = reasons.chain(KERNEL_DROPS);
    Json(reasons.collect::<BTreeMap<_, _>>()).into_response()
}

/// Query of [`nets`].
#[derive(Deserialize)]
pub(super) struct NetsQuery {
    /// This one only.
    net: Option<String>,
    /// false: nets without their list of nodes, which is most of the answer.
    nodes: Option<bool>,
}

/// `GET /api/v1/nets?net=&nodes=`
pub(super) async fn nets(State(shared): State<Shared>, Query(query): Query<NetsQuery>) -> Response {
    let (started, in_force) = (shared.router.started(), shared.router.in_force());
    let table = Arc::clone(&in_force.config.table);
    let is_asked_for =
        |id: &NetId| query.net.as_ref().is_none_or(|name| table.net(*id).name == *name);
    let nets: Vec<NetId> = table.net_ids().filter(is_asked_for).collect();
    if query.net.is_some() && nets.is_empty() {
        return (StatusCode::NOT_FOUND, "no net has this name\n").into_response();
    }
    let with_nodes = query.nodes.unwrap_or(true);
    let net = move |net| {
        let mut net = NetState::of(&in_force, started, net);
        net.nodes = net.nodes.filter(|_| with_nodes);
        serde_json::to_string(&net)
    };
    json_list("nets", nets.into_iter().map(net), &shared.turn)
}

/// Query of [`flows`].
#[derive(Deserialize)]
pub(super) struct FlowsQuery {
    limit: Option<usize>,
}

/// `GET /api/v1/flows?limit=`
pub(super) async fn flows(
    State(shared): State<Shared>,
    Query(query): Query<FlowsQuery>,
) -> Response {
    let limit = query.limit.unwrap_or(DEFAULT_FLOWS);
    if limit > MOST_FLOWS {
        let message = format!("limit is at most {MOST_FLOWS}\n");
        return (StatusCode::BAD_REQUEST, message).into_response();
    }
    let asking = shared.flow_lists.asking.lock().await;
    let Some(flows) = shared.router.flows(limit).await else {
        let message = "a worker gives no answer\n";
        return (StatusCode::SERVICE_UNAVAILABLE, message).into_response();
    };
    drop(asking);
    let flows = flows.into_iter().flat_map(|(table, flows)| {
        flows.into_iter().map(move |flow| serde_json::to_string(&Flow::of(&table, &flow)))
    });
    json_list("flows", shared.flow_lists.keep(Box::new(flows)), &shared.turn)
}

/// A list of flows is large, and asking for it wakes the workers: one is made at a time, and a few
/// are kept for slow readers.
#[derive(Clone, Default)]
pub(super) struct FlowLists {
    asking: Arc<tokio::sync::Mutex<()>>,
    /// Oldest first.
    kept: Arc<Mutex<VecDeque<Weak<KeptList>>>>,
}

/// None when it was cut.
type KeptList = Mutex<Option<FlowList>>;

type FlowList = Box<dyn Iterator<Item = serde_json::Result<String>> + Send>;

impl FlowLists {
    const MOST: usize = 4;

    /// The same list, but cut when so many others were asked for later.
    fn keep(
        &self,
        list: FlowList,
    ) -> impl Iterator<Item = serde_json::Result<String>> + Send + 'static + use<> {
        let list = Arc::new(Mutex::new(Some(list)));
        let mut kept = lock(&self.kept);
        kept.retain(|list| list.strong_count() > 0);
        if kept.len() >= Self::MOST
            && let Some(oldest) = kept.pop_front().and_then(|list| list.upgrade())
        {
            *lock(&oldest) = None;
        }
        kept.push_back(Arc::downgrade(&list));
        iter::from_fn(move || match lock(&list).as_mut() {
            Some(list) => list.next(),
            None => Some(Err(serde_json::Error::custom("others asked for it later"))),
        })
    }
}

/// Nothing panics while it has one of these locks.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// `GET /api/v1/config`
pub(super) async fn config(State(shared): State<Shared>) -> Response {
    let in_force = shared.router.in_force();
    shared.turn.take(|| Json(ConfigInForce::of(&in_force.config)).into_response()).await
}

/// An object with one list, made and sent item by item.
fn json_list(
    name: &str,
    items: impl Iterator<Item = serde_json::Result<String>> + Send + 'static,
    turn: &Turn,
) -> Response {
    let separators = iter::once("\n").chain(iter::repeat(",\n"));
    let items = separators.zip(items);
    let items = items.map(|(separator, item)| item.map(|item| separator.to_owned() + &item));
    let chunks = iter::once(Ok(format!("{{\"{name}\":[")))
        .chain(items)
        .chain(iter::once(Ok("\n]}\n".to_owned())));
    ([(CONTENT_TYPE, "application/json")], turn.body(chunks)).into_response()
}

/// The process, and what belongs to no net.
#[derive(Serialize)]
struct Status<'a> {
    version: &'static str,
    /// Null where it is not known.
    commit: Option<&'static str>,
    ready: bool,
    uptime_seconds: f64,
    reload: ReloadState<'a>,
    workers: usize,
    public_ports: usize,
    max_flows: u32,
    /// About how many addresses have sent wrong passwords since the start.
    wrong_password_sources: u32,
    /// The estimate goes no further than this.
    wrong_password_sources_at_most: u32,
    /// From the plant, of no server of the table.
    stray_responses: DirectionState,
    /// Answers that the kernel dropped on sockets towards the plant, which belong to no net.
    upstream_kernel_dropped_datagrams: BTreeMap<&'static str, u64>,
    /// Upper bounds of `response_time_buckets`; one more bucket takes the rest.
    response_time_bounds_seconds: [f64; RESPONSE_BUCKETS.len()],
    sandbox: Vec<LayerState<'a>>,
}

/// How the last reload went.
#[derive(Serialize)]
struct ReloadState<'a> {
    /// All of the configuration that was last read is in force.
    successful: bool,
    /// Since the configuration in force came into force.
    in_force_seconds: f64,
    /// Reloads that have begun since the start.
    begun: u64,
    /// Which of them this tells of; 0: the start.
    number: u64,
    /// Why it changed nothing; null: it did not fail.
    error: Option<&'a str>,
    /// The faults of what was read.
    faults: &'a [String],
    /// What the configuration has that is in force, but for this.
    not_in_force: Vec<&'a NotInForce>,
}

impl<'a> ReloadState<'a> {
    fn of(last: &'a LastReload) -> Self {
        Self {
            successful: last.successful(),
            in_force_seconds: last.success_at.elapsed().as_secs_f64(),
            begun: last.begun,
            number: last.number,
            error: last.error.as_deref(),
            faults: &last.faults,
            not_in_force: last.not_in_force().collect(),
        }
    }
}

#[derive(Serialize)]
struct LayerState<'a> {
    layer: &'static str,
    state: &'static str,
    /// Null when there is nothing to explain.
    why: Option<&'a str>,
}

impl<'a> Status<'a> {
    fn of(shared: &'a Shared, last_reload: &'a LastReload) -> Self {
        let state = |(layer, state): (Layer, &'a sandbox::State)| LayerState {
            layer: layer.label(),
            state: state.label(),
            why: state.why(),
        };
        let in_force = shared.router.in_force();
        let Config { table, limits, .. } = &in_force.config;
        Self {
            version: env!("CARGO_PKG_VERSION"),
            commit: Some(COMMIT).filter(|commit| !commit.is_empty()),
            ready: shared.router.is_ready(),
            uptime_seconds: shared.router.started().elapsed().as_secs_f64(),
            reload: ReloadState::of(last_reload),
            workers: in_force.counters.len(),
            public_ports: table.mappings().len(),
            max_flows: limits.max_flows,
            wrong_password_sources: totals::wrong_password_sources(&in_force.counters, table),
            wrong_password_sources_at_most: SourceSketch::MOST,
            stray_responses: DirectionState::of(
                &NodeTotals::of_strays(&in_force.counters),
                Direction::Response,
            ),
            upstream_kernel_dropped_datagrams: in_force.upstream_kernel_drops().by_cause().into(),
            response_time_bounds_seconds: RESPONSE_BUCKETS,
            sandbox: shared.sandbox.layers().map(state).collect(),
        }
    }
}

/// What the configuration says of a net, without its nodes.
#[derive(Serialize)]
struct NetRules<'a> {
    name: &'a str,
    kind: &'static str,
    /// Of a UDP Range net only.
    start_port: Option<u16>,
    allow: &'a [IpNet],
    credentials: Vec<CredentialName<'a>>,
    allow_without_password: bool,
    require_response_password: bool,
    idle_timeout_seconds: f64,
    max_flows: u32,
    /// Null: any number.
    max_requests_per_second: Option<u32>,
    /// Null: any number.
    max_flow_requests_per_second: Option<u32>,
}

impl<'a> NetRules<'a> {
    fn of(net: &'a Net) -> Self {
        let (kind, start_port) = match net.kind {
            NetKind::UdpRange { start_port } => ("udp_range_net", Some(start_port)),
            NetKind::Server => ("server", None),
        };
        Self {
            name: &net.name,
            kind,
            start_port,
            allow: &net.allow,
            credentials: net.credentials.iter().map(CredentialName::of).collect(),
            allow_without_password: net.allow_without_password,
            require_response_password: net.require_response_password,
            idle_timeout_seconds: net.idle_timeout.as_secs_f64(),
            max_flows: net.max_flows,
            max_requests_per_second: net.max_requests.map(RequestRate::per_second),
            max_flow_requests_per_second: net.max_flow_requests.map(RequestRate::per_second),
        }
    }
}

#[derive(Serialize)]
struct CredentialName<'a> {
    name: &'a str,
    has_device_password: bool,
}

impl<'a> CredentialName<'a> {
    fn of(credential: &'a Credential) -> Self {
        Self { name: &credential.name, has_device_password: credential.device_password.is_some() }
    }
}

/// One element of the NAT table.
#[derive(Serialize)]
struct Element {
    node: u8,
    public_port: u16,
    server: SocketAddr,
}

impl Element {
    fn of(mapping: Mapping) -> Self {
        let Mapping { node_address, public_port, server, .. } = mapping;
        Self { node: node_address, public_port, server }
    }
}

/// A net and what happened there.
#[derive(Serialize)]
struct NetState<'a> {
    #[serde(flatten)]
    rules: NetRules<'a>,
    /// The /24 that all the servers of a UDP Range net stand in (PAS 7).
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
    /// Of all nodes together.
    #[serde(flatten)]
    traffic: Traffic,
    /// Absent when not asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    nodes: Option<Vec<NodeState>>,
}

impl<'a> NetState<'a> {
    fn of(in_force: &'a ActiveConfig, started: Instant, id: NetId) -> Self {
        let table = &in_force.config.table;
        let net = table.net(id);
        let totals = NetTotals::of_net(&in_force.counters, table, id);
        let node = |mapping| NodeState::of(in_force, started, mapping);
        let nodes: Vec<_> = table.mappings_of(id).map(node).collect();
        let count = |state: Presence| nodes.iter().filter(|node| node.presence == state).count();
        let silent = nodes.iter().filter(|node| node.presence == Presence::Silent);
        let closed = |reason: CloseReason| (reason.label(), totals.flows_closed(reason));
        let credentials = net.credentials.iter().map(|credential| credential.name.as_str());
        Self {
            rules: NetRules::of(net),
            subnet: subnet(table, id),
            flows: totals.flows,
            flows_opened: totals.flows_opened,
            flows_closed: CloseReason::ALL.into_iter().map(closed).collect(),
            accepted_requests: credentials.zip(totals.accepted.iter().copied()).collect(),
            kernel_dropped_datagrams: in_force.kernel_drops(id).by_cause().into(),
            wrong_password_sources: totals.wrong_password_sources,
            answering_nodes: count(Presence::Answering),
            silent_nodes: silent.map(|node| node.element.node).collect(),
            never_asked_nodes: count(Presence::NeverAsked),
            traffic: Traffic::of(&NodeTotals::of_net(&in_force.counters, table, id)),
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
    /// Since the last request that wants an answer; null: never.
    last_request_age_seconds: Option<f64>,
    /// Since the last response; null: never.
    last_response_age_seconds: Option<f64>,
}

fn label<S: Serializer>(presence: &Presence, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(presence.label())
}

/// Datagrams, and how long answers took, since the start.
#[derive(Serialize)]
struct Traffic {
    request: DirectionState,
    response: DirectionState,
    response_time_mean_seconds: Option<f64>,
    response_time_median_seconds: Option<f64>,
    response_time_p99_seconds: Option<f64>,
    /// How many answers fell into each bucket alone.
    response_time_buckets: [u64; RESPONSE_BUCKETS.len() + 1],
    /// The same by finer buckets, for who adds up nets or takes differences; those without an answer
    /// are left out.
    response_times: Vec<ResponseTimes>,
}

/// Answers that took about the same time.
#[derive(Serialize)]
struct ResponseTimes {
    /// Null: no bound.
    up_to_seconds: Option<f64>,
    answers: u64,
    sum_seconds: f64,
}

impl ResponseTimes {
    fn of(times: &ResponseTotals) -> Vec<Self> {
        let bucket = |(upper, bucket): (Option<Duration>, BucketTotals)| Self {
            up_to_seconds: upper.map(|upper| upper.as_secs_f64()),
            answers: bucket.answers,
            sum_seconds: bucket.sum.as_secs_f64(),
        };
        times.buckets().filter(|(_, bucket)| bucket.answers > 0).map(bucket).collect()
    }
}

impl Traffic {
    fn of(totals: &NodeTotals) -> Self {
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

impl NodeState {
    fn of(in_force: &ActiveConfig, started: Instant, mapping: MappingId) -> Self {
        let totals = NodeTotals::of_node(&in_force.counters, mapping);
        let now = started.elapsed();
        let age = |last| now.saturating_sub(last).as_secs_f64();
        Self {
            element: Element::of(in_force.config.table.mapping(mapping)),
            presence: totals.presence(now),
            traffic: Traffic::of(&totals),
            last_request_age_seconds: totals.last_request.map(age),
            last_response_age_seconds: totals.last_response.map(age),
        }
    }
}

#[derive(Serialize)]
struct DirectionState {
    received_datagrams: u64,
    forwarded_datagrams: u64,
    forwarded_bytes: u64,
    /// By reason; those at 0 are left out.
    dropped_datagrams: BTreeMap<&'static str, u64>,
}

impl DirectionState {
    fn of(node: &NodeTotals, direction: Direction) -> Self {
        let totals: &DirectionTotals = node.direction(direction);
        let reasons = direction.drop_reasons().iter();
        let dropped = reasons.map(|&reason| (reason.label(), totals.dropped(reason)));
        Self {
            received_datagrams: totals.received,
            forwarded_datagrams: totals.forwarded,
            forwarded_bytes: totals.forwarded_bytes,
            dropped_datagrams: dropped.filter(|&(_, n)| n > 0).collect(),
        }
    }
}

/// A flow.
#[derive(Serialize)]
struct Flow<'a> {
    net: &'a str,
    #[serde(flatten)]
    element: Element,
    client: SocketAddr,
    public_address: IpAddr,
    /// Null without a password.
    credential: Option<&'a str>,
    upstream_port: u16,
    age_seconds: f64,
    idle_seconds: f64,
}

impl<'a> Flow<'a> {
    fn of(table: &'a Table, flow: &FlowRecord) -> Self {
        let mapping = table.mapping(flow.mapping);
        let net = table.net(mapping.net);
        let credential = flow.credential.and_then(|index| net.credentials.get(index));
        Self {
            net: &net.name,
            element: Element::of(mapping),
            client: flow.client,
            public_address: flow.public_address,
            credential: credential.map(|credential| credential.name.as_str()),
            upstream_port: flow.upstream_port,
            age_seconds: flow.age.as_secs_f64(),
            idle_seconds: flow.idle.as_secs_f64(),
        }
    }
}

/// The configuration, passwords left out.
#[derive(Serialize)]
struct ConfigInForce<'a> {
    listen: &'a [IpAddr],
    header: String,
    nets: Vec<NetConfig<'a>>,
    max_flows: u32,
    wrong_password_burst: u16,
    wrong_password_address_burst: u32,
    wrong_password_interval_seconds: f64,
    audit_lines: u32,
    prefilter: &'static str,
    busy_poll_seconds: f64,
    /// Null: whoever started it.
    user: Option<&'a str>,
    /// Null: one for each two cores.
    workers: Option<usize>,
    receive_buffer_bytes: usize,
    drain_seconds: f64,
    /// Null when switched off.
    admin_listen: Option<SocketAddr>,
    /// Whether the admin server asks for a token.
    admin_has_token: bool,
    metrics_without_token: bool,
    /// Whether `POST /-/reload` is switched on.
    admin_reload: bool,
}

#[derive(Serialize)]
struct NetConfig<'a> {
    #[serde(flatten)]
    rules: NetRules<'a>,
    nodes: Vec<Element>,
}

impl<'a> ConfigInForce<'a> {
    fn of(config: &'a Config) -> Self {
        let Config { listen, table, limits, datapath, log, runtime, admin, files: _ } = config;
        let nets = table.net_ids().map(|id| NetConfig {
            rules: NetRules::of(table.net(id)),
            nodes: table.mappings_of(id).map(|m| Element::of(table.mapping(m))).collect(),
        });
        Self {
            listen,
            header: table.header.to_string(),
            nets: nets.collect(),
            max_flows: limits.max_flows,
            wrong_password_burst: limits.wrong_password_burst,
            wrong_password_address_burst: limits.wrong_password_address_burst,
            wrong_password_interval_seconds: limits.wrong_password_interval.as_secs_f64(),
            audit_lines: log.audit_lines,
            prefilter: datapath.prefilter.label(),
            busy_poll_seconds: datapath.busy_poll.as_secs_f64(),
            user: runtime.user.as_deref(),
            workers: runtime.workers.map(usize::from),
            receive_buffer_bytes: datapath.receive_buffer,
            drain_seconds: runtime.drain.as_secs_f64(),
            admin_listen: admin.as_ref().map(|admin| admin.listen),
            admin_has_token: admin.as_ref().is_some_and(|admin| admin.token.is_some()),
            metrics_without_token: admin.as_ref().is_some_and(|a| a.metrics_without_token),
            admin_reload: admin.as_ref().is_some_and(|admin| admin.reload),
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::config::fixture::{NODE_33, config};

    #[test]
    fn a_flow_names_its_net_node_and_credential() {
        let table = config().table;
        let record = FlowRecord {
            client: "198.51.100.9:50000".parse().unwrap(),
            public_address: "203.0.113.1".parse().unwrap(),
            mapping: NODE_33,
            credential: Some(1),
            upstream_port: 40999,
            age: Duration::from_millis(61_500),
            idle: Duration::from_millis(250),
        };
        assert_eq!(
            serde_json::to_value(Flow::of(&table, &record)).unwrap(),
            json!({
                "net": "section-1", "node": 33, "public_port": 40033,
                "server": "172.17.17.33:34379", "client": "198.51.100.9:50000",
                "public_address": "203.0.113.1", "credential": "team-b", "upstream_port": 40999,
                "age_seconds": 61.5, "idle_seconds": 0.25,
            })
        );
        let without = FlowRecord { credential: None, ..record };
        assert_eq!(Flow::of(&table, &without).credential, None);
    }
}
