//! The outcome of a check as JSON: one object, whatever the outcome.

use std::net::{IpAddr, SocketAddr};

use serde::Serialize;

use super::Refusal;
use super::client::rows;
use crate::config::{Config, Fault, Warning};
use crate::nat::{Mapping, NO_NODE, Net};

/// Faults, or what the configuration results in.
#[derive(Serialize)]
pub(super) struct Object<'a> {
    sound: bool,
    faults: Vec<Told<'a>>,
    warnings: Vec<Told<'a>>,
    #[serde(flatten)]
    result: Option<Outcome<'a>>,
}

/// A fault or a warning.
#[derive(Default, Serialize)]
struct Told<'a> {
    /// The file, or the environment variable in its place.
    file: Option<String>,
    line: Option<usize>,
    key: Option<&'a str>,
    problem: String,
    remedy: Option<&'a str>,
    excerpt: Option<&'a str>,
    /// It may go away without an edit.
    passes: bool,
}

/// What a sound configuration results in.
#[derive(Serialize)]
struct Outcome<'a> {
    listen: &'a [IpAddr],
    nat_table: Vec<Line<'a>>,
    nets: Vec<OfNet<'a>>,
    clients: Vec<Row<'a>>,
}

/// A line of the NAT table: one for each node.
#[derive(Serialize)]
struct Line<'a> {
    net: &'a str,
    /// None for a PROFINET device.
    node: Option<u8>,
    /// The one address; none: each address of `listen`.
    public_address: Option<IpAddr>,
    public_port: u16,
    server: SocketAddr,
}

/// The rules of a net. Of its passwords, the names.
#[derive(Serialize)]
struct OfNet<'a> {
    name: &'a str,
    kind: &'static str,
    allow: Vec<String>,
    passwords: Vec<&'a str>,
    allow_without_password: bool,
    idle_timeout_seconds: f64,
    max_flows: u32,
}

/// What a client enters in its IPNetTable (PAS 8, Table 4).
#[derive(Serialize)]
#[serde(rename_all = "PascalCase")]
struct Row<'a> {
    #[serde(rename = "net")]
    net: &'a str,
    /// One of these; none of them: the public address, which the relay does not know.
    #[serde(rename = "IPAddr")]
    ip_address: Vec<IpAddr>,
    #[serde(rename = "UDPPort")]
    udp_port: u16,
    #[serde(rename = "UsePW")]
    use_password: u8,
    nettype: String,
    /// The only node that the row reaches.
    #[serde(rename = "node")]
    only: Option<u8>,
}

/// What there is to say.
pub(super) fn object<'a>(
    checked: &'a Result<(Config, Vec<Warning>), Refusal>,
    remarks: &[String],
) -> Object<'a> {
    let remarks = remarks.iter().map(|remark| Told { problem: remark.clone(), ..Told::default() });
    match checked {
        Ok((config, warnings)) => {
            let warnings = warnings.iter().map(|Warning(fault)| told(fault));
            let warnings = warnings.chain(remarks).collect();
            Object { sound: true, faults: Vec::new(), warnings, result: Some(outcome(config)) }
        }
        Err(refusal) => {
            let faults = match refusal {
                Refusal::Faults(faults) => faults.0.iter().map(told).collect(),
                other => vec![Told { problem: other.to_string(), ..Told::default() }],
            };
            Object { sound: false, faults, warnings: remarks.collect(), result: None }
        }
    }
}

fn told(fault: &Fault) -> Told<'_> {
    Told {
        file: Some(fault.file.display().to_string()),
        line: fault.line,
        key: Some(fault.key.as_str()).filter(|key| !key.is_empty()),
        problem: fault.problem.clone(),
        remedy: Some(&fault.remedy),
        excerpt: fault.excerpt.as_deref(),
        passes: fault.passes,
    }
}

fn outcome(config: &Config) -> Outcome<'_> {
    let line = |mapping: &Mapping| Line {
        net: &config.table.net(mapping.net).name,
        node: Some(mapping.node_address).filter(|node| *node != NO_NODE),
        public_address: mapping.local_address,
        public_port: mapping.public_port,
        server: mapping.server,
    };
    let public = match config.listen.iter().any(IpAddr::is_unspecified) {
        true => Vec::new(),
        false => config.listen.clone(),
    };
    let clients = rows(config).map(|row| Row {
        net: &row.net.name,
        ip_address: row.local_subnet.map_or_else(|| public.clone(), |subnet| vec![subnet.into()]),
        udp_port: row.udp_port,
        use_password: row.use_password.into(),
        nettype: row.nettype.to_string(),
        only: row.only,
    });
    Outcome {
        listen: &config.listen,
        nat_table: config.table.mappings().iter().map(line).collect(),
        nets: config.table.nets().iter().map(of_net).collect(),
        clients: clients.collect(),
    }
}

fn of_net(net: &Net) -> OfNet<'_> {
    OfNet {
        name: &net.name,
        kind: net.kind.label(),
        allow: net.allow.iter().map(ToString::to_string).collect(),
        passwords: net.credentials.iter().map(|credential| credential.name.as_str()).collect(),
        allow_without_password: net.allow_without_password,
        idle_timeout_seconds: net.idle_timeout.as_secs_f64(),
        max_flows: net.max_flows,
    }
}
