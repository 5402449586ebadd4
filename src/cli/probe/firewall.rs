//! Whether a rule of nft keeps requests from a public port: the rule set as `nft -j list ruleset` prints
//! it, gone through for one datagram.
//!
//! Not everything of the datagram is known, and not every expression is understood. So a condition may be
//! met, not met, or open, and a port that depends on an open one is neither let in nor kept out for sure.

mod condition;
#[cfg(test)]
mod tests;

use std::collections::HashMap;

use serde_json::Value;

use crate::probe::Check;
pub(super) use condition::Arriving;
use condition::{Met, matches, test};

/// The most chains that are entered from another one.
const DEEPEST: usize = 16;

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
