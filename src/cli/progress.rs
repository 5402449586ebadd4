//! How far long work is: a line on stderr that is drawn again and again, for whoever looks at a terminal.

use std::io::{IsTerminal, Write, stderr};
use std::time::{Duration, Instant};

/// Shorter work shows nothing.
const PATIENCE: Duration = Duration::from_secs(2);
/// Time between two pictures.
const INTERVAL: Duration = Duration::from_millis(200);
/// Characters in the bar.
const BAR: usize = 30;
/// Moves to the front of the line and clears it.
const CLEAR: &str = "\r\x1b[K";

/// The line. It is cleared when it is dropped.
#[derive(Debug)]
pub(super) struct ProgressLine {
    /// None where nobody would see it.
    due: Option<Instant>,
    is_drawn: bool,
}

impl ProgressLine {
    /// The line of work that begins now. It is shown on a terminal alone, and only if it `may` be.
    pub(super) fn new(may: bool) -> Self {
        let is_seen = may && stderr().is_terminal();
        Self { due: is_seen.then(|| Instant::now() + PATIENCE), is_drawn: false }
    }

    /// When it is to be drawn. `None` for never.
    pub(super) fn due(&self) -> Option<Instant> {
        self.due
    }

    /// Draws it, in place of the picture before.
    pub(super) fn draw(&mut self, text: &str) {
        self.due = self.due.map(|_| Instant::now() + INTERVAL);
        self.is_drawn = true;
        // Where it cannot be shown, the work still goes on.
        let _ = stderr().write_all(format!("{CLEAR}{text}").as_bytes());
    }

    /// Makes room for other lines.
    pub(super) fn clear(&mut self) {
        if std::mem::take(&mut self.is_drawn) {
            let _ = stderr().write_all(CLEAR.as_bytes());
        }
    }
}

impl Drop for ProgressLine {
    fn drop(&mut self) {
        self.clear();
    }
}

/// A bar of a share from 0 to 1, with its percentage.
pub(super) fn bar(share: f64) -> String {
    let share = share.clamp(0.0, 1.0);
    let full = (share * BAR as f64) as usize;
    format!("[{}{}] {:3.0} %", "#".repeat(full), " ".repeat(BAR - full), share * 100.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_is_full_at_the_end() {
        for (share, full, percent) in
            [(0.0, 0, "  0 %"), (0.5, 15, " 50 %"), (1.0, 30, "100 %"), (1.1, 30, "100 %")]
        {
            let bar = bar(share);
            assert_eq!(bar, format!("[{}{}] {percent}", "#".repeat(full), " ".repeat(30 - full)));
        }
    }
}
