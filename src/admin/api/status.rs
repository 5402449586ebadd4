//! `/api/v1/status`: the process, its last reload, and what belongs to no net.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use super::traffic::DirectionState;
use crate::COMMIT;
use crate::admin::Shared;
use crate::config::{Changes, Config, NotInForce};
use crate::datapath::{ActiveConfig, LastReload, OffloadState};
use crate::nat::{Direction, RESPONSE_BUCKETS, SourceSketch};
use crate::observe::totals::{self, NodeTotals};
use crate::sandbox::{self, Layer};

/// `GET /api/v1/status`
pub(in crate::admin) async fn status(State(shared): State<Shared>) -> Response {
    let (active, last_reload) = (shared.router.active_config(), shared.router.last_reload());
    Json(Status::of(&shared, &active, &last_reload)).into_response()
}

/// The process, and what belongs to no net.
#[derive(Serialize)]
struct Status<'a> {
    version: &'static str,
    /// Null when it is not known.
    commit: Option<&'static str>,
    /// What the status page is called; null: nothing.
    title: Option<&'a str>,
    ready: bool,
    uptime_seconds: f64,
    reload: ReloadState<'a>,
    workers: usize,
    public_ports: usize,
    max_flows: u32,
    /// About how many addresses have sent wrong passwords since the start.
    wrong_password_sources: u32,
    /// The upper limit of that estimate.
    wrong_password_sources_at_most: u32,
    /// Datagrams from the plant that no server of the table sent.
    stray_responses: DirectionState,
    /// What the kernel dropped on sockets towards the plant. These sockets belong to no net.
    upstream_kernel_dropped_datagrams: BTreeMap<&'static str, u64>,
    /// Upper bounds of `response_time_buckets`; the last bucket has none.
    response_time_bounds_seconds: [f64; RESPONSE_BUCKETS.len()],
    sandbox: Vec<LayerState<'a>>,
    offload: KernelState,
    /// Whether `POST /api/v1/probe` is enabled.
    probe: bool,
}

/// How the last reload went.
#[derive(Serialize)]
struct ReloadState<'a> {
    /// Whether all of the configuration that was last read is in force.
    successful: bool,
    /// How long the current configuration has been in force.
    in_force_seconds: f64,
    /// Reloads that have begun since the start.
    begun: u64,
    /// The number of the reload described here; 0: the start.
    number: u64,
    /// Why it failed; null: it did not.
    error: Option<&'a str>,
    /// The faults of the configuration that was read.
    faults: &'a [String],
    /// What it changed; nothing when it failed.
    changes: &'a Changes,
    /// Flows that it closed because the new configuration has no place for them.
    flows_closed: usize,
    /// Parts of the configuration that are not in force.
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
            changes: &last.changes,
            flows_closed: last.flows_closed,
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

/// Whether the kernel carries open flows.
#[derive(Serialize)]
struct KernelState {
    /// `on` or `off`.
    state: &'static str,
    /// Why it is off; null: it is on.
    why: Option<String>,
    /// Flows that the kernel carries now.
    flows: usize,
    /// The interfaces at which it does.
    interfaces: Vec<String>,
}

impl From<OffloadState> for KernelState {
    fn from(OffloadState { why_not, flows, interfaces }: OffloadState) -> Self {
        let state = if why_not.is_none() { "on" } else { "off" };
        Self { state, why: why_not, flows, interfaces }
    }
}

impl<'a> Status<'a> {
    fn of(shared: &'a Shared, active: &'a ActiveConfig, last_reload: &'a LastReload) -> Self {
        let state = |(layer, state): (Layer, &'a sandbox::State)| LayerState {
            layer: layer.label(),
            state: state.label(),
            why: state.why(),
        };
        let Config { table, limits, admin, .. } = &active.config;
        Self {
            version: env!("CARGO_PKG_VERSION"),
            commit: Some(COMMIT).filter(|commit| !commit.is_empty()),
            title: admin.as_ref().and_then(|admin| admin.title.as_deref()),
            ready: shared.router.is_ready(),
            uptime_seconds: shared.router.started().elapsed().as_secs_f64(),
            reload: ReloadState::of(last_reload),
            workers: active.workers,
            public_ports: table.mappings().len(),
            max_flows: limits.max_flows,
            wrong_password_sources: totals::wrong_password_sources(&active.counters, table),
            wrong_password_sources_at_most: SourceSketch::MOST,
            stray_responses: DirectionState::of(
                &NodeTotals::of_strays(&active.counters),
                Direction::Response,
            ),
            upstream_kernel_dropped_datagrams: active.upstream_kernel_drops().by_cause().into(),
            response_time_bounds_seconds: RESPONSE_BUCKETS,
            sandbox: shared.sandbox.layers().map(state).collect(),
            offload: shared.router.offload().into(),
            probe: admin.as_ref().is_some_and(|admin| admin.probe),
        }
    }
}
