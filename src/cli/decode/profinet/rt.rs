//! Cyclic data, and frames whose ID is not in use.

use std::fmt::{self, Display};

use serde::Serialize;

use super::Fault;
use super::connections::Layout;
use super::submodules::Submodules;
use super::words::Shown;
use crate::cli::output::Hex;
use crate::profinet::Uuid;
use crate::profinet::rt::{
    ApduStatus, CyclicData, DataStatus, FrameId, FrameKind, RtFrame, TransferStatus,
};

/// What an RT frame says.
#[derive(Debug, Serialize)]
pub(in crate::cli::decode) struct RtFields<'a> {
    frame_id: u16,
    frame_id_name: &'static str,
    #[serde(flatten)]
    status: Option<StatusFields>,
    data_length: usize,
    data: Shown<Hex<'a>>,
    /// Null where the Connect of this stream is not in the capture.
    submodules: Option<Submodules<'a>>,
    #[serde(skip)]
    pub(super) ar: Option<Uuid>,
    #[serde(flatten)]
    pub(super) fault: Option<Fault>,
}

/// The status at the end of cyclic data.
#[derive(Debug, Serialize)]
struct StatusFields {
    cycle_counter: u16,
    data_status: DataStatusFields,
    transfer_status: u8,
    #[serde(skip_serializing_if = "is_sound", serialize_with = "faults")]
    transfer_faults: TransferStatus,
}

#[derive(Debug, Serialize)]
struct DataStatusFields {
    value: u8,
    primary: bool,
    redundancy: bool,
    data_valid: bool,
    provider_running: bool,
    station_ok: bool,
    ignore: bool,
}

impl<'a> RtFields<'a> {
    /// Of a frame that was not captured to its end, the status is not there.
    pub(super) fn of(frame: RtFrame<'a>, is_whole: bool) -> Self {
        let behind = frame.behind;
        let (mut data, mut status, mut fault) = (behind.rest(), None, None);
        if let FrameKind::Cyclic(_) = frame.frame_id.kind() {
            if is_whole {
                match CyclicData::parse(behind) {
                    Ok(cyclic) => (data, status) = (cyclic.data, Some(cyclic.status)),
                    Err(error) => fault = Some(error.into()),
                }
            } else {
                let error_offset = behind.offset() + behind.len();
                fault = Some(Fault { error: "it was not captured to its end", error_offset });
            }
        }
        Self {
            frame_id: frame.frame_id.0,
            frame_id_name: frame.frame_id.name(),
            status: status.as_ref().map(StatusFields::of),
            data_length: data.len(),
            data: Shown(Hex(data)),
            submodules: None,
            ar: None,
            fault,
        }
    }

    /// The same as part of its AR, cut into submodules.
    pub(super) fn with_layout(self, layout: Option<&'a Layout>) -> Self {
        let whole = layout.filter(|_| self.status.is_some());
        let submodules = whole.map(|layout| Submodules::new(layout, self.data.0.0));
        Self { submodules, ar: layout.map(|layout| layout.ar), ..self }
    }

    /// Whether it is cut into submodules.
    pub(super) fn has_submodules(&self) -> bool {
        self.submodules.is_some()
    }

    /// The frame ID, and the status.
    pub(super) fn stream(&self) -> Option<(FrameId, Option<ApduStatus>)> {
        let status = self.status.as_ref().map(|it| ApduStatus {
            cycle_counter: it.cycle_counter,
            data_status: DataStatus(it.data_status.value),
            transfer_status: TransferStatus(it.transfer_status),
        });
        let frame_id = FrameId(self.frame_id);
        matches!(frame_id.kind(), FrameKind::Cyclic(_)).then_some((frame_id, status))
    }
}

impl StatusFields {
    fn of(status: &ApduStatus) -> Self {
        let data_status = status.data_status;
        Self {
            cycle_counter: status.cycle_counter,
            data_status: DataStatusFields {
                value: data_status.0,
                primary: data_status.is_primary(),
                redundancy: data_status.has_redundancy_fault(),
                data_valid: data_status.is_valid(),
                provider_running: data_status.is_running(),
                station_ok: data_status.is_without_problem(),
                ignore: data_status.is_ignored(),
            },
            transfer_status: status.transfer_status.0,
            transfer_faults: status.transfer_status,
        }
    }
}

impl Display for RtFields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.frame_id_name)?;
        write!(f, " ${:04X}, ", self.frame_id)?;
        if let Some(status) = &self.status {
            f.write_str("cycle ")?;
            status.cycle_counter.fmt(f)?;
            f.write_str(", ")?;
            status.data_status.fmt(f)?;
            if status.transfer_status != 0 {
                write!(f, ", transfer status ${:02X}", status.transfer_status)?;
            }
            f.write_str(", ")?;
        }
        self.data_length.fmt(f)?;
        f.write_str(" octets")?;
        match &self.submodules {
            None => Ok(()),
            Some(it) => write!(f, " of {} parts, {} bad", it.count(), it.bad()),
        }
    }
}

impl Display for DataStatusFields {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match (self.data_valid, self.provider_running) {
            (true, true) => "valid, run",
            (true, false) => "valid, stop",
            (false, true) => "invalid, run",
            (false, false) => "invalid, stop",
        })?;
        f.write_str(if self.station_ok { ", ok" } else { ", station has a problem" })?;
        f.write_str(if self.primary { ", primary" } else { ", backup" })?;
        if self.redundancy {
            f.write_str(", redundancy fault")?;
        }
        f.write_str(if self.ignore { ", ignored" } else { "" })
    }
}

fn is_sound(status: &TransferStatus) -> bool {
    status.0 == 0
}

fn faults<S: serde::Serializer>(status: &TransferStatus, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(status.faults())
}
