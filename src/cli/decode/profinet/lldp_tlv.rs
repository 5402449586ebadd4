//! A TLV of an LLDP frame.

use std::fmt::{self, Display};

use serde::Serialize;

use super::words::{Shown, Text, UuidOctets};
use crate::cli::output::Hex;
use crate::profinet::MacAddress;
use crate::profinet::lldp::{
    Address, LldpTlv, LldpValue, OrganisationValue, advertised_speeds, capability_names,
    class_2_name, class_3_name, mau_type_name,
};

/// What a TLV says.
#[derive(Serialize)]
pub(super) struct TlvFields<'a> {
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
    Id {
        subtype: u8,
        id: Shown<AddressShown<'a>>,
    },
    TimeToLive {
        seconds: u16,
    },
    Text {
        text: Shown<Text<'a>>,
    },
    Capabilities {
        supported: u16,
        supported_names: Bits,
        enabled: u16,
        enabled_names: Bits,
    },
    Management {
        address: Shown<AddressShown<'a>>,
        interface_subtype: u8,
        interface_number: u32,
        object_id: Shown<Hex<'a>>,
    },
    Organisation {
        oui: Shown<Oui>,
        subtype: u8,
        #[serde(flatten)]
        value: OfOrganisation<'a>,
    },
    Octets {
        data: Shown<Hex<'a>>,
    },
}

#[derive(Serialize)]
#[serde(untagged)]
enum OfOrganisation<'a> {
    Delay {
        receive_delay_local: u32,
        receive_delay_remote: u32,
        transmit_delay_local: u32,
        transmit_delay_remote: u32,
        cable_delay: u32,
    },
    PortStatus {
        class_2_status: u16,
        class_2_name: &'static str,
        class_3_status: u16,
        class_3_name: &'static str,
    },
    Alias {
        alias_name: Shown<Text<'a>>,
    },
    Mrp {
        domain_uuid: Shown<UuidOctets>,
        mrrt_status: u16,
    },
    ChassisMac {
        chassis_mac: Shown<MacAddress>,
    },
    Ptcp {
        master: Shown<MacAddress>,
        subdomain_uuid: Shown<UuidOctets>,
        ir_data_uuid: Shown<UuidOctets>,
        length_of_period: Period,
        red_period_begin: Period,
        orange_period_begin: Period,
        green_period_begin: Period,
    },
    MauTypeExtension {
        mau_type_extension: u16,
    },
    MacPhy {
        autonegotiation_supported: bool,
        autonegotiation_enabled: bool,
        advertised: u16,
        advertised_names: Speeds,
        mau_type: u16,
        mau_type_name: &'static str,
    },
    MaximumFrameSize {
        maximum_frame_size: u16,
    },
    Octets {
        data: Shown<Hex<'a>>,
    },
}

/// Nanoseconds in a cycle of isochronous communication.
#[derive(Serialize)]
struct Period {
    valid: bool,
    nanoseconds: u32,
}

struct Bits(u16);

struct Speeds(u16);

impl Serialize for Bits {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(capability_names(self.0))
    }
}

impl Serialize for Speeds {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(advertised_speeds(self.0))
    }
}

/// An organisation: `00:0e:cf`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Oui(pub(super) [u8; 3]);

impl Display for Oui {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [first, second, third] = self.0;
        write!(f, "{first:02x}:{second:02x}:{third:02x}")
    }
}

/// An address or a name.
#[derive(Clone, Copy, Debug)]
pub(super) struct AddressShown<'a>(pub(super) Address<'a>);

impl Display for AddressShown<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Address::Mac(address) => address.fmt(f),
            Address::V4(address) => address.fmt(f),
            Address::V6(address) => address.fmt(f),
            Address::Text(text) => Text(text).fmt(f),
            Address::Other { octets, .. } => Hex(octets).fmt(f),
        }
    }
}

impl<'a> TlvFields<'a> {
    pub(super) fn of(tlv: &LldpTlv<'a>) -> Self {
        let name = match tlv.value {
            LldpValue::Organisation { oui, subtype, .. } => OrganisationValue::name(oui, subtype),
            _ => tlv.name(),
        };
        Self { kind: tlv.kind, name, value: Value::of(&tlv.value) }
    }

