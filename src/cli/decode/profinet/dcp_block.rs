//! A block of a DCP frame.

use std::fmt::{self, Display};
use std::net::Ipv4Addr;

use serde::Serialize;

use super::words::{List, Shown, Text};
use crate::cli::output::Hex;
use crate::profinet::MacAddress;
use crate::profinet::dcp::{
    DcpBlock, DcpValue, IpParameter, block_error_name, ip_block_info_name, reset_name, role_names,
    suboption_name,
};

/// What a block says.
#[derive(Serialize)]
pub(super) struct BlockFields<'a> {
    option: u8,
    suboption: u8,
    name: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    length: Option<u16>,
    #[serde(flatten)]
    qualifier: Option<Qualifier>,
    #[serde(flatten)]
    info: Option<Info>,
    #[serde(flatten)]
    value: Value<'a>,
}

/// How something is set.
#[derive(Serialize)]
struct Qualifier {
    qualifier: u16,
    permanent: bool,
    /// Only of a reset to factory.
    #[serde(skip_serializing_if = "Option::is_none")]
    reset: Option<&'static str>,
}

#[derive(Serialize)]
struct Info {
    block_info: u16,
    /// Only of an IP address.
    #[serde(skip_serializing_if = "Option::is_none")]
    block_info_name: Option<&'static str>,
}

/// The fields of the contents. Their names tell the kind.
#[derive(Serialize)]
#[serde(untagged)]
enum Value<'a> {
    None {},
    MacAddress {
        mac_address: Shown<MacAddress>,
    },
    Ip {
        ip_address: Ipv4Addr,
        netmask: Ipv4Addr,
        gateway: Ipv4Addr,
    },
    IpSuite {
        ip_address: Ipv4Addr,
        netmask: Ipv4Addr,
        gateway: Ipv4Addr,
        dns: [Ipv4Addr; 4],
    },
    TypeOfStation {
        type_of_station: Shown<Text<'a>>,
    },
    NameOfStation {
        name_of_station: Shown<Text<'a>>,
    },
    AliasName {
        alias_name: Shown<Text<'a>>,
    },
    OtherText {
        text: Shown<Text<'a>>,
    },
    DeviceId {
        vendor_id: u16,
        device_id: u16,
    },
    DeviceRole {
        role: u8,
        roles: Roles,
    },
    DeviceOptions {
        options: Options<'a>,
    },
    DeviceInstance {
        instance_high: u8,
        instance_low: u8,
    },
    Dhcp {
        dhcp_option: u8,
        data: Shown<Hex<'a>>,
    },
    Signal {
        signal: u16,
        flash_once: bool,
    },
    Response {
        of_option: u8,
        of_suboption: u8,
        of_name: &'static str,
        block_error: u8,
        block_error_name: &'static str,
    },
    DeviceInitiative {
        device_initiative: u16,
        says_hello: bool,
    },
    Octets {
        data: Shown<Hex<'a>>,
    },
}

struct Roles(u8);

impl Serialize for Roles {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(role_names(self.0))
    }
}

/// Pairs of option and suboption.
struct Options<'a>(&'a [u8]);

#[derive(Serialize)]
struct OptionFields {
    option: u8,
    suboption: u8,
    name: &'static str,
}

impl Options<'_> {
    fn each(&self) -> impl Iterator<Item = OptionFields> + Clone {
        self.0.chunks_exact(2).map(|pair| OptionFields {
            option: pair[0],
            suboption: pair[1],
            name: suboption_name(pair[0], pair[1]),
        })
    }
}

impl Serialize for Options<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        List(self.each()).serialize(serializer)
    }
}

impl<'a> BlockFields<'a> {
    pub(super) fn of(block: &DcpBlock<'a>) -> Self {
        let (option, suboption) = (block.option, block.suboption);
        Self {
            option,
            suboption,
            name: suboption_name(option, suboption),
            length: block.length,
            qualifier: block.qualifier.map(|qualifier| Qualifier {
                qualifier,
                permanent: qualifier & 1 != 0,
                reset: ((option, suboption) == (5, 6)).then_some(reset_name(qualifier)),
            }),
            info: block.info.map(|block_info| Info {
                block_info,
                block_info_name: (option == 1).then_some(ip_block_info_name(block_info)),
            }),
            value: Value::of(block),
        }
    }
}

