//! `/api/v1/config`: the configuration in force, without passwords.

use std::net::{IpAddr, SocketAddr};
use std::path::Path;

use axum::Json;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use ipnet::IpNet;
use serde::Serialize;

use crate::admin::Shared;
use crate::config::Config;
use crate::nat::{Credential, Mapping, Net, NetKind, RequestRate};

/// `GET /api/v1/config`
pub(in crate::admin) async fn config(State(shared): State<Shared>) -> Response {
    let active = shared.router.active_config();
    shared.turn.take(|| Json(ConfigInForce::of(&active.config)).into_response()).await
}

/// The configuration.
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
    kernel: &'static str,
    busy_poll_seconds: f64,
    /// Null: the user that started the relay.
    user: Option<&'a str>,
    /// Null: one for each two cores.
    workers: Option<usize>,
    receive_buffer_bytes: usize,
    pre_drain_seconds: f64,
    drain_seconds: f64,
    /// Null when the admin server is disabled.
    admin_listen: Option<SocketAddr>,
    /// Whether the admin server asks for a token.
    admin_has_token: bool,
    metrics_without_token: bool,
    /// Whether `POST /-/reload` is enabled.
    admin_reload: bool,
    /// Null: where the service manager has a folder for it, if it has one.
    control: Option<&'a Path>,
    /// Whether `POST /api/v1/probe` is enabled.
    admin_probe: bool,
    /// What the status page is called.
    admin_title: Option<&'a str>,
}

#[derive(Serialize)]
struct NetConfig<'a> {
    #[serde(flatten)]
    rules: NetRules<'a>,
    nodes: Vec<Element>,
}

impl<'a> ConfigInForce<'a> {
    fn of(config: &'a Config) -> Self {
        let Config { listen, table, limits, datapath, log, runtime, admin, control, .. } = config;
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
            kernel: datapath.kernel.label(),
            busy_poll_seconds: datapath.busy_poll.as_secs_f64(),
            user: runtime.user.as_deref(),
            workers: runtime.workers.map(usize::from),
            receive_buffer_bytes: datapath.receive_buffer,
            pre_drain_seconds: runtime.pre_drain.as_secs_f64(),
            drain_seconds: runtime.drain.as_secs_f64(),
            admin_listen: admin.as_ref().map(|admin| admin.listen),
            admin_has_token: admin.as_ref().is_some_and(|admin| admin.token.is_some()),
            metrics_without_token: admin.as_ref().is_some_and(|a| a.metrics_without_token),
            admin_reload: admin.as_ref().is_some_and(|admin| admin.reload),
            control: control.as_deref(),
            admin_probe: admin.as_ref().is_some_and(|admin| admin.probe),
            admin_title: admin.as_ref().and_then(|admin| admin.title.as_deref()),
        }
    }
}

/// What the configuration says of a net, without its nodes.
#[derive(Serialize)]
pub(super) struct NetRules<'a> {
    name: &'a str,
    kind: &'static str,
    /// Of a remote net, that of the other plant; null for a single server.
    start_port: Option<u16>,
    allow: &'a [IpNet],
    credentials: Vec<CredentialName<'a>>,
    allow_without_password: bool,
    require_response_password: bool,
    idle_timeout_seconds: f64,
    max_flows: u32,
    /// Null: no limit.
    max_requests_per_second: Option<u32>,
    /// Null: no limit.
    max_flow_requests_per_second: Option<u32>,
}

impl<'a> NetRules<'a> {
    pub(super) fn of(net: &'a Net) -> Self {
        let start_port = match net.kind {
            NetKind::UdpRange { start_port } | NetKind::Remote { start_port } => Some(start_port),
            NetKind::Server | NetKind::ProfinetDevice { .. } => None,
        };
        Self {
            name: &net.name,
            kind: net.kind.label(),
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
pub(super) struct Element {
    pub(super) node: u8,
    /// The one address at which it is reached, in a remote net; null: all of `[public] listen`.
    local_address: Option<IpAddr>,
    public_port: u16,
    server: SocketAddr,
}

impl Element {
    pub(super) fn of(mapping: Mapping) -> Self {
        let Mapping { node_address, local_address, public_port, server, .. } = mapping;
        Self { node: node_address, local_address, public_port, server }
    }
}
