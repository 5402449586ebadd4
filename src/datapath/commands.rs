//! What the control plane asks of a worker, whatever datapath it is.

use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::time::Instant;

use tokio::sync::mpsc::Sender;

use crate::config::Datapath;
use crate::nat::{FlowRecord, Succession, Table};

use super::socket::public::Listeners;

/// What a worker is asked to do.
pub(in crate::datapath) enum Command {
    /// Say that you are alive.
    Ping(Sender<()>),
    /// Send up to so many flows, and the table that they belong to.
    Flows(usize, Sender<(Arc<Table>, Vec<FlowRecord>)>),
    /// Go over to another configuration, and tell how many flows were closed by it when all have
    /// gone over.
    Reload(Box<WorkerReload>, SyncSender<usize>),
    /// Close upstream sockets whose ports are wanted for something else, each as soon as its last
    /// answers are in, and tell when there is none left.
    CloseLeft(SyncSender<()>),
    /// Take no more requests, wait for answers until then at the latest, and end.
    Drain(Instant),
}

/// What a worker needs of another configuration.
pub(in crate::datapath) struct WorkerReload {
    pub succession: Succession,
    pub listeners: Listeners,
    pub upstream_limit: usize,
    pub settings: Datapath,
}
