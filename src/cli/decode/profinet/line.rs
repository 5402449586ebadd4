//! What is printed of a frame: where it was found, and what it says.

use std::fmt::Display;
use std::io::{self, Write};
use std::time::SystemTime;

use serde::Serialize;

use super::ethernet::Vlan;
use super::words::Shown;
use super::{Protocol, tree};
use crate::cli::decode::line::rfc3339;

/// A frame between two ends, which have addresses of the kind `A`.
#[derive(Debug, Serialize)]
#[serde(bound = "A: Display, F: Serialize")]
pub(in crate::cli::decode) struct FrameLine<A, F> {
    /// Counted from 1, as Wireshark does.
    pub(in crate::cli::decode) frame: u64,
    #[serde(serialize_with = "rfc3339", skip_serializing_if = "Option::is_none")]
    pub(in crate::cli::decode) time: Option<SystemTime>,
    pub(in crate::cli::decode) from: Shown<A>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::cli::decode) to: Option<Shown<A>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::cli::decode) vlan: Option<Vlan>,
    pub(in crate::cli::decode) protocol: Protocol,
    #[serde(flatten)]
    pub(in crate::cli::decode) fields: F,
}

impl<A: Display, F: Display + Serialize> FrameLine<A, F> {
    /// On one line.
    pub(in crate::cli::decode) fn write_text(&self, output: &mut impl Write) -> io::Result<()> {
        self.heading(output)?;
        writeln!(output)
    }

    /// With a line for each field.
    pub(in crate::cli::decode) fn write_tree(&self, output: &mut impl Write) -> io::Result<()> {
        self.heading(output)?;
        tree::write(&self.fields, output)
    }

    fn heading(&self, output: &mut impl Write) -> io::Result<()> {
        write!(output, "packet {}, ", self.frame)?;
        if let Some(time) = self.time {
            write!(output, "{}, ", humantime::format_rfc3339_micros(time))?;
        }
        write!(output, "{}", self.from)?;
        if let Some(to) = &self.to {
            write!(output, " > {to}")?;
        }
        if let Some(vlan) = &self.vlan {
            write!(output, ", {vlan}")?;
        }
        write!(output, ": {}", self.fields)
    }
}
