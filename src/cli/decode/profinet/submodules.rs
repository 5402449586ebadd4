//! Cyclic data, cut into its submodules.

use serde::ser::SerializeSeq;
use serde::{Serialize, Serializer};

use super::connections::{Layout, Part};
use super::words::Shown;
use crate::cli::output::Hex;
use crate::profinet::rt::IoStatus;

/// The data of a frame, and what is where in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Submodules<'a> {
    layout: &'a Layout,
    data: &'a [u8],
}

/// A part of a frame. What the frame is too short for is null.
#[derive(Debug, Serialize)]
struct PartFields<'a> {
    /// Data with the provider's status, or the consumer's status.
    kind: &'static str,
    api: u32,
    slot: u16,
    subslot: u16,
    offset: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    data: Option<Shown<Hex<'a>>>,
    status: Option<u8>,
    good: Option<bool>,
    /// Who says that it is bad.
    #[serde(skip_serializing_if = "Option::is_none")]
    bad_by: Option<&'static str>,
}

impl<'a> Submodules<'a> {
    pub(super) fn new(layout: &'a Layout, data: &'a [u8]) -> Self {
        Self { layout, data }
    }

    /// How many parts there are.
    pub(super) fn count(&self) -> usize {
        self.layout.parts().len()
    }

    /// How many of them are bad.
    pub(super) fn bad(&self) -> usize {
        let statuses = self.layout.parts().iter().filter_map(|part| self.status(part));
        statuses.filter(|status| !status.is_good()).count()
    }

    fn status(&self, part: &Part) -> Option<IoStatus> {
        let octet = self.data.get(part.offset + part.data_length.unwrap_or(0))?;
        Some(IoStatus(*octet))
    }

    fn fields(&self, part: &Part) -> PartFields<'a> {
        let status = self.status(part);
        let end = part.data_length.map(|length| part.offset + length);
        PartFields {
            kind: if end.is_some() { "data" } else { "consumer status" },
            api: part.api,
            slot: part.slot,
            subslot: part.subslot,
            offset: part.offset,
            data: end.and_then(|end| self.data.get(part.offset..end)).map(|it| Shown(Hex(it))),
            status: status.map(|status| status.0),
            good: status.map(IoStatus::is_good),
            bad_by: status.filter(|status| !status.is_good()).map(IoStatus::instance_name),
        }
    }
}

impl Serialize for Submodules<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut list = serializer.serialize_seq(Some(self.count()))?;
        for part in self.layout.parts() {
            list.serialize_element(&self.fields(part))?;
        }
        list.end()
    }
}
