//! What commands show once or again and again: in place on a terminal, one after the other elsewhere.

use std::io::{self, Write, stdout};
use std::process::ExitCode;
use std::time::Duration;

use serde_json::{Value, json};
use terminal_size::{Height, Width, terminal_size_of};

use super::output::{Format, out};
use super::signals::Signals;
use crate::harmless::{harmless, harmless_json};

/// An object of a relay as one line.
pub(super) fn json_line(value: &Value) -> String {
    harmless_json(&value.to_string()) + "\n"
}

/// Shows what `text` makes, again and again until Ctrl-C. An error inside is shown in its place, for the relay
/// may answer again later; one around it ends the command. `for_more` says how to see what has no room.
pub(super) async fn watch(
    interval: Duration,
    format: Format,
    for_more: &str,
    mut text: impl AsyncFnMut() -> anyhow::Result<anyhow::Result<String>>,
) -> anyhow::Result<ExitCode> {
    let mut signals = Signals::new()?;
    loop {
        let text = tokio::select! {
            text = text() => text?,
            _ = signals.next() => return Ok(ExitCode::SUCCESS),
        };
        let text = text.unwrap_or_else(|error| match format {
            Format::Json => json_line(&json!({ "error": format!("{error:#}") })),
            Format::Text => format!("pnet-nat: {}\n", harmless(&format!("{error:#}"))),
        });
        show(&text, format, for_more)?;
        tokio::select! {
            _ = signals.next() => return Ok(ExitCode::SUCCESS),
            () = tokio::time::sleep(interval) => {}
        }
    }
}

/// Shows a table in place of the one before, cut to the height of the terminal.
fn show(text: &str, format: Format, for_more: &str) -> io::Result<()> {
    let mut out = out();
    let (Some((_, height)), Format::Text) = (terminal(), format) else {
        out.write_all(text.as_bytes())?;
        return out.flush();
    };
    let room = usize::from(height.0).saturating_sub(2);
    write!(out, "\x1b[H\x1b[?7l")?; // cursor to the top, no wrapping
    for line in text.lines().take(room) {
        writeln!(out, "{line}\x1b[K")?;
    }
    write!(out, "\x1b[J\x1b[?7h")?; // clear the rest, wrap again
    if let Some(more) = text.lines().count().checked_sub(room).filter(|more| *more > 0) {
        write!(out, "{more} more lines: {for_more}\r")?;
    }
    out.flush()
}

/// The columns of the terminal; none if stdout is not a terminal.
pub(super) fn width() -> Option<u16> {
    terminal().map(|(width, _)| width.0)
}

fn terminal() -> Option<(Width, Height)> {
    terminal_size_of(stdout())
}
