//! DCP frames.

use std::fmt::{self, Display};

use serde::{Serialize, Serializer};

use super::Fault;
use super::dcp_block::BlockFields;
use super::words::List;
use crate::profinet::dcp::{Dcp, DcpBlock, ServiceId, ServiceType};
use crate::profinet::rt::{DcpFrame, FrameId, FrameKind};
use crate::profinet::{Malformed, Octets};

/// What such a frame says.
#[derive(Debug, Serialize)]
pub(in crate::cli::decode) struct DcpFields<'a> {
    frame_id: u16,
    frame_id_name: &'static str,
    #[serde(flatten)]
    header: Option<Header<'a>>,
    #[serde(flatten)]
    pub(super) fault: Option<Fault>,
}

#[derive(Debug, Serialize)]
struct Header<'a> {
    service_id: u8,
    service_id_name: &'static str,
    service_type: u8,
    service_type_name: &'static str,
    xid: u32,
    /// Only in an identify request; units of 10 ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    response_delay: Option<u16>,
    data_length: u16,
    #[serde(serialize_with = "blocks")]
    blocks: Dcp<'a>,
}

impl<'a> DcpFields<'a> {
    pub(super) fn of(frame_id: FrameId, behind: Octets<'a>) -> Self {
        let read = Dcp::parse(behind);
        let fault: Option<Malformed> = match &read {
            Ok(dcp) => dcp.blocks().find_map(Result::err),
            Err(error) => Some(*error),
        };
        let is_asked = frame_id.kind() == FrameKind::Dcp(DcpFrame::IdentifyRequest);
        Self {
            frame_id: frame_id.0,
            frame_id_name: frame_id.name(),
            header: read.ok().map(|dcp| Header::of(dcp, is_asked)),
            fault: fault.map(Fault::from),
        }
    }
}

impl<'a> Header<'a> {
    fn of(dcp: Dcp<'a>, is_asked: bool) -> Self {
        Self {
            service_id: dcp.service_id.number(),
            service_id_name: dcp.service_id.name(),
            service_type: dcp.service_type.number(),
            service_type_name: dcp.service_type.name(),
            xid: dcp.xid,
            response_delay: is_asked.then_some(dcp.response_delay),
            data_length: dcp.data_length,
            blocks: dcp,
        }
    }
}

/// The blocks up to the first one that cannot be read.
fn sound<'a>(dcp: &Dcp<'a>) -> impl Iterator<Item = DcpBlock<'a>> + Clone {
    dcp.blocks().map_while(Result::ok)
}

fn blocks<S: Serializer>(dcp: &Dcp<'_>, serializer: S) -> Result<S::Ok, S::Error> {
    List(sound(dcp).map(|block| BlockFields::of(&block))).serialize(serializer)
}

impl Display for DcpFields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(header) = &self.header else { return f.write_str(self.frame_id_name) };
        write!(
            f,
            "DCP {} {}, xid ${:08X}",
            header.service_id_name, header.service_type_name, header.xid
        )?;
        if let Some(delay) = header.response_delay {
            write!(f, ", response delay {delay}")?;
        }
        let dcp = &header.blocks;
        let is_get = dcp.service_id == ServiceId::Get && dcp.service_type == ServiceType::Request;
        let mut separator = if is_get { "; wants " } else { "; " };
        sound(dcp).try_for_each(|block| {
            f.write_str(separator)?;
            separator = ", ";
            BlockFields::of(&block).fmt(f)
        })
    }
}