    /// What people look for, on the one line.
    pub(super) fn brief(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.value {
            Value::Text { text } if self.kind == 5 => write!(f, ", system \"{text}\""),
            Value::Management { address, .. } => write!(f, ", managed at {address}"),
            Value::Organisation { value: OfOrganisation::MacPhy { mau_type_name, .. }, .. } => {
                write!(f, ", {mau_type_name}")
            }
            Value::Organisation { value: OfOrganisation::ChassisMac { chassis_mac }, .. } => {
                write!(f, ", chassis {chassis_mac}")
            }
            _ => Ok(()),
        }
    }
}

impl<'a> Value<'a> {
    fn of(value: &LldpValue<'a>) -> Self {
        match *value {
            LldpValue::ChassisId(id) | LldpValue::PortId(id) => {
                Self::Id { subtype: id.subtype, id: Shown(AddressShown(id.value)) }
            }
            LldpValue::TimeToLive(seconds) => Self::TimeToLive { seconds },
            LldpValue::Text(text) => Self::Text { text: Shown(Text(text)) },
            LldpValue::Capabilities { supported, enabled } => Self::Capabilities {
                supported,
                supported_names: Bits(supported),
                enabled,
                enabled_names: Bits(enabled),
            },
            LldpValue::ManagementAddress {
                address,
                interface_subtype,
                interface_number,
                object_id,
            } => Self::Management {
                address: Shown(AddressShown(address)),
                interface_subtype,
                interface_number,
                object_id: Shown(Hex(object_id)),
            },
            LldpValue::Organisation { oui, subtype, value } => Self::Organisation {
                oui: Shown(Oui(oui)),
                subtype,
                value: OfOrganisation::of(&value),
            },
            LldpValue::Octets(octets) => Self::Octets { data: Shown(Hex(octets)) },
        }
    }
}

impl<'a> OfOrganisation<'a> {
    fn of(value: &OrganisationValue<'a>) -> Self {
        match *value {
            OrganisationValue::Delay {
                receive_local,
                receive_remote,
                transmit_local,
                transmit_remote,
                cable,
            } => Self::Delay {
                receive_delay_local: receive_local,
                receive_delay_remote: receive_remote,
                transmit_delay_local: transmit_local,
                transmit_delay_remote: transmit_remote,
                cable_delay: cable,
            },
            OrganisationValue::PortStatus { class_2, class_3 } => Self::PortStatus {
                class_2_status: class_2,
                class_2_name: class_2_name(class_2),
                class_3_status: class_3,
                class_3_name: class_3_name(class_3),
            },
            OrganisationValue::Alias(alias) => Self::Alias { alias_name: Shown(Text(alias)) },
            OrganisationValue::MrpPortStatus { domain_uuid, mrrt_status } => {
                Self::Mrp { domain_uuid: Shown(UuidOctets(domain_uuid)), mrrt_status }
            }
            OrganisationValue::ChassisMac(address) => {
                Self::ChassisMac { chassis_mac: Shown(address) }
            }
            OrganisationValue::PtcpStatus { master, subdomain_uuid, ir_data_uuid, periods } => {
                let [length, red, orange, green] = periods.map(|it| Period {
                    valid: it & 0x8000_0000 != 0,
                    nanoseconds: it & 0x7FFF_FFFF,
                });
                Self::Ptcp {
                    master: Shown(master),
                    subdomain_uuid: Shown(UuidOctets(subdomain_uuid)),
                    ir_data_uuid: Shown(UuidOctets(ir_data_uuid)),
                    length_of_period: length,
                    red_period_begin: red,
                    orange_period_begin: orange,
                    green_period_begin: green,
                }
            }
            OrganisationValue::MauTypeExtension(mau_type_extension) => {
                Self::MauTypeExtension { mau_type_extension }
            }
            OrganisationValue::MacPhy { autonegotiation, advertised, mau_type } => Self::MacPhy {
                autonegotiation_supported: autonegotiation & 1 != 0,
                autonegotiation_enabled: autonegotiation & 2 != 0,
                advertised,
                advertised_names: Speeds(advertised),
                mau_type,
                mau_type_name: mau_type_name(mau_type),
            },
            OrganisationValue::MaximumFrameSize(maximum_frame_size) => {
                Self::MaximumFrameSize { maximum_frame_size }
            }
            OrganisationValue::Octets(octets) => Self::Octets { data: Shown(Hex(octets)) },
        }
    }
}
