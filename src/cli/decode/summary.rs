//! What a capture has shown, server by server. A server is an address and port that was asked: a public
//! port of the relay, or a node in the plant. Invariant: at most [`MOST`] have a row of their own.

use std::collections::HashMap;
use std::fmt::{self, Display};
use std::net::SocketAddr;

use comfy_table::CellAlignment;
use foldhash::fast::RandomState;
use serde::Serialize;

use super::pairing::{Asked, Request};
use crate::cli::output::{duration, table};
use crate::observe::totals::ResponseTotals;

/// Servers with a row of their own; the others share one.
const MOST: usize = 1024;

/// Counts of a capture.
#[derive(Debug, Default)]
pub(super) struct Summary {
    rows: Vec<Row>,
    /// The place of a server's row.
    places: HashMap<SocketAddr, usize, RandomState>,
    /// Lines with a datagram.
    pub(super) datagrams: u64,
    /// Answers to none of the requests.
    pub(super) unasked: u64,
    /// Fragments whose datagram is not known, since the first one is missing.
    pub(super) lost_fragments: u64,
}

/// What is known of a server.
#[derive(Debug, Default)]
struct Row {
    /// None in the row of all others.
    server: Option<SocketAddr>,
    node: Node,
    requests: u64,
    unanswered: u64,
    malformed: u64,
    from_another_port: u64,
    times: Box<ResponseTotals>,
    answers: u64,
}

/// The node that a server's requests name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Node {
    #[default]
    Unknown,
    One(u8),
    Several,
}

impl Summary {
    pub(super) fn malformed(&mut self, server: SocketAddr) {
        self.row(server).malformed += 1;
    }

    pub(super) fn request(&mut self, request: &Request) {
        let row = self.row(request.server);
        row.requests += 1;
        row.node = match row.node {
            Node::Unknown => Node::One(request.node_address),
            Node::One(node_address) if node_address == request.node_address => row.node,
            Node::One(_) | Node::Several => Node::Several,
        };
    }

    pub(super) fn answer(&mut self, asked: &Asked) {
        let row = self.row(asked.server);
        if asked.from_another_port {
            row.from_another_port += 1;
            return;
        }
        row.answers += 1;
        if let Some(elapsed) = asked.elapsed {
            row.times.observe(elapsed);
        }
    }

    pub(super) fn unanswered(&mut self, request: &Request) {
        self.row(request.server).unanswered += 1;
    }

    fn row(&mut self, server: SocketAddr) -> &mut Row {
        let next = self.rows.len();
        let place = match self.places.get(&server) {
            Some(&place) => place,
            None if next < MOST => {
                self.places.insert(server, next);
                self.rows.push(Row { server: Some(server), ..Row::default() });
                next
            }
            None => {
                if next == MOST {
                    self.rows.push(Row::default());
                }
                MOST
            }
        };
        &mut self.rows[place]
    }

    /// As it is printed. `name` tells the net and the node of a server, if they are known.
    pub(super) fn report<'a>(
        &self,
        is_stopped: bool,
        name: impl Fn(SocketAddr) -> Option<(&'a str, u8)>,
    ) -> Report<'a> {
        let sum = |count: fn(&Row) -> u64| self.rows.iter().map(count).sum();
        let mut rows: Vec<_> = self.rows.iter().collect();
        rows.sort_by_key(|row| (row.server.is_none(), row.server));
        let servers = rows.into_iter().map(|row| {
            let known = row.server.and_then(&name);
            let node = known.map_or(row.node, |(_, node_address)| Node::One(node_address));
            ServerReport {
                server: row.server,
                net: known.map(|(net, _)| net),
                node_address: if let Node::One(node_address) = node {
                    Some(node_address)
                } else {
                    None
                },
                is_several: node == Node::Several,
                requests: row.requests,
                answers: row.answers,
                unanswered: row.unanswered,
                response_time_median_seconds: row.quantile(0.5),
                response_time_p99_seconds: row.quantile(0.99),
                malformed: row.malformed,
                from_another_port: row.from_another_port,
            }
        });
        Report {
            datagrams: self.datagrams,
            malformed: sum(|row| row.malformed),
            requests: sum(|row| row.requests),
            answers: sum(|row| row.answers),
            unanswered: sum(|row| row.unanswered),
            from_another_port: sum(|row| row.from_another_port),
            unasked: self.unasked,
            lost_fragments: self.lost_fragments,
            is_stopped,
            servers: servers.collect(),
        }
    }
}

