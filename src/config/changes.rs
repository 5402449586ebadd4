//! What a new configuration changes, in the names of the file.

use std::collections::BTreeMap;
use std::fmt::{self, Display, Formatter};
use std::time::Duration;

use serde::Serialize;

use super::{Config, Runtime};
use crate::nat::{Credential, Mapping, NO_NODE, Net, Table};
use crate::pnet::wire::Password;

/// The differences between two configurations.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Changes {
    /// Sections and keys outside the nets.
    pub settings_changed: Vec<&'static str>,
    /// By name.
    pub nets_added: Vec<String>,
    /// By name.
    pub nets_removed: Vec<String>,
    /// Nets with a changed rule: kind, start port, clients, timeout, limits, the records that may be
    /// read, what is required of a password, which one is sent, or whether a gateway is meant.
    pub nets_changed: Vec<String>,
    /// Nodes, by net: "section-1: 1-4, 33". A PROFINET device is told by its net alone.
    pub mappings_added: Vec<String>,
    /// Nodes, by net.
    pub mappings_removed: Vec<String>,
    /// Nodes with another address, public port or server, by net.
    pub mappings_changed: Vec<String>,
    /// By net and name: "section-1: service".
    pub credentials_added: Vec<String>,
    /// By net and name.
    pub credentials_withdrawn: Vec<String>,
    /// Those with another password, towards clients or servers, by net and name.
    pub credentials_changed: Vec<String>,
}

/// Something of a configuration that is not in force.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct NotInForce {
    /// A setting, or a public address with its ports.
    pub what: String,
    /// Why not, and what to do.
    pub why: String,
}

impl Display for NotInForce {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.what, self.why)
    }
}

impl Changes {
    /// What is different in `new`.
    pub fn between(old: &Config, new: &Config) -> Self {
        let nets = Difference::of(&nets(old), &nets(new), NetRules::is_same);
        let mappings = Difference::of(&mappings(&old.table), &mappings(&new.table), same_way);
        let passwords = |old: &&Credential, new: &&Credential| same_passwords(old, new);
        let credentials =
            Difference::of(&credentials(&old.table), &credentials(&new.table), passwords);
        let names = |names: Vec<&str>| names.into_iter().map(str::to_owned).collect();
        let credential = |(net, name)| format!("{net}: {name}");
        let named = |keys: Vec<_>| keys.into_iter().map(credential).collect();
        Self {
            settings_changed: settings(old, new),
            nets_added: names(nets.added),
            nets_removed: names(nets.removed),
            nets_changed: names(nets.changed),
            mappings_added: by_net(&mappings.added),
            mappings_removed: by_net(&mappings.removed),
            mappings_changed: by_net(&mappings.changed),
            credentials_added: named(credentials.added),
            credentials_withdrawn: named(credentials.removed),
            credentials_changed: named(credentials.changed),
        }
    }
}

/// Keys that only one of two maps has, and keys with different values.
struct Difference<K> {
    added: Vec<K>,
    removed: Vec<K>,
    changed: Vec<K>,
}

impl<K: Ord + Copy> Difference<K> {
    fn of<V>(old: &BTreeMap<K, V>, new: &BTreeMap<K, V>, same: impl Fn(&V, &V) -> bool) -> Self {
        let missing = |from: &BTreeMap<K, V>, of: &BTreeMap<K, V>| {
            of.keys().copied().filter(|key| !from.contains_key(key)).collect()
        };
        let changed = |(key, new): (&K, &V)| {
            let old = old.get(key)?;
            (!same(old, new)).then_some(*key)
        };
        Self {
            added: missing(old, new),
            removed: missing(new, old),
            changed: new.iter().filter_map(changed).collect(),
        }
    }
}

/// The rules of a net.
struct NetRules<'a> {
    net: &'a Net,
    is_beyond_gateway: bool,
}

fn nets(config: &Config) -> BTreeMap<&str, NetRules<'_>> {
    let rules = |id| NetRules {
        net: config.table.net(id),
        is_beyond_gateway: config.beyond_gateway.contains(&id),
    };
    config.table.net_ids().map(rules).map(|rules| (rules.net.name.as_str(), rules)).collect()
}

fn mappings(table: &Table) -> BTreeMap<(&str, u8), Mapping> {
    let key = |mapping: &Mapping| (table.net(mapping.net).name.as_str(), mapping.node_address);
    table.mappings().iter().map(|mapping| (key(mapping), *mapping)).collect()
}

fn credentials(table: &Table) -> BTreeMap<(&str, &str), &Credential> {
    let mut credentials = BTreeMap::new();
    for net in table.nets() {
        for credential in &net.credentials {
            credentials.insert((net.name.as_str(), credential.name.as_str()), credential);
        }
    }
    credentials
}

impl NetRules<'_> {
    /// Credentials are compared one by one, but for their order.
    fn is_same(&self, new: &Self) -> bool {
        let Net {
            name: _,
            kind,
            allow,
            credentials: _,
            allow_without_password,
            require_response_password,
            idle_timeout,
            max_flows,
            max_requests,
            max_flow_requests,
        } = self.net;
        let net = new.net;
        *kind == net.kind
            && *allow == net.allow
            && *allow_without_password == net.allow_without_password
            && *require_response_password == net.require_response_password
            && *idle_timeout == net.idle_timeout
            && *max_flows == net.max_flows
            && *max_requests == net.max_requests
            && *max_flow_requests == net.max_flow_requests
            && self.is_beyond_gateway == new.is_beyond_gateway
            && self.sent_password() == new.sent_password()
    }

    /// The name of the password that requests of a remote net get.
    fn sent_password(&self) -> Option<&str> {
        let first = self.net.credentials.first().filter(|_| self.net.kind.is_remote());
        first.map(|credential| credential.name.as_str())
    }
}

