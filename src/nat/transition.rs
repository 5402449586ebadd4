//! What happens to flows when new rules come: which index of the old table is which index of the
//! new one, or why there is none.
//!
//! It is computed once for all workers, so that no worker has to look anything up by name.

use std::collections::{BTreeSet, HashMap};

use super::flow::Flow;
use super::ids::{ListenerId, MappingId, NetId};
use super::net::Credential;
use super::reason::CloseReason;
use super::rules::Rules;
use super::table::Table;

/// Which mappings, credentials and sockets of one table are in the next.
#[derive(Debug)]
pub struct Transition {
    /// For each old mapping, the new one with the same net, node, address, port and server, and with
    /// the same records of a PROFINET device.
    mappings: Box<[Option<MappingId>]>,
    /// For each old net and credential, the new credential with the same passwords.
    credentials: Box<[Box<[Option<u16>]>]>,
    /// Public sockets that are closed.
    gone: BTreeSet<ListenerId>,
}

/// The mapping and the credential of a flow in the new table.
pub(super) struct FlowTarget {
    pub mapping: MappingId,
    pub credential: Option<u16>,
}

impl Transition {
    /// The transition from `old` to `new`, in which the public sockets `gone` are closed.
    pub fn new(old: &Rules, new: &Rules, gone: BTreeSet<ListenerId>) -> Self {
        let (old, new) = (&*old.table, &*new.table);
        let known: HashMap<_, _> =
            new.nets().iter().map(|net| &net.name).zip(new.net_ids()).collect();
        let nets: Vec<Option<NetId>> =
            old.nets().iter().map(|net| known.get(&net.name).copied()).collect();
        let mappings = old.mappings().iter().map(|was| {
            let net = nets[usize::from(was.net.0)]?;
            new.mapping_of_server(was.server).filter(|&mapping| {
                let is = new.mapping(mapping);
                (is.net, is.server, is.local_address, is.public_port, is.node_address)
                    == (net, was.server, was.local_address, was.public_port, was.node_address)
                    && new.net(net).kind == old.net(was.net).kind
            })
        });
        let credentials = old.nets().iter().zip(&nets).map(|(was, is)| {
            let same = |credential: &Credential| new.net((*is)?).same_credential(credential);
            was.credentials.iter().map(same).collect()
        });
        Self { mappings: mappings.collect(), credentials: credentials.collect(), gone }
    }

    /// The new index of a credential of an old net, if its passwords are still there.
    pub(super) fn credential(&self, net: NetId, index: u16) -> Option<u16> {
        self.credentials[usize::from(net.0)][usize::from(index)]
    }

    /// The mapping and credential of a flow in the new table, or why it has to be closed.
    pub(super) fn place(
        &self,
        flow: &Flow,
        old: &Table,
        new: &Table,
    ) -> Result<FlowTarget, CloseReason> {
        let mapping = self.mappings[flow.mapping.0 as usize];
        let here = !self.gone.contains(&flow.endpoints.listener);
        let mapping = mapping.filter(|_| here).ok_or(CloseReason::MappingRemoved)?;
        let id = new.mapping(mapping).net;
        let net = new.net(id);
        if !new.allows(id, flow.endpoints.client.ip()) {
            return Err(CloseReason::SourceWithdrawn);
        }
        let credential = match flow.credential {
            None if net.allow_without_password => None,
            None => return Err(CloseReason::PasswordWithdrawn),
            Some(index) => {
                let is = self.credential(old.mapping(flow.mapping).net, index);
                Some(is.ok_or(CloseReason::PasswordWithdrawn)?)
            }
        };
        Ok(FlowTarget { mapping, credential })
    }
}
