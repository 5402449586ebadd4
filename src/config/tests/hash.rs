//! What the checksum of a net depends on, and what it does not.

use std::collections::BTreeMap;

use super::reference::{read as read_reference, switched_on, switched_on_with};
use super::*;

/// The checksum of each net by its name.
fn hashes(config: &Config) -> BTreeMap<String, String> {
    let nets = config.table.net_ids();
    nets.map(|id| (config.table.net(id).name.clone(), config.hash_of(id))).collect()
}

/// Which nets have another checksum with this change of the annotated configuration.
fn changed_by(section: &str, key: &str, value: &str) -> Vec<String> {
    let sound = |text: &str| hashes(&read_reference(text).unwrap_or_else(|it| panic!("{it}")).0);
    let (before, after) = (sound(&switched_on()), sound(&switched_on_with(section, key, value)));
    let is_new = |(name, hash): &(&String, &String)| before.get(*name) != Some(*hash);
    after.iter().filter(is_new).map(|(name, _)| name.clone()).collect()
}

/// Each key of the annotated configuration with another value.
pub(super) fn each_key() -> impl Iterator<Item = (&'static str, &'static str)> {
    OF_A_NET.into_iter().chain(OF_A_REMOTE_NET).chain(OF_ALL).chain(OF_NONE)
}

