//! A `[[profinet_device]]`: one public port for one PROFINET device, of which some records may be read.

use std::net::SocketAddr;

use crate::nat::{NO_NODE, NetKind, Record, Records};
use crate::profinet::rpc;

use super::address::{address, is_a_host, is_link_local};
use super::net::{
    Allowed, Claim, Draft, PublicPort, Rules, refuse_everybody, rules, warn_of_privileged_ports,
};
use super::toml_table::{Entry, Section};

/// One public port → the device's RPC port.
pub(super) fn profinet_device(mut section: Section<'_>) -> Draft<'_> {
    let place = section.place.clone();
    let name = section.key("name", "\"drive-7\"").required();
    let port_entry = section.key("public_port", "45007").required();
    let port = port_entry.integer(1..=u16::MAX);
    let address_entry = section.key("address", "\"172.17.17.7\"").required();
    let device = address(&address_entry).filter(|address| {
        let is_device = is_a_host(*address) && !is_link_local(*address);
        if !is_device {
            let problem = format!("no device can be at {address}");
            address_entry.fault(problem, "name the device's own address");
        }
        is_device
    });
    let records = records(&section.key("records", "[\"im0\", \"im1\"]"));
    let beyond = section.key("servers_beyond_gateway", "true");
    let kind = NetKind::ProfinetDevice { records };
    let Rules { net, networks } = rules(&mut section, &name, kind);
    section.finish();

    for (entry, network) in &networks {
        refuse_everybody(
            entry,
            network,
            "PROFINET has no passwords, so everybody could ask the device",
        );
    }
    let port = port.map(PublicPort::everywhere);
    let public_ports = Claim { entry: port_entry, values: port.into_iter().collect() };
    warn_of_privileged_ports(&public_ports);
    let server = device.map(|device| SocketAddr::new(device, rpc::PORT));
    Draft {
        place,
        name,
        net,
        nodes: vec![NO_NODE],
        public_ports,
        servers: Claim { entry: address_entry, values: server.into_iter().collect() },
        allowed: Allowed::of(networks),
        servers_beyond_gateway: beyond.boolean().unwrap_or(false),
    }
}

/// The records that may be read.
fn records(entry: &Entry<'_>) -> Records {
    if entry.is_absent() {
        return Records::default();
    }
    let records = entry.list().into_iter().filter_map(|element| {
        let text = element.text()?;
        let record = text.parse::<Record>();
        let names = || Records::all().iter().map(Record::label).collect::<Vec<_>>();
        #[cfg(test)]
        element.asks(super::asked::Wanted::OneOf(names()));
        if record.is_err() {
            element.fault(
                format!("{} is no record", super::report::quoted(text)),
                format!("choose among {}", names().join(", ")),
            );
        }
        record.ok()
    });
    records.collect()
}
