//! The output of commands on stdout: text for people, or one JSON object a line.

use std::fmt::{self, Write as _};
use std::io::{self, Stdout, Write, stdout};

use anstream::{AutoStream, ColorChoice};
use comfy_table::{CellAlignment, Table, presets};
use serde::Serialize;

use crate::nat::NO_NODE;
use crate::probe::Verdict;

/// The format of the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Format {
    Text,
    Json,
}

/// Text with or without colours.
#[derive(Clone, Copy, Debug)]
pub(super) struct Paint {
    pub(super) colour: bool,
}

impl Paint {
    /// Colours under the same conditions as in the help texts: not in a file, and not with `NO_COLOR`.
    pub(super) fn of_stdout() -> Self {
        Self { colour: AutoStream::choice(&stdout()) != ColorChoice::Never }
    }

    pub(super) fn bold(self, text: &str) -> String {
        self.with("1", text)
    }

    pub(super) fn dim(self, text: &str) -> String {
        self.with("2", text)
    }

    pub(super) fn red(self, text: &str) -> String {
        self.with("31", text)
    }

    pub(super) fn green(self, text: &str) -> String {
        self.with("32", text)
    }

    /// In the colour of a verdict.
    pub(super) fn verdict(self, verdict: Verdict, text: &str) -> String {
        let code = match verdict {
            Verdict::Good => "32",
            Verdict::Doubtful => "33",
            Verdict::Bad => "31",
            Verdict::Unknown => "90",
        };
        self.with(code, text)
    }

    fn with(self, code: &str, text: &str) -> String {
        if self.colour { format!("\x1b[{code}m{text}\x1b[0m") } else { text.to_owned() }
    }
}

/// The standard output. Its errors say that they come from it.
pub(super) struct Out(Stdout);

pub(super) fn out() -> Out {
    Out(stdout())
}

impl Write for Out {
    fn write(&mut self, octets: &[u8]) -> io::Result<usize> {
        self.0.write(octets).map_err(Self::error)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush().map_err(Self::error)
    }
}

impl Out {
    /// Adds to an error what could not be written to.
    pub(super) fn error(error: io::Error) -> io::Error {
        io::Error::new(error.kind(), format!("cannot write to the standard output: {error}"))
    }
}

pub(super) fn print_json(line: &impl Serialize, out: &mut impl Write) -> io::Result<()> {
    serde_json::to_writer(&mut *out, line)?;
    writeln!(out)
}

/// Octets as pairs of hexadecimal digits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hex<'a>(pub(super) &'a [u8]);

impl fmt::Display for Hex<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const DIGITS: &[u8; 16] = b"0123456789abcdef";
        self.0.iter().try_for_each(|octet| {
            let [high, low] = [octet >> 4, octet & 0x0F].map(|digit| DIGITS[usize::from(digit)]);
            f.write_char(char::from(high))?;
            f.write_char(char::from(low))
        })
    }
}

/// Route elements, separated by dots.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dotted<'a>(pub(super) &'a [u8]);

impl fmt::Display for Dotted<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some((first, others)) = self.0.split_first() else { return Ok(()) };
        write!(f, "{first}")?;
        others.iter().try_for_each(|element| write!(f, ".{element}"))
    }
}

/// A table that is plain text, and Markdown too.
pub(super) fn plain_table(header: impl Into<comfy_table::Row>) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::ASCII_MARKDOWN).set_header(header);
    table
}

/// A table whose columns of figures are on the right.
pub(super) fn table<Row>(header: impl Into<comfy_table::Row>, rows: &[Row]) -> Table
where
    Row: AsRef<[String]> + Clone + Into<comfy_table::Row>,
{
    let mut table = plain_table(header);
    table.add_rows(rows.to_vec());
    let is_figure = |text: &String| text == "–" || text.starts_with(|c: char| c.is_ascii_digit());
    for (index, column) in table.column_iter_mut().enumerate() {
        if rows.iter().all(|row| is_figure(&row.as_ref()[index])) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}

/// A time with two digits, since the relay gives no more.
pub(super) fn duration(seconds: Option<f64>) -> String {
    let Some(seconds) = seconds else { return "–".to_owned() };
    let (figure, unit) = if seconds < 1.0 { (seconds * 1e3, "ms") } else { (seconds, "s") };
    let before_the_point = figure.max(1e-9).log10().floor();
    let decimals = (1.0 - before_the_point).clamp(0.0, 3.0) as usize;
    format!("{figure:.decimals$} {unit}")
}

/// A node's address in a cell; "–" where there is none, as for a PROFINET device.
pub(super) fn node(node: u8) -> String {
    if node == NO_NODE { "–".to_owned() } else { node.to_string() }
}

/// A time rounded to its largest unit.
pub(super) fn age(seconds: f64) -> String {
    let unit = [("d", 86_400.0), ("h", 3_600.0), ("min", 60.0)];
    match unit.into_iter().find(|(_, length)| seconds >= 2.0 * length) {
        Some((name, length)) => format!("{:.0} {name}", (seconds / length).floor()),
        None => format!("{seconds:.0} s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_the_two_digits_that_are_true() {
        assert_eq!(duration(None), "–");
        for (seconds, text) in [
            (0.000_053, "0.053 ms"),
            (0.0052, "5.2 ms"),
            (0.027, "27 ms"),
            (0.82, "820 ms"),
            (1.0, "1.0 s"),
            (3.1, "3.1 s"),
            (62.0, "62 s"),
        ] {
            assert_eq!(duration(Some(seconds)), text);
        }
    }
}
