//! `/api/v1/flows`: the open flows.

use std::collections::{HashMap, VecDeque};
use std::iter;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::ser::Error as _;
use serde::{Deserialize, Serialize};

use super::config::Element;
use super::json_list_and;
use crate::admin::Shared;
use crate::datapath::ActiveConfig;
use crate::nat::{FlowRecord, FlowTraffic, Net, Table};

const DEFAULT_FLOWS: usize = 1000;
/// A worker makes its list between two datagrams, so the list must be short.
const MOST_FLOWS: usize = 10_000;

/// Query of [`flows`].
#[derive(Deserialize)]
pub(in crate::admin) struct FlowsQuery {
    limit: Option<usize>,
    /// Only flows of the net with this name.
    net: Option<String>,
}

/// `GET /api/v1/flows?limit=&net=`
pub(in crate::admin) async fn flows(
    State(shared): State<Shared>,
    Query(query): Query<FlowsQuery>,
) -> Response {
    let limit = query.limit.unwrap_or(DEFAULT_FLOWS);
    if limit > MOST_FLOWS {
        let message = format!("limit is at most {MOST_FLOWS}\n");
        return (StatusCode::BAD_REQUEST, message).into_response();
    }
    let active = shared.router.active_config();
    let is_asked_for = |net: &Net| query.net.as_ref().is_none_or(|name| net.name == *name);
    if !active.config.table.nets().iter().any(is_asked_for) {
        return (StatusCode::NOT_FOUND, "no net has this name\n").into_response();
    }
    // A worker would look for a net among all of its flows; so it lists those of all nets.
    let listed = if query.net.is_some() { MOST_FLOWS } else { limit };
    let asking = shared.flow_lists.asking.lock().await;
    let Some(lists) = shared.router.flows(listed).await else {
        let message = "a worker does not answer\n";
        return (StatusCode::SERVICE_UNAVAILABLE, message).into_response();
    };
    drop(asking);
    let has_all = lists.iter().map(|(_, flows)| flows.len()).sum::<usize>() < listed;
    let flows = lists
        .into_iter()
        .flat_map(|(table, flows)| flows.into_iter().map(move |flow| (Arc::clone(&table), flow)));
    let mut flows: Vec<_> =
        flows.filter(|(table, flow)| is_asked_for(net_of(table, flow))).collect();
    let complete = has_all && flows.len() <= limit;
    flows.truncate(limit);
    let credentials = credentials(&active, &flows, is_asked_for);
    let members = serde_json::to_string(&credentials)
        .map(|credentials| format!(",\n\"credentials\":{credentials},\"complete\":{complete}"));
    let Ok(members) = members else {
        return StatusCode::INTERNAL_SERVER_ERROR.into_response(); // names are text
    };
    let flows =
        flows.into_iter().map(|(table, flow)| serde_json::to_string(&Flow::of(&table, &flow)));
    json_list_and("flows", shared.flow_lists.keep(Box::new(flows)), &members, &shared.turn)
}

/// How much a password is used.
#[derive(Serialize)]
struct CredentialUse<'a> {
    net: &'a str,
    credential: &'a str,
    /// Since the start.
    accepted_requests: u64,
    /// Listed flows whose latest request carried it.
    flows: u64,
}

fn credentials<'a>(
    active: &'a ActiveConfig,
    flows: &[(Arc<Table>, FlowRecord)],
    is_asked_for: impl Fn(&Net) -> bool,
) -> Vec<CredentialUse<'a>> {
    let table = &active.config.table;
    let mut used = HashMap::new();
    for (table, flow) in flows {
        let net = net_of(table, flow);
        if let Some(credential) = credential_of(net, flow) {
            *used.entry((net.name.as_str(), credential)).or_insert(0) += 1;
        }
    }
    let credentials = table.net_ids().filter(|&id| is_asked_for(table.net(id))).flat_map(|id| {
        let net = table.net(id);
        let accepted = move |index: usize| {
            active.counters.iter().map(|worker| worker.accepted(id)[index].get()).sum()
        };
        net.credentials.iter().enumerate().map(move |(index, credential)| {
            (net.name.as_str(), credential.name.as_str(), accepted(index))
        })
    });
    let of = |(net, credential, accepted_requests)| CredentialUse {
        net,
        credential,
        accepted_requests,
        flows: used.get(&(net, credential)).copied().unwrap_or_default(),
    };
    credentials.map(of).collect()
}

fn net_of<'a>(table: &'a Table, flow: &FlowRecord) -> &'a Net {
    table.net(table.mapping(flow.mapping).net)
}

/// The name of the credential of the latest request.
fn credential_of<'a>(net: &'a Net, flow: &FlowRecord) -> Option<&'a str> {
    let credential = flow.credential.and_then(|index| net.credentials.get(index));
    credential.map(|credential| credential.name.as_str())
}

/// A list of flows is large, and the workers are woken to make it. So only one is made at a time, and
/// only a few are kept for slow clients.
#[derive(Clone, Default)]
pub(in crate::admin) struct FlowLists {
    asking: Arc<tokio::sync::Mutex<()>>,
    /// Oldest first.
    kept: Arc<Mutex<VecDeque<Weak<KeptList>>>>,
}

/// None: it was cut.
type KeptList = Mutex<Option<FlowList>>;

type FlowList = Box<dyn Iterator<Item = serde_json::Result<String>> + Send>;

impl FlowLists {
    const MOST: usize = 4;

    /// The same list, but it is cut when too many later ones were asked for.
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
            None => Some(Err(serde_json::Error::custom("too many later requests"))),
        })
    }
}

/// No code panics while it holds one of these locks.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A flow.
#[derive(Serialize)]
struct Flow<'a> {
    net: &'a str,
    #[serde(flatten)]
    element: Element,
    client: SocketAddr,
    public_address: IpAddr,
    /// Null: the client sent no password.
    credential: Option<&'a str>,
    upstream_port: u16,
    age_seconds: f64,
    idle_seconds: f64,
    /// Requests that were accepted.
    requests: u64,
    /// Datagrams of the server that were passed on.
    responses: u64,
    /// The UDP payload of both.
    octets: u64,
}

impl<'a> Flow<'a> {
    fn of(table: &'a Table, flow: &FlowRecord) -> Self {
        let mapping = table.mapping(flow.mapping);
        let net = table.net(mapping.net);
        let FlowTraffic { requests, responses, octets } = flow.traffic;
        Self {
            net: &net.name,
            element: Element::of(mapping),
            client: flow.client,
            public_address: flow.public_address,
            credential: credential_of(net, flow),
            upstream_port: flow.upstream_port,
            age_seconds: flow.age.as_secs_f64(),
            idle_seconds: flow.idle.as_secs_f64(),
            requests,
            responses,
            octets,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

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
            upstream_port: 20999,
            age: Duration::from_millis(61_500),
            idle: Duration::from_millis(250),
            traffic: FlowTraffic { requests: 7, responses: 6, octets: 400 },
        };
        assert_eq!(
            serde_json::to_value(Flow::of(&table, &record)).unwrap(),
            json!({
                "net": "section-1", "node": 33, "local_address": null, "public_port": 20033,
                "server": "172.17.17.33:34379", "client": "198.51.100.9:50000",
                "public_address": "203.0.113.1", "credential": "team-b", "upstream_port": 20999,
                "age_seconds": 61.5, "idle_seconds": 0.25,
                "requests": 7, "responses": 6, "octets": 400,
            })
        );
        let without = FlowRecord { credential: None, ..record };
        assert_eq!(Flow::of(&table, &without).credential, None);
    }
}
