//! The media redundancy protocol (MRP, IEC 62439-2): the frames of a ring and of an interconnection (P-12).
//!
//! A frame is a version and a row of TLVs. Invariant: the roles of the sender are told from the TLV, since
//! no frame names them.

use super::MacAddress;
use super::octets::{Malformed, Octets};

/// The Ethertype of MRP.
pub const ETHER_TYPE: u16 = 0x88E3;

/// An MRP frame.
#[derive(Clone, Copy, Debug)]
pub struct Mrp<'a> {
    /// The version of the protocol: 1.
    pub version: u16,
    tlvs: Octets<'a>,
}

/// A part of a frame.
#[derive(Clone, Copy, Debug)]
pub struct MrpTlv<'a> {
    /// Its number in the frame.
    pub kind: u8,
    /// What it says.
    pub value: MrpValue<'a>,
}

/// What a TLV says. Intervals are in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // The fields are named as in the standard, and have an own doc where it is not all said.
pub enum MrpValue<'a> {
    /// In every frame.
    Common { sequence_id: u16, domain_uuid: [u8; 16] },
    /// A manager looks whether the ring is closed.
    Test(Test),
    /// The ring has changed: forget after `interval` which address is where.
    TopologyChange { priority: u16, source: MacAddress, interval: u16 },
    /// A client's line is down, or up again.
    LinkChange { is_up: bool, source: MacAddress, port_role: u16, interval: u16, blocked: u16 },
    /// An interconnection manager looks whether the interconnection is closed.
    InTest { interconnection_id: u16, test: Test },
    /// The interconnection has changed.
    InTopologyChange { source: MacAddress, interconnection_id: u16, interval: u16 },
    /// A line of the interconnection is down, or up again.
    InLinkChange {
        is_up: bool,
        source: MacAddress,
        port_role: u16,
        interconnection_id: u16,
        interval: u16,
    },
    /// The interconnection manager asks for the state of the line.
    InLinkStatusPoll { source: MacAddress, port_role: u16, interconnection_id: u16 },
    /// What a manufacturer adds: with any OUI, managers that choose one of them.
    Option { oui: [u8; 3], auto_manager: Option<AutoManager>, octets: &'a [u8] },
    /// Any other TLV.
    Octets(&'a [u8]),
}

/// The contents of a test, of a ring or of an interconnection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Test {
    /// The manager's priority. It is 0 in an interconnection, which has none.
    pub priority: u16,
    /// The manager.
    pub source: MacAddress,
    /// The port it was sent from.
    pub port_role: u16,
    /// 0: open; 1: closed.
    pub state: u16,
    /// How often the state has changed.
    pub transitions: u16,
    /// Milliseconds of the sender's clock.
    pub timestamp: u32,
}

/// Managers of one ring choose who goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AutoManager {
    /// 1: a better manager tells another one to give up; 2: it tells the ring; 3: an automatic manager.
    pub kind: u8,
    /// The sender's priority and address; the other manager's. An automatic manager names nobody.
    pub ends: Option<[(u16, MacAddress); 2]>,
}

impl<'a> Mrp<'a> {
    /// Reads the payload of an Ethernet frame.
    pub fn parse(octets: &'a [u8]) -> Result<Self, Malformed> {
        let mut tlvs = Octets::new(octets);
        Ok(Self { version: tlvs.u16()?, tlvs })
    }

    /// The TLVs up to the one that ends them. After an error come no more.
    pub fn tlvs(&self) -> MrpTlvs<'a> {
        MrpTlvs { left: Some(self.tlvs) }
    }
}

/// The TLVs of a frame, one after the other.
#[derive(Clone, Debug)]
pub struct MrpTlvs<'a> {
    left: Option<Octets<'a>>,
}

impl<'a> Iterator for MrpTlvs<'a> {
    type Item = Result<MrpTlv<'a>, Malformed>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut octets = self.left.take()?;
        let tlv = MrpTlv::read(&mut octets).transpose()?;
        self.left = tlv.is_ok().then_some(octets);
        Some(tlv)
    }
}

impl<'a> MrpTlv<'a> {
    /// None at the TLV that ends the frame.
    fn read(octets: &mut Octets<'a>) -> Result<Option<Self>, Malformed> {
        let (kind, length) = (octets.u8()?, octets.u8()?);
        if kind == 0 {
            return Ok(None);
        }
        let mut value = octets.part(length.into())?;
        // TLVs begin at multiples of four, counted from the first one. Not every sender pads them.
        let padding = (2 + usize::from(length)).next_multiple_of(4) - 2 - usize::from(length);
        if octets.len() > padding && octets.rest().iter().take(padding).all(|&octet| octet == 0) {
            octets.take(padding)?;
        }
        Ok(Some(Self { kind, value: MrpValue::read(kind, &mut value)? }))
    }

