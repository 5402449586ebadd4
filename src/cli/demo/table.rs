//! The output of the demo: on a terminal a table that is redrawn in place, otherwise a line a second, and
//! a summary at the end.
//!
//! Invariant: no line of the live table wraps, since redrawing would then leave parts behind. The table
//! fits into 80 columns.

use std::fmt::Write as _;
use std::io::{self, IsTerminal, Write, stdout};
use std::net::SocketAddr;
use std::time::Duration;

use super::figures::{Figures, NodeFigures};
use super::traffic::Intrusions;
use crate::cli::output::{Paint, out};

/// Standard output, and how it is written to.
pub(super) struct Display {
    live: bool,
    paint: Paint,
    /// How many lines the last table has; the next one replaces them.
    lines: usize,
}

impl Display {
    /// Prints what is running and where to look.
    pub(super) fn open(admin: SocketAddr) -> io::Result<Self> {
        let live = stdout().is_terminal();
        let paint = Paint::of_stdout();
        let title = paint.bold("pnet-nat demo");
        writeln!(
            out(),
            "{title}: a remote client polls four server nodes through the relay, all on\n\
             loopback. A stranger sends wrong passwords and garbage, and gets nothing.\n\n\
             \x20 status page  http://{admin}/\n\
             \x20 to try       curl http://{admin}/metrics\n\
             \x20              curl http://{admin}/api/v1/nets\n\
             \x20              curl http://{admin}/-/ready\n\
             \x20 to end       Ctrl-C\n"
        )?;
        Ok(Self { live, paint, lines: 0 })
    }

    /// How often to call [`show`](Self::show).
    pub(super) fn interval(&self) -> Duration {
        if self.live { Duration::from_millis(200) } else { Duration::from_secs(1) }
    }

    /// Shows the current figures.
    pub(super) fn show(&mut self, figures: &Figures) -> io::Result<()> {
        if !self.live {
            return writeln!(out(), "{}", line(figures));
        }
        // A wrapped line would take two lines, so a narrow terminal cuts it off.
        write!(out(), "\x1b[?7l")?;
        self.redraw(figures)?;
        write!(out(), "\x1b[?7h")?;
        out().flush()
    }

    /// Shows the last figures, and what is wrong with them.
    pub(super) fn close(&mut self, figures: &Figures, faults: &[String]) -> io::Result<()> {
        if !self.live {
            writeln!(out())?;
        }
        self.redraw(figures)?;
        let mut out = out();
        writeln!(out)?;
        for fault in faults {
            writeln!(out, "{} {fault}", self.paint.red("✗"))?;
        }
        if faults.is_empty() {
            let tick = self.paint.green("✓");
            writeln!(
                out,
                "{tick} every answer was right and none was lost\n\
                 {tick} the stranger was never answered, and nothing it sent reached a node\n\
                 {tick} received = forwarded + dropped, for every node and direction"
            )?;
        }
        Ok(())
    }

    fn redraw(&mut self, figures: &Figures) -> io::Result<()> {
        let table = table(figures, self.paint);
        let mut out = out();
        if self.lines > 0 {
            write!(out, "\x1b[{}F", self.lines)?; // up to the first line of the last table
        }
        for line in table.lines() {
            let erase = if self.live { "\x1b[K" } else { "" };
            writeln!(out, "{line}{erase}")?;
        }
        self.lines = table.lines().count();
        out.flush()
    }
}

fn line(figures: &Figures) -> String {
    let sum = |of: fn(&NodeFigures) -> u64| figures.nodes.iter().map(of).sum::<u64>();
    let Intrusions { wrong_passwords, garbage, answered } = figures.intrusions;
    format!(
        "{:>4} s  client: {} requests, {} right answers; stranger: {} datagrams, {} dropped, \
         {answered} answered",
        figures.elapsed.as_secs(),
        sum(|node| node.polled.requests),
        sum(|node| node.polled.right),
        wrong_passwords + garbage,
        figures.dropped.iter().map(|(_, dropped)| dropped).sum::<u64>(),
    )
}

fn table(figures: &Figures, paint: Paint) -> String {
    let mut table = String::new();
    let heading = format!(
        "{:<16}   {:<19} {:>9} {:>9} {:>9} {:>8}",
        "public port", "server node", "requests", "answers", "response", "dropped"
    );
    table += &paint.bold(&heading);
    table.push('\n');
    for node in &figures.nodes {
        table += &row(node, paint);
    }
    table.push('\n');
    table += &strangers(figures, paint);
    table
}

fn row(node: &NodeFigures, paint: Paint) -> String {
    let polled = node.polled;
    let answers = format!("{:>9}", polled.right);
    // One request may still be waiting for its answer.
    let answers = if polled.wrong == 0 && polled.requests - polled.right <= 1 {
        paint.green(&answers)
    } else {
        paint.red(&answers)
    };
    let dropped: u64 = node.relayed.iter().map(|relayed| relayed.dropped).sum();
    format!(
        "{:<16} → {:<19} {:>9} {answers} {:>9} {:>8}\n",
        node.public.to_string(),
        node.server.to_string(),
        polled.requests,
        mean(polled.round_trips, polled.right + polled.wrong),
        dropped
    )
}

fn strangers(figures: &Figures, paint: Paint) -> String {
    let Intrusions { wrong_passwords, garbage, answered } = figures.intrusions;
    let count = answered.to_string();
    let answered = if answered == 0 { paint.green(&count) } else { paint.red(&count) };
    let mut text = format!(
        "stranger: {wrong_passwords} wrong passwords, {garbage} times garbage; answered: {answered}\n"
    );
    for reasons in figures.dropped.chunks(3) {
        text += " ";
        for (reason, dropped) in reasons {
            let reason = format!(" {:<18}", reason.label());
            let _ = write!(text, "{}{dropped:>6}", paint.dim(&reason));
        }
        text.push('\n');
    }
    text
}

/// The mean time in milliseconds.
fn mean(sum: Duration, number: u64) -> String {
    if number == 0 {
        return "–".into();
    }
    format!("{:.2} ms", sum.as_secs_f64() * 1e3 / number as f64)
}

#[cfg(test)]
mod tests {
    use super::super::figures::tests::sound;
    use super::*;

    #[test]
    fn no_line_of_a_table_is_longer_than_80_columns_and_none_is_coloured_without_asking() {
        let plain = table(&sound(), Paint { colour: false });
        assert!(plain.lines().all(|line| line.chars().count() <= 80), "{plain}");
        assert!(!plain.contains('\x1b'));
        let coloured = table(&sound(), Paint { colour: true });
        assert_ne!(coloured, plain);
        let codes = ["0", "1", "2", "31", "32"].map(|code| format!("\x1b[{code}m"));
        let stripped = codes.iter().fold(coloured, |text, code| text.replace(code, ""));
        assert_eq!(stripped, plain);
    }

    #[test]
    fn a_row_tells_of_one_node() {
        let mut node = sound().nodes.remove(0);
        node.polled.round_trips = Duration::from_millis(2_500_000);
        assert_eq!(
            row(&node, Paint { colour: false }),
            "127.0.0.1:20001  → 127.17.17.1:34379     1000000   1000000   2.50 ms   400000\n"
        );
        assert!(row(&node, Paint { colour: true }).contains("\x1b[32m  1000000\x1b[0m"));
        node.polled.right -= 2;
        assert!(row(&node, Paint { colour: true }).contains("\x1b[31m   999998\x1b[0m"));
    }
}
