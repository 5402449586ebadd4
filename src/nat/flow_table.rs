//! The open flows of one worker. Requests and responses both find their flow here.
//!
//! Both indices hold only numbers of flows; keys are compared inside the flows. So a datagram of
//! one flow among a hundred thousand touches little memory besides its flow.

use std::array;
use std::hash::BuildHasher;
use std::net::SocketAddr;

use foldhash::fast::SeedableRandomState;
use hashbrown::HashTable;
use slab::Slab;

use super::flow::{Endpoints, Flow};
use super::ids::{FlowId, UpstreamId};

/// The parts of an index.
const PARTS: usize = 64;

/// Flows by their number, by the client's side and by the server's side.
#[derive(Debug)]
pub(super) struct Flows {
    flows: Slab<Flow>,
    by_endpoints: Index,
    by_server: Index,
    hash: SeedableRandomState,
}

/// Flows by a hash. To grow a large table takes so long that datagrams would wait, and a table that
/// is large from the start is slow, because a few flows lie far apart in it. So the index has
/// parts, and each grows by itself.
#[derive(Debug)]
struct Index([HashTable<FlowId>; PARTS]);

impl Flows {
    /// No flows, and memory for this many: to move them later would hold up all datagrams.
    pub(super) fn new(hash: SeedableRandomState, capacity: usize) -> Self {
        Self {
            flows: Slab::with_capacity(capacity),
            by_endpoints: Index::new(),
            by_server: Index::new(),
            hash,
        }
    }

    /// The flow that a request belongs to.
    #[inline]
    pub(super) fn of_request(&self, endpoints: &Endpoints) -> Option<FlowId> {
        let is_it = |id: &FlowId| self.get(*id).endpoints == *endpoints;
        self.by_endpoints.find(self.hash.hash_one(endpoints), is_it)
    }

    /// The flow that a response belongs to.
    #[inline]
    pub(super) fn of_response(&self, upstream: UpstreamId, server: SocketAddr) -> Option<FlowId> {
        let is_it = |id: &FlowId| {
            let flow = self.get(*id);
            flow.upstream == upstream && flow.server == server
        };
        self.by_server.find(self.hash.hash_one((upstream, server)), is_it)
    }

    #[inline]
    pub(super) fn get(&self, id: FlowId) -> &Flow {
        &self.flows[id.key()]
    }

    #[inline]
    pub(super) fn get_mut(&mut self, id: FlowId) -> &mut Flow {
        &mut self.flows[id.key()]
    }

    /// As `get`, for a flow that may be closed.
    pub(super) fn find(&self, id: FlowId) -> Option<&Flow> {
        self.flows.get(id.key())
    }

    /// As `get_mut`, for a flow that may be closed.
    #[inline]
    pub(super) fn find_mut(&mut self, id: FlowId) -> Option<&mut Flow> {
        self.flows.get_mut(id.key())
    }

    pub(super) fn insert(&mut self, flow: Flow) -> FlowId {
        let id = FlowId::new(self.flows.insert(flow));
        let Self { flows, by_endpoints, by_server, hash } = self;
        let hash_of = |id: &FlowId| hash.hash_one(flows[id.key()].endpoints);
        by_endpoints.insert(id, hash_of);
        let hash_of = |id: &FlowId| hash.hash_one(server_side(&flows[id.key()]));
        by_server.insert(id, hash_of);
        id
    }

    /// From now on, no request finds this flow.
    pub(super) fn leave(&mut self, id: FlowId) {
        let hash = self.hash.hash_one(self.get(id).endpoints);
        self.by_endpoints.remove(id, hash);
    }

    pub(super) fn remove(&mut self, id: FlowId) -> Flow {
        self.leave(id);
        let flow = self.flows.remove(id.key());
        self.by_server.remove(id, self.hash.hash_one(server_side(&flow)));
        flow
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (FlowId, &Flow)> {
        self.flows.iter().map(|(key, flow)| (FlowId::new(key), flow))
    }

    pub(super) fn contains(&self, id: FlowId) -> bool {
        self.flows.contains(id.key())
    }

    pub(super) fn len(&self) -> usize {
        self.flows.len()
    }
}

impl Index {
    fn new() -> Self {
        Self(array::from_fn(|_| HashTable::new()))
    }

    #[inline]
    fn find(&self, hash: u64, is_it: impl FnMut(&FlowId) -> bool) -> Option<FlowId> {
        self.0[part(hash)].find(hash, is_it).copied()
    }

    fn insert(&mut self, id: FlowId, hash_of: impl Fn(&FlowId) -> u64) {
        let hash = hash_of(&id);
        self.0[part(hash)].insert_unique(hash, id, hash_of);
    }

    fn remove(&mut self, id: FlowId, hash: u64) {
        if let Ok(entry) = self.0[part(hash)].find_entry(hash, |other| *other == id) {
            entry.remove();
        }
    }
}

/// Chosen by bits that the table does not use: it uses the lowest and the highest.
#[inline]
fn part(hash: u64) -> usize {
    (hash >> 32) as usize % PARTS
}

/// What a response finds its flow by.
fn server_side(flow: &Flow) -> (UpstreamId, SocketAddr) {
    (flow.upstream, flow.server)
}
