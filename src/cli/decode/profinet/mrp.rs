//! MRP frames.

use std::fmt::{self, Display};

use serde::{Serialize, Serializer};

use super::Fault;
use super::lldp_tlv::Oui;
use super::words::{List, Shown, UuidOctets};
use crate::cli::output::Hex;
use crate::profinet::MacAddress;
use crate::profinet::mrp::{
    AutoManager, Mrp, MrpTlv, MrpValue, Test, port_role_name, priority_name,
};

/// What such a frame says.
#[derive(Debug, Serialize)]
pub(in crate::cli::decode) struct MrpFields<'a> {
    version: Option<u16>,
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "tlvs")]
    tlvs: Option<Mrp<'a>>,
    #[serde(flatten)]
    pub(super) fault: Option<Fault>,
}

#[derive(Serialize)]
struct TlvFields<'a> {
    #[serde(rename = "type")]
    kind: u8,
    name: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    sender: Option<&'static str>,
    #[serde(flatten)]
    value: Value<'a>,
}

/// The fields of the contents. Their names tell the kind.
#[derive(Serialize)]
#[serde(untagged)]
enum Value<'a> {
    Common {
        sequence_id: u16,
        domain_uuid: Shown<UuidOctets>,
    },
    Test {
        priority: u16,
        priority_name: &'static str,
        #[serde(flatten)]
        test: TestFields,
    },
    TopologyChange {
        priority: u16,
        priority_name: &'static str,
        source: Shown<MacAddress>,
        interval: u16,
    },
    LinkChange {
        source: Shown<MacAddress>,
        port_role: u16,
        port_role_name: &'static str,
        interval: u16,
        blocked: u16,
    },
    InTest {
        interconnection_id: u16,
        #[serde(flatten)]
        test: TestFields,
    },
    InTopologyChange {
        source: Shown<MacAddress>,
        interconnection_id: u16,
        interval: u16,
    },
    InLink {
        source: Shown<MacAddress>,
        port_role: u16,
        port_role_name: &'static str,
        interconnection_id: u16,
        #[serde(skip_serializing_if = "Option::is_none")]
        interval: Option<u16>,
    },
    Option {
        oui: Shown<Oui>,
        #[serde(flatten)]
        auto_manager: Option<AutoManagerFields>,
        data: Shown<Hex<'a>>,
    },
    Octets {
        data: Shown<Hex<'a>>,
    },
}

#[derive(Serialize)]
struct TestFields {
    source: Shown<MacAddress>,
    port_role: u16,
    port_role_name: &'static str,
    ring_state: u16,
    ring_state_name: &'static str,
    transitions: u16,
    timestamp: u32,
}

/// Managers that choose one of them.
#[derive(Serialize)]
struct AutoManagerFields {
    sub_type: u8,
    sub_type_name: &'static str,
    #[serde(flatten)]
    ends: Option<AutoManagerEnds>,
}

#[derive(Serialize)]
struct AutoManagerEnds {
    priority: u16,
    source: Shown<MacAddress>,
    other_priority: u16,
    other_source: Shown<MacAddress>,
}

impl<'a> MrpFields<'a> {
    pub(super) fn of(octets: &'a [u8]) -> Self {
        let read = Mrp::parse(octets);
        let fault = match &read {
            Ok(mrp) => mrp.tlvs().find_map(Result::err),
            Err(error) => Some(*error),
        };
        let tlvs = read.ok();
        Self { version: tlvs.map(|mrp| mrp.version), tlvs, fault: fault.map(Fault::from) }
    }
}

/// The TLVs up to the first one that cannot be read.
fn sound<'a>(mrp: &Mrp<'a>) -> impl Iterator<Item = TlvFields<'a>> + Clone {
    mrp.tlvs().map_while(Result::ok).map(|tlv| TlvFields::of(&tlv))
}

fn tlvs<S: Serializer>(mrp: &Option<Mrp<'_>>, serializer: S) -> Result<S::Ok, S::Error> {
    mrp.as_ref().map(|mrp| List(sound(mrp))).serialize(serializer)
}

impl<'a> TlvFields<'a> {
    fn of(tlv: &MrpTlv<'a>) -> Self {
        let value = Value::of(&tlv.value);
        Self { kind: tlv.kind, name: tlv.name(), sender: tlv.sender_role(), value }
    }
}

