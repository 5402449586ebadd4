//! What tests ask of a core, whatever has happened to it.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Instant;

use super::Core;
use crate::nat::flow::Flow;

impl Core {
    /// Whether answers of this server may go to this client.
    pub(in crate::nat) fn takes_answers(&self, client: SocketAddr, server: SocketAddr) -> bool {
        let is_its = |flow: &Flow| flow.endpoints.client == client && self.place(flow).is_some();
        self.flows.iter().any(|(_, flow)| flow.server == server && is_its(flow))
    }

    /// Panics where the tables do not agree with each other.
    pub(in crate::nat) fn check_invariants(&self, now: Instant) {
        let now = self.nanos(now);
        let mut by_net = BTreeMap::<&str, u64>::new();
        for (id, flow) in self.flows.iter() {
            let table = &self.rules_of(flow).0.table;
            let mapping = table.mapping(flow.mapping);
            assert_eq!(flow.server, table.answers_from(&mapping));
            let found = self.flows.of_request(&flow.endpoints);
            assert_eq!(found == Some(id), flow.left == 0, "a request finds its flow");
            let found = self.flows.of_response(flow.upstream, flow.server);
            assert_eq!(found, Some(id), "an answer finds its flow");
            assert!(flow.opened <= flow.last_used() && flow.last_used() <= now);
            *by_net.entry(&table.net(mapping.net).name).or_default() += u64::from(flow.left == 0);
        }
        let table = &self.rules.table;
        for (net, id) in table.nets().iter().zip(table.net_ids()) {
            let open = by_net.get(&*net.name).copied().unwrap_or_default();
            assert_eq!(self.counters.net(id).flows.get(), open);
        }
        let leaving = self.flows.iter().filter(|(_, flow)| flow.left > 0).map(|(id, _)| id);
        assert_eq!(self.leaving, leaving.collect(), "those that wait for their last answers");
        self.upstreams.check_invariants(self.flows.len());
    }
}
