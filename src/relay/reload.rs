//! A new configuration for a core at work.
//!
//! A flow lives on, with its upstream port, when its mapping, its password and its client's address
//! are still good; otherwise it is closed at once. Counters of nets and nodes that stay go on.

use std::sync::Arc;
use std::time::Instant;

use super::core::Core;
use super::counters::Counters;
use super::flow::Flow;
use super::ids::{FlowId, ListenerId};
use super::reason::CloseReason;
use super::rules::Rules;
use super::shell::Shell;
use super::table::{MappingId, Table};

/// Where a flow stands in new rules.
struct Place {
    mapping: MappingId,
    listener: ListenerId,
    credential: Option<u16>,
}

impl Core {
    /// Goes over to new rules and returns the counters that count from here on. `listener` tells
    /// what an old public socket is called now, if it is still there.
    pub fn reload(
        &mut self,
        now: Instant,
        rules: &Rules,
        listener: impl Fn(ListenerId) -> Option<ListenerId>,
        shell: &mut impl Shell,
    ) -> Arc<Counters> {
        let old = &self.rules.table;
        let place = |flow: &Flow| {
            let listener = listener(flow.endpoints.listener);
            place(flow, old, &rules.table, listener.ok_or(CloseReason::MappingRemoved)?)
        };
        let places: Vec<_> = self.flows.iter().map(|(id, flow)| (id, place(flow))).collect();
        let now = self.nanos(now);
        for (id, place) in places {
            match place {
                Ok(place) => self.move_flow(id, &place, rules),
                Err(reason) => self.close(id, reason, now, shell),
            }
        }
        self.flows.reindex();
        self.throttle.set_limits(&rules.limits);
        self.counters = Arc::new(self.counters.carried_over(&self.rules.table, &rules.table));
        self.rules = rules.clone();
        Arc::clone(&self.counters)
    }

    fn move_flow(&mut self, id: FlowId, place: &Place, rules: &Rules) {
        let flow = self.flows.get_mut(id);
        self.rules.budget.give(self.rules.table.mapping(flow.mapping).net);
        // A lower limit closes nothing; it is kept to when flows are opened.
        rules.budget.take_regardless(rules.table.mapping(place.mapping).net);
        flow.mapping = place.mapping;
        flow.endpoints.listener = place.listener;
        flow.credential = place.credential;
    }
}

/// Where a flow stands in a new table, or why it has to go.
fn place(
    flow: &Flow,
    old: &Table,
    new: &Table,
    listener: ListenerId,
) -> Result<Place, CloseReason> {
    let was = old.mapping(flow.mapping);
    let is_the_same = |mapping: &MappingId| {
        let is = new.mapping(*mapping);
        is.public_port == was.public_port
            && is.node_address == was.node_address
            && new.net(is.net).name == old.net(was.net).name
    };
    let mapping = new.mapping_of_server(was.server).filter(is_the_same);
    let mapping = mapping.ok_or(CloseReason::MappingRemoved)?;
    let net = new.net(new.mapping(mapping).net);
    if !net.allows(flow.endpoints.client.ip()) {
        return Err(CloseReason::SourceWithdrawn);
    }
    let credential = match flow.credential {
        None if net.allow_without_password => None,
        None => return Err(CloseReason::PasswordWithdrawn),
        Some(index) => {
            let was = &old.net(was.net).credentials[usize::from(index)];
            let is = net.credential(was.password.octets()).filter(|&index| {
                let is = &net.credentials[usize::from(index)];
                bool::from(is.at_server().matches(was.at_server().octets()))
            });
            Some(is.ok_or(CloseReason::PasswordWithdrawn)?)
        }
    };
    Ok(Place { mapping, listener, credential })
}
