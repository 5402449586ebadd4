//! What frames of PROFINET say, as JSON and as text.
//!
//! Each protocol has a struct that borrows its view. `Serialize` gives the JSON, and the tree of `-v` is made
//! of the same (`tree`); `Display` gives the one line for people. Invariant: nothing here allocates for a
//! frame, since there may be millions, and what a frame has as text is shown without control characters.

mod alarm;
mod connections;
mod dcp;
mod dcp_block;
mod ethernet;
mod line;
mod lldp;
mod lldp_tlv;
mod mrp;
mod ptcp;
mod rpc;
mod rpc_fragments;
mod rpc_value;
mod rt;
mod streams;
mod submodules;
mod summary;
mod tree;
mod words;

use std::fmt::{self, Display};

use serde::Serialize;

use crate::profinet::alarm::PduType;
use crate::profinet::rt::{ApduStatus, FrameId, FrameKind, RtFrame};
use crate::profinet::{Malformed, Uuid};
use crate::profinet::{lldp as lldp_wire, mrp as mrp_wire};

pub(super) use connections::Connections;
pub(super) use ethernet::{Ethernet, frame};
pub(super) use line::FrameLine;
pub(super) use rpc::RpcFields;
pub(super) use rpc_fragments::RpcFragments;
pub(super) use summary::{ProfinetReport, ProfinetSummary};
pub(super) use words::Shown;

/// What a frame is, as `--protocol` and the JSON call it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Protocol {
    PNet,
    ProfinetRt,
    ProfinetDcp,
    ProfinetAlarm,
    ProfinetRpc,
    Lldp,
    Mrp,
    Ptcp,
}

impl Protocol {
    pub(super) const ALL: [Self; 8] = [
        Self::PNet,
        Self::ProfinetRt,
        Self::ProfinetDcp,
        Self::ProfinetAlarm,
        Self::ProfinetRpc,
        Self::Lldp,
        Self::Mrp,
        Self::Ptcp,
    ];
}

/// What a frame says, as far as it can be read.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub(super) enum Fields<'a> {
    Rt(rt::RtFields<'a>),
    Dcp(dcp::DcpFields<'a>),
    Alarm(alarm::AlarmFields<'a>),
    Ptcp(ptcp::PtcpFields<'a>),
    Lldp(lldp::LldpFields<'a>),
    Mrp(mrp::MrpFields<'a>),
    /// Not even a frame ID.
    Short(Fault),
}

/// Why it cannot be read, and the first octet that is wrong or missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Fault {
    error: &'static str,
    error_offset: usize,
}

impl<'a> Fields<'a> {
    /// Reads what was captured of a frame, and tells what it is.
    pub(super) fn of(frame: &Ethernet<'a>, connections: &'a Connections) -> (Protocol, Self) {
        let octets = frame.octets;
        match frame.ether_type {
            lldp_wire::ETHER_TYPE => (Protocol::Lldp, Self::Lldp(lldp::LldpFields::of(octets))),
            mrp_wire::ETHER_TYPE => (Protocol::Mrp, Self::Mrp(mrp::MrpFields::of(octets))),
            _ => match RtFrame::parse(octets) {
                Ok(rt) => Self::of_rt(rt, frame, connections),
                Err(error) => (Protocol::ProfinetRt, Self::Short(error.into())),
            },
        }
    }

    fn of_rt(
        rt: RtFrame<'a>,
        frame: &Ethernet<'a>,
        connections: &'a Connections,
    ) -> (Protocol, Self) {
        let (id, behind) = (rt.frame_id, rt.behind);
        match id.kind() {
            FrameKind::Alarm(_) => {
                let fields = alarm::AlarmFields::of(id, behind).with_ar(frame, connections);
                (Protocol::ProfinetAlarm, Self::Alarm(fields))
            }
            FrameKind::Dcp(_) => (Protocol::ProfinetDcp, Self::Dcp(dcp::DcpFields::of(id, behind))),
            FrameKind::Ptcp(kind) => {
                (Protocol::Ptcp, Self::Ptcp(ptcp::PtcpFields::of(id, kind, behind)))
            }
            FrameKind::Cyclic(_) | FrameKind::Fragment | FrameKind::Reserved => {
                let layout = connections.layout(frame.from, frame.to, id);
                let fields = rt::RtFields::of(rt, octets_are_whole(frame));
                (Protocol::ProfinetRt, Self::Rt(fields.with_layout(layout)))
            }
        }
    }

    /// Why it cannot be read to its end.
    pub(super) fn fault(&self) -> Option<Fault> {
        match self {
            Self::Rt(it) => it.fault,
            Self::Dcp(it) => it.fault,
            Self::Alarm(it) => it.fault,
            Self::Ptcp(it) => it.fault,
            Self::Lldp(it) => it.fault,
            Self::Mrp(it) => it.fault,
            Self::Short(fault) => Some(*fault),
        }
    }

    /// Its stream, for the summary: the frame ID, and the status of cyclic data.
    pub(super) fn stream(&self) -> Option<(FrameId, Option<ApduStatus>)> {
        match self {
            Self::Rt(it) => it.stream(),
            _ => None,
        }
    }

    /// Whether it is cyclic data that was cut into submodules.
    pub(super) fn has_submodules(&self) -> bool {
        matches!(self, Self::Rt(it) if it.has_submodules())
    }

    /// The AR that it belongs to, where the Connect is known.
    pub(super) fn ar(&self) -> Option<Uuid> {
        match self {
            Self::Rt(it) => it.ar,
            Self::Alarm(it) => it.ar,
            _ => None,
        }
    }

    /// The kind of an alarm's frame.
    pub(super) fn alarm(&self) -> Option<(FrameId, PduType)> {
        match self {
            Self::Alarm(it) => it.kind(),
            _ => None,
        }
    }
}

fn octets_are_whole(frame: &Ethernet<'_>) -> bool {
    frame.octets.len() == frame.length
}

impl Display for Fields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rt(it) => it.fmt(f),
            Self::Dcp(it) => it.fmt(f),
            Self::Alarm(it) => it.fmt(f),
            Self::Ptcp(it) => it.fmt(f),
            Self::Lldp(it) => it.fmt(f),
            Self::Mrp(it) => it.fmt(f),
            Self::Short(_) => f.write_str("RT"),
        }?;
        match self.fault() {
            Some(Fault { error, error_offset }) => {
                write!(f, "; malformed at octet {error_offset}: {error}")
            }
            None => Ok(()),
        }
    }
}

impl From<Malformed> for Fault {
    fn from(Malformed { offset, what }: Malformed) -> Self {
        Self { error: what, error_offset: offset }
    }
}

#[cfg(test)]
mod tests;
