//! Who is refused and why, as a table, and in a line of the state as a whole.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use anyhow::Context;
use comfy_table::ContentArrangement;
use serde::Deserialize;
use serde_json::Value;
use strum::VariantArray;

use super::super::output::{age, node, table};
use super::table::Layout;
use crate::nat::DropReason;

/// How many rows are shown without `--full`.
const MOST: usize = 50;
/// How long ago is not lately, in seconds.
const LATELY: f64 = 600.0;

/// The API's answer.
#[derive(Debug, Deserialize)]
pub(super) struct Refused {
    /// Newest first.
    pub(super) refused: Vec<Row>,
    pub(super) not_listed: u64,
    /// Explanations by label.
    pub(super) drop_reasons: BTreeMap<String, String>,
}

/// Datagrams of one sender, for one node, that were dropped for one reason.
#[derive(Debug, Deserialize)]
pub(super) struct Row {
    source: String,
    net: String,
    node: u8,
    direction: String,
    reason: String,
    count: u64,
    first_age_seconds: f64,
    last_age_seconds: f64,
}

impl Refused {
    pub(super) fn read(answer: Value) -> anyhow::Result<Self> {
        serde_json::from_value(answer).context("the relay has another version of the API")
    }

    pub(super) fn draw(&self, layout: Layout) -> String {
        if self.refused.is_empty() {
            return "Nobody was refused.\n".to_owned();
        }
        let most = if layout.full { self.refused.len() } else { MOST };
        let shown = &self.refused[..self.refused.len().min(most)];
        let header = ["Source", "Net", "Node", "Reason", "Count", "First", "Last"];
        let rows: Vec<_> = shown.iter().map(Row::cells).collect();
        let mut text = format!("{}\n", table(header, &rows));
        let more = self.refused.len() - shown.len();
        if more > 0 {
            let _ = writeln!(text, "{more} more; --full lists them.");
        }
        if self.not_listed > 0 {
            let found = "more datagrams were dropped, whose senders found no place in this list.";
            let _ = writeln!(text, "{} {found}", self.not_listed);
        }
        let reasons: BTreeSet<_> = shown.iter().map(|row| row.reason.as_str()).collect();
        let meaning = |reason: &str| self.drop_reasons.get(reason).map_or("", String::as_str);
        let rows = reasons.into_iter().map(|reason| {
            [reason.to_owned(), meaning(reason).replace('`', "")] //
        });
        let mut meanings =
            table(["Reason", "What it means, what to do"], &rows.collect::<Vec<_>>());
        if let Some(width) = layout.width {
            meanings.set_content_arrangement(ContentArrangement::Dynamic).set_width(width);
        }
        let _ = writeln!(text, "\n{meanings}");
        text
    }
}

impl Row {
    fn cells(&self) -> [String; 7] {
        [
            self.source.clone(),
            self.net.clone(),
            node(self.node),
            self.reason.clone(),
            self.count.to_string(),
            age(self.first_age_seconds) + " ago",
            age(self.last_age_seconds) + " ago",
        ]
    }

    /// Whether it is a request of somebody who means the relay, and was refused lately.
    fn is_of_now(&self) -> bool {
        let reason = DropReason::VARIANTS.iter().find(|reason| reason.label() == self.reason);
        let is_noise = reason.is_some_and(|reason| reason.is_malformed());
        self.direction == "request" && self.last_age_seconds < LATELY && !is_noise
    }
}

/// A line that names whom the relay refuses now; none if it is nobody.
pub(super) fn hint(rows: &[Row]) -> Option<String> {
    let lately: Vec<_> = rows.iter().filter(|row| row.is_of_now()).collect();
    let Row { source, net, reason, count, .. } = lately.first()?;
    let others: BTreeSet<_> =
        lately.iter().map(|row| &row.source).filter(|other| *other != source).collect();
    let times = if *count == 1 { "once".to_owned() } else { format!("{count} times") };
    let others = match others.len() {
        0 => String::new(),
        1 => ", and 1 other sender".to_owned(),
        others => format!(", and {others} other senders"),
    };
    Some(format!(
        "Refused in the last 10 minutes: {source} for {net}, {reason}, {times}{others}. \
         pnet-nat status --refused tells more."
    ))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::cli::output::Paint;

    fn row(source: &str, reason: &str, count: u64, last: f64) -> Value {
        json!({ "source": source, "net": "section-1", "node": 3, "direction": "request",
                "reason": reason, "count": count, "first_age_seconds": 840.0,
                "last_age_seconds": last })
    }

    fn read(rows: &[Value], not_listed: u64) -> Refused {
        let reasons = json!({ "source_not_allowed": "In none of `allow`." });
        let answer = json!({
            "refused": rows, "not_listed": not_listed, "drop_reasons": reasons,
        });
        Refused::read(answer).unwrap()
    }

    #[test]
    fn each_row_says_who_how_often_and_when_and_each_reason_what_it_means() {
        let layout = |full| Layout { paint: Paint { colour: false }, width: None, full };
        assert_eq!(read(&[], 0).draw(layout(false)), "Nobody was refused.\n");
        let mut device = row("2001:db8::7", "rpc_write", 1, 7.0);
        device["node"] = json!(0);
        let all = [row("198.51.100.9", "source_not_allowed", 138, 3.1), device];
        let text = read(&all, 5).draw(layout(false));
        let cells = |line: &str| -> Vec<String> {
            line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()
        };
        let rows: Vec<_> = text.lines().map(cells).collect();
        let first = "198.51.100.9|section-1|3|source_not_allowed|138|14 min ago|3 s ago";
        assert_eq!(rows[2], first.split('|').collect::<Vec<_>>());
        let second = "2001:db8::7|section-1|–|rpc_write|1|14 min ago|7 s ago";
        assert_eq!(rows[3], second.split('|').collect::<Vec<_>>());
        assert!(text.contains("\n5 more datagrams were dropped, whose senders "), "{text}");
        assert!(text.contains("| source_not_allowed | In none of allow. "), "{text}");

        let many = vec![row("198.51.100.9", "throttled", 1, 1.0); MOST + 3];
        let text = read(&many, 0).draw(layout(false));
        assert!(text.contains("|\n3 more; --full lists them.\n"), "{text}");
        assert_eq!(read(&many, 0).draw(layout(true)).matches("198.51.100.9").count(), MOST + 3);
    }

    #[test]
    fn one_line_names_the_newest_and_leaves_out_noise_and_what_is_over() {
        let mut answer = row("172.17.17.3", "unknown_flow", 4, 1.0);
        answer["direction"] = json!("response");
        let none = [
            answer,
            row("198.51.100.1", "bad_header", 5, 1.0),
            row("198.51.100.2", "source_not_allowed", 5, 601.0),
        ];
        assert_eq!(hint(&read(&none, 0).refused), None);
        let one = [&none[..], &[row("198.51.100.9", "source_not_allowed", 138, 3.1)]].concat();
        let expected = "Refused in the last 10 minutes: 198.51.100.9 for section-1, \
                        source_not_allowed, 138 times. pnet-nat status --refused tells more.";
        assert_eq!(hint(&read(&one, 0).refused).as_deref(), Some(expected));
        let again = [
            row("198.51.100.9", "password_wrong", 1, 9.0),
            row("198.51.100.7", "throttled", 1, 9.0),
        ];
        let two = [&one[..], &again].concat();
        let line = hint(&read(&two, 0).refused).unwrap();
        assert!(line.contains(", 138 times, and 1 other sender. "), "{line}");
    }
}
