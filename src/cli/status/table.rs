//! Draws the state of a relay: a few lines about the relay, then nets, nodes and drop reasons.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::Duration;

use comfy_table::ContentArrangement;

use super::super::output::{self, Paint, age, duration, table};
use super::refused::hint;
use super::snapshot::{Net, Node, NotInForce, Offload, Reload, Snapshot, Status, Traffic};

/// The most nodes that are all listed without `--full`.
const MOST_NODES: u64 = 100;

/// What to do about a silent node; the status page explains it in detail.
const SILENT: &str = "
A silent node: ping its server from the router. No reply: check its power, cable and address. All
nodes of a net silent: check the route to it; send_failed below grows when there is none. It replies
to ping only: check its Secure port and its password. unknown_flow below grows: it answers from
another address or port. To have the router look for the cause: pnet-nat probe --help
";

/// How it is drawn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    pub(super) paint: Paint,
    /// Columns; none: no limit.
    pub(super) width: Option<u16>,
    /// Whether every node is listed.
    pub(super) full: bool,
}

/// An earlier state, and how long ago that was.
type Earlier<'a> = Option<(Duration, &'a Snapshot)>;

impl Layout {
    /// Draws counts since the start, or rates since an earlier state.
    pub(super) fn draw(self, seen: &Snapshot, earlier: Earlier<'_>, url: &str) -> String {
        let mut text = self.relay(&seen.status, url);
        if !seen.is_one_net {
            let flows: u64 = seen.nets.iter().map(|net| net.flows).sum();
            let _ = writeln!(text, "Flows: {flows} of {}", seen.status.max_flows);
        }
        if let Some(hint) = hint(&seen.refused) {
            let _ = writeln!(text, "{}", self.paint.bold(&hint));
        }
        let nets = net_rows(seen, earlier);
        let _ = write!(text, "\n{}\n", self.table(net_header(earlier.is_some()), &nets));
        text += &self.nodes(seen, earlier);
        if seen.nets.iter().any(|net| !net.silent_nodes.is_empty()) {
            text += SILENT;
        }
        text += &self.drops(seen, earlier);
        text
    }

    fn relay(self, status: &Status, url: &str) -> String {
        let Status { version, public_ports, .. } = status;
        let commit = status.commit.as_ref().map(|commit| format!(" ({commit})"));
        let mut text = format!(
            "pnet-nat {version}{} at {url}, up for {}, {public_ports} public ports\n",
            commit.unwrap_or_default(),
            age(status.uptime_seconds)
        );
        if !status.ready {
            text += &self.paint.red("Not relaying: it is starting or stopping.");
            text.push('\n');
        }
        let in_force = age(status.reload.in_force_seconds);
        if status.reload.successful {
            let _ = writeln!(
                text,
                "Last reload successful; this configuration has been in force for {in_force}"
            );
        } else {
            for line in not_successful(&status.reload, &in_force) {
                text += &self.paint.red(&line);
                text.push('\n');
            }
        }
        let layers = status.sandbox.iter().map(|layer| {
            let why = layer.why.as_ref().map(|why| format!(" ({why})")).unwrap_or_default();
            format!("{} {}{why}", layer.layer, layer.state)
        });
        let _ = writeln!(text, "Confinement: {}", layers.collect::<Vec<_>>().join(", "));
        let _ = writeln!(text, "In the kernel: {}", in_the_kernel(&status.offload));
        text
    }

    fn nodes(self, seen: &Snapshot, earlier: Earlier<'_>) -> String {
        let all = seen.nets.iter().map(|net| net.nodes.len() as u64).sum::<u64>();
        let every = self.full || all <= MOST_NODES;
        let nodes: Vec<_> = seen
            .nets
            .iter()
            .flat_map(|net| net.nodes.iter().map(move |node| (net, node)))
            .filter(|(_, node)| every || node.state == "silent")
            .collect();
        let mut text = match (every, nodes.len()) {
            (true, _) => "\n".to_owned(),
            (false, 0) => return format!("\nNone of {all} nodes is silent; --full lists them.\n"),
            (false, silent) => {
                format!("\nSilent: {silent} of {all} nodes; --full lists all.\n")
            }
        };
        let rows: Vec<_> = nodes.iter().map(|(net, node)| node_row(net, node, earlier)).collect();
        let table = self.table(node_header(earlier.is_some()), &rows);
        for (index, line) in table.lines().enumerate() {
            // Below the header and its rule there is a line for each node.
            let node = index.checked_sub(2).and_then(|row| nodes.get(row));
            let line = match node.map(|(_, node)| node.state.as_str()) {
                Some("silent") => self.paint.red(line),
                Some("never_asked") => self.paint.dim(line),
                _ => line.to_owned(),
            };
            text += &line;
            text.push('\n');
        }
        text
    }

    fn drops(self, seen: &Snapshot, earlier: Earlier<'_>) -> String {
        let dropped = seen.dropped();
        if dropped.is_empty() {
            return "\nNothing was dropped.\n".to_owned();
        }
        let before: Option<(Duration, BTreeMap<_, _>)> =
            earlier.map(|(ago, seen)| (ago, seen.dropped().into_iter().collect()));
        let meaning = |reason| seen.drop_reasons.get(reason).map_or("", String::as_str);
        let rows = dropped.iter().map(|(reason, count)| {
            let mut row = vec![reason.clone(), count.to_string()];
            row.extend(before.as_ref().map(|(ago, before)| {
                rate(*ago, *count, before.get(reason).copied().unwrap_or_default())
            }));
            row.push(meaning(reason).replace('`', ""));
            row
        });
        let mut header = vec!["Dropped", "Since start"];
        header.extend(before.as_ref().map(|_| "A second"));
        header.push("What it means, what to do");
        let mut table = table(header, &rows.collect::<Vec<_>>());
        if let Some(width) = self.width {
            table.set_content_arrangement(ContentArrangement::Dynamic).set_width(width);
        }
        let mut text = format!("\n{table}\n");
        let sources = seen.wrong_password_sources();
        if sources > 0 {
            let at_most = seen.status.wrong_password_sources_at_most;
            let or_more = if sources >= at_most { " or more" } else { "" };
            let addresses = if sources == 1 { "address" } else { "addresses" };
            let _ = writeln!(text, "\nWrong passwords came from {sources}{or_more} {addresses}.");
        }
        text
    }

