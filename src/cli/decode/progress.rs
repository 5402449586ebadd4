//! How far a long read is, as a line on stderr: a bar where the length of the input is known.

use std::io::{IsTerminal, Write, stderr, stdout};
use std::time::{Duration, Instant};

/// Shorter work shows nothing.
const PATIENCE: Duration = Duration::from_secs(2);
/// Time between two pictures.
const INTERVAL: Duration = Duration::from_millis(200);
/// Characters in the bar.
const BAR: usize = 30;
/// Moves to the front of the line and clears it.
const CLEAR: &str = "\r\x1b[K";

/// What was read so far. It is cleared when it is dropped.
#[derive(Debug)]
pub(super) struct Progress {
    /// None where nobody would see it, or where it would mix with the result.
    next: Option<Instant>,
    began: Instant,
    /// Octets of the input, if that is known.
    total: Option<u64>,
    read: u64,
    is_drawn: bool,
}

impl Progress {
    /// For an input of so many octets. It is shown only on a terminal that the result does not go to.
    pub(super) fn of(total: Option<u64>) -> Self {
        let (is_seen, began) = (stderr().is_terminal() && !stdout().is_terminal(), Instant::now());
        Self { next: is_seen.then(|| began + PATIENCE), began, total, read: 0, is_drawn: false }
    }

    /// Adds octets.
    pub(super) fn add(&mut self, octets: usize) {
        self.read += octets as u64;
        let now = Instant::now();
        if self.next.is_some_and(|next| next <= now) {
            self.next = Some(now + INTERVAL);
            self.is_drawn = true;
            let line = line(self.read, self.total, now - self.began);
            // Where it cannot be shown, the work still goes on.
            let _ = stderr().write_all(format!("{CLEAR}{line}").as_bytes());
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if self.is_drawn {
            let _ = stderr().write_all(CLEAR.as_bytes());
        }
    }
}

fn line(read: u64, total: Option<u64>, since: Duration) -> String {
    let mebibytes = |octets: u64| octets as f64 / f64::from(1 << 20);
    let speed = mebibytes(read) / since.as_secs_f64().max(1e-3);
    // A file may have grown, and a device has no length.
    let Some(total) = total.filter(|&total| 0 < total && read <= total) else {
        return format!("{:.0} MiB read, {speed:.0} MiB/s", mebibytes(read));
    };
    let share = read as f64 / total as f64;
    let full = (share * BAR as f64) as usize;
    format!(
        "[{}{}] {:3.0} % of {:.0} MiB, {speed:.0} MiB/s",
        "#".repeat(full),
        " ".repeat(BAR - full.min(BAR)),
        share * 100.0,
        mebibytes(total)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_where_the_length_is_known_and_holds() {
        const MEBIBYTE: u64 = 1 << 20;
        let after = |read, total| line(read * MEBIBYTE, total, Duration::from_secs(2));
        let half = "[###############               ]  50 % of 200 MiB, 50 MiB/s";
        assert_eq!(after(100, Some(200 * MEBIBYTE)), half);
        let all = "[##############################] 100 % of 200 MiB, 100 MiB/s";
        assert_eq!(after(200, Some(200 * MEBIBYTE)), all);
        for total in [None, Some(0), Some(99 * MEBIBYTE)] {
            assert_eq!(after(100, total), "100 MiB read, 50 MiB/s");
        }
        assert!(line(0, Some(1), Duration::ZERO).starts_with("[  "));
    }
}