impl<'a> Value<'a> {
    fn of(block: &DcpBlock<'a>) -> Self {
        match block.value {
            DcpValue::None => Self::None {},
            DcpValue::MacAddress(address) => Self::MacAddress { mac_address: Shown(address) },
            DcpValue::Ip(IpParameter { address, netmask, gateway }) => {
                Self::Ip { ip_address: address, netmask, gateway }
            }
            DcpValue::IpSuite(IpParameter { address, netmask, gateway }, dns) => {
                Self::IpSuite { ip_address: address, netmask, gateway, dns }
            }
            DcpValue::Text(octets) => Self::text(block, Shown(Text(octets))),
            DcpValue::DeviceId { vendor_id, device_id } => Self::DeviceId { vendor_id, device_id },
            DcpValue::DeviceRole(role) => Self::DeviceRole { role, roles: Roles(role) },
            DcpValue::DeviceOptions(options) => Self::DeviceOptions { options: Options(options) },
            DcpValue::DeviceInstance { high, low } => {
                Self::DeviceInstance { instance_high: high, instance_low: low }
            }
            DcpValue::Dhcp { code, value } => {
                Self::Dhcp { dhcp_option: code, data: Shown(Hex(value)) }
            }
            DcpValue::Signal(signal) => Self::Signal { signal, flash_once: signal == 0x0100 },
            DcpValue::Response { option, suboption, error } => Self::Response {
                of_option: option,
                of_suboption: suboption,
                of_name: suboption_name(option, suboption),
                block_error: error,
                block_error_name: block_error_name(error),
            },
            DcpValue::DeviceInitiative(value) => {
                Self::DeviceInitiative { device_initiative: value, says_hello: value == 1 }
            }
            DcpValue::Octets(octets) => Self::Octets { data: Shown(Hex(octets)) },
        }
    }

    fn text(block: &DcpBlock<'_>, text: Shown<Text<'a>>) -> Self {
        match (block.option, block.suboption) {
            (2, 1) => Self::TypeOfStation { type_of_station: text },
            (2, 2) => Self::NameOfStation { name_of_station: text },
            (2, 6) => Self::AliasName { alias_name: text },
            _ => Self::OtherText { text },
        }
    }
}

impl Display for BlockFields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)?;
        match self.name {
            "unknown" | "reserved" | "manufacturer's" => {
                write!(f, " {}/{}", self.option, self.suboption)?;
            }
            _ => {}
        }
        self.value.fmt(f)?;
        match &self.qualifier {
            Some(Qualifier { reset: Some(reset), .. }) => write!(f, " ({reset})"),
            // A signal or the end of a transaction is neither.
            Some(Qualifier { permanent, .. }) if self.option != 5 => {
                f.write_str(if *permanent { " (permanent)" } else { " (temporary)" })
            }
            _ => Ok(()),
        }?;
        match &self.info {
            Some(Info { block_info_name: Some(name), block_info: 2.. }) => write!(f, " ({name})"),
            _ => Ok(()),
        }
    }
}

impl Display for Value<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None {} => Ok(()),
            Self::MacAddress { mac_address } => write!(f, " {mac_address}"),
            Self::Ip { ip_address, netmask, gateway }
            | Self::IpSuite { ip_address, netmask, gateway, .. } => {
                write!(f, " {ip_address} mask {netmask} gateway {gateway}")
            }
            Self::TypeOfStation { type_of_station: text }
            | Self::NameOfStation { name_of_station: text }
            | Self::AliasName { alias_name: text }
            | Self::OtherText { text } => write!(f, " \"{text}\""),
            Self::DeviceId { vendor_id, device_id } => {
                write!(f, " ${vendor_id:04X}:${device_id:04X}")
            }
            Self::DeviceRole { role, .. } => {
                let mut separator = " ";
                role_names(*role).try_for_each(|name| {
                    write!(f, "{separator}{name}")?;
                    separator = " and ";
                    Ok(())
                })
            }
            Self::DeviceOptions { options } => write!(f, " {}", options.each().count()),
            Self::DeviceInstance { instance_high, instance_low } => {
                write!(f, " {instance_high}.{instance_low}")
            }
            Self::Dhcp { data, .. } | Self::Octets { data } => write!(f, " {data}"),
            Self::Signal { signal, flash_once } => match flash_once {
                true => f.write_str(" flash once"),
                false => write!(f, " ${signal:04X}"),
            },
            Self::Response { of_name, block_error_name, .. } => {
                write!(f, " to {of_name}: {block_error_name}")
            }
            Self::DeviceInitiative { says_hello, .. } => {
                f.write_str(if *says_hello { " says hello" } else { " silent" })
            }
        }
    }
}
