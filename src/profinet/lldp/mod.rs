//! LLDP (IEEE 802.1AB): what a port tells its neighbour, with the TLVs of PROFINET and of IEEE 802.3 (P-11).
//!
//! `organisation` has the TLVs of type 127, `mau` the names of lines, `names` how a station and its port are
//! called. Invariant: a TLV that is not known keeps its numbers and its octets.

mod mau;
mod names;
mod organisation;

use std::net::{Ipv4Addr, Ipv6Addr};

use super::MacAddress;
use super::octets::{Malformed, Octets};

pub use mau::mau_type_name;
pub use names::{Names, NamesMode};
pub use organisation::{OrganisationValue, advertised_speeds, class_2_name, class_3_name};

/// The Ethertype of LLDP.
pub const ETHER_TYPE: u16 = 0x88CC;

/// An LLDP frame.
#[derive(Clone, Copy, Debug)]
pub struct Lldp<'a> {
    tlvs: Octets<'a>,
}

/// A part of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LldpTlv<'a> {
    /// Its type: 1 to 127.
    pub kind: u8,
    /// What it says.
    pub value: LldpValue<'a>,
}

/// What a TLV says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LldpValue<'a> {
    /// 1: which station.
    ChassisId(Id<'a>),
    /// 2: which of its ports.
    PortId(Id<'a>),
    /// 3: for so many seconds it counts.
    TimeToLive(u16),
    /// 4, 5 and 6: description of the port, name and description of the system.
    Text(&'a [u8]),
    /// 7: what the station can be, and what it is. Bits by [`capability_names`].
    Capabilities {
        /// What it can be.
        supported: u16,
        /// What it is.
        enabled: u16,
    },
    /// 8: where it is managed.
    ManagementAddress {
        /// The address.
        address: Address<'a>,
        /// 2: an ifIndex; 3: a port of the system.
        interface_subtype: u8,
        /// Its number.
        interface_number: u32,
        /// The object of a MIB, as BER writes it; often empty.
        object_id: &'a [u8],
    },
    /// 127: of an organisation.
    Organisation {
        /// The organisation.
        oui: [u8; 3],
        /// Its number of the TLV.
        subtype: u8,
        /// What it says.
        value: OrganisationValue<'a>,
    },
    /// Any other TLV.
    Octets(&'a [u8]),
}

/// A name of a station or of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Id<'a> {
    /// Whose name it is. The numbers of stations and ports differ.
    pub subtype: u8,
    /// The name.
    pub value: Address<'a>,
}

/// An address, or a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Address<'a> {
    /// Of an interface.
    Mac(MacAddress),
    /// On IPv4.
    V4(Ipv4Addr),
    /// On IPv6.
    V6(Ipv6Addr),
    /// A name.
    Text(&'a [u8]),
    /// Of another family.
    Other {
        /// Its number with IANA.
        family: u8,
        /// Its octets.
        octets: &'a [u8],
    },
}

impl<'a> Lldp<'a> {
    /// The payload of an Ethernet frame.
    pub fn new(octets: &'a [u8]) -> Self {
        Self { tlvs: Octets::new(octets) }
    }

    /// The TLVs up to the one that ends them, or to the end of the frame. After an error come no more.
    pub fn tlvs(&self) -> LldpTlvs<'a> {
        LldpTlvs { left: Some(self.tlvs) }
    }
}

/// The TLVs of a frame, one after the other.
#[derive(Clone, Debug)]
pub struct LldpTlvs<'a> {
    left: Option<Octets<'a>>,
}

impl<'a> Iterator for LldpTlvs<'a> {
    type Item = Result<LldpTlv<'a>, Malformed>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut octets = self.left.take().filter(|octets| !octets.is_empty())?;
        let tlv = LldpTlv::read(&mut octets).transpose()?;
        self.left = tlv.is_ok().then_some(octets);
        Some(tlv)
    }
}

impl<'a> LldpTlv<'a> {
    /// None at the TLV that ends the frame.
    fn read(octets: &mut Octets<'a>) -> Result<Option<Self>, Malformed> {
        let head = octets.u16()?;
        let (kind, length) = ((head >> 9) as u8, head & 0x01FF);
        if kind == 0 {
            return Ok(None);
        }
        let mut value = octets.part(length.into())?;
        Ok(Some(Self { kind, value: LldpValue::read(kind, &mut value)? }))
    }

    /// Its type in words.
    pub fn name(&self) -> &'static str {
        match self.kind {
            1 => "chassis ID",
            2 => "port ID",
            3 => "time to live",
            4 => "port description",
            5 => "system name",
            6 => "system description",
            7 => "capabilities",
            8 => "management address",
            127 => "organisation",
            _ => "reserved",
        }
    }
}

impl<'a> LldpValue<'a> {
    fn read(kind: u8, octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        Ok(match kind {
            1 => Self::ChassisId(Id::read(octets, 4, 5)?),
            2 => Self::PortId(Id::read(octets, 3, 4)?),
            3 => Self::TimeToLive(octets.u16()?),
            4..=6 => Self::Text(octets.rest()),
            7 => Self::Capabilities { supported: octets.u16()?, enabled: octets.u16()? },
            8 => {
                let length = octets.u8()?;
                let address = Address::read(&mut octets.part(length.into())?)?;
                let interface_subtype = octets.u8()?;
                let interface_number = octets.u32()?;
                let length = octets.u8()?;
                let object_id = octets.take(length.into())?;
                Self::ManagementAddress { address, interface_subtype, interface_number, object_id }
            }
            127 => {
                let (oui, subtype) = (octets.array()?, octets.u8()?);
                let value = OrganisationValue::read(oui, subtype, octets)?;
                Self::Organisation { oui, subtype, value }
            }
            _ => Self::Octets(octets.rest()),
        })
    }
}

impl<'a> Id<'a> {
    /// `mac` and `network` are the subtypes of addresses; all others are names.
    fn read(octets: &mut Octets<'a>, mac: u8, network: u8) -> Result<Self, Malformed> {
        let subtype = octets.u8()?;
        let value = if subtype == mac {
            Address::Mac(MacAddress(octets.array()?))
        } else if subtype == network {
            Address::read(octets)?
        } else {
            Address::Text(octets.rest())
        };
        Ok(Self { subtype, value })
    }
}

impl<'a> Address<'a> {
    /// The family by its number with IANA, and the address.
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        Ok(match octets.u8()? {
            1 => Self::V4(octets.array::<4>()?.into()),
            2 => Self::V6(octets.array::<16>()?.into()),
            6 if octets.len() == MacAddress::LEN => Self::Mac(MacAddress(octets.array()?)),
            family => Self::Other { family, octets: octets.rest() },
        })
    }
}

/// What a station can be: the bits that are set.
pub fn capability_names(bits: u16) -> impl Iterator<Item = &'static str> {
    const NAMES: [&str; 8] = [
        "other",
        "repeater",
        "bridge",
        "WLAN access point",
        "router",
        "telephone",
        "cable modem",
        "station only",
    ];
    let is_set = move |&(bit, _): &(u32, _)| bits & 1 << bit != 0;
    (0..).zip(NAMES).filter(is_set).map(|(_, name)| name)
}

#[cfg(test)]
mod tests;
