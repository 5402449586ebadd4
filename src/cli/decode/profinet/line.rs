//! What is printed of a frame: where it was found, and what it says.

use std::fmt::{self, Display};
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
    pub(in crate::cli::decode) fn write_text(&self, output: &mut impl fmt::Write) -> fmt::Result {
        writeln!(output, "{self}")
    }

    /// With a line for each field.
    pub(in crate::cli::decode) fn write_tree(&self, output: &mut impl Write) -> io::Result<()> {
        write!(output, "{self}")?;
        tree::write(&self.fields, output)
    }
}

/// There may be millions of lines: plain calls cost a third less than `write!`.
impl<A: Display, F: Display> Display for FrameLine<A, F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("packet ")?;
        self.frame.fmt(f)?;
        f.write_str(", ")?;
        if let Some(time) = self.time {
            humantime::format_rfc3339_micros(time).fmt(f)?;
            f.write_str(", ")?;
        }
        self.from.fmt(f)?;
        if let Some(to) = &self.to {
            f.write_str(" > ")?;
            to.fmt(f)?;
        }
        if let Some(vlan) = &self.vlan {
            f.write_str(", ")?;
            vlan.fmt(f)?;
        }
        f.write_str(": ")?;
        self.fields.fmt(f)
    }
}
