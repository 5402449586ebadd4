//! Whether a rule of nft keeps requests from a public port: the rule set as `nft -j list ruleset` prints
//! it, gone through for one datagram.
//!
//! Not everything of the datagram is known, and not every expression is understood. So a condition may be
//! met, not met, or open, and a port that depends on an open one is neither let in nor kept out for sure.

use std::collections::HashMap;
use std::net::IpAddr;

use ipnet::IpNet;
use serde_json::Value;

use crate::probe::Check;

/// The most chains that are entered from another one.
const DEEPEST: usize = 16;

/// A request of a client to a public port.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arriving<'a> {
    pub(super) is_ipv4: bool,
    pub(super) port: u16,
    /// The interfaces that it may come in by; empty: that is not known.
    pub(super) interfaces: &'a [String],
    /// The networks that the client may be in.
    pub(super) clients: &'a [IpNet],
}

/// What becomes of a datagram.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Fate {
    /// No rule keeps it out.
    Passes,
    /// It is dropped here.
    Dropped(String),
    /// A condition that is not known decides, here.
    Open(String),
}

/// Whether a condition is met.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Met {
    Yes,
    No,
    Open,
}

impl Met {
    fn of(is_met: bool) -> Self {
        if is_met { Self::Yes } else { Self::No }
    }

    fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::No, _) | (_, Self::No) => Self::No,
            (Self::Yes, Self::Yes) => Self::Yes,
            _ => Self::Open,
        }
    }

    fn or(self, other: Self) -> Self {
        match (self, other) {
            (Self::Yes, _) | (_, Self::Yes) => Self::Yes,
            (Self::No, Self::No) => Self::No,
            _ => Self::Open,
        }
    }

    fn not(self) -> Self {
        match self {
            Self::Yes => Self::No,
            Self::No => Self::Yes,
            Self::Open => Self::Open,
        }
    }
}

/// What may come of a chain.
#[derive(Clone, Copy, Debug, Default)]
struct Ends {
    accepts: bool,
    drops: bool,
    /// It comes to the end of the chain, or returns.
    goes_on: bool,
}

/// A rule set.
pub(super) struct Rules<'a> {
    /// Chains with a hook that a datagram to this host passes.
    bases: Vec<&'a Value>,
    /// The rules of each chain, by family, table and name.
    chains: HashMap<[&'a str; 3], Vec<&'a Value>>,
}

impl<'a> Rules<'a> {
    /// The rules in what nft printed.
    pub(super) fn of(printed: &'a Value) -> Self {
        let mut rules = Self { bases: Vec::new(), chains: HashMap::new() };
        for object in printed["nftables"].as_array().into_iter().flatten() {
            let (chain, rule) = (&object["chain"], &object["rule"]);
            let hook = chain["hook"].as_str();
            if matches!(hook, Some("prerouting" | "input")) && chain["type"] == "filter" {
                rules.bases.push(chain);
            }
            if let Some(name) = rule["chain"].as_str() {
                rules.chains.entry(key(rule, name)).or_default().push(rule);
            }
        }
        rules
    }

    /// What becomes of a datagram.
    pub(super) fn fate(&self, arriving: Arriving<'_>) -> Fate {
        let mut fate = Fate::Passes;
        for base in &self.bases {
            let family = base["family"].as_str().unwrap_or_default();
            if !matches!((family, arriving.is_ipv4), ("inet", _) | ("ip", true) | ("ip6", false)) {
                continue;
            }
            let name = base["name"].as_str().unwrap_or_default();
            let mut ends = self.run(key(base, name), arriving, 0);
            let policy_drops = base["policy"] == "drop";
            ends.drops |= ends.goes_on && policy_drops;
            ends.accepts |= ends.goes_on && !policy_drops;
            let table = base["table"].as_str().unwrap_or_default();
            let place = format!("chain {name} of table {family} {table}");
            match (ends.drops, ends.accepts) {
                (true, false) => return Fate::Dropped(place),
                (true, true) => fate = Fate::Open(place),
                (false, _) => {}
            }
        }
        fate
    }

