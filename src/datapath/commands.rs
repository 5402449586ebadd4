//! What the control plane asks of a worker, for every kind of datapath.

use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::time::Instant;

use tokio::sync::mpsc::Sender;

use crate::config::Datapath;
use crate::nat::{Counters, FlowRecord, Succession, Table};

use super::socket::public::Listeners;

/// What a worker is asked to do.
pub(in crate::datapath) enum Command {
    /// Answer, to show that the worker is alive.
    Ping(Sender<()>),
    /// Send at most this many flows, with the table that they belong to.
    Flows(usize, Sender<(Arc<Table>, Vec<FlowRecord>)>),
    /// Go over to another configuration. When all flows have gone over, tell how many were closed.
    Reload(Box<WorkerReload>, SyncSender<usize>),
    /// Close the upstream sockets whose ports are wanted for something else, each as soon as its
    /// last answers are in. Tell when none of them is left.
    CloseLeft(SyncSender<()>),
    /// Take no more requests, wait for answers until this time at the latest, and end.
    Drain(Instant),
}

/// What a worker needs to go over to another configuration.
pub(in crate::datapath) struct WorkerReload {
    pub succession: Succession,
    pub listeners: Listeners,
    pub upstream_limit: usize,
    pub settings: Datapath,
    /// The counters of flows in the kernel, where there are any.
    pub offload: Option<Arc<Counters>>,
}
