//! Which of the router's own sockets a flow uses towards its server.
//!
//! One socket serves many clients, but never two at the same server: an answer is told apart by
//! (socket, server) alone. A client keeps to one socket as far as it can, so that a server's table
//! of dynamic clients does not fill. A pair that a flow gave up rests for 120 s before
//! another client may have it (N-9, RFC 6888 REQ-8); its port cannot be had again meanwhile, for
//! the socket stays open as long as one of its pairs is in use or rests. How many pairs a net may
//! have is bounded, and with them its sockets.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};

use foldhash::fast::SeedableRandomState;
use slab::Slab;

use super::budget::PairPlace;
use super::effects::Effects;
use super::ids::UpstreamId;
use super::queue::Queue;
use super::reason::DropReason;
use super::rules::Rules;
use super::table::{Mapping, Table};
use super::time::Nanos;

/// How long a pair that a flow gave up is kept from other clients.
const REST: Nanos = 120_000_000_000;

/// How many open sockets are tried at random before another is opened.
const PROBES: usize = 8;

/// How many are tried, beginning with any, when no other can be opened: who asks for it must not
/// hold up everybody else.
const LAST_PROBES: usize = 1024;

/// How many pairs are freed in one go. Each may take a socket with it, which costs a system call.
const AT_ONCE: usize = if cfg!(test) { 2 } else { 64 };

/// Whose flow a (socket, server) serves: the client and where it sends to. Answers that come late,
/// to a flow that was closed and opened again, leave from there too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Owner {
    pub client: SocketAddr,
    pub public_address: IpAddr,
    pub public_port: u16,
}

/// The upstream sockets of one worker and what each is used for.
#[derive(Debug)]
pub(super) struct Upstreams {
    sockets: Slab<Socket>,
    /// The keys of `sockets`, dense, to pick from.
    open: Vec<UpstreamId>,
    /// Those that no flow is given any more, until their last answers are in.
    leaving: Vec<UpstreamId>,
    pairs: HashMap<(UpstreamId, SocketAddr), Lease, SeedableRandomState>,
    homes: HashMap<(SocketAddr, IpAddr), ClientAffinity, SeedableRandomState>,
    /// When the pairs that were given up will have rested, in that order. One that was taken up
    /// again since is still here.
    resting: Queue<(Nanos, UpstreamId, SocketAddr)>,
    random: fastrand::Rng,
}

#[derive(Debug)]
struct Socket {
    ipv4: bool,
    port: u16,
    /// Its place among those that are open.
    place: usize,
    /// Pairs in use or resting.
    pairs: u32,
    state: SocketState,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum SocketState {
    Open,
    /// Its port is wanted for something else: it takes answers and is given to no flow.
    Leaving,
    /// That is over; its pairs do no more than rest.
    Closed,
}

/// A (socket, server) that is in use or rests.
#[derive(Debug)]
struct Lease {
    owner: Owner,
    state: PairState,
    _place: PairPlace,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum PairState {
    Used,
    RestsUntil(Nanos),
}

/// The socket that a client keeps to, for what it sends to one public address: towards a server, a
/// client of two needs two.
#[derive(Debug)]
struct ClientAffinity {
    socket: UpstreamId,
    /// The client's pairs in use or resting, on whichever socket.
    pairs: u32,
}

impl Upstreams {
    /// No sockets, and room for the pairs of so many flows.
    pub(super) fn new(hash: SeedableRandomState, random: fastrand::Rng, capacity: usize) -> Self {
        Self {
            sockets: Slab::new(),
            open: Vec::new(),
            leaving: Vec::new(),
            pairs: HashMap::with_capacity_and_hasher(capacity, hash.clone()),
            homes: HashMap::with_capacity_and_hasher(capacity, hash),
            resting: Queue::new(),
            random,
        }
    }

    /// Gives a flow a socket on which nobody else talks to its server, and tells its port. Fails when
    /// too many pairs of its net are in use or rest, or there is no such socket and no other can be
    /// opened.
    pub(super) fn assign(
        &mut self,
        owner: Owner,
        mapping: &Mapping,
        rules: &Rules,
        effects: &mut impl Effects,
    ) -> Result<(UpstreamId, u16), DropReason> {
        let server = mapping.server;
        let home = self.home(owner, server);
        if let Some(socket) = home
            && let Some(pair) = self.pairs.get_mut(&(socket, server))
        {
            pair.state = PairState::Used; // what rests for this very client
            return Ok((socket, self.sockets[socket.key()].port));
        }
        let place = rules.budget.take_pair(mapping.net).ok_or(DropReason::FlowLimit)?;
        let socket = home
            .or_else(|| self.probe(owner, server))
            .or_else(|| self.open(&rules.table, mapping, effects))
            .or_else(|| self.search(owner, server))
            .ok_or(DropReason::UpstreamExhausted)?;
        let used = Lease { owner, state: PairState::Used, _place: place };
        if self.pairs.insert((socket, server), used).is_none() {
            self.sockets[socket.key()].pairs += 1;
            let home =
                self.homes.entry(owner.home()).or_insert(ClientAffinity { socket, pairs: 0 });
            home.pairs += 1;
            let at_home = self.sockets.get(home.socket.key());
            if at_home.is_some_and(|socket| socket.state != SocketState::Open) {
                home.socket = socket;
            }
        }
        Ok((socket, self.sockets[socket.key()].port))
    }

    /// Gives no flow any more the sockets whose ports are wanted for something else.
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

    /// Whether a flow's socket is about to be closed, so that the flow has to go to another one.
    pub(super) fn is_leaving(&self, socket: UpstreamId) -> bool {
        let socket = self.sockets.get(socket.key());
        socket.is_some_and(|socket| socket.state == SocketState::Leaving)
    }