    fn run(&self, chain: [&'a str; 3], arriving: Arriving<'_>, depth: usize) -> Ends {
        let mut ends = Ends::default();
        if depth > DEEPEST {
            return Ends { accepts: true, drops: true, goes_on: true };
        }
        for rule in self.chains.get(&chain).into_iter().flatten() {
            let mut met = Met::Yes;
            for statement in rule["expr"].as_array().into_iter().flatten() {
                let Some((name, content)) = statement.as_object().and_then(|it| it.iter().next())
                else {
                    continue;
                };
                let there = match name.as_str() {
                    "match" => {
                        met = met.and(matches(content, arriving));
                        None
                    }
                    "accept" => Some(Ends { accepts: true, ..Ends::default() }),
                    "drop" | "reject" => Some(Ends { drops: true, ..Ends::default() }),
                    "return" => Some(Ends { goes_on: true, ..Ends::default() }),
                    "jump" | "goto" => {
                        let target = content["target"].as_str().unwrap_or_default();
                        Some(self.run(key(rule, target), arriving, depth + 1))
                    }
                    "vmap" => Some(self.vmap(rule, content, arriving, depth)),
                    "counter" | "log" | "comment" | "notrack" | "mangle" | "ct helper" => None,
                    // A limit, an expression of iptables, or what nobody has heard of.
                    _ => {
                        met = met.and(Met::Open);
                        None
                    }
                };
                let Some(there) = there.filter(|_| met != Met::No) else { continue };
                ends.accepts |= there.accepts;
                ends.drops |= there.drops;
                let is_left = met == Met::Yes
                    && (!there.goes_on || matches!(name.as_str(), "goto" | "return"));
                if is_left {
                    ends.goes_on |= there.goes_on;
                    return ends;
                }
            }
        }
        ends.goes_on = true;
        ends
    }

    /// A map from a value to what is done.
    fn vmap(&self, rule: &'a Value, map: &'a Value, arriving: Arriving<'_>, depth: usize) -> Ends {
        let mut all = Ends::default();
        let Some(pairs) = map["data"]["set"].as_array() else {
            return Ends { accepts: true, drops: true, goes_on: true };
        };
        for pair in pairs {
            let met = test(&map["key"], &pair[0], arriving);
            let Some((name, content)) = pair[1].as_object().and_then(|it| it.iter().next()) else {
                continue;
            };
            let there = match name.as_str() {
                _ if met == Met::No => continue,
                "accept" => Ends { accepts: true, ..Ends::default() },
                "drop" => Ends { drops: true, ..Ends::default() },
                "jump" | "goto" => {
                    let target = content["target"].as_str().unwrap_or_default();
                    self.run(key(rule, target), arriving, depth + 1)
                }
                _ => Ends { goes_on: true, ..Ends::default() },
            };
            if met == Met::Yes {
                return there;
            }
            all = Ends {
                accepts: all.accepts | there.accepts,
                drops: all.drops | there.drops,
                goes_on: true,
            };
        }
        Ends { goes_on: true, ..all }
    }
}

fn key<'a>(object: &'a Value, chain: &'a str) -> [&'a str; 3] {
    let text = |name: &str| object[name].as_str().unwrap_or_default();
    [text("family"), text("table"), chain]
}

/// Whether a datagram meets a match.
fn matches(content: &Value, arriving: Arriving<'_>) -> Met {
    let met = test(&content["left"], &content["right"], arriving);
    match content["op"].as_str() {
        Some("==" | "in") => met,
        Some("!=") => met.not(),
        _ => Met::Open,
    }
}

/// Whether what is on the left has this value, or one of these.
fn test(left: &Value, right: &Value, arriving: Arriving<'_>) -> Met {
    if let Some(values) = right.as_array().or(right["set"].as_array()) {
        let met = values.iter().map(|value| test(left, value, arriving));
        return met.fold(Met::No, Met::or);
    }
    let right = if right["elem"].is_object() { &right["elem"]["val"] } else { right };
    let payload = &left["payload"];
    let protocol = payload["protocol"].as_str().unwrap_or_default();
    let field = payload["field"].as_str().or(left["meta"]["key"].as_str()).unwrap_or_default();
    let is_udp = || Met::of(right == "udp" || *right == 17);
    match (protocol, field) {
        ("ip", _) if !arriving.is_ipv4 => Met::No,
        ("ip6", _) if arriving.is_ipv4 => Met::No,
        ("ip", "protocol") | ("ip6", "nexthdr") | ("", "l4proto") => is_udp(),
        ("", "nfproto") => Met::of(right == if arriving.is_ipv4 { "ipv4" } else { "ipv6" }),
        ("udp" | "th", "dport") => port(right, arriving.port),
        ("udp" | "th" | "", "sport") => Met::Open,
        ("tcp" | "icmp" | "icmpv6" | "sctp" | "dccp" | "udplite" | "esp" | "ah", _) => Met::No,
        ("", "iifname" | "iif") => interface(right, arriving.interfaces),
        ("ip" | "ip6", "saddr") => client(right, arriving.clients),
        _ if left["ct"]["key"] == "state" => {
            if right.is_string() {
                Met::of(right == "new")
            } else {
                Met::Open
            }
        }
        _ => Met::Open,
    }
}

fn port(right: &Value, port: u16) -> Met {
    let port = u64::from(port);
    if let Some(number) = right.as_u64() {
        return Met::of(number == port);
    }
    match (right["range"][0].as_u64(), right["range"][1].as_u64()) {
        (Some(first), Some(last)) => Met::of((first..=last).contains(&port)),
        _ => Met::Open,
    }
}

