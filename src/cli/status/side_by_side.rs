//! Several relays side by side: a row for each, and for each net whether they configure it alike.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::super::output::{age, table};
use super::snapshot::{Net, Snapshot, Status};
use super::table::Layout;
use crate::harmless::harmless;

/// What a relay said, or why there is nothing to show of it.
pub(super) type Said<T> = Result<T, String>;

/// How the relays configure a net.
#[derive(Debug, PartialEq, Eq, Serialize)]
struct Agreement {
    net: String,
    /// Whether all that have the net have the same checksum of it.
    agrees: bool,
    /// By checksum, the relays that have it.
    hashes: BTreeMap<String, Vec<String>>,
    /// Those that do not have the net.
    absent: Vec<String>,
}

/// Everything as one object, for scripts.
pub(super) fn as_json(
    answers: Vec<(String, Said<Value>)>,
    seen: &[(String, Said<Snapshot>)],
) -> Value {
    let relay = |(target, answer): (String, Said<Value>)| {
        let answer = answer.unwrap_or_else(|error| json!({ "error": error }));
        let mut relay = Map::from_iter([("target".to_owned(), target.into())]);
        relay.extend(answer.as_object().cloned().unwrap_or_default());
        Value::Object(relay)
    };
    let relays: Vec<_> = answers.into_iter().map(relay).collect();
    json!({ "relays": relays, "nets": agreements(seen) })
}

impl Layout {
    /// Draws counts since the start of each relay.
    pub(super) fn side_by_side(self, seen: &[(String, Said<Snapshot>)]) -> String {
        let header = [
            "Relay",
            "State",
            "Answered",
            "Unanswered",
            "Dropped",
            "Silent",
            "Up for",
            "In force for",
            "Version",
        ];
        let rows: Vec<_> = seen.iter().map(|(target, said)| row(target, said)).collect();
        let drawn = self.table(header, &rows);
        let mut text = String::new();
        for (index, line) in drawn.lines().enumerate() {
            // Below the header and its rule there is a line for each relay.
            let row = index.checked_sub(2).and_then(|row| rows.get(row));
            let is_well = row.is_none_or(|[_, state, ..]| state == RELAYING);
            text += &if is_well { line.to_owned() } else { self.paint.red(line) };
            text.push('\n');
        }
        for error in seen.iter().filter_map(|(_, said)| said.as_ref().err()) {
            let _ = writeln!(text, "{}", self.paint.red(&harmless(error)));
        }
        let versions: BTreeSet<_> = seen
            .iter()
            .filter_map(|(_, said)| said.as_ref().ok())
            .map(|seen| version(&seen.status))
            .collect();
        if versions.len() > 1 {
            let _ = writeln!(text, "{}", self.paint.bold("The relays have different versions."));
        }
        let rows: Vec<_> = agreements(seen).iter().map(Agreement::cells).collect();
        if !rows.is_empty() {
            let _ = writeln!(text, "\n{}", table(["Net", "Configuration"], &rows));
        }
        text
    }
}

const RELAYING: &str = "relaying";

fn row(target: &str, said: &Said<Snapshot>) -> [String; 9] {
    let target = harmless(target);
    let none = || "–".to_owned();
    let Ok(seen) = said else {
        let state = "see below".to_owned();
        return [target, state, none(), none(), none(), none(), none(), none(), none()];
    };
    let Status { ready, reload, uptime_seconds, .. } = &seen.status;
    let state = match (ready, reload.successful) {
        (false, _) => "not relaying",
        (true, false) => "reload failed",
        (true, true) => RELAYING,
    };
    let sum = |of: fn(&Net) -> u64| seen.nets.iter().map(of).sum::<u64>();
    let requests = sum(|net| net.traffic.request.forwarded_datagrams);
    let answers = sum(|net| net.traffic.response.forwarded_datagrams);
    let dropped: u64 = seen.dropped().iter().map(|(_, count)| count).sum();
    [
        target,
        state.to_owned(),
        answers.to_string(),
        requests.saturating_sub(answers).to_string(),
        dropped.to_string(),
        sum(|net| net.silent_nodes.len() as u64).to_string(),
        age(*uptime_seconds),
        age(reload.in_force_seconds),
        version(&seen.status),
    ]
}

fn version(Status { version, commit, .. }: &Status) -> String {
    let commit = commit.as_ref().map(|commit| format!(" ({commit})"));
    format!("{version}{}", commit.unwrap_or_default())
}

/// An agreement for each net that one of the relays has.
fn agreements(seen: &[(String, Said<Snapshot>)]) -> Vec<Agreement> {
    let answered: Vec<_> =
        seen.iter().filter_map(|(target, said)| Some((target, said.as_ref().ok()?))).collect();
    let names: BTreeSet<_> =
        answered.iter().flat_map(|(_, seen)| seen.nets.iter().map(|net| &net.name)).collect();
    let of = |name: &String| {
        let (mut hashes, mut absent) = (BTreeMap::<_, Vec<_>>::new(), Vec::new());
        for (target, seen) in &answered {
            match seen.nets.iter().find(|net| net.name == *name) {
                Some(net) => {
                    hashes.entry(net.config_hash.clone()).or_default().push((*target).clone());
                }
                None => absent.push((*target).clone()),
            }
        }
        Agreement { net: name.clone(), agrees: hashes.len() < 2, hashes, absent }
    };
    names.into_iter().map(of).collect()
}

impl Agreement {
    fn cells(&self) -> [String; 2] {
        let mut told: Vec<_> = match self.agrees {
            true => {
                let relays = self.hashes.values().map(Vec::len).sum::<usize>();
                vec![format!("the same at {relays} of {}", relays + self.absent.len())]
            }
            false => {
                let of = |(hash, targets): (&String, &Vec<String>)| {
                    format!("{hash} at {}", targets.join(", "))
                };
                vec![format!(
                    "differs: {}",
                    self.hashes.iter().map(of).collect::<Vec<_>>().join("; ")
                )]
            }
        };
        if !self.absent.is_empty() {
            told.push(format!("not at {}", self.absent.join(", ")));
        }
        [self.net.clone(), told.join("; ")]
    }
}
