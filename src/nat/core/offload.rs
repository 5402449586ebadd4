//! Which flows a faster datapath may carry, and when it has to let go of them.
//!
//! A flow is offered when its client asks a second time: those who ask once cost nothing more. It is
//! recalled before it is closed, and as soon as something about it needs judgement for each datagram.

use super::Core;
use crate::nat::effects::Effects;
use crate::nat::flow::{Flow, Offload};
use crate::nat::ids::FlowId;
use crate::nat::net::{Credential, NetKind};
use crate::nat::offload::Offer;
use crate::nat::protocol::Header;
use crate::nat::table::Table;

impl Core {
    /// Offers a flow, once.
    #[cold]
    pub(super) fn offer(&mut self, id: FlowId, effects: &mut impl Effects) {
        let flow = self.flows.get(id);
        let offer = offer(flow, &self.rules.table);
        let taken = offer.and_then(|offer| effects.offload(&self.rules.table, &offer));
        let flow = self.flows.get_mut(id);
        match taken {
            Some(shared) => flow.carried_by(shared),
            None => flow.offload = Offload::Declined,
        }
    }

    /// Has the faster datapath let go of a flow.
    #[cold]
    pub(super) fn recall(&mut self, id: FlowId, effects: &mut impl Effects) {
        let flow = self.flows.get_mut(id);
        if let Offload::Carried(shared) = &flow.offload {
            effects.recall(shared.place());
        }
        flow.carried_no_more();
    }

    /// Has it let go of every flow.
    pub fn recall_all(&mut self, effects: &mut impl Effects) {
        let ids: Vec<_> = self.flows.iter().map(|(id, _)| id).collect();
        ids.into_iter().for_each(|id| self.recall(id, effects));
    }
}

/// The offer of a flow; none where a datagram needs more judgement than the datapath has.
fn offer<'a>(flow: &Flow, table: &'a Table) -> Option<Offer<'a>> {
    let mapping = table.mapping(flow.mapping);
    let net = table.net(mapping.net);
    let kind = matches!(net.kind, NetKind::UdpRange { .. } | NetKind::Server);
    let unlimited = net.max_requests.is_none() && net.max_flow_requests.is_none();
    // An answer may have an earlier password, too.
    let one_password = flow.earlier_credentials.is_empty();
    if !kind || !unlimited || !one_password || flow.left != 0 {
        return None;
    }
    let credential = flow.credential?;
    let Credential { password, device_password: None, .. } =
        &net.credentials[usize::from(credential)]
    else {
        return None; // passwords are exchanged
    };
    Some(Offer {
        client: flow.endpoints.client,
        public_address: flow.endpoints.public_address,
        public_port: mapping.public_port,
        upstream_port: flow.upstream_port,
        server: mapping.server,
        node_address: mapping.node_address,
        header: table.header,
        password,
        mapping: flow.mapping,
        net: mapping.net,
        credential,
    })
}

/// What a faster datapath keeps of a flow, besides addresses and password: the header that it compares, and
/// the name under which requests are counted. None where it may not carry the flow.
pub(super) fn kept_terms<'a>(flow: &Flow, table: &'a Table) -> Option<(Header, &'a str)> {
    let offer = offer(flow, table)?;
    let credential = &table.net(offer.net).credentials[usize::from(offer.credential)];
    Some((offer.header, &credential.name))
}
