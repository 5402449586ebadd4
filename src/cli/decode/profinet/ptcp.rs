//! PTCP frames.

use std::fmt::{self, Display};

use serde::{Serialize, Serializer};

use super::Fault;
use super::words::{List, Shown, UuidOctets};
use crate::cli::output::Hex;
use crate::profinet::ptcp::{Delay, Ptcp, PtcpTlv, PtcpValue};
use crate::profinet::rt::{FrameId, PtcpFrame};
use crate::profinet::{MacAddress, Malformed, Octets};

/// What such a frame says.
#[derive(Debug, Serialize)]
pub(in crate::cli::decode) struct PtcpFields<'a> {
    frame_id: u16,
    frame_id_name: &'static str,
    #[serde(flatten)]
    header: Option<Header<'a>>,
    #[serde(flatten)]
    pub(super) fault: Option<Fault>,
}

#[derive(Debug, Serialize)]
struct Header<'a> {
    sequence_id: u16,
    #[serde(flatten)]
    delay: Option<DelayFields>,
    #[serde(serialize_with = "tlvs")]
    tlvs: Ptcp<'a>,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum DelayFields {
    Sync { delay_10_ns: u32, delay_1_ns_octet: u8, delay_ns: u32 },
    Line { delay_ns: u32 },
    FollowUp { delay_ns: i32 },
}

#[derive(Serialize)]
struct TlvFields<'a> {
    #[serde(rename = "type")]
    kind: u8,
    name: &'static str,
    #[serde(flatten)]
    value: Value<'a>,
}

/// The fields of the contents. Their names tell the kind.
#[derive(Serialize)]
#[serde(untagged)]
enum Value<'a> {
    Subdomain {
        master: Shown<MacAddress>,
        subdomain_uuid: Shown<UuidOctets>,
    },
    Time {
        epoch: u16,
        seconds: u32,
        nanoseconds: u32,
    },
    TimeExtension {
        flags: u16,
        utc_offset: u16,
    },
    Master {
        priority_1: u8,
        priority_2: u8,
        clock_class: u8,
        clock_accuracy: u8,
        clock_variance: i16,
    },
    PortParameter {
        receive_delay: u32,
        transmit_delay: u32,
    },
    DelayParameter {
        port: Shown<MacAddress>,
    },
    PortTime {
        received: u32,
    },
    IrData {
        ir_data_uuid: Shown<UuidOctets>,
    },
    Octets {
        data: Shown<Hex<'a>>,
    },
}

impl<'a> PtcpFields<'a> {
    pub(super) fn of(frame_id: FrameId, kind: PtcpFrame, behind: Octets<'a>) -> Self {
        let read = Ptcp::parse(kind, behind);
        let fault: Option<Malformed> = match &read {
            Ok(Some(ptcp)) => ptcp.tlvs().find_map(Result::err),
            Ok(None) => None,
            Err(error) => Some(*error),
        };
        let header = read.ok().flatten().map(|ptcp| Header {
            sequence_id: ptcp.sequence_id,
            delay: ptcp.delay.map(DelayFields::from),
            tlvs: ptcp,
        });
        let fault = fault.map(Fault::from);
        Self { frame_id: frame_id.0, frame_id_name: frame_id.name(), header, fault }
    }
}

impl From<Delay> for DelayFields {
    fn from(delay: Delay) -> Self {
        match delay {
            Delay::Sync { tens, ones, nanoseconds } => {
                Self::Sync { delay_10_ns: tens, delay_1_ns_octet: ones, delay_ns: nanoseconds }
            }
            Delay::Line(delay_ns) => Self::Line { delay_ns },
            Delay::FollowUp(delay_ns) => Self::FollowUp { delay_ns },
        }
    }
}

/// The TLVs up to the first one that cannot be read.
fn sound<'a>(ptcp: &Ptcp<'a>) -> impl Iterator<Item = PtcpTlv<'a>> + Clone {
    ptcp.tlvs().map_while(Result::ok)
}

fn tlvs<S: Serializer>(ptcp: &Ptcp<'_>, serializer: S) -> Result<S::Ok, S::Error> {
    List(sound(ptcp).map(TlvFields::of)).serialize(serializer)
}

impl<'a> TlvFields<'a> {
    fn of(tlv: PtcpTlv<'a>) -> Self {
        Self { kind: tlv.kind, name: tlv.name(), value: Value::of(tlv.value) }
    }
}

impl<'a> Value<'a> {
    fn of(value: PtcpValue<'a>) -> Self {
        match value {
            PtcpValue::Subdomain { master, uuid } => {
                Self::Subdomain { master: Shown(master), subdomain_uuid: Shown(UuidOctets(uuid)) }
            }
            PtcpValue::Time { epoch, seconds, nanoseconds } => {
                Self::Time { epoch, seconds, nanoseconds }
            }
            PtcpValue::TimeExtension { flags, utc_offset } => {
                Self::TimeExtension { flags, utc_offset }
            }
            PtcpValue::Master {
                priority_1,
                priority_2,
                clock_class,
                clock_accuracy,
                clock_variance,
            } => {
                Self::Master { priority_1, priority_2, clock_class, clock_accuracy, clock_variance }
            }
            PtcpValue::PortParameter { receive_delay, transmit_delay } => {
                Self::PortParameter { receive_delay, transmit_delay }
            }
            PtcpValue::DelayParameter { port } => Self::DelayParameter { port: Shown(port) },
            PtcpValue::PortTime { received } => Self::PortTime { received },
            PtcpValue::IrData { uuid } => Self::IrData { ir_data_uuid: Shown(UuidOctets(uuid)) },
            PtcpValue::Octets(octets) => Self::Octets { data: Shown(Hex(octets)) },
        }
    }
}

impl Display for PtcpFields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(header) = &self.header else {
            return write!(f, "{} ${:04X}", self.frame_id_name, self.frame_id);
        };
        write!(f, "{}, sequence {}", self.frame_id_name, header.sequence_id)?;
        match &header.delay {
            Some(DelayFields::Sync { delay_ns, .. } | DelayFields::Line { delay_ns }) => {
                write!(f, ", delay {delay_ns} ns")?;
            }
            Some(DelayFields::FollowUp { delay_ns }) => write!(f, ", delay {delay_ns} ns")?,
            None => {}
        }
        sound(&header.tlvs).try_for_each(|tlv| match tlv.value {
            PtcpValue::Subdomain { master, .. } => write!(f, ", master {master}"),
            PtcpValue::DelayParameter { port } => write!(f, ", port {port}"),
            _ => Ok(()),
        })
    }
}
