//! A checksum of what has to be the same at every relay of a net. Prometheus finds by it the relay that has
//! another configuration than the others.
//!
//! It is made of a text that depends only on what is configured: not on the order or the spelling in the file,
//! and not on the processor. Every struct is taken apart by name, so that the compiler asks about a new key.

use std::fmt::Write;
use std::net::SocketAddr;

use flate2::Crc;

use super::Config;
use crate::nat::{Credential, Limits, Mapping, Net, NetId, NetKind, Record, RequestRate};

impl Config {
    /// The checksum of a net, as eight hexadecimal digits. No password is in it: whoever may read it could
    /// try words until one fits.
    pub fn hash_of(&self, net: NetId) -> String {
        let mut crc = Crc::new();
        crc.update(self.shared_settings(net).as_bytes());
        format!("{:08x}", crc.sum())
    }

    /// What clients of a net can tell apart, one setting a line. Left out is what each router has for itself:
    /// addresses, routes, how datagrams are taken from the kernel, the process, and who watches it.
    fn shared_settings(&self, id: NetId) -> String {
        let Self {
            listen: _,
            table,
            beyond_gateway: _,
            limits,
            datapath: _,
            log: _,
            runtime: _,
            admin: _,
            control: _,
            files: _,
        } = self;
        let Limits {
            max_flows,
            wrong_password_burst,
            wrong_password_address_burst,
            wrong_password_interval,
        } = limits;
        let interval = wrong_password_interval.as_nanos();
        let mut text = format!("header {}\n", table.header);
        let _ = writeln!(
            text,
            "limits {max_flows} {wrong_password_burst} {wrong_password_address_burst} {interval}"
        );
        write_rules(&mut text, table.net(id));
        let mut mappings: Vec<_> = table.mappings_of(id).map(|id| table.mapping(id)).collect();
        mappings.sort_by_key(|mapping| mapping.node_address);
        for mapping in mappings {
            write_mapping(&mut text, mapping);
        }
        text
    }
}

fn write_rules(text: &mut String, net: &Net) {
    let Net {
        name: _, // it stands beside the checksum
        kind,
        allow,
        credentials,
        allow_without_password,
        require_response_password,
        idle_timeout,
        max_flows,
        max_requests,
        max_flow_requests,
    } = net;
    let _ = write!(text, "kind {}", kind.label());
    let _ = match kind {
        NetKind::UdpRange { start_port } | NetKind::Remote { start_port } => {
            writeln!(text, " {start_port}")
        }
        NetKind::Server => writeln!(text),
        NetKind::ProfinetDevice { records } => {
            let labels: Vec<_> = records.iter().map(Record::label).collect();
            writeln!(text, " {}", labels.join(" "))
        }
    };
    let mut allow = allow.clone();
    allow.sort();
    allow.dedup();
    for network in allow {
        let _ = writeln!(text, "allow {network}");
    }
    let mut credentials: Vec<_> = credentials.iter().collect();
    if !kind.is_remote() {
        // A remote net sends its first password, so there the order counts.
        credentials.sort_by_key(|credential| &credential.name);
    }
    for Credential { name, password: _, device_password } in credentials {
        let _ = writeln!(text, "password {name} {}", device_password.is_some());
    }
    let (timeout, per_second) = (idle_timeout.as_nanos(), RequestRate::per_second);
    let [requests, flow_requests] =
        [max_requests, max_flow_requests].map(|rate| rate.map_or(0, per_second));
    let _ = writeln!(text, "without password {allow_without_password} {require_response_password}");
    let _ = writeln!(text, "bounds {timeout} {max_flows} {requests} {flow_requests}");
}

fn write_mapping(text: &mut String, mapping: Mapping) {
    let Mapping { net: _, node_address, local_address, public_port, server } = mapping;
    // The zone of a link-local address is a number that each router has for itself.
    let server = SocketAddr::new(server.ip(), server.port());
    let _ = write!(text, "node {node_address} {public_port} {server}");
    let _ = match local_address {
        Some(address) => writeln!(text, " {address}"),
        None => writeln!(text),
    };
}
