//! Where lines of frames go.

use std::cell::RefCell;
use std::fmt::Display;
use std::io::{self, Write};

use serde::Serialize;

use super::profinet::FrameLine;
use super::settings::Settings;
use crate::cli::output::{Format, print_json};

/// The output, and how it is written.
pub(super) struct Printer<'a, W> {
    output: &'a RefCell<W>,
    format: Format,
    is_verbose: bool,
    /// A line of text. Its room is used again.
    line: String,
}

impl<'a, W: Write> Printer<'a, W> {
    pub(super) fn new(settings: &Settings, output: &'a RefCell<W>) -> Self {
        let (format, is_verbose) = (settings.format, settings.is_verbose);
        Self { output, format, is_verbose, line: String::new() }
    }

    pub(super) fn print<A, F>(&mut self, line: &FrameLine<A, F>) -> io::Result<()>
    where
        A: Display,
        F: Display + Serialize,
    {
        let mut output = self.output.borrow_mut();
        match self.format {
            Format::Text if self.is_verbose => line.write_tree(&mut *output),
            Format::Text => {
                // Of many small pieces; so the output is asked only once.
                self.line.clear();
                line.write_text(&mut self.line).map_err(io::Error::other)?;
                output.write_all(self.line.as_bytes())
            }
            Format::Json => print_json(line, &mut *output),
        }
    }
}
