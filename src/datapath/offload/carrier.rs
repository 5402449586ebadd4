//! What one worker has the kernel carry.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr, SocketAddrV4};
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use super::Offload;
use super::layout::{Ends, Entry, KernelFlow, Key, Terms};
use crate::datapath::socket::port_pool::Ports;
use crate::datapath::socket::sys::{bpf, options};
use crate::nat::{Counters, Lent, Offer, SharedFlow};

/// The flows of one worker in the kernel.
#[derive(Debug)]
pub(in crate::datapath) struct Carrier {
    offload: Arc<Offload>,
    /// Those of the kernel, for the table in force.
    counters: Arc<Counters>,
    /// By place, how the datagrams of both directions come in.
    keys: HashMap<u32, [Key; 2]>,
    /// The addresses of this machine towards servers, as they were when `offload.sources` had this value.
    sources: (u32, HashMap<IpAddr, IpAddr>),
}

impl Carrier {
    pub(in crate::datapath) fn new(offload: Arc<Offload>, counters: Arc<Counters>) -> Self {
        Self { offload, counters, keys: HashMap::new(), sources: Default::default() }
    }

    /// Goes over to the counters for another table.
    pub(in crate::datapath) fn reload(&mut self, counters: Arc<Counters>) {
        self.counters = counters;
    }

    /// Has the kernel carry a flow, once a datagram of each direction has shown the way. None where it cannot.
    pub(in crate::datapath) fn carry(
        &mut self,
        offer: &Offer<'_>,
        ports: &Arc<Ports>,
    ) -> Option<Lent<SharedFlow>> {
        let [node, credential] =
            self.counters.places(offer.mapping, offer.net, offer.credential)?;
        let client = ipv4(offer.client)?;
        let public = ipv4(SocketAddr::new(offer.public_address, offer.public_port))?;
        let server = ipv4(offer.server)?;
        let own = self.source_towards(offer.server, ports)?;
        let upstream = ipv4(SocketAddr::new(own, offer.upstream_port))?;
        let shared = self.offload.flows.lend()?;
        self.flow(shared.place()).set_password(*offer.password.octets());
        let (header, node_address, flow) = (offer.header.0, offer.node_address, shared.place());
        let terms = Terms { header, node_address, flow, node, credential };
        let entries = Entry::both(&Ends { client, public, upstream, server }, terms);
        let keys = entries.each_ref().map(|entry| entry.comes);
        if entries.iter().try_for_each(|entry| self.offload.enter(entry)).is_err() {
            self.remove(shared.place(), keys);
            return None;
        }
        self.keys.insert(shared.place(), keys);
        self.offload.set_lease();
        Some(shared)
    }

    /// The address of this machine that the kernel picks towards a server. If it picks another one for the
    /// datagrams, none of them takes the short way.
    fn source_towards(&mut self, server: SocketAddr, ports: &Arc<Ports>) -> Option<IpAddr> {
        let Self { offload, sources: (as_of, sources), .. } = self;
        let latest = offload.sources.load(Relaxed);
        if *as_of != latest {
            sources.clear();
            *as_of = latest;
        }
        if let Some(known) = sources.get(&server.ip()) {
            return Some(*known);
        }
        let own = options::source_towards(server, ports).ok()?;
        sources.insert(server.ip(), own);
        Some(own)
    }

    /// Has the kernel let go of the flow with this place.
    pub(in crate::datapath) fn let_go(&mut self, place: u32) {
        if let Some(keys) = self.keys.remove(&place) {
            self.remove(place, keys);
            self.offload.set_lease();
        }
    }

    fn flow(&self, place: u32) -> &KernelFlow {
        &self.offload.flows.all()[place as usize]
    }

    fn remove(&self, place: u32, keys: [Key; 2]) {
        self.flow(place).wipe();
        for key in keys {
            // An error: it is not there.
            let _ = bpf::delete(self.offload.entries.as_fd(), &key.to_octets());
        }
    }
}

fn ipv4(address: SocketAddr) -> Option<SocketAddrV4> {
    match address {
        SocketAddr::V4(address) => Some(address),
        SocketAddr::V6(_) => None,
    }
}