fn same_way(old: &Mapping, new: &Mapping) -> bool {
    (old.local_address, old.public_port, old.server)
        == (new.local_address, new.public_port, new.server)
}

fn same_passwords(old: &Credential, new: &Credential) -> bool {
    let same = |old: &Password, new: &Password| bool::from(old.matches(new.octets()));
    same(&old.password, &new.password) && same(old.at_server(), new.at_server())
}

fn settings(old: &Config, new: &Config) -> Vec<&'static str> {
    let changed = [
        ("[public] listen", old.listen != new.listen),
        ("[protocol] header", old.table.header != new.table.header),
        ("[limits]", old.limits != new.limits),
        ("[datapath]", old.datapath != new.datapath),
        ("[log]", old.log != new.log),
        // Its other keys need a restart: `not_in_force` tells of them.
        ("[runtime]", times(&old.runtime) != times(&new.runtime)),
        ("[admin]", old.admin != new.admin),
    ];
    changed.into_iter().filter_map(|(key, changed)| changed.then_some(key)).collect()
}

fn times(runtime: &Runtime) -> [Duration; 2] {
    [runtime.pre_drain, runtime.drain]
}

/// A text for each net: its name and its nodes, written as in the file.
fn by_net(nodes: &[(&str, u8)]) -> Vec<String> {
    let of_net = |nodes: &[(&str, u8)]| match nodes {
        [(net, NO_NODE)] => (*net).to_owned(),
        nodes => {
            let numbers: Vec<_> = nodes.iter().map(|(_, node)| u16::from(*node)).collect();
            format!("{}: {}", nodes[0].0, runs(&numbers))
        }
    };
    nodes.chunk_by(|(net, _), (next, _)| net == next).map(of_net).collect()
}

/// Ascending numbers as runs: "1-4, 33".
pub(crate) fn runs(numbers: &[u16]) -> String {
    each_run(numbers).collect::<Vec<_>>().join(", ")
}

/// The runs of ascending numbers: "1-4", "33".
pub(crate) fn each_run(numbers: &[u16]) -> impl Iterator<Item = String> {
    let runs = numbers.chunk_by(|number, next| number.checked_add(1) == Some(*next));
    runs.map(|run| match run {
        [first, .., last] => format!("{first}-{last}"),
        run => run[0].to_string(),
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::config::fixture::config;
    use crate::nat::NetKind;

    #[test]
    fn the_same_is_no_change() {
        assert_eq!(Changes::between(&config(), &config()), Changes::default());
    }

    #[test]
    fn nodes_are_told_as_runs_by_their_nets() {
        let nodes =
            [("a", 1), ("a", 2), ("a", 3), ("a", 5), ("b", 6), ("c", 7), ("c", 8), ("d", NO_NODE)];
        assert_eq!(by_net(&nodes), ["a: 1-3, 5", "b: 6", "c: 7-8", "d"]);
        assert_eq!(by_net(&[]), [""; 0]);
    }

    /// The same port leads to the same server, but the flows are closed.
    #[test]
    fn another_kind_of_net_is_told() {
        let old = config();
        let mut nets = old.table.nets().to_vec();
        nets[1].kind = NetKind::UdpRange { start_port: 20193 };
        let table = Table::new(old.table.header, nets, old.table.mappings().to_vec());
        let new = Config { table: Arc::new(table), ..old.clone() };
        let expected = Changes { nets_changed: vec!["press".into()], ..Changes::default() };
        assert_eq!(Changes::between(&old, &new), expected);
    }

    #[test]
    fn every_difference_has_its_place() {
        let old = config();
        let mut nets = old.table.nets().to_vec();
        nets[0].max_flows += 1;
        nets[0].credentials[0].password = Password::new(*b"another!");
        nets[0].credentials[1].name = "team-c".into();
        nets[1].name = "oven".into();
        let mut mappings = old.table.mappings().to_vec();
        mappings[0].server.set_port(34380);
        mappings[2].node_address = 34;
        let table = Arc::new(Table::new("02000001".parse().unwrap(), nets, mappings));
        let new = Config { table, listen: Vec::new(), admin: None, ..old.clone() };
        let expected = Changes {
            settings_changed: vec!["[public] listen", "[protocol] header", "[admin]"],
            nets_added: vec!["oven".into()],
            nets_removed: vec!["press".into()],
            nets_changed: vec!["section-1".into()],
            mappings_added: vec!["oven: 7".into(), "section-1: 34".into()],
            mappings_removed: vec!["press: 7".into(), "section-1: 33".into()],
            mappings_changed: vec!["section-1: 1".into()],
            credentials_added: vec!["section-1: team-c".into()],
            credentials_withdrawn: vec!["section-1: team-b".into()],
            credentials_changed: vec!["section-1: service".into()],
        };
        assert_eq!(Changes::between(&old, &new), expected);
    }
}
