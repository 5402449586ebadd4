//! A block of a DCP frame.

use std::net::Ipv4Addr;

use super::BlockHead;
use crate::profinet::MacAddress;
use crate::profinet::octets::{Malformed, Octets};

/// A block: what it is about, and what it says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DcpBlock<'a> {
    /// The group.
    pub option: u8,
    /// The member of the group.
    pub suboption: u8,
    /// Octets of the contents, with qualifier or info. None where blocks are names alone.
    pub length: Option<u16>,
    /// In a set request: bit 0 is 1 where the value stays after a power cycle. The other bits are the
    /// kind of a reset to factory.
    pub qualifier: Option<u16>,
    /// In an answer: the state of an IP address; 0 of all others.
    pub info: Option<u16>,
    /// What it says.
    pub value: DcpValue<'a>,
}

/// What a block says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DcpValue<'a> {
    /// Nothing: it is asked for, or there is nothing to say.
    None,
    /// 1/1: the address of the interface.
    MacAddress(MacAddress),
    /// 1/2: the address on IP.
    Ip(IpParameter),
    /// 1/3: the same, and four name servers.
    IpSuite(IpParameter, [Ipv4Addr; 4]),
    /// 2/1, 2/2, 2/6, 7/1: type of station, name of station, alias name, name of a TSN domain.
    Text(&'a [u8]),
    /// 2/3, 2/8: the manufacturer and its device; also of the maker of the original.
    DeviceId {
        /// The manufacturer's number.
        vendor_id: u16,
        /// The device's number with this manufacturer.
        device_id: u16,
    },
    /// 2/4: a bit for each role.
    DeviceRole(u8),
    /// 2/5: options and suboptions that the device knows, two octets each.
    DeviceOptions(&'a [u8]),
    /// 2/7: which of several devices at this interface.
    DeviceInstance {
        /// The high octet.
        high: u8,
        /// The low octet.
        low: u8,
    },
    /// 3: an option of DHCP.
    Dhcp {
        /// Its number.
        code: u8,
        /// Its contents.
        value: &'a [u8],
    },
    /// 5/3: 0x0100 lets a light flash once.
    Signal(u16),
    /// 5/4: what has become of a block of the request.
    Response {
        /// Its option.
        option: u8,
        /// Its suboption.
        suboption: u8,
        /// 0: done. See [`super::block_error_name`].
        error: u8,
    },
    /// 6/1: 1 where the device tells by itself that it is there.
    DeviceInitiative(u16),
    /// Any other block.
    Octets(&'a [u8]),
}

/// A station's place on IP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IpParameter {
    /// Its address.
    pub address: Ipv4Addr,
    /// The mask of its net.
    pub netmask: Ipv4Addr,
    /// Its router. Its own address, or 0.0.0.0, where there is none.
    pub gateway: Ipv4Addr,
}

impl<'a> DcpBlock<'a> {
    pub(super) fn read(octets: &mut Octets<'a>, head: BlockHead) -> Result<Self, Malformed> {
        let (option, suboption) = (octets.u8()?, octets.u8()?);
        let names = Self {
            option,
            suboption,
            length: None,
            qualifier: None,
            info: None,
            value: DcpValue::None,
        };
        if head == BlockHead::NamesAlone {
            return Ok(names);
        }
        let length = octets.u16()?;
        let mut contents = octets.part(length.into())?;
        // Blocks begin at even octets. Some devices leave the last one out.
        if length % 2 == 1 && !octets.is_empty() {
            octets.take(1)?;
        }
        let is_response = (option, suboption) == (5, 4);
        let mut word = |of| match head {
            head if head == of && !is_response => contents.u16().map(Some),
            _ => Ok(None),
        };
        let (qualifier, info) = (word(BlockHead::Qualifier)?, word(BlockHead::Info)?);
        let value = DcpValue::read(option, suboption, &mut contents)?;
        Ok(Self { length: Some(length), qualifier, info, value, ..names })
    }
}

impl<'a> DcpValue<'a> {
    fn read(option: u8, suboption: u8, octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        let text = matches!((option, suboption), (2, 1 | 2 | 6) | (7, 1));
        if octets.is_empty() && !text {
            return Ok(Self::None);
        }
        Ok(match (option, suboption) {
            (1, 1) => Self::MacAddress(MacAddress(octets.array()?)),
            (1, 2) => Self::Ip(IpParameter::read(octets)?),
            (1, 3) => {
                let ip = IpParameter::read(octets)?;
                let mut server = || octets.array().map(Ipv4Addr::from);
                Self::IpSuite(ip, [server()?, server()?, server()?, server()?])
            }
            _ if text => Self::Text(octets.take(octets.len())?),
            (2, 3 | 8) => Self::DeviceId { vendor_id: octets.u16()?, device_id: octets.u16()? },
            (2, 4) => Self::DeviceRole(octets.u8()?),
            (2, 5) => Self::DeviceOptions(octets.rest()),
            (2, 7) => Self::DeviceInstance { high: octets.u8()?, low: octets.u8()? },
            (3, _) => {
                let (code, length) = (octets.u8()?, octets.u8()?);
                Self::Dhcp { code, value: octets.take(length.into())? }
            }
            (5, 3) => Self::Signal(octets.u16()?),
            (5, 4) => Self::Response {
                option: octets.u8()?,
                suboption: octets.u8()?,
                error: octets.u8()?,
            },
            (6, 1) => Self::DeviceInitiative(octets.u16()?),
            _ => Self::Octets(octets.rest()),
        })
    }
}

impl IpParameter {
    fn read(octets: &mut Octets<'_>) -> Result<Self, Malformed> {
        let mut address = || octets.array().map(Ipv4Addr::from);
        Ok(Self { address: address()?, netmask: address()?, gateway: address()? })
    }
}