    pub(super) fn table<const COLUMNS: usize>(
        self,
        header: [&str; COLUMNS],
        rows: &[[String; COLUMNS]],
    ) -> String {
        table(header, rows).to_string()
    }
}

/// The flows that the kernel carries, or why it carries none.
fn in_the_kernel(Offload { why, flows, interfaces }: &Offload) -> String {
    if let Some(why) = why {
        return format!("no: {why}");
    }
    let noun = if *flows == 1 { "flow" } else { "flows" };
    let at = if interfaces.is_empty() { "no interface" } else { &interfaces.join(", ") };
    format!("{flows} {noun}, at {at}")
}

fn net_header(rates: bool) -> [&'static str; 9] {
    let [requests, _] = request_and_answer(rates);
    ["Net", "Answering", "Silent", "Never asked", requests, "Median", "99 %", "Flows", "Dropped"]
}

fn node_header(rates: bool) -> [&'static str; 10] {
    let [requests, answers] = request_and_answer(rates);
    [
        "Net",
        "Node",
        "State",
        requests,
        answers,
        "Median",
        "99 %",
        "Dropped",
        "Last answer",
        "Server",
    ]
}

fn request_and_answer(rates: bool) -> [&'static str; 2] {
    if rates { ["Requests/s", "Answers/s"] } else { ["Requests", "Answers"] }
}

fn net_rows(seen: &Snapshot, earlier: Earlier<'_>) -> Vec<[String; 9]> {
    let row = |net: &Net| {
        let before = earlier.map(|(ago, seen)| {
            let same = |before: &&Net| before.name == net.name;
            (ago, seen.nets.iter().find(same).map(|net| &net.traffic))
        });
        let [requests, _] = traffic(&net.traffic, before);
        [
            net.name.clone(),
            net.answering_nodes.to_string(),
            net.silent_nodes.len().to_string(),
            net.never_asked_nodes.to_string(),
            requests,
            duration(net.traffic.response_time_median_seconds),
            duration(net.traffic.response_time_p99_seconds),
            format!("{} of {}", net.flows, net.max_flows),
            net.traffic.dropped().to_string(),
        ]
    };
    seen.nets.iter().map(row).collect()
}

fn node_row(net: &Net, node: &Node, earlier: Earlier<'_>) -> [String; 10] {
    let before = earlier.map(|(ago, seen)| {
        let before = seen.nets.iter().find(|before| before.name == net.name);
        let nodes = before.map(|net| net.nodes.as_slice()).unwrap_or_default();
        let same =
            |before: &&Node| (before.node, before.public_port) == (node.node, node.public_port);
        (ago, nodes.iter().find(same).map(|node| &node.traffic))
    });
    let [requests, answers] = traffic(&node.traffic, before);
    [
        net.name.clone(),
        output::node(node.node),
        node_state(node),
        requests,
        answers,
        duration(node.traffic.response_time_median_seconds),
        duration(node.traffic.response_time_p99_seconds),
        node.traffic.dropped().to_string(),
        node.last_response_age_seconds.map_or("–".to_owned(), |seconds| age(seconds) + " ago"),
        node.server.clone(),
    ]
}

/// "refused" for a node that was never asked only because its requests were dropped.
fn node_state(node: &Node) -> String {
    let refused: u64 = node.traffic.request.dropped_datagrams.values().sum();
    if node.state == "never_asked" && refused > 0 {
        return "refused".to_owned();
    }
    node.state.replace('_', " ")
}

/// Forwarded requests and answers: how many, or how many a second since an earlier state.
fn traffic(now: &Traffic, earlier: Option<(Duration, Option<&Traffic>)>) -> [String; 2] {
    let [request, response]: [fn(&Traffic) -> u64; 2] =
        [|t| t.request.forwarded_datagrams, |t| t.response.forwarded_datagrams];
    [request, response].map(|count| match earlier {
        None => count(now).to_string(),
        Some((_, None)) => "–".to_owned(),
        Some((ago, Some(before))) => rate(ago, count(now), count(before)),
    })
}

/// The rate a second since an earlier state.
fn rate(ago: Duration, now: u64, before: u64) -> String {
    format!("{:.1}", now.saturating_sub(before) as f64 / ago.as_secs_f64())
}

/// A line for each part that the last reload did not bring into force.
fn not_successful(reload: &Reload, in_force: &str) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(error) = &reload.error {
        lines.push(format!(
            "Last reload failed: {error}. The configuration before it has been in force for {in_force}."
        ));
        lines.extend(reload.faults.iter().map(|fault| format!("  {fault}")));
    } else {
        lines.push(format!(
            "Not all of this configuration is in force; the rest has been for {in_force}."
        ));
    }
    let item = |NotInForce { what, why }: &NotInForce| format!("  not in force: {what}: {why}");
    lines.extend(reload.not_in_force.iter().map(item));
    lines
}
