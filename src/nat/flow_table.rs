//! The open flows of one worker, found by either side.
//!
//! Both indices hold nothing but flow numbers and compare inside the flows, so that a datagram of
//! one among a hundred thousand touches little memory beside its flow.

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

/// Flows by number, by client, and by server.
#[derive(Debug)]
pub(super) struct Flows {
    flows: Slab<Flow>,
    by_endpoints: Index,
    by_server: Index,
    hash: SeedableRandomState,
}

/// Flows by the hash of something. A table that grows stands still, and one that is large from the
/// start is slow, for few flows lie far apart in it. So it has parts, each of which grows by itself.
#[derive(Debug)]
struct Index([HashTable<FlowId>; PARTS]);

impl Flows {
    /// No flows, and room for so many: to make room later would hold up everybody.
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

    /// The same, when it may be closed by now.
    pub(super) fn find(&self, id: FlowId) -> Option<&Flow> {
        self.flows.get(id.key())
    }

    /// The same, when it may be closed by now.
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

    /// From here on, no request belongs to it.
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

/// By bits that a table does not use: it takes the lowest ones and the highest.
#[inline]
fn part(hash: u64) -> usize {
    (hash >> 32) as usize % PARTS
}

/// What a response's way in is known by.
fn server_side(flow: &Flow) -> (UpstreamId, SocketAddr) {
    (flow.upstream, flow.server)
}
