//! What commands show once or again and again: in place on a terminal, one after the other elsewhere.

use std::io::{self, Write, stdout};

use serde_json::Value;
use terminal_size::{Height, Width, terminal_size_of};

use super::output::{Format, out};
use crate::harmless::harmless_json;

/// An object of a relay as one line.
pub(super) fn json_line(value: &Value) -> String {
    harmless_json(&value.to_string()) + "\n"
}

/// Shows a table in place of the one before, cut to the height of the terminal. `for_more` says how to see
/// the rest.
pub(super) fn show(text: &str, format: Format, for_more: &str) -> io::Result<()> {
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