impl Row {
    fn quantile(&self, share: f64) -> Option<f64> {
        self.times.quantile(share).map(|time| time.as_secs_f64())
    }
}

/// A summary as it is printed.
#[derive(Debug, Serialize)]
pub(super) struct Report<'a> {
    datagrams: u64,
    malformed: u64,
    requests: u64,
    answers: u64,
    unanswered: u64,
    #[serde(rename = "answers_from_another_port")]
    from_another_port: u64,
    #[serde(rename = "answers_without_request")]
    unasked: u64,
    lost_fragments: u64,
    #[serde(rename = "stopped")]
    is_stopped: bool,
    servers: Vec<ServerReport<'a>>,
}

#[derive(Debug, Serialize)]
struct ServerReport<'a> {
    /// Null: all that have no row of their own.
    server: Option<SocketAddr>,
    #[serde(skip_serializing_if = "Option::is_none")]
    net: Option<&'a str>,
    /// Null where requests name several nodes, or where there is none.
    node_address: Option<u8>,
    #[serde(skip)]
    is_several: bool,
    requests: u64,
    answers: u64,
    unanswered: u64,
    response_time_median_seconds: Option<f64>,
    response_time_p99_seconds: Option<f64>,
    malformed: u64,
    #[serde(rename = "answers_from_another_port")]
    from_another_port: u64,
}

impl Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "\nDatagrams: {}, malformed: {}. Requests: {}, answered: {}, unanswered: {}.",
            self.datagrams, self.malformed, self.requests, self.answers, self.unanswered
        )?;
        let has_nets = self.servers.iter().any(|server| server.net.is_some());
        let mut header = vec!["Server"];
        header.extend(has_nets.then_some("Net"));
        header.extend(["Node", "Requests", "Answers", "Unanswered", "Median", "99 %", "Faults"]);
        let rows: Vec<_> = self.servers.iter().map(|server| server.cells(has_nets)).collect();
        let mut table = table(header, &rows);
        // Addresses begin with a figure, and are none.
        if let Some(servers) = table.column_mut(0) {
            servers.set_cell_alignment(CellAlignment::Left);
        }
        writeln!(f, "\n{table}")?;
        let mut notes = Vec::new();
        if self.from_another_port > 0 {
            notes.push(format!(
                "Answers from another port than was asked: {}. The relay drops them.",
                self.from_another_port
            ));
        }
        if self.unasked > 0 {
            notes.push(format!("Answers whose request is not in the capture: {}.", self.unasked));
        }
        if self.lost_fragments > 0 {
            notes.push(format!(
                "Fragments of datagrams whose first fragment is missing: {}.",
                self.lost_fragments
            ));
        }
        if self.is_stopped {
            notes.push("A signal came before the end of the input.".to_owned());
        }
        if !notes.is_empty() {
            writeln!(f)?;
        }
        notes.iter().try_for_each(|note| writeln!(f, "{note}"))
    }
}

impl ServerReport<'_> {
    fn cells(&self, has_nets: bool) -> Vec<String> {
        let or_dash = |text: Option<String>| text.unwrap_or_else(|| "–".to_owned());
        let several = self.is_several.then(|| "several".to_owned());
        let node = self.node_address.map(|node_address| node_address.to_string()).or(several);
        let mut cells = vec![self.server.map_or("others".to_owned(), |server| server.to_string())];
        cells.extend(has_nets.then(|| or_dash(self.net.map(str::to_owned))));
        cells.push(or_dash(node));
        cells.extend([self.requests, self.answers, self.unanswered].map(|count| count.to_string()));
        cells.push(duration(self.response_time_median_seconds));
        cells.push(duration(self.response_time_p99_seconds));
        cells.push((self.malformed + self.from_another_port).to_string());
        cells
    }
}

#[cfg(test)]
mod tests;
