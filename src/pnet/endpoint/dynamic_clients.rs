//! The clients that a server has no row for in its IPNetTable: net 125 (PAS 9).

use std::net::SocketAddrV4;
use std::time::Duration;

use arrayvec::ArrayVec;

use crate::pnet::wire::{LAST_NODE, NodeAddress, Password};

/// A client in net 125.
#[derive(Clone, Debug)]
pub struct DynamicClient {
    /// Where it sent its last request from.
    pub address: SocketAddrV4,
    /// The password of that request, which goes into the response. There is none when the
    /// request came to the Normal port without one.
    pub password: Option<Password>,
    /// When that request came, in the caller's time.
    pub last_used: Duration,
}

/// The table behind IPNetID 125. It has a place for each node address, 1 to 125 (A13).
#[derive(Clone, Debug, Default)]
pub struct DynamicClients {
    /// The client at node address 1 is the first.
    clients: ArrayVec<DynamicClient, { LAST_NODE as usize }>,
}

impl DynamicClients {
    /// Notes a request of a client, and returns the client's node address in net 125.
    ///
    /// A client that is there keeps its place. Another one takes a free place. When there is
    /// none, it takes the place of the client that has been silent for the longest time (A13).
    pub fn note(
        &mut self,
        now: Duration,
        address: SocketAddrV4,
        password: Option<Password>,
    ) -> NodeAddress {
        let client = DynamicClient { address, password, last_used: now };
        let known = self.clients.iter().position(|client| client.address == address);
        let index = match known {
            Some(index) => index,
            None if !self.clients.is_full() => {
                self.clients.push(client);
                return node_address(self.clients.len() - 1);
            }
            None => self.longest_silent(),
        };
        self.clients[index] = client;
        node_address(index)
    }

    /// The client at a node address.
    pub fn get(&self, node_address: NodeAddress) -> Option<&DynamicClient> {
        self.clients.get(usize::from(node_address.get()) - 1)
    }

    /// The number of clients, 0 to 125.
    pub fn len(&self) -> usize {
        self.clients.len()
    }

    /// Whether there is no client.
    pub fn is_empty(&self) -> bool {
        self.clients.is_empty()
    }

    fn longest_silent(&self) -> usize {
        let clients = self.clients.iter().enumerate();
        clients.min_by_key(|(_, client)| client.last_used).map_or(0, |(index, _)| index)
    }
}

/// The node address of a place. There are as many places as node addresses.
fn node_address(index: usize) -> NodeAddress {
    NodeAddress::all().nth(index).expect("a place for each node address")
}
