//! A `[[remote_net]]`: nodes of another plant, for programs on this side that know neither UDP Range
//! nets nor passwords.
//!
//! Node 3 is at the address *local subnet + 3* here, as in an IP Range net (PAS 8 a), and at the port
//! *start port + 3* of the other plant's router (PAS 8 d).

use std::net::{IpAddr, SocketAddr};

use ipnet::IpNet;

use crate::nat::NetKind;
use crate::pnet::wire::NORMAL_PORT;

use super::address::{address, is_a_host};
use super::net::{
    Allowed, Claim, Draft, PublicPort, Rules, refuse_everybody, rules, start_port, subnet,
};
use super::node_range::nodes;
use super::toml_table::{Entry, Section};

/// server = router : start port + node address, local address = local subnet + node address.
pub(super) fn remote_net(mut section: Section<'_>) -> Draft<'_> {
    let place = section.place.clone();
    let name = section.key("name", "\"plant-2\"").required();
    let router_entry = section.key("router", "\"203.0.113.5\"").required();
    let router = router(&router_entry);
    let start_port_entry = section.key("start_port", "20000").required();
    let start_port = start_port(&start_port_entry);
    let nodes = nodes(&section.key("nodes", "[\"1-4\", 33]").required());
    let subnet_entry = section.key("local_subnet", "\"127.17.2.0\"").required();
    let subnet = subnet(&subnet_entry);
    let local_port = section.key("local_port", "34378");
    let local_port = local_port.integer(1..=u16::MAX).unwrap_or(NORMAL_PORT);
    let kind = NetKind::Remote { start_port: start_port.unwrap_or_default() };
    let Rules { net, networks } = rules(&mut section, &name, kind);
    section.finish();

    networks.iter().for_each(|(entry, network)| check_local(entry, network));
    let local = subnet.map(|[a, b, c, _]| {
        let at =
            |&node: &u8| PublicPort { address: Some([a, b, c, node].into()), port: local_port };
        nodes.iter().map(at).collect()
    });
    let servers = router.zip(start_port).map(|(router, start)| {
        let server = |&node: &u8| SocketAddr::new(router, start + u16::from(node));
        nodes.iter().map(server).collect()
    });
    Draft {
        place,
        name,
        net,
        nodes,
        public_ports: Claim { entry: subnet_entry, values: local.unwrap_or_default() },
        servers: Claim { entry: router_entry, values: servers.unwrap_or_default() },
        // Local programs do not come by `[public] listen`.
        allowed: Allowed::default(),
        servers_beyond_gateway: true,
    }
}

/// The address of the other plant's router.
fn router(entry: &Entry<'_>) -> Option<IpAddr> {
    let address = address(entry)?;
    if !is_a_host(address) {
        entry.fault(
            format!("no router can be at {address}"),
            "name the other plant's public address",
        );
        return None;
    }
    Some(address)
}

/// Who may send without a password: never everybody.
fn check_local(entry: &Entry<'_>, network: &IpNet) {
    refuse_everybody(entry, network, "they could enter the other plant without a password");
    if network.prefix_len() > 0 && network.addr().is_ipv6() {
        entry.warn(
            format!(
                "no program with an address in {network} can use the net: local addresses are IPv4"
            ),
            "remove it",
        );
    }
}
