//! Frames of an alarm connection.

use std::fmt::{self, Display};

use serde::{Serialize, Serializer};

use super::Fault;
use super::connections::Connections;
use super::ethernet::Ethernet;
use super::rpc::write_blocks;
use super::rpc_value::{Elements, Fields};
use super::words::Shown;
use crate::cli::output::Hex;
use crate::profinet::alarm::{AlarmFrame, PduType};
use crate::profinet::blocks::Blocks;
use crate::profinet::rt::FrameId;
use crate::profinet::view::{Value, fault_of};
use crate::profinet::{Octets, PnioStatus, Uuid};

/// What such a frame says.
#[derive(Debug, Serialize)]
pub(in crate::cli::decode) struct AlarmFields<'a> {
    frame_id: u16,
    frame_id_name: &'static str,
    #[serde(flatten)]
    header: Option<Header<'a>>,
    #[serde(flatten)]
    pub(super) fault: Option<Fault>,
    #[serde(skip)]
    pub(super) ar: Option<Uuid>,
}

#[derive(Debug, Serialize)]
struct Header<'a> {
    destination_endpoint: u16,
    source_endpoint: u16,
    pdu_type: u8,
    pdu_type_name: &'static str,
    version: u8,
    window_size: u8,
    immediate_acknowledge: u8,
    send_sequence: u16,
    acknowledge_sequence: u16,
    contents_length: usize,
    /// Why the connection ends.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "status")]
    status: Option<PnioStatus>,
    /// Of an alarm, and of the application's answer to one.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "blocks")]
    blocks: Option<Blocks<'a>>,
    /// Of other frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    contents: Option<Shown<Hex<'a>>>,
}

impl<'a> AlarmFields<'a> {
    pub(super) fn of(frame_id: FrameId, behind: Octets<'a>) -> Self {
        let read = AlarmFrame::parse(behind);
        let mut fault = read.as_ref().err().copied().map(Fault::from);
        let header = read.ok().map(|frame| {
            let status = frame.error_status().unwrap_or_else(|error| {
                fault = Some(error.into());
                None
            });
            Header::of(&frame, status)
        });
        let blocks = header.as_ref().and_then(|header| header.blocks);
        let in_blocks = blocks.and_then(|blocks| fault_of(Value::List(&blocks)));
        let fault = fault.or_else(|| in_blocks.map(Fault::from));
        Self { frame_id: frame_id.0, frame_id_name: frame_id.name(), header, fault, ar: None }
    }

    /// The same as part of its AR.
    pub(super) fn with_ar(self, frame: &Ethernet<'_>, connections: &Connections) -> Self {
        let ar = self.header.as_ref().zip(frame.to).and_then(|(header, to)| {
            let from = (frame.from, header.source_endpoint);
            connections.ar_of_alarms([from, (to, header.destination_endpoint)])
        });
        Self { ar, ..self }
    }

    /// Which queue, and what the frame is.
    pub(super) fn kind(&self) -> Option<(FrameId, PduType)> {
        let header = self.header.as_ref()?;
        Some((FrameId(self.frame_id), header.pdu_type.into()))
    }
}

impl<'a> Header<'a> {
    fn of(frame: &AlarmFrame<'a>, status: Option<[u8; 4]>) -> Self {
        let contents = frame.contents.rest();
        let is_data = frame.pdu_type == PduType::Data;
        Self {
            destination_endpoint: frame.destination_endpoint,
            source_endpoint: frame.source_endpoint,
            pdu_type: frame.pdu_type.number(),
            pdu_type_name: frame.pdu_type.name(),
            version: frame.version,
            window_size: frame.window_size,
            immediate_acknowledge: frame.immediate_acknowledge,
            send_sequence: frame.send_sequence,
            acknowledge_sequence: frame.acknowledge_sequence,
            contents_length: contents.len(),
            status: status.map(|octets| u32::from_be_bytes(octets).into()),
            blocks: is_data.then(|| Blocks::new(frame.contents)),
            contents: (!is_data && !contents.is_empty()).then_some(Shown(Hex(contents))),
        }
    }
}

impl Display for AlarmFields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.frame_id_name)?;
        let Some(header) = &self.header else { return Ok(()) };
        write!(
            f,
            ", {}, endpoint {} to {}, sends {}, acknowledges {}",
            header.pdu_type_name,
            header.source_endpoint,
            header.destination_endpoint,
            header.send_sequence,
            header.acknowledge_sequence
        )?;
        if let Some(status) = &header.status {
            return write!(f, ", {status}");
        }
        if let Some(blocks) = &header.blocks {
            return write_blocks(*blocks, f);
        }
        match header.contents_length {
            0 => Ok(()),
            length => write!(f, ", {length} octets"),
        }
    }
}

fn status<S: Serializer>(value: &Option<PnioStatus>, serializer: S) -> Result<S::Ok, S::Error> {
    value.as_ref().map(|status| Fields(status)).serialize(serializer)
}

fn blocks<S: Serializer>(value: &Option<Blocks<'_>>, serializer: S) -> Result<S::Ok, S::Error> {
    value.as_ref().map(|blocks| Elements(blocks)).serialize(serializer)
}