    /// Closes the sockets that are about to be closed and whose last answers are in. Tells whether
    /// there are others.
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

    /// Takes a flow's socket from it; the pair begins to rest.
    pub(super) fn release(&mut self, socket: UpstreamId, server: SocketAddr, now: Nanos) {
        if let Some(pair) = self.pairs.get_mut(&(socket, server)) {
            let end = now + REST;
            pair.state = PairState::RestsUntil(end);
            self.resting.push((end, socket, server));
        }
    }

    /// Frees the pairs that have rested, and closes the sockets that nothing needs any more: so many
    /// at a time. Tells whether there are more.
    pub(super) fn expire(&mut self, now: Nanos, effects: &mut impl Effects) -> bool {
        for _ in 0..AT_ONCE {
            let rested = self.resting.pop_if(|&(end, ..)| end <= now);
            let Some((end, socket, server)) = rested else { return false };
            let Some(pair) = self.pairs.get(&(socket, server)) else { continue };
            let (owner, state) = (pair.owner, pair.state);
            if state == PairState::RestsUntil(end) {
                self.pairs.remove(&(socket, server));
                self.leave_home(owner);
                self.leave_socket(socket, effects);
            }
        }
        true
    }

    pub(super) fn is_empty(&self) -> bool {
        self.sockets.is_empty()
    }

    /// Pairs in use or resting.
    #[cfg(test)]
    pub(super) fn pairs(&self) -> usize {
        self.pairs.len()
    }

    /// Panics where the tables do not agree with each other.
    #[cfg(test)]
    pub(super) fn check_invariants(&self, flows: usize) {
        let used = |pair: &&Lease| matches!(pair.state, PairState::Used);
        assert_eq!(self.pairs.values().filter(used).count(), flows);
        let are = |state| move |socket: &(usize, &Socket)| socket.1.state == state;
        let count = |state| self.sockets.iter().filter(are(state)).count();
        assert_eq!(self.open.len(), count(SocketState::Open));
        assert_eq!(self.leaving.len(), count(SocketState::Leaving));
        for (key, socket) in &self.sockets {
            let pairs = self.pairs.keys().filter(|(id, _)| id.key() == key).count();
            assert_eq!(pairs, socket.pairs as usize);
            assert!(pairs > 0, "a socket that nothing needs is closed");
            assert!(socket.state != SocketState::Open || self.open[socket.place].key() == key);
        }
        for (key, home) in &self.homes {
            let pairs = self.pairs.values().filter(|pair| pair.owner.home() == *key).count();
            assert_eq!(pairs, home.pairs as usize);
        }
    }

    fn home(&self, owner: Owner, server: SocketAddr) -> Option<UpstreamId> {
        let home = self.homes.get(&owner.home())?;
        self.may_use(home.socket, owner, server).then_some(home.socket)
    }

    fn probe(&mut self, owner: Owner, server: SocketAddr) -> Option<UpstreamId> {
        for _ in 0..PROBES.min(self.open.len()) {
            let socket = self.open[self.random.usize(..self.open.len())];
            if self.may_use(socket, owner, server) {
                return Some(socket);
            }
        }
        None
    }

    fn search(&mut self, owner: Owner, server: SocketAddr) -> Option<UpstreamId> {
        let (before, from) = self.open.split_at(self.random.usize(..=self.open.len()));
        let mut sockets = from.iter().chain(before).copied().take(LAST_PROBES);
        sockets.find(|&id| self.may_use(id, owner, server))
    }

    fn open(
        &mut self,
        table: &Table,
        to: &Mapping,
        effects: &mut impl Effects,
    ) -> Option<UpstreamId> {
        let place = self.sockets.vacant_entry();
        let socket = UpstreamId(u32::try_from(place.key()).ok()?);
        let port = effects.open_upstream(table, socket, to.net, to.server.is_ipv4())?;
        let (ipv4, at) = (to.server.is_ipv4(), self.open.len());
        place.insert(Socket { ipv4, port, place: at, pairs: 0, state: SocketState::Open });
        self.open.push(socket);
        Some(socket)
    }

    fn may_use(&self, socket: UpstreamId, owner: Owner, server: SocketAddr) -> bool {
        // A client's home may have been closed, while it still has pairs elsewhere.
        self.sockets.get(socket.key()).is_some_and(|socket| {
            socket.ipv4 == server.is_ipv4() && socket.state == SocketState::Open
        }) && self.pairs.get(&(socket, server)).is_none_or(|pair| {
            // A pair does not have to rest for whom it served.
            pair.owner == owner && matches!(pair.state, PairState::RestsUntil(_))
        })
    }

    fn leave_home(&mut self, owner: Owner) {
        if let Some(home) = self.homes.get_mut(&owner.home()) {
            home.pairs -= 1;
            if home.pairs == 0 {
                self.homes.remove(&owner.home());
            }
        }
    }

    fn leave_socket(&mut self, socket: UpstreamId, effects: &mut impl Effects) {
        let pairs = &mut self.sockets[socket.key()].pairs;
        *pairs -= 1;
        if *pairs == 0 {
            let Socket { place, state, .. } = self.sockets.remove(socket.key());
            match state {
                SocketState::Open => self.forget(place),
                SocketState::Leaving => self.leaving.retain(|&id| id != socket),
                SocketState::Closed => return,
            }
            effects.close_upstream(socket);
        }
    }

    /// Takes a socket from among those that are open, where it has this place.
    fn forget(&mut self, place: usize) {
        self.open.swap_remove(place);
        if let Some(moved) = self.open.get(place) {
            self.sockets[moved.key()].place = place;
        }
    }
}

impl Owner {
    /// What homes are found by.
    fn home(self) -> (SocketAddr, IpAddr) {
        (self.client, self.public_address)
    }
}
