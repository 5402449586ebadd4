//! A progress bar for work that takes long, for whoever looks at a terminal.

use std::io::{self, IsTerminal, Write};
use std::time::Duration;

use tokio::time::Instant;

/// Work that takes no longer has no bar.
const BEGINS_AFTER: Duration = Duration::from_secs(2);
/// Time from one drawing to the next.
const INTERVAL: Duration = Duration::from_millis(200);
const WIDTH: usize = 30;

/// The bar on stderr, where it does not get into the results.
#[derive(Debug)]
pub(super) struct ProgressBar {
    /// When it is drawn next. `None` if stderr is no terminal.
    due: Option<Instant>,
    is_drawn: bool,
}

impl ProgressBar {
    pub(super) fn new() -> Self {
        let due = io::stderr().is_terminal().then(|| Instant::now() + BEGINS_AFTER);
        Self { due, is_drawn: false }
    }

    /// When it is to be drawn.
    pub(super) fn due(&self) -> Option<Instant> {
        self.due
    }

    /// Draws what has been done, in requests and parts of them.
    pub(super) fn draw(&mut self, done: f64, all: u64) {
        self.due = self.due.map(|_| Instant::now() + INTERVAL);
        self.is_drawn = true;
        write(&format!("\r{}\x1b[K", bar(done, all)));
    }

    /// Takes it away, to make room for a line of output.
    pub(super) fn clear(&mut self) {
        if std::mem::take(&mut self.is_drawn) {
            write("\r\x1b[K");
        }
    }
}

fn write(text: &str) {
    // It is of no use to anybody if it cannot be written.
    let _ = io::stderr().write_all(text.as_bytes());
}

fn bar(done: f64, all: u64) -> String {
    let share = (done / all as f64).clamp(0.0, 1.0);
    let full = (share * WIDTH as f64) as usize;
    let percent = (share * 100.0) as u8;
    let (full, empty) = ("#".repeat(full), " ".repeat(WIDTH - full));
    format!("[{full}{empty}] {percent:3} %, {} of {all}", done as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_is_full_at_the_end() {
        assert_eq!(bar(0.0, 8), format!("[{}]   0 %, 0 of 8", " ".repeat(30)));
        assert_eq!(bar(2.5, 5), format!("[{}{}]  50 %, 2 of 5", "#".repeat(15), " ".repeat(15)));
        assert_eq!(bar(5.0, 5), format!("[{}] 100 %, 5 of 5", "#".repeat(30)));
    }
}
