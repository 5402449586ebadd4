//! A small configuration for tests of what is shown: one UDP Range net with two nodes and two
//! credentials, one single server without a password.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use crate::config::{Admin, Config, Datapath, Log, Runtime};
use crate::nat::{Credential, Limits, Mapping, MappingId, Net, NetId, NetKind, Table};
use crate::pnet::wire::{Header, Password};

pub(crate) const SECTION: NetId = NetId(0);
pub(crate) const NODE_1: MappingId = MappingId(0);
pub(crate) const NODE_33: MappingId = MappingId(2);

/// Every password in the configuration.
pub(crate) const PASSWORDS: [[u8; 8]; 3] = [*b"Pw-4-5ec", *b"\x9a\x01\xfe~{}0q", *b"dev!ce-1"];

/// The configuration.
pub(crate) fn config() -> Config {
    let nets = vec![
        Net {
            credentials: credentials(),
            ..net("section-1", NetKind::UdpRange { start_port: 20000 })
        },
        Net { allow_without_password: true, ..net("press", NetKind::Server) },
    ];
    // The net of the first and last node is one: mappings need not be sorted by net.
    let mappings = vec![
        mapping(SECTION, 1, 20001, [172, 17, 17, 1]),
        mapping(NetId(1), 7, 20200, [172, 17, 18, 7]),
        mapping(SECTION, 33, 20033, [172, 17, 17, 33]),
    ];
    Config {
        listen: vec![Ipv4Addr::UNSPECIFIED.into()],
        table: Arc::new(Table::new(Header::default(), nets, mappings)),
        beyond_gateway: Vec::new(),
        limits: Limits {
            max_flows: 10_000,
            wrong_password_burst: 10,
            wrong_password_address_burst: 5120,
            wrong_password_interval: Duration::from_secs(60),
        },
        datapath: Datapath::default(),
        log: Log::default(),
        runtime: Runtime::default(),
        admin: Some(Admin {
            listen: SocketAddr::from(([127, 0, 0, 1], 9378)),
            token: None,
            metrics_without_token: false,
            reload: false,
            probe: false,
            title: None,
        }),
        control: None,
        files: Vec::new(),
    }
}

/// 64 UDP Range nets of 125 nodes.
pub(crate) fn large_table(nets: u16) -> Arc<Table> {
    let all = (0..nets)
        .map(|i| net(&format!("section-{i}"), NetKind::UdpRange { start_port: 10_000 + 200 * i }));
    let mappings = (0..nets).flat_map(|i| {
        (1..=125u8).map(move |node| {
            let port = 10_000 + 200 * i + u16::from(node);
            mapping(NetId(i), node, port, [172, 17, i as u8, node])
        })
    });
    Arc::new(Table::new(Header::default(), all.collect(), mappings.collect()))
}

fn net(name: &str, kind: NetKind) -> Net {
    Net { allow: vec!["198.51.100.0/24".parse().unwrap()], max_flows: 4096, ..Net::new(name, kind) }
}

fn credentials() -> Vec<Credential> {
    let [service, team, device] = PASSWORDS.map(Password::new);
    vec![
        Credential { name: "service".to_owned(), password: service, device_password: None },
        Credential { name: "team-b".to_owned(), password: team, device_password: Some(device) },
    ]
}

fn mapping(net: NetId, node_address: u8, public_port: u16, server: [u8; 4]) -> Mapping {
    let server = SocketAddr::new(IpAddr::from(server), 34379);
    Mapping { net, node_address, local_address: None, public_port, server }
}