fn interface(right: &Value, interfaces: &[String]) -> Met {
    let Some(name) = right.as_str().filter(|_| !interfaces.is_empty()) else { return Met::Open };
    let is_it = |interface: &String| match name.strip_suffix('*') {
        Some(start) => interface.starts_with(start),
        None => interface == name,
    };
    let those = interfaces.iter().filter(|interface| is_it(interface)).count();
    match those {
        0 => Met::No,
        all if all == interfaces.len() => Met::Yes,
        _ => Met::Open,
    }
}

fn client(right: &Value, clients: &[IpNet]) -> Met {
    let prefix = &right["prefix"];
    let network = match (prefix["addr"].as_str(), prefix["len"].as_u64()) {
        (Some(address), Some(length)) => format!("{address}/{length}").parse().ok(),
        _ => right.as_str().and_then(|text| Some(IpNet::from(text.parse::<IpAddr>().ok()?))),
    };
    let Some(network): Option<IpNet> = network else { return Met::Open };
    let of_this_family = |it: &&IpNet| it.addr().is_ipv4() == network.addr().is_ipv4();
    let mut clients = clients.iter().filter(of_this_family).peekable();
    if clients.peek().is_none() {
        return Met::Open;
    }
    let clients: Vec<_> = clients.collect();
    if clients.iter().all(|it| network.contains(*it)) {
        Met::Yes
    } else if clients.iter().any(|it| network.contains(*it) || it.contains(&network)) {
        Met::Open
    } else {
        Met::No
    }
}

