//! What happened, as a table.

use std::time::{Duration, UNIX_EPOCH};

use anyhow::Context;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::table::Layout;

/// How many events are shown without `--full`.
const MOST: usize = 50;
/// The last second of the year 9999, in seconds since 1970. No later one can be written.
const LATEST: f64 = 253_402_300_799.0;

/// The API's answer, newest first.
#[derive(Debug, Deserialize)]
pub(super) struct Events(pub(super) Vec<Event>);

#[derive(Debug, Deserialize, Serialize)]
pub(super) struct Event {
    number: u64,
    /// Seconds since 1970.
    time: f64,
    kind: String,
    net: Option<String>,
    node: Option<u8>,
    text: String,
}

impl Events {
    /// Reads an answer, and keeps the events of one net, or all.
    pub(super) fn read(mut answer: Value, net: Option<&str>) -> anyhow::Result<Self> {
        let mut events: Self = serde_json::from_value(answer["events"].take())
            .context("the relay has another version of the API")?;
        events.0.retain(|event| net.is_none_or(|net| event.net.as_deref() == Some(net)));
        Ok(events)
    }

    pub(super) fn draw(&self, layout: Layout) -> String {
        let most = if layout.full { self.0.len() } else { MOST };
        let rows: Vec<_> = self.0.iter().take(most).map(row).collect();
        let header = ["Time (UTC)", "Kind", "What happened"];
        let mut text = format!("{}\n", layout.table(header, &rows));
        if let Some(more) = self.0.len().checked_sub(MOST).filter(|more| *more > 0 && !layout.full)
        {
            text += &format!("{more} earlier events; --full lists them.\n");
        }
        text
    }
}

fn row(event: &Event) -> [String; 3] {
    let time = Duration::try_from_secs_f64(event.time.clamp(0.0, LATEST)).unwrap_or_default();
    let time = humantime::format_rfc3339_seconds(UNIX_EPOCH + time).to_string();
    [time.replace('T', " ").replace('Z', ""), event.kind.clone(), event.text.clone()]
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::cli::output::Paint;

    fn event(number: u64, time: f64, net: &str) -> Value {
        json!({ "number": number, "time": time, "kind": "node_silent", "net": net, "node": null,
                "text": format!("2 nodes (1-2) of {net} are silent") })
    }

    #[test]
    fn the_last_50_are_shown_newest_first_whatever_their_time() {
        let layout = |full| Layout { paint: Paint { colour: false }, width: None, full };
        let all: Vec<_> = (1..=60).rev().map(|n| event(n, 1.795e9, "section-1")).collect();
        let answer = json!({ "events": all });
        let events = Events::read(answer, None).unwrap();
        let table = events.draw(layout(false));
        assert!(
            table.contains("| 2026-11-18 11:06:40 | node_silent | 2 nodes (1-2) of "),
            "{table}"
        );
        assert!(table.ends_with("|\n10 earlier events; --full lists them.\n"), "{table}");
        assert_eq!(events.draw(layout(true)).lines().count(), 62);

        let odd = json!({ "events": [event(3, 1e300, "press"), event(2, -1.0, "press"), event(1, 0.0, "other")] });
        let events = Events::read(odd, Some("press")).unwrap();
        let table = events.draw(layout(false));
        assert_eq!((table.contains("9999-12-31"), table.contains("1970-01-01")), (true, true));
        assert_eq!(table.lines().count(), 4, "{table}");
        assert!(Events::read(json!({}), None).is_err());
    }
}
