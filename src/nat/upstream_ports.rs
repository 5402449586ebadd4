//! Which of the router's upstream sockets a flow uses towards its server.
//!
//! One socket serves many clients, but at each server only one of them: an answer shows nothing but
//! the socket and the server that it belongs to. So a flow has a lease on its pair (socket, server). A
//! client keeps the same socket where possible, so that the servers' tables of dynamic clients do
//! not fill up.
//!
//! After a flow has ended, its lease rests for 120 s before another client may have the pair (N-9,
//! RFC 6888 REQ-8). A socket stays open as long as one of its leases is in use or rests, so its port
//! is not free for others either. The number of leases of each net has a limit, and so has the number of
//! sockets.

mod owner;

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};

use foldhash::fast::SeedableRandomState;
use slab::Slab;

use super::budget::LeasePlace;
use super::effects::Effects;
use super::ids::{NetId, UpstreamId};
use super::net::Mapping;
use super::queue::Queue;
use super::reason::DropReason;
use super::rules::Rules;
use super::table::Table;
use super::time::Nanos;

pub(super) use owner::Owner;
pub use owner::SocketKind;

/// How long a lease rests after its flow has ended.
const REST: Nanos = 120_000_000_000;

/// How many open sockets are tried at random before another one is opened.
const PROBES: usize = 8;

/// How many are tried one after the other when no other socket can be opened. A longer search would
/// hold up all other datagrams.
const LAST_PROBES: usize = 1024;

/// How many leases one call drops. Each may close a socket, which costs a system call.
const AT_ONCE: usize = if cfg!(test) { 2 } else { 64 };

/// The upstream sockets of one worker and what each is used for.
#[derive(Debug)]
pub(super) struct Upstreams {
    sockets: Slab<Socket>,
    /// The keys of the open sockets in a dense list, to pick one at random.
    open: Vec<UpstreamId>,
    /// Sockets that wait for last answers and take no new flow.
    leaving: Vec<UpstreamId>,
    leases: HashMap<(UpstreamId, SocketAddr), Lease, SeedableRandomState>,
    affinities: HashMap<(SocketAddr, IpAddr), ClientAffinity, SeedableRandomState>,
    /// Resting leases, in the order in which their rest ends. A lease that came into use again is
    /// still in here.
    resting: Queue<(Nanos, UpstreamId, SocketAddr)>,
    random: fastrand::Rng,
}

#[derive(Debug)]
struct Socket {
    kind: SocketKind,
    port: u16,
    /// Its index in `open`.
    place: usize,
    /// Leases in use or resting.
    leases: u32,
    state: SocketState,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum SocketState {
    Open,
    /// Its port is wanted for something else: it waits for last answers and takes no new flow.
    Leaving,
    /// Closed after that. Its leases still rest.
    Closed,
}

/// The use of a pair (socket, server) by one client, and its rest afterwards.
#[derive(Debug)]
struct Lease {
    owner: Owner,
    state: LeaseState,
    _place: LeasePlace,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum LeaseState {
    InUse,
    RestsUntil(Nanos),
}

/// The socket that a client keeps for all that it sends to one public address. A client that sends
/// to two public addresses needs two sockets, because it may talk to one server through both.
#[derive(Debug)]
struct ClientAffinity {
    socket: UpstreamId,
    /// The client's leases in use or resting, on whichever socket.
    leases: u32,
}

impl Upstreams {
    /// No sockets, and memory for the leases of this many flows.
    pub(super) fn new(hash: SeedableRandomState, random: fastrand::Rng, capacity: usize) -> Self {
        Self {
            sockets: Slab::new(),
            open: Vec::new(),
            leaving: Vec::new(),
            leases: HashMap::with_capacity_and_hasher(capacity, hash.clone()),
            affinities: HashMap::with_capacity_and_hasher(capacity, hash),
            resting: Queue::new(),
            random,
        }
    }

