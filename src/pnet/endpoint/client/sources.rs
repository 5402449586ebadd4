//! Whom a client says to be, towards each server node.
//!
//! A server that does not know a client gives it IPNetID 125 and a node address, and says so in its
//! response. The client uses them in its next requests to that node (R-40, PAS 9). Each server has such a
//! table of its own, so what one node gave means nothing to another.

use std::collections::BTreeMap;

use super::{DestinationRoute, Source};
use crate::pnet::wire::{Elements, IpNetId, NodeAddress};

#[derive(Clone, Debug, Default)]
pub(super) struct Sources(BTreeMap<(u8, u8), Source>);

fn key(destination: &DestinationRoute) -> (u8, u8) {
    (destination.ip_net_id.get(), destination.node.number())
}

impl Sources {
    /// Makes room for what a node may give, before it is asked for the first time.
    pub(super) fn prepare(&mut self, destination: &DestinationRoute, source: Source) {
        self.0.entry(key(destination)).or_insert(source);
    }

    /// The source of the next request to a node.
    pub(super) fn get(&self, destination: &DestinationRoute, otherwise: Source) -> Source {
        self.0.get(&key(destination)).copied().unwrap_or(otherwise)
    }

    /// Takes what a response is addressed to. What is no address of a node is of no use.
    pub(super) fn learn(&mut self, destination: &DestinationRoute, destinations: &Elements) {
        let &[net, node, ..] = &destinations[..] else { return };
        let known = self.0.get_mut(&key(destination));
        if let (Some(known), Some(ip_net_id), Some(node_address)) =
            (known, IpNetId::new(net), NodeAddress::new(node))
        {
            *known = Source { ip_net_id, node_address };
        }
    }
}
