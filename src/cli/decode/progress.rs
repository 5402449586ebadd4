//! How far a long read is: a bar where the length of the input is known.

use std::io::{IsTerminal, stdout};
use std::time::{Duration, Instant};

use crate::cli::progress::{ProgressLine, bar};

/// What was read so far.
#[derive(Debug)]
pub(super) struct Progress {
    line: ProgressLine,
    began: Instant,
    /// Octets of the input, if that is known.
    total: Option<u64>,
    read: u64,
}

impl Progress {
    /// For an input of so many octets. It is shown only on a terminal that the result does not go to.
    pub(super) fn of(total: Option<u64>) -> Self {
        let line = ProgressLine::new(!stdout().is_terminal());
        Self { line, began: Instant::now(), total, read: 0 }
    }

    /// Adds octets.
    pub(super) fn add(&mut self, octets: usize) {
        self.read += octets as u64;
        let now = Instant::now();
        if self.line.due().is_some_and(|due| due <= now) {
            self.line.draw(&line(self.read, self.total, now - self.began));
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
    let bar = bar(read as f64 / total as f64);
    format!("{bar} of {:.0} MiB, {speed:.0} MiB/s", mebibytes(total))
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
