//! Draws the flows of a relay: a table of clients, and one of passwords.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::net::{IpAddr, SocketAddr};

use comfy_table::Table;
use serde::Deserialize;

use super::super::output::{age, node, table};
use crate::config::runs;

/// The last columns of both tables.
const TRAFFIC: [&str; 3] = ["Requests", "Answers", "Octets"];

/// The relay's answer.
#[derive(Debug, Deserialize)]
pub(super) struct Flows {
    flows: Vec<Flow>,
    credentials: Vec<Credential>,
    /// Whether these are all flows.
    complete: bool,
}

#[derive(Debug, Deserialize)]
struct Flow {
    net: String,
    node: u8,
    client: SocketAddr,
    credential: Option<String>,
    age_seconds: f64,
    idle_seconds: f64,
    requests: u64,
    responses: u64,
    octets: u64,
}

#[derive(Debug, Deserialize)]
struct Credential {
    net: String,
    credential: String,
    accepted_requests: u64,
    flows: u64,
}

/// A client of a net, with everything that it uses one password for.
#[derive(Debug, Default)]
struct Client {
    nodes: Vec<u8>,
    flows: u64,
    age_seconds: f64,
    idle_seconds: f64,
    requests: u64,
    responses: u64,
    octets: u64,
}

impl Flows {
    /// Draws a line for each client of a net, or with `full` for each flow.
    pub(super) fn draw(&self, full: bool) -> String {
        let mut text = match self.flows.len() {
            0 => "No client is connected.\n".to_owned(),
            _ if full => format!("{}\n", self.each()),
            _ => format!("{}\n", self.by_client()),
        };
        if !self.complete {
            let listed = self.flows.len();
            let _ = writeln!(text, "\nMore flows are open than these {listed}: --limit, or --net");
        }
        if !self.credentials.is_empty() {
            let row = |credential: &Credential| {
                [
                    credential.net.clone(),
                    credential.credential.clone(),
                    credential.accepted_requests.to_string(),
                    credential.flows.to_string(),
                ]
            };
            let rows: Vec<_> = self.credentials.iter().map(row).collect();
            let header = ["Net", "Password", "Requests since start", "Flows"];
            let _ = write!(text, "\n{}\n", table(header, &rows));
        }
        text
    }

    fn by_client(&self) -> Table {
        let mut clients: BTreeMap<(&str, IpAddr, Option<&str>), Client> = BTreeMap::new();
        for flow in &self.flows {
            let key = (flow.net.as_str(), flow.client.ip(), flow.credential.as_deref());
            clients.entry(key).or_default().add(flow);
        }
        let row = |((net, client, password), mut of): ((&str, IpAddr, _), Client)| {
            of.nodes.sort_unstable();
            of.nodes.dedup();
            [
                net.to_owned(),
                client.to_string(),
                nodes(&of.nodes),
                password_name(password),
                of.flows.to_string(),
                age(of.age_seconds),
                age(of.idle_seconds),
                of.requests.to_string(),
                of.responses.to_string(),
                of.octets.to_string(),
            ]
        };
        let rows: Vec<_> = clients.into_iter().map(row).collect();
        let header = ["Net", "Client", "Nodes", "Password", "Flows", "Since", "Idle"];
        table(header.into_iter().chain(TRAFFIC), &rows)
    }

    fn each(&self) -> Table {
        let row = |flow: &Flow| {
            [
                flow.net.clone(),
                flow.client.to_string(),
                node(flow.node),
                password_name(flow.credential.as_deref()),
                age(flow.age_seconds),
                age(flow.idle_seconds),
                flow.requests.to_string(),
                flow.responses.to_string(),
                flow.octets.to_string(),
            ]
        };
        let mut flows: Vec<_> = self.flows.iter().collect();
        flows.sort_by_key(|flow| (&flow.net, flow.client, flow.node));
        let rows: Vec<_> = flows.into_iter().map(row).collect();
        let header = ["Net", "Client", "Node", "Password", "Since", "Idle"];
        table(header.into_iter().chain(TRAFFIC), &rows)
    }
}

impl Client {
    fn add(&mut self, flow: &Flow) {
        let is_first = self.flows == 0;
        let idle = if is_first { flow.idle_seconds } else { self.idle_seconds };
        self.idle_seconds = idle.min(flow.idle_seconds);
        self.age_seconds = self.age_seconds.max(flow.age_seconds);
        self.nodes.push(flow.node);
        self.flows += 1;
        self.requests += flow.requests;
        self.responses += flow.responses;
        self.octets += flow.octets;
    }
}

/// Node addresses of one net, ascending.
fn nodes(all: &[u8]) -> String {
    match all {
        [one] => node(*one),
        all => runs(&all.iter().copied().map(u16::from).collect::<Vec<_>>()),
    }
}

/// The name of the password of the latest request.
fn password_name(credential: Option<&str>) -> String {
    credential.unwrap_or("–").to_owned()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn flow(
        node: u8,
        client: &str,
        credential: Option<&str>,
        seconds: [f64; 2],
    ) -> serde_json::Value {
        json!({
            "net": "section-1", "node": node, "client": client, "credential": credential,
            "age_seconds": seconds[0], "idle_seconds": seconds[1], "requests": 3, "responses": 2,
            "octets": 100,
        })
    }

    fn draw(flows: &[serde_json::Value], complete: bool, full: bool) -> String {
        let credential = json!({ "net": "section-1", "credential": "team-b", "accepted_requests": 9, "flows": 3 });
        let answer = json!({ "flows": flows, "credentials": [credential], "complete": complete });
        serde_json::from_value::<Flows>(answer).unwrap().draw(full)
    }

    #[test]
    fn a_client_of_a_net_is_a_line_with_its_nodes() {
        let flows = [
            flow(2, "198.51.100.9:50001", Some("team-b"), [60.0, 4.0]),
            flow(1, "198.51.100.9:50000", Some("team-b"), [300.0, 9.0]),
            flow(33, "198.51.100.9:50000", Some("team-b"), [10.0, 5.0]),
            flow(1, "198.51.100.9:50002", None, [1.0, 0.0]),
        ];
        let expected = "\
| Net       |       Client |   Nodes | Password | Flows | Since | Idle | Requests | Answers | Octets |
|-----------|--------------|---------|----------|-------|-------|------|----------|---------|--------|
| section-1 | 198.51.100.9 |       1 | –        |     1 |   1 s |  0 s |        3 |       2 |    100 |
| section-1 | 198.51.100.9 | 1-2, 33 | team-b   |     3 | 5 min |  4 s |        9 |       6 |    300 |

| Net       | Password | Requests since start | Flows |
|-----------|----------|----------------------|-------|
| section-1 | team-b   |                    9 |     3 |
";
        assert_eq!(draw(&flows, true, false), expected);
        let full = draw(&flows[..1], false, true);
        assert!(full.contains("| section-1 | 198.51.100.9:50001 |    2 | team-b "), "{full}");
        assert!(full.contains("\nMore flows are open than these 1: --limit, or --net\n"), "{full}");
        assert!(draw(&[], true, false).starts_with("No client is connected.\n\n| Net "));
    }
}
