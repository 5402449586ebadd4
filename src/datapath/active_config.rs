//! The configuration in force, from one reload to the next.
//!
//! A reader takes the whole [`ActiveConfig`] and keeps it until it has read everything. So its
//! figures and its table belong together. A retired configuration still tells its last figures, but
//! holds no socket open.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::config::{Config, Prefilter};
use crate::nat::{Counters, NetId, Rules};

use crate::datapath::socket::filtered::{KernelDrops, NetDrops};
use crate::datapath::socket::public::Listeners;

/// A configuration, and what is counted while it is in force.
#[derive(Debug)]
pub struct ActiveConfig {
    /// The configuration.
    pub config: Config,
    /// The checksum of each net, made once: whoever watches asks for it again and again.
    config_hashes: Vec<String>,
    /// The rules by which the workers decide.
    pub(in crate::datapath) rules: Rules,
    /// The counters of each worker, and behind them those of the flows in the kernel, if it carries any. A
    /// figure of the relay is the sum over all.
    pub counters: Vec<Arc<Counters>>,
    /// The number of workers.
    pub workers: usize,
    /// What the kernel dropped on the public sockets of each net.
    drops: Vec<Arc<NetDrops>>,
    /// What the kernel dropped on the upstream sockets, which belong to no net.
    pub(in crate::datapath) upstream_drops: Arc<NetDrops>,
    /// The public sockets of each worker.
    listeners: Mutex<Vec<Listeners>>,
}

impl ActiveConfig {
    pub(in crate::datapath) fn new(
        config: Config,
        rules: Rules,
        counters: Vec<Arc<Counters>>,
        workers: usize,
        drops: Vec<Arc<NetDrops>>,
        upstream_drops: Arc<NetDrops>,
        listeners: Vec<Listeners>,
    ) -> Self {
        let listeners = Mutex::new(listeners);
        let config_hashes = config.table.net_ids().map(|net| config.hash_of(net)).collect();
        Self { config, config_hashes, rules, counters, workers, drops, upstream_drops, listeners }
    }

    /// The same at all relays that configure the net alike.
    pub fn config_hash(&self, net: NetId) -> &str {
        &self.config_hashes[usize::from(net.0)]
    }

    /// Datagrams that the kernel dropped on a net's public sockets.
    pub fn kernel_drops(&self, net: NetId) -> KernelDrops {
        for (_, listener) in self.listeners().iter().flat_map(Listeners::iter) {
            if listener.net == net {
                listener.account();
            }
        }
        self.drops[usize::from(net.0)].get()
    }

    /// The same without asking the kernel, as the workers saw it last. During a flood, they look about
    /// once a second.
    pub fn kernel_drops_seen(&self, net: NetId) -> KernelDrops {
        self.drops[usize::from(net.0)].get()
    }

    /// For each net, whether the kernel refuses a flood at one of its public ports. There is nothing
    /// to tell of where the prefilter is always on or always off.
    pub fn floods(&self) -> Vec<bool> {
        let mut floods = vec![false; self.drops.len()];
        if self.config.datapath.prefilter == Prefilter::Auto {
            for (_, listener) in self.listeners().iter().flat_map(Listeners::iter) {
                floods[usize::from(listener.net.0)] |= listener.socket.is_filtered();
            }
        }
        floods
    }

    /// Datagrams that the kernel dropped on upstream sockets. The figure may be a second old.
    pub fn upstream_kernel_drops(&self) -> KernelDrops {
        self.upstream_drops.get()
    }

    /// The public sockets of each worker.
    pub(in crate::datapath) fn listeners(&self) -> MutexGuard<'_, Vec<Listeners>> {
        // The list is only read or emptied, so it is whole even after a panic.
        self.listeners.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the kernel dropped, for each net.
    pub(in crate::datapath) fn drops(&self) -> &[Arc<NetDrops>] {
        &self.drops
    }

    /// What the kernel dropped, under the name of each net.
    pub(in crate::datapath) fn drops_by_name(&self) -> HashMap<&str, &Arc<NetDrops>> {
        let names = self.config.table.nets().iter().map(|net| net.name.as_str());
        names.zip(&self.drops).collect()
    }

    /// Lets go of the public sockets.
    pub(in crate::datapath) fn retire(&self) {
        self.listeners().clear();
    }
}
