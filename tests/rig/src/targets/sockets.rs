//! The upstream sockets that a core asks for, and what it tells of its flows.

use std::collections::HashMap;
use std::net::SocketAddr;

use pnet_nat::nat::{
    CloseReason, Effects, FlowRecord, MappingId, NetId, SocketKind, Table, Throttled, UpstreamId,
};

/// The sockets that the core asks for. A port is given again as soon as it is free.
#[derive(Default)]
pub(super) struct Sockets {
    pub limit: usize,
    pub ports: HashMap<UpstreamId, u16>,
    pub opened_flows: usize,
    pub closed_flows: usize,
    /// Port, server and client of each flow that was closed since the last step.
    pub just_closed: Vec<(u16, SocketAddr, SocketAddr)>,
    pub throttled: usize,
}

impl Sockets {
    /// The socket with this port.
    pub(super) fn id_of(&self, port: u16) -> Option<UpstreamId> {
        self.ports.iter().find(|(_, is)| **is == port).map(|(id, _)| *id)
    }
}

impl Effects for Sockets {
    fn open_upstream(
        &mut self,
        _: &Table,
        id: UpstreamId,
        _: NetId,
        kind: SocketKind,
    ) -> Option<u16> {
        assert!(kind.ipv4 && !self.ports.contains_key(&id), "opened twice");
        if self.ports.len() >= self.limit {
            return None;
        }
        let port = (50_000..).find(|port| self.ports.values().all(|other| other != port))?;
        self.ports.insert(id, port);
        Some(port)
    }

    fn close_upstream(&mut self, id: UpstreamId) {
        self.ports.remove(&id).expect("closes what it opened");
    }

    fn flow_opened(&mut self, _: &Table, flow: &FlowRecord) {
        assert!(self.ports.values().any(|&port| port == flow.upstream_port));
        self.opened_flows += 1;
    }

    fn flow_closed(&mut self, table: &Table, flow: &FlowRecord, _: CloseReason) {
        self.closed_flows += 1;
        let server = table.mapping(flow.mapping).server;
        self.just_closed.push((flow.upstream_port, server, flow.client));
    }

    fn throttling_begun(&mut self, _: &Table, _: &Throttled, _: MappingId) {
        self.throttled += 1;
    }

    fn throttling_ended(&mut self, _: &Throttled) {
        self.throttled = self.throttled.checked_sub(1).expect("it began");
    }
}
