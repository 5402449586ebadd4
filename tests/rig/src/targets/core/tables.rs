//! The configurations of the steps. Each bit of one octet is one difference between them.

use std::sync::Arc;
use std::time::Duration;

use pnet_nat::nat::{Credential, Limits, Mapping, Net, NetId, NetKind, RequestRate, Rules, Table};
use pnet_nat::pnet::wire::{Header, Password};

use super::super::input::Input;

pub(super) fn rules(input: &mut Input<'_>) -> Rules {
    let (table, limits) = table_and_limits(input);
    Rules::new(table, limits)
}

pub(super) fn followed_by(rules: &Rules, input: &mut Input<'_>) -> Rules {
    let (table, limits) = table_and_limits(input);
    rules.followed_by(table, limits)
}

fn table_and_limits(input: &mut Input<'_>) -> (Arc<Table>, Limits) {
    let (variant, bounds) = (input.octet(), input.octet());
    let limits = Limits {
        max_flows: 1 + u32::from(bounds % 16),
        wrong_password_burst: 2,
        wrong_password_address_burst: 1024,
        wrong_password_interval: Duration::from_secs(60),
    };
    let section_flows = 1 + u32::from(bounds / 16);
    let rate = (bounds % 16 > 12).then(|| RequestRate::new(2));
    (Arc::new(table(variant, section_flows, rate)), limits)
}

fn table(variant: u8, section_flows: u32, rate: Option<RequestRate>) -> Table {
    let differs = |bit: u8| variant & (1 << bit) != 0;
    let near = if differs(0) { "198.51.100.0/29" } else { "198.51.100.0/24" };
    let allow = vec![near.parse().unwrap(), "2001:db8::/64".parse().unwrap()];
    let net = |name: &str, kind, credentials, idle_timeout, max_flows| Net {
        allow: allow.clone(),
        credentials,
        idle_timeout: Duration::from_secs(idle_timeout),
        max_flows,
        max_requests: rate,
        max_flow_requests: rate.map(|_| RequestRate::new(1)),
        ..Net::new(name, kind)
    };
    let device = if differs(1) { b"device!!" } else { b"device-2" };
    let mut passwords = vec![credential(b"service!", None), credential(b"rotated!", Some(device))];
    if differs(2) {
        passwords.remove(0);
    }
    if differs(3) {
        passwords.reverse();
    }
    let range = NetKind::UdpRange { start_port: 20_000 };
    let section = net("section-1", range, passwords, 150, section_flows);
    let press = vec![credential(b"press!!!", None)];
    let mut press = net("press", NetKind::Server, press, 30, 3);
    press.require_response_password = true;
    let mut open = net("open", NetKind::Server, Vec::new(), 150, 3);
    open.allow_without_password = true;

    let remote = NetKind::Remote { start_port: 20_000 };
    let mut other = vec![credential(b"remote-1", None), credential(b"remote-2", None)];
    if differs(3) {
        other.reverse();
    }
    let remote = net("plant-2", remote, other, 150, 4);

    let mapping = |net, node_address, public_port, server: &str| Mapping {
        net: NetId(net),
        node_address,
        local_address: (net == 3).then(|| [127, 17, 2, node_address].into()),
        public_port,
        server: server.parse().unwrap(),
    };
    let third = if differs(4) { "172.17.17.34:34379" } else { "172.17.17.33:34379" };
    let mut mappings = vec![
        mapping(0, 1, 20_001, "172.17.17.1:34379"),
        mapping(0, 33, 20_033, third),
        mapping(1, 7, 20_200, "172.17.18.7:34379"),
        mapping(2, 8, 40_201, "172.17.18.8:34379"),
        mapping(3, 1, 34_378, "203.0.113.5:20001"),
        mapping(3, 2, 34_378, "203.0.113.5:20002"),
    ];
    if differs(5) {
        mappings.remove(0);
    }
    if differs(6) {
        mappings.reverse();
    }
    if differs(7) {
        mappings.retain(|mapping| mapping.net != NetId(2));
    }
    Table::new(Header::default(), vec![section, press, open, remote], mappings)
}

fn credential(password: &[u8; 8], device: Option<&[u8; 8]>) -> Credential {
    Credential {
        name: String::from_utf8_lossy(password).into_owned(),
        password: Password::new(*password),
        device_password: device.map(|octets| Password::new(*octets)),
    }
}
