//! Public sockets, and the mappings that they stand for.
//!
//! A socket stays open over a reload as long as its address and port are wanted. Its mapping may
//! change. Its place in a worker's [`Listeners`] never changes.

use std::collections::BTreeSet;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use crate::nat::{ListenerId, MappingId, NetId, Table};

use crate::datapath::kernel_filter::request;
use crate::datapath::socket::filtered::{FilteredSocket, NetDrops};
use crate::datapath::socket::sys::batch::Destination;

/// A public socket of one worker, with its mapping in the NAT table in force.
#[derive(Clone, Debug)]
pub(in crate::datapath) struct Listener {
    pub socket: Arc<FilteredSocket>,
    /// The address and port at which it listens.
    pub address: SocketAddr,
    pub mapping: MappingId,
    pub net: NetId,
    /// Whether datagrams may be longer than those of P-NET.
    pub is_long: bool,
    pub drops: Arc<NetDrops>,
}

/// The public sockets of one worker, by [`ListenerId`]. When a socket is closed, its place is empty
/// until another socket takes it.
#[derive(Clone, Debug, Default)]
pub(in crate::datapath) struct Listeners(Vec<Option<Listener>>);

impl Listener {
    /// The configured address. There is none when the socket serves all addresses of the router.
    pub(in crate::datapath) fn own_address(&self) -> Option<IpAddr> {
        Some(self.address.ip()).filter(|address| !address.is_unspecified())
    }

    /// How the destination of a datagram is known.
    pub(in crate::datapath) fn destination(&self) -> Destination {
        match self.own_address() {
            Some(_) => Destination::Bound,
            None => Destination::FromControl,
        }
    }

    /// Turns the request filter on or off. The program is the one for the net as it stands in
    /// `table`.
    pub(in crate::datapath) fn filter(&self, on: bool, table: &Table) -> io::Result<()> {
        let program =
            on.then(|| request::program(table.header, table.net(self.net), self.address.ip()));
        self.socket.filter(program.as_ref(), &self.drops)
    }

    /// Accounts for what the kernel dropped; see [`FilteredSocket::account`].
    pub(in crate::datapath) fn account(&self) -> Option<u32> {
        self.socket.account(&self.drops)
    }
}

impl Listeners {
    #[inline]
    pub(in crate::datapath) fn get(&self, id: ListenerId) -> Option<&Listener> {
        self.0.get(id.0 as usize)?.as_ref()
    }

    pub(in crate::datapath) fn iter(&self) -> impl Iterator<Item = (ListenerId, &Listener)> {
        let places = (0..).map(ListenerId).zip(&self.0);
        places.filter_map(|(id, listener)| Some((id, listener.as_ref()?)))
    }

    /// Number of places, with the empty ones.
    pub(in crate::datapath) fn places(&self) -> usize {
        self.0.len()
    }

    /// Puts a listener in its place.
    pub(in crate::datapath) fn put(&mut self, id: ListenerId, listener: Listener) {
        let index = id.0 as usize;
        if self.0.len() <= index {
            self.0.resize_with(index + 1, || None);
        }
        self.0[index] = Some(listener);
    }

    /// The places whose sockets in `before` are not in them any more.
    pub(in crate::datapath) fn gone(&self, before: &Self) -> BTreeSet<ListenerId> {
        before.iter().map(|(id, _)| id).filter(|&id| !self.keeps(id, before)).collect()
    }

    /// Empties a place.
    pub(in crate::datapath) fn remove(&mut self, id: ListenerId) {
        if let Some(place) = self.0.get_mut(id.0 as usize) {
            *place = None;
        }
    }

    /// Whether the socket in this place is the same in both.
    pub(in crate::datapath) fn keeps(&self, id: ListenerId, other: &Self) -> bool {
        let (here, there) = (self.get(id), other.get(id));
        here.zip(there).is_some_and(|(here, there)| Arc::ptr_eq(&here.socket, &there.socket))
    }
}
