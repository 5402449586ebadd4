//! What a running relay says of itself, its nets and its nodes.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use crate::cli::admin_server::AdminServer;
use crate::harmless::{harmless, harmless_value};
use crate::probe::{Check, Counted};

const CHECK: &str = "relay";
const RELAY: &str = "the relay";

/// The answers of its admin server.
pub(super) struct Relay {
    status: Value,
    nets: Vec<Value>,
}

impl Relay {
    /// Asks a relay.
    pub(super) async fn ask(server: &AdminServer) -> anyhow::Result<Self> {
        let [status, nets] =
            [server.get("/api/v1/status").await?, server.get("/api/v1/nets").await?]
                .map(|answer: Map<String, Value>| harmless_value(answer.into()));
        let nets = nets["nets"].as_array().cloned().unwrap_or_default();
        Ok(Self { status, nets })
    }

    /// Whether it relays, and all of its configuration is in force.
    pub(super) fn judge(&self) -> Vec<Check> {
        let mut checks = Vec::new();
        if self.status["ready"] == true {
            let version = self.status["version"].as_str().unwrap_or_default();
            checks.push(Check::good(CHECK, RELAY, format!("pnet-nat {version} relays")));
        } else {
            let text = "is not ready: it is starting or stopping";
            checks
                .push(Check::bad(CHECK, RELAY, text).remedy("see its log: journalctl -u pnet-nat"));
        }
        let reload = &self.status["reload"];
        if reload["successful"] == false {
            let why =
                reload["error"].as_str().unwrap_or("not all of it could be brought into force");
            let text = format!("the configuration that was last read is not in force: {why}");
            checks.push(
                Check::doubtful(CHECK, RELAY, text)
                    .remedy("pnet-nat status tells more; then reload"),
            );
        }
        checks
    }

    /// Whether requests to a net come at all, and whether the kernel drops any.
    pub(super) fn judge_net(&self, name: &str) -> Vec<Check> {
        let Some(net) = self.net(name) else {
            let text = "the relay does not have this net: another configuration is in force";
            return vec![Check::bad(CHECK, name, text).remedy("reload the relay")];
        };
        let mut checks = Vec::new();
        if net["request"]["received_datagrams"] == 0 {
            let text = "no request has come since the relay started";
            checks.push(Check::unknown("clients", name, text).remedy(
                "if a client asks: its IPAddr has to be this router's public address, its UDPPort the start \
                 port, and whatever is in front of this router has to let the public ports through",
            ));
        }
        let dropped = counts(&net["kernel_dropped_datagrams"]);
        let dropped: Vec<_> = dropped.iter().filter(|(_, count)| **count > 0).collect();
        if !dropped.is_empty() {
            let items: Vec<_> =
                dropped.iter().map(|(cause, count)| format!("{count} ({cause})")).collect();
            let text = format!(
                "dropped by the kernel before the relay saw them, as in a flood: {}",
                items.join(", ")
            );
            checks.push(Check::doubtful("flood", name, text).remedy(
                "prefilter: find the sender and keep it out with a firewall; overflow: raise `receive_buffer` \
                 and sysctl net.core.rmem_max, add workers",
            ));
        }
        checks
    }

    /// What it has counted of a node.
    pub(super) fn counted(&self, net: &str, node_address: u8) -> Option<Counted> {
        let nodes = self.net(net)?["nodes"].as_array()?;
        let node = nodes.iter().find(|node| node["node"] == node_address)?;
        let mut dropped = BTreeMap::new();
        for direction in ["request", "response"] {
            for (reason, count) in counts(&node[direction]["dropped_datagrams"]) {
                *dropped.entry(reason).or_default() += count;
            }
        }
        Some(Counted {
            is_silent: node["state"] == "silent",
            last_answer_seconds: node["last_response_age_seconds"].as_f64(),
            dropped,
        })
    }

    fn net(&self, name: &str) -> Option<&Value> {
        self.nets.iter().find(|net| net["name"] == name)
    }
}

/// That no relay answers.
pub(super) fn no_answer(error: &anyhow::Error) -> Check {
    let text = harmless(&format!("{error:#}"));
    Check::bad(CHECK, RELAY, text).remedy("start it: systemctl status pnet-nat tells why it ended")
}

/// That there is nobody to ask.
pub(super) fn no_admin_server() -> Check {
    Check::unknown(CHECK, RELAY, "its admin server is off ([admin] enabled), so it cannot be asked")
}

fn counts(object: &Value) -> BTreeMap<String, u64> {
    let counts = object.as_object().into_iter().flatten();
    counts.filter_map(|(name, count)| Some((name.clone(), count.as_u64()?))).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::probe::Verdict;

    fn relay() -> Relay {
        Relay {
            status: json!({"ready": true, "version": "0.1.0", "reload": {"successful": true}}),
            nets: vec![json!({
                "name": "section-1",
                "request": {"received_datagrams": 40},
                "kernel_dropped_datagrams": {"overflow": 0, "prefilter": 900},
                "nodes": [
                    {"node": 3, "state": "silent", "last_response_age_seconds": 9.0,
                     "request": {"dropped_datagrams": {"node_mismatch": 2}},
                     "response": {"dropped_datagrams": {"unknown_flow": 1}}},
                ],
            })],
        }
    }

    #[test]
    fn a_flood_and_what_a_node_was_refused_are_read() {
        let checks = relay().judge_net("section-1");
        assert_eq!(checks.len(), 1);
        assert_eq!(
            checks[0].text,
            "dropped by the kernel before the relay saw them, as in a flood: 900 (prefilter)"
        );
        let counted = relay().counted("section-1", 3).unwrap();
        assert!(counted.is_silent);
        assert_eq!(counted.dropped["node_mismatch"] + counted.dropped["unknown_flow"], 3);
        assert!(relay().counted("section-1", 4).is_none());
        assert_eq!(relay().judge_net("section-2")[0].verdict, Verdict::Bad);
    }

    #[test]
    fn a_relay_that_is_not_ready_or_not_reloaded_says_so() {
        assert_eq!(relay().judge().len(), 1);
        let mut stopping = relay();
        stopping.status =
            json!({"ready": false, "reload": {"successful": false, "error": "it is not sound"}});
        let verdicts: Vec<_> = stopping.judge().iter().map(|check| check.verdict).collect();
        assert_eq!(verdicts, [Verdict::Bad, Verdict::Doubtful]);
    }

    #[test]
    fn a_net_that_nobody_asks_is_told_of() {
        let mut quiet = relay();
        quiet.nets[0]["request"]["received_datagrams"] = json!(0);
        quiet.nets[0]["kernel_dropped_datagrams"] = json!({});
        let checks = quiet.judge_net("section-1");
        assert_eq!((checks.len(), checks[0].verdict), (1, Verdict::Unknown));
    }
}