impl<'a> Value<'a> {
    fn of(value: &MrpValue<'a>) -> Self {
        match *value {
            MrpValue::Common { sequence_id, domain_uuid } => {
                Self::Common { sequence_id, domain_uuid: Shown(UuidOctets(domain_uuid)) }
            }
            MrpValue::Test(test) => Self::Test {
                priority: test.priority,
                priority_name: priority_name(test.priority),
                test: TestFields::of(&test),
            },
            MrpValue::TopologyChange { priority, source, interval } => Self::TopologyChange {
                priority,
                priority_name: priority_name(priority),
                source: Shown(source),
                interval,
            },
            MrpValue::LinkChange { source, port_role, interval, blocked, .. } => {
                let port_role_name = port_role_name(port_role);
                let source = Shown(source);
                Self::LinkChange { source, port_role, port_role_name, interval, blocked }
            }
            MrpValue::InTest { interconnection_id, test } => {
                Self::InTest { interconnection_id, test: TestFields::of(&test) }
            }
            MrpValue::InTopologyChange { source, interconnection_id, interval } => {
                Self::InTopologyChange { source: Shown(source), interconnection_id, interval }
            }
            MrpValue::InLinkChange { source, port_role, interconnection_id, interval, .. } => {
                Self::in_link(source, port_role, interconnection_id, Some(interval))
            }
            MrpValue::InLinkStatusPoll { source, port_role, interconnection_id } => {
                Self::in_link(source, port_role, interconnection_id, None)
            }
            MrpValue::Option { oui, auto_manager, octets } => Self::Option {
                oui: Shown(Oui(oui)),
                auto_manager: auto_manager.as_ref().map(AutoManagerFields::of),
                data: Shown(Hex(octets)),
            },
            MrpValue::Octets(octets) => Self::Octets { data: Shown(Hex(octets)) },
        }
    }

    fn in_link(
        source: MacAddress,
        port_role: u16,
        interconnection_id: u16,
        interval: Option<u16>,
    ) -> Self {
        let (source, port_role_name) = (Shown(source), port_role_name(port_role));
        Self::InLink { source, port_role, port_role_name, interconnection_id, interval }
    }
}

impl TestFields {
    fn of(test: &Test) -> Self {
        Self {
            source: Shown(test.source),
            port_role: test.port_role,
            port_role_name: port_role_name(test.port_role),
            ring_state: test.state,
            ring_state_name: test.state_name(),
            transitions: test.transitions,
            timestamp: test.timestamp,
        }
    }
}

impl AutoManagerFields {
    fn of(auto_manager: &AutoManager) -> Self {
        let ends = auto_manager.ends.map(|[(priority, source), (other_priority, other_source)]| {
            let [source, other_source] = [source, other_source].map(Shown);
            AutoManagerEnds { priority, source, other_priority, other_source }
        });
        Self { sub_type: auto_manager.kind, sub_type_name: auto_manager.name(), ends }
    }
}

impl Display for MrpFields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("MRP")?;
        self.tlvs.as_ref().map_or(Ok(()), |mrp| {
            let mut separator = " ";
            sound(mrp).try_for_each(|tlv| {
                f.write_str(separator)?;
                separator = "; ";
                tlv.fmt(f)
            })
        })
    }
}

impl Display for TlvFields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.name.strip_prefix("MRP_").unwrap_or(self.name);
        match &self.value {
            Value::Common { sequence_id, domain_uuid } => {
                write!(f, "sequence {sequence_id}, domain {domain_uuid}")
            }
            Value::Test { priority, priority_name, test } => {
                write!(f, "{name} priority ${priority:04X} ({priority_name}), {test}")
            }
            Value::InTest { interconnection_id, test } => {
                write!(f, "{name} of interconnection {interconnection_id}, {test}")
            }
            Value::TopologyChange { source, interval, .. }
            | Value::InTopologyChange { source, interval, .. } => {
                write!(f, "{name} by {source}, in {interval} ms")
            }
            Value::LinkChange { source, port_role_name, .. }
            | Value::InLink { source, port_role_name, .. } => {
                write!(f, "{name} by {source}, {port_role_name}")
            }
            Value::Option { oui, auto_manager: None, .. } => write!(f, "{name} of {oui}"),
            Value::Option { auto_manager: Some(it), .. } => match &it.ends {
                Some(ends) => {
                    write!(f, "{} by {} to {}", it.sub_type_name, ends.source, ends.other_source)
                }
                None => f.write_str(it.sub_type_name),
            },
            Value::Octets { data } => write!(f, "TLV {}: {data}", self.kind),
        }
    }
}

impl Display for TestFields {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { source, port_role_name, ring_state_name, transitions, .. } = self;
        write!(
            f,
            "ring {ring_state_name}, by {source}, {port_role_name}, transitions {transitions}"
        )
    }
}