/// Each key with another value than in the annotated configuration.
const OF_A_NET: [(&str, &str); 33] = [
    ("udp_range_net.name", r#""section-2""#),
    ("udp_range_net.start_port", "21000"),
    ("udp_range_net.subnet", r#""172.17.19.0""#),
    ("udp_range_net.nodes", r#"["1-5", 33]"#),
    ("udp_range_net.server_port", "34380"),
    ("udp_range_net.allow", r#"["198.51.100.0/25"]"#),
    ("udp_range_net.idle_timeout", r#""6m""#),
    ("udp_range_net.max_flows", "4097"),
    ("udp_range_net.max_requests_per_second", "201"),
    ("udp_range_net.max_flow_requests_per_second", "21"),
    ("udp_range_net.require_response_password", "true"),
    ("udp_range_net.allow_without_password", "true"),
    ("udp_range_net.password.name", r#""other""#),
    ("server.name", r#""oven""#),
    ("server.public_port", "20201"),
    ("server.address", r#""172.17.20.7:34379""#),
    ("server.node", "8"),
    ("server.allow", r#"["198.51.100.8"]"#),
    ("server.idle_timeout", r#""6m""#),
    ("server.max_flows", "4097"),
    ("server.max_requests_per_second", "201"),
    ("server.max_flow_requests_per_second", "21"),
    ("server.require_response_password", "true"),
    ("server.allow_without_password", "true"),
    ("server.password.name", r#""other""#),
    ("profinet_device.name", r#""drive-8""#),
    ("profinet_device.public_port", "45008"),
    ("profinet_device.address", r#""172.17.17.8""#),
    ("profinet_device.records", r#"["im0"]"#),
    ("profinet_device.allow", r#"["198.51.100.0/29"]"#),
    ("profinet_device.max_flows", "4097"),
    ("profinet_device.max_requests_per_second", "201"),
    ("profinet_device.max_flow_requests_per_second", "21"),
];

const OF_A_REMOTE_NET: [(&str, &str); 13] = [
    ("remote_net.name", r#""plant-3""#),
    ("remote_net.router", r#""203.0.113.6""#),
    ("remote_net.start_port", "20100"),
    ("remote_net.nodes", r#"["1-5"]"#),
    ("remote_net.local_subnet", r#""127.17.3.0""#),
    ("remote_net.local_port", "34381"),
    ("remote_net.allow", r#"["127.0.0.0/9"]"#),
    ("remote_net.idle_timeout", r#""6m""#),
    ("remote_net.max_flows", "4097"),
    ("remote_net.max_requests_per_second", "201"),
    ("remote_net.max_flow_requests_per_second", "21"),
    ("remote_net.require_response_password", "true"),
    ("remote_net.password.name", r#""other""#),
];

/// What all nets share.
const OF_ALL: [(&str, &str); 5] = [
    ("protocol.header", r#""02000001""#),
    ("limits.max_flows", "65537"),
    ("limits.wrong_password_burst", "11"),
    ("limits.wrong_password_address_burst", "5121"),
    ("limits.wrong_password_interval", r#""7s""#),
];

/// What each router has for itself, and what must not be told.
const OF_NONE: [(&str, &str); 26] = [
    ("public.listen", r#"["192.0.2.7"]"#),
    ("udp_range_net.servers_beyond_gateway", "true"),
    ("udp_range_net.password.file", r#""secrets/press""#),
    ("udp_range_net.password.device_file", r#""secrets/press""#),
    ("server.servers_beyond_gateway", "true"),
    ("server.password.file", r#""secrets/section-1""#),
    ("server.password.device_file", r#""secrets/section-1""#),
    ("profinet_device.servers_beyond_gateway", "true"),
    ("remote_net.password.file", r#""secrets/section-1""#),
    ("datapath.receive_buffer", "65536"),
    ("datapath.prefilter", r#""off""#),
    ("datapath.kernel", r#""off""#),
    ("datapath.busy_poll", r#""50us""#),
    ("log.audit_lines", "501"),
    ("runtime.user", r#""nobody""#),
    ("runtime.workers", "3"),
    ("runtime.pre_drain", r#""6s""#),
    ("runtime.drain", r#""6s""#),
    ("admin.listen", r#""127.0.0.1:9379""#),
    ("admin.token_file", r#""secrets/admin-2""#),
    ("admin.metrics_without_token", "true"),
    ("admin.reload", "true"),
    ("admin.title", r#""Other""#),
    ("admin.probe", "true"),
    ("admin.control", r#""/run/other/control.sock""#),
    ("admin.enabled", "false"),
];

#[test]
fn each_key_is_in_it_or_left_out_on_purpose() {
    let mut known = Vec::new();
    for (path, value) in OF_A_NET.into_iter().chain(OF_A_REMOTE_NET) {
        let (section, key) = path.rsplit_once('.').unwrap();
        let net = match section.split('.').next().unwrap() {
            _ if key == "name" && !section.contains('.') => value.trim_matches('"'),
            "udp_range_net" => "section-1",
            "server" => "press",
            "profinet_device" => "drive-7",
            _ => "plant-2",
        };
        assert_eq!(changed_by(section, key, value), [net], "{path} = {value}");
        known.push(path);
    }
    for (path, value) in OF_ALL {
        let (section, key) = path.rsplit_once('.').unwrap();
        assert_eq!(changed_by(section, key, value).len(), 4, "{path} = {value}");
        known.push(path);
    }
    for (path, value) in OF_NONE {
        let (section, key) = path.rsplit_once('.').unwrap();
        assert_eq!(changed_by(section, key, value), [""; 0], "{path} = {value}");
        known.push(path);
    }
    let mut section = String::new();
    for line in switched_on().lines().map(str::trim) {
        if line.starts_with('[') {
            section = line.trim_matches(['[', ']']).to_owned();
        } else if let Some((key, _)) = line.split_once(" = ").filter(|_| !line.starts_with('#')) {
            let path = format!("{section}.{key}");
            assert!(known.contains(&path.as_str()), "{path} belongs into one of the lists above");
        }
    }
}

#[test]
fn neither_order_nor_spelling_counts() {
    let two_passwords = changed(
        "file = \"secrets/a\"\n\n",
        "file = \"secrets/a\"\n[[udp_range_net.password]]\nname = \"team\"\nfile = \"secrets/b\"\n\n",
    );
    let usual = hashes(&read(&two_passwords).unwrap().0);
    let (range, server) = two_passwords.split_once("[[server]]").unwrap();
    let (public, range) = range.split_once("[[udp_range_net]]").unwrap();
    let (rules, passwords) = range.split_once("[[udp_range_net.password]]").unwrap();
    let (first, second) = passwords.split_once("[[udp_range_net.password]]").unwrap();
    let rules = rules.replace("[\"1-4\", 33]", "[33, 4, \"2-3\", 1]");
    let server = server.replacen("node = 7", "node = 7\nidle_timeout = \"300s\"", 1);
    let other = format!(
        "[[server]]{server}\n[[udp_range_net]]{rules}server_port = 34379\n\
         [[udp_range_net.password]]{second}[[udp_range_net.password]]{first}\n{public}"
    );
    assert_eq!(hashes(&read(&other).unwrap().0), usual);

    let both = |list: &str| {
        let text = two_passwords.replacen("[\"198.51.100.0/24\"]", list, 1);
        hashes(&read(&text).unwrap().0)
    };
    let ordered = both("[\"198.51.100.0/24\", \"203.0.113.9\"]");
    assert_eq!(ordered, both("[\"203.0.113.9/32\", \"198.51.100.0/24\", \"203.0.113.9\"]"));
    assert_ne!(ordered, usual);
}

/// So two relays agree whatever they run on, and a new version with the same keys agrees with an old one.
#[test]
fn it_is_the_same_everywhere() {
    let hashes = hashes(&read(SOUND).unwrap().0);
    assert_eq!(hashes["section-1"], "196726dd");
    assert_eq!(hashes["press"], "f1d323b7");
}

/// A remote net sends the first of its passwords.
#[test]
fn the_order_of_passwords_counts_where_the_first_is_sent() {
    let password = |name: &str, file: &str| {
        format!("[[remote_net.password]]\nname = \"{name}\"\nfile = \"secrets/{file}\"\n")
    };
    let net = "[[remote_net]]\nname = \"plant-2\"\nrouter = \"203.0.113.5\"\nstart_port = 20000\n\
               nodes = [3]\nlocal_subnet = \"127.17.2.0\"\nallow = [\"127.0.0.0/8\"]\n";
    let (old, new) = (password("old", "a"), password("new", "b"));
    let of = |passwords: String| hashes(&read(&(net.to_owned() + &passwords)).unwrap().0);
    assert_ne!(of(format!("{old}{new}")), of(format!("{new}{old}")));
}