    /// Finds a socket for a flow on which nobody else talks to its server, and returns it with its
    /// port. Fails with [`FlowLimit`](DropReason::FlowLimit) when as many leases as allowed are in
    /// use or rest, and with [`UpstreamExhausted`](DropReason::UpstreamExhausted) when there is no
    /// such socket and no other can be opened.
    pub(super) fn assign(
        &mut self,
        owner: Owner,
        mapping: &Mapping,
        rules: &Rules,
        effects: &mut impl Effects,
    ) -> Result<(UpstreamId, u16), DropReason> {
        let server = rules.table.answers_from(mapping);
        let kind = rules.table.socket_kind(mapping);
        let kept = self.kept_socket(owner, kind, server);
        if let Some(socket) = kept
            && let Some(lease) = self.leases.get_mut(&(socket, server))
        {
            lease.state = LeaseState::InUse; // the client's own, which rests
            return Ok((socket, self.sockets[socket.key()].port));
        }
        let place = rules.budget.take_lease(mapping.net).ok_or(DropReason::FlowLimit)?;
        let socket = kept
            .or_else(|| self.probe(owner, kind, server))
            .or_else(|| self.open(&rules.table, mapping.net, kind, effects))
            .or_else(|| self.search(owner, kind, server))
            .ok_or(DropReason::UpstreamExhausted)?;
        let lease = Lease { owner, state: LeaseState::InUse, _place: place };
        if self.leases.insert((socket, server), lease).is_none() {
            self.sockets[socket.key()].leases += 1;
            let affinity = self
                .affinities
                .entry(owner.affinity())
                .or_insert(ClientAffinity { socket, leases: 0 });
            affinity.leases += 1;
            let kept = self.sockets.get(affinity.socket.key());
            if kept.is_some_and(|socket| socket.state != SocketState::Open) {
                affinity.socket = socket;
            }
        }
        Ok((socket, self.sockets[socket.key()].port))
    }

    /// From now on, no new flow gets a socket whose port is wanted for something else.
    pub(super) fn leave(&mut self, is_wanted: impl Fn(u16) -> bool) {
        let wanted = |id: &UpstreamId| is_wanted(self.sockets[id.key()].port);
        let leaving: Vec<_> = self.open.iter().copied().filter(wanted).collect();
        for &id in &leaving {
            let socket = &mut self.sockets[id.key()];
            socket.state = SocketState::Leaving;
            let place = socket.place;
            self.forget(place);
        }
        self.leaving.extend(leaving);
    }

    /// Whether a socket is about to be closed, so that its flows need another one.
    pub(super) fn is_leaving(&self, socket: UpstreamId) -> bool {
        let socket = self.sockets.get(socket.key());
        socket.is_some_and(|socket| socket.state == SocketState::Leaving)
    }

    /// Closes the sockets that are about to be closed and are not used by a flow any more. True
    /// while there are others.
    pub(super) fn close_left(
        &mut self,
        is_used: impl Fn(UpstreamId) -> bool,
        effects: &mut impl Effects,
    ) -> bool {
        let sockets = &mut self.sockets;
        self.leaving.retain(|&id| {
            if is_used(id) {
                return true;
            }
            sockets[id.key()].state = SocketState::Closed;
            effects.close_upstream(id);
            false
        });
        !self.leaving.is_empty()
    }

    /// Ends the use of a lease. It begins to rest.
    pub(super) fn release(&mut self, socket: UpstreamId, server: SocketAddr, now: Nanos) {
        if let Some(lease) = self.leases.get_mut(&(socket, server)) {
            let end = now + REST;
            lease.state = LeaseState::RestsUntil(end);
            self.resting.push((end, socket, server));
        }
    }

    /// Drops leases whose rest is over, and closes sockets without a lease. Each call does a part of
    /// it; true means that there may be more.
    pub(super) fn expire(&mut self, now: Nanos, effects: &mut impl Effects) -> bool {
        for _ in 0..AT_ONCE {
            let rested = self.resting.pop_if(|&(end, ..)| end <= now);
            let Some((end, socket, server)) = rested else { return false };
            let Some(lease) = self.leases.get(&(socket, server)) else { continue };
            let (owner, state) = (lease.owner, lease.state);
            if state == LeaseState::RestsUntil(end) {
                self.leases.remove(&(socket, server));
                self.leave_affinity(owner);
                self.leave_socket(socket, effects);
            }
        }
        true
    }

    pub(super) fn is_empty(&self) -> bool {
        self.sockets.is_empty()
    }

    /// Leases in use or resting.
    #[cfg(test)]
    pub(super) fn leases(&self) -> usize {
        self.leases.len()
    }