    /// Its name in the standard.
    pub fn name(&self) -> &'static str {
        match self.kind {
            1 => "MRP_Common",
            2 => "MRP_Test",
            3 => "MRP_TopologyChange",
            4 => "MRP_LinkDown",
            5 => "MRP_LinkUp",
            6 => "MRP_InTest",
            7 => "MRP_InTopologyChange",
            8 => "MRP_InLinkDown",
            9 => "MRP_InLinkUp",
            10 => "MRP_InLinkStatusPoll",
            0x7F => "MRP_Option",
            _ => "unknown",
        }
    }

    /// Who sends such a TLV; none where anybody may.
    pub fn sender_role(&self) -> Option<&'static str> {
        match self.kind {
            2 | 3 => Some("manager (MRM)"),
            4 | 5 => Some("client (MRC)"),
            6 | 7 | 10 => Some("interconnection manager (MIM)"),
            8 | 9 => Some("interconnection client (MIC)"),
            _ => None,
        }
    }
}

impl<'a> MrpValue<'a> {
    fn read(kind: u8, octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        Ok(match kind {
            1 => Self::Common { sequence_id: octets.u16()?, domain_uuid: octets.array()? },
            2 => Self::Test(Test { priority: octets.u16()?, ..Test::read(octets)? }),
            3 => Self::TopologyChange {
                priority: octets.u16()?,
                source: address(octets)?,
                interval: octets.u16()?,
            },
            4 | 5 => Self::LinkChange {
                is_up: kind == 5,
                source: address(octets)?,
                port_role: octets.u16()?,
                interval: octets.u16()?,
                blocked: octets.u16()?,
            },
            6 => Self::InTest { interconnection_id: octets.u16()?, test: Test::read(octets)? },
            7 => Self::InTopologyChange {
                source: address(octets)?,
                interconnection_id: octets.u16()?,
                interval: octets.u16()?,
            },
            8 | 9 => Self::InLinkChange {
                is_up: kind == 9,
                source: address(octets)?,
                port_role: octets.u16()?,
                interconnection_id: octets.u16()?,
                interval: octets.u16()?,
            },
            10 => Self::InLinkStatusPoll {
                source: address(octets)?,
                port_role: octets.u16()?,
                interconnection_id: octets.u16()?,
            },
            0x7F => {
                let oui = octets.array()?;
                Self::Option {
                    oui,
                    auto_manager: AutoManager::read(*octets),
                    octets: octets.rest(),
                }
            }
            _ => Self::Octets(octets.rest()),
        })
    }
}

impl Test {
    /// What is behind the priority, or behind the number of the interconnection.
    fn read(octets: &mut Octets<'_>) -> Result<Self, Malformed> {
        Ok(Self {
            priority: 0,
            source: address(octets)?,
            port_role: octets.u16()?,
            state: octets.u16()?,
            transitions: octets.u16()?,
            timestamp: octets.u32()?,
        })
    }

    /// The state in words.
    pub fn state_name(&self) -> &'static str {
        match self.state {
            0 => "open",
            1 => "closed",
            _ => "unknown",
        }
    }
}

impl AutoManager {
    /// None where the option has no part of this kind: a manufacturer may put anything there.
    fn read(mut octets: Octets<'_>) -> Option<Self> {
        // What the first edition of the standard left to manufacturers comes first.
        if let 0 | 4 = octets.u8().ok()? {
            octets.take(2).ok()?;
        }
        let kind = octets.u8().ok()?;
        let length = octets.u8().ok()?;
        let mut part = octets.part(length.into()).ok()?;
        let mut end = || Some((part.u16().ok()?, address(&mut part).ok()?));
        match kind {
            1 | 2 => Some(Self { kind, ends: Some([end()?, end()?]) }),
            3 => Some(Self { kind, ends: None }),
            _ => None,
        }
    }

    /// Its name in the standard.
    pub fn name(&self) -> &'static str {
        match self.kind {
            1 => "MRP_TestMgrNAck",
            2 => "MRP_TestPropagate",
            _ => "MRP_AutoMgr",
        }
    }
}

/// The role of a port in words.
pub fn port_role_name(role: u16) -> &'static str {
    match role {
        0 => "primary ring port",
        1 => "secondary ring port",
        2 => "interconnection port",
        _ => "unknown",
    }
}

/// A manager's priority in words: the smaller number wins.
pub fn priority_name(priority: u16) -> &'static str {
    match priority {
        0x0000 => "highest",
        0x1000..=0x7FFF => "high",
        0x8000 => "default",
        0x9000..=0xEFFF => "low",
        0xF000..=0xFFFF => "lowest",
        _ => "other",
    }
}

fn address(octets: &mut Octets<'_>) -> Result<MacAddress, Malformed> {
    octets.array().map(MacAddress)
}

#[cfg(test)]
mod tests;