/// Whether the firewall lets requests to the public ports of a net in. `printed` is what nft printed.
pub(super) fn judge(net: &str, printed: Option<&Value>, requests: &[Arriving<'_>]) -> Check {
    const CHECK: &str = "firewall";
    let Some(printed) = printed else {
        return Check::unknown(CHECK, net, "the rules of nft cannot be read")
            .remedy("run the probe as root, with nft there");
    };
    let rules = Rules::of(printed);
    let remedy = |port: u16| format!("let it in: nft add rule …, `udp dport {port} accept`");
    let mut open = None;
    for request in requests {
        match rules.fate(*request) {
            Fate::Passes => {}
            Fate::Dropped(place) => {
                let port = request.port;
                let text = format!("requests to UDP {port} are dropped by {place}");
                return Check::bad(CHECK, net, text).remedy(remedy(port));
            }
            Fate::Open(place) => open = open.or(Some((request.port, place))),
        }
    }
    match open {
        None => Check::good(CHECK, net, "no rule of nft keeps requests from the public ports"),
        Some((port, place)) => {
            let text = format!("{place} lets some requests to UDP {port} in, and drops others");
            Check::unknown(CHECK, net, text)
                .remedy("see whether its conditions fit the clients: nft list ruleset")
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::probe::Verdict;

    fn matching(left: Value, right: Value) -> Value {
        json!({"match": {"op": "==", "left": left, "right": right}})
    }

    fn dport(right: Value) -> Value {
        matching(json!({"payload": {"protocol": "udp", "field": "dport"}}), right)
    }

    fn iifname(name: &str) -> Value {
        matching(json!({"meta": {"key": "iifname"}}), json!(name))
    }

    fn saddr(address: &str, length: u8) -> Value {
        let left = json!({"payload": {"protocol": "ip", "field": "saddr"}});
        matching(left, json!({"prefix": {"addr": address, "len": length}}))
    }

    /// What becomes of a request to port 20004 in an input chain with these rules.
    fn fate(policy: &str, rules: &[Vec<Value>]) -> &'static str {
        let mut printed =
            vec![json!({"chain": {"family": "inet", "table": "filter", "name": "input",
            "type": "filter", "hook": "input", "prio": 0, "policy": policy}})];
        let rule = |expr: &Vec<Value>| json!({"rule": {"family": "inet", "table": "filter", "chain": "input", "expr": expr}});
        printed.extend(rules.iter().map(rule));
        printed.push(json!({"rule": {"family": "inet", "table": "filter", "chain": "clients",
            "expr": [dport(json!(20004)), {"accept": null}]}}));
        let printed = json!({ "nftables": printed });
        let interfaces = ["wan0".to_owned()];
        let clients = ["198.51.100.0/24".parse().unwrap()];
        let arriving =
            Arriving { is_ipv4: true, port: 20004, interfaces: &interfaces, clients: &clients };
        match Rules::of(&printed).fate(arriving) {
            Fate::Passes => "passes",
            Fate::Dropped(place) => {
                assert_eq!(place, "chain input of table inet filter");
                "dropped"
            }
            Fate::Open(_) => "open",
        }
    }

    #[test]
    fn a_policy_that_drops_wants_a_rule_that_accepts() {
        let (accept, drop) = (json!({"accept": null}), json!({"drop": null}));
        let range = json!({"range": [20001, 20125]});
        assert_eq!(fate("accept", &[]), "passes");
        assert_eq!(fate("drop", &[]), "dropped");
        for ports in [json!(20004), range.clone(), json!({"set": [53, range]})] {
            assert_eq!(fate("drop", &[vec![dport(ports), accept.clone()]]), "passes");
        }
        assert_eq!(fate("drop", &[vec![dport(json!(20005)), accept.clone()]]), "dropped");
        assert_eq!(
            fate("accept", &[vec![json!({"counter": {"packets": 1}}), drop.clone()]]),
            "dropped"
        );
        // The first rule counts.
        let rules = [vec![dport(json!(20004)), drop.clone()], vec![accept.clone()]];
        assert_eq!(fate("accept", &rules), "dropped");
        let rules = [vec![dport(json!(20004)), accept], vec![drop]];
        assert_eq!(fate("drop", &rules), "passes");
    }

    /// The rules of docs/operations.md.
    #[test]
    fn conditions_on_interface_and_client_are_judged_by_the_configuration() {
        let accept = || json!({"accept": null});
        let ours = |name| vec![iifname(name), dport(json!(20004)), accept()];
        let no_plant = vec![iifname("wan0"), saddr("172.17.17.0", 24), json!({"drop": null})];
        assert_eq!(fate("drop", &[no_plant.clone(), ours("wan0")]), "passes");
        assert_eq!(fate("drop", &[no_plant, ours("plant0")]), "dropped");
        assert_eq!(fate("drop", &[ours("wan*")]), "passes");
        let from = |address, length| vec![saddr(address, length), accept()];
        assert_eq!(fate("drop", &[from("198.51.0.0", 16)]), "passes");
        assert_eq!(fate("drop", &[from("198.51.100.7", 32)]), "open");
        assert_eq!(fate("drop", &[from("203.0.113.0", 24)]), "dropped");
    }

    #[test]
    fn states_protocols_and_chains_are_understood() {
        let state = json!({"ct": {"key": "state"}});
        let accept = || json!({"accept": null});
        let established = matching(state.clone(), json!(["established", "related"]));
        assert_eq!(fate("drop", &[vec![established, accept()]]), "dropped");
        assert_eq!(
            fate("drop", &[vec![matching(state.clone(), json!("new")), accept()]]),
            "passes"
        );
        let tcp = matching(json!({"payload": {"protocol": "tcp", "field": "dport"}}), json!(20004));
        assert_eq!(fate("drop", &[vec![tcp, accept()]]), "dropped");
        let udp = matching(json!({"meta": {"key": "l4proto"}}), json!("udp"));
        assert_eq!(fate("drop", &[vec![udp, accept()]]), "passes");
        assert_eq!(fate("drop", &[vec![json!({"jump": {"target": "clients"}})]]), "passes");
        assert_eq!(fate("drop", &[vec![json!({"jump": {"target": "none"}})]]), "dropped");
        let map = json!({"vmap": {"key": state, "data": {"set": [
            ["invalid", {"drop": null}], ["established", {"accept": null}]]}}});
        assert_eq!(fate("drop", &[vec![map.clone()]]), "dropped");
        assert_eq!(fate("drop", &[vec![map], vec![dport(json!(20004)), accept()]]), "passes");
    }

    #[test]
    fn what_is_not_understood_stays_open() {
        for what in [json!({"xt": null}), json!({"limit": {"rate": 5}}), json!({"new thing": 1})] {
            assert_eq!(fate("drop", &[vec![what.clone(), json!({"accept": null})]]), "open");
            assert_eq!(fate("accept", &[vec![what, json!({"drop": null})]]), "open");
        }
        // A chain that jumps to itself.
        assert_eq!(fate("drop", &[vec![json!({"jump": {"target": "input"}})]]), "open");
    }

    #[test]
    fn the_verdict_names_port_and_chain() {
        let arriving = Arriving { is_ipv4: true, port: 20004, interfaces: &[], clients: &[] };
        assert_eq!(judge("n", None, &[arriving]).verdict, Verdict::Unknown);
        let chain = |policy| {
            json!({"nftables": [{"chain": {"family": "ip", "table": "f", "name": "in",
                "type": "filter", "hook": "input", "policy": policy}}]})
        };
        assert_eq!(judge("n", Some(&chain("accept")), &[arriving]).verdict, Verdict::Good);
        let check = judge("n", Some(&chain("drop")), &[arriving]);
        assert_eq!(check.verdict, Verdict::Bad);
        assert_eq!(check.text, "requests to UDP 20004 are dropped by chain in of table ip f");
        let v6 = Arriving { is_ipv4: false, ..arriving };
        assert_eq!(judge("n", Some(&chain("drop")), &[v6]).verdict, Verdict::Good);
    }
}
