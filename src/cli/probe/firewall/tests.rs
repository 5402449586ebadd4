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
    let mut printed = vec![json!({"chain": {"family": "inet", "table": "filter", "name": "input",
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
    assert_eq!(fate("drop", &[vec![matching(state.clone(), json!("new")), accept()]]), "passes");
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