    /// Panics where the tables do not agree with each other.
    #[cfg(test)]
    pub(super) fn check_invariants(&self, flows: usize) {
        let in_use = |lease: &&Lease| matches!(lease.state, LeaseState::InUse);
        assert_eq!(self.leases.values().filter(in_use).count(), flows);
        let are = |state| move |socket: &(usize, &Socket)| socket.1.state == state;
        let count = |state| self.sockets.iter().filter(are(state)).count();
        assert_eq!(self.open.len(), count(SocketState::Open));
        assert_eq!(self.leaving.len(), count(SocketState::Leaving));
        for (key, socket) in &self.sockets {
            let leases = self.leases.keys().filter(|(id, _)| id.key() == key).count();
            assert_eq!(leases, socket.leases as usize);
            assert!(leases > 0, "a socket that nothing needs is closed");
            assert!(socket.state != SocketState::Open || self.open[socket.place].key() == key);
        }
        for (key, affinity) in &self.affinities {
            let leases =
                self.leases.values().filter(|lease| lease.owner.affinity() == *key).count();
            assert_eq!(leases, affinity.leases as usize);
        }
    }

    fn kept_socket(
        &self,
        owner: Owner,
        kind: SocketKind,
        server: SocketAddr,
    ) -> Option<UpstreamId> {
        let affinity = self.affinities.get(&owner.affinity())?;
        self.may_use(affinity.socket, owner, kind, server).then_some(affinity.socket)
    }

    fn probe(&mut self, owner: Owner, kind: SocketKind, server: SocketAddr) -> Option<UpstreamId> {
        for _ in 0..PROBES.min(self.open.len()) {
            let socket = self.open[self.random.usize(..self.open.len())];
            if self.may_use(socket, owner, kind, server) {
                return Some(socket);
            }
        }
        None
    }

    fn search(&mut self, owner: Owner, kind: SocketKind, server: SocketAddr) -> Option<UpstreamId> {
        let (before, from) = self.open.split_at(self.random.usize(..=self.open.len()));
        let mut sockets = from.iter().chain(before).copied().take(LAST_PROBES);
        sockets.find(|&id| self.may_use(id, owner, kind, server))
    }

    fn open(
        &mut self,
        table: &Table,
        net: NetId,
        kind: SocketKind,
        effects: &mut impl Effects,
    ) -> Option<UpstreamId> {
        let place = self.sockets.vacant_entry();
        let socket = UpstreamId(u32::try_from(place.key()).ok()?);
        let port = effects.open_upstream(table, socket, net, kind)?;
        let at = self.open.len();
        place.insert(Socket { kind, port, place: at, leases: 0, state: SocketState::Open });
        self.open.push(socket);
        Some(socket)
    }

    fn may_use(
        &self,
        socket: UpstreamId,
        owner: Owner,
        kind: SocketKind,
        server: SocketAddr,
    ) -> bool {
        // The client's socket may be closed while the client still has leases on others.
        self.sockets
            .get(socket.key())
            .is_some_and(|socket| socket.kind == kind && socket.state == SocketState::Open)
            && self.leases.get(&(socket, server)).is_none_or(|lease| {
                // The client that had the lease need not wait.
                lease.owner == owner && matches!(lease.state, LeaseState::RestsUntil(_))
            })
    }

    fn leave_affinity(&mut self, owner: Owner) {
        if let Some(affinity) = self.affinities.get_mut(&owner.affinity()) {
            affinity.leases -= 1;
            if affinity.leases == 0 {
                self.affinities.remove(&owner.affinity());
            }
        }
    }

    fn leave_socket(&mut self, socket: UpstreamId, effects: &mut impl Effects) {
        let leases = &mut self.sockets[socket.key()].leases;
        *leases -= 1;
        if *leases == 0 {
            let Socket { place, state, .. } = self.sockets.remove(socket.key());
            match state {
                SocketState::Open => self.forget(place),
                SocketState::Leaving => self.leaving.retain(|&id| id != socket),
                SocketState::Closed => return,
            }
            effects.close_upstream(socket);
        }
    }

    /// Removes the socket at this index from the open ones.
    fn forget(&mut self, place: usize) {
        self.open.swap_remove(place);
        if let Some(moved) = self.open.get(place) {
            self.sockets[moved.key()].place = place;
        }
    }
}
