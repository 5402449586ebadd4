//! TLVs of organisations: those of PROFINET and of IEEE 802.3.

use crate::profinet::MacAddress;
use crate::profinet::octets::{Malformed, Octets};

/// PROFIBUS & PROFINET International.
const PNO: [u8; 3] = [0x00, 0x0E, 0xCF];
/// The working group of Ethernet.
const IEEE_802_3: [u8; 3] = [0x00, 0x12, 0x0F];

/// What a TLV of an organisation says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OrganisationValue<'a> {
    /// PROFINET 1: delays in ns, 0 where they were not measured.
    Delay {
        /// From the line to the time stamp, here.
        receive_local: u32,
        /// The same, at the neighbour.
        receive_remote: u32,
        /// From the time stamp to the line, here.
        transmit_local: u32,
        /// The same, at the neighbour.
        transmit_remote: u32,
        /// Of the cable.
        cable: u32,
    },
    /// PROFINET 2: the state of the port for the two isochronous classes.
    PortStatus {
        /// See [`class_2_name`].
        class_2: u16,
        /// See [`class_3_name`] for its lowest three bits.
        class_3: u16,
    },
    /// PROFINET 3: the port's alias name.
    Alias(&'a [u8]),
    /// PROFINET 4: the ring that the port belongs to.
    MrpPortStatus {
        /// The domain's UUID, the highest octet first.
        domain_uuid: [u8; 16],
        /// The state of the port for redundant real time.
        mrrt_status: u16,
    },
    /// PROFINET 5: the address of the station's interface.
    ChassisMac(MacAddress),
    /// PROFINET 6: the clock, and the phases of isochronous communication.
    PtcpStatus {
        /// The clock master.
        master: MacAddress,
        /// The clock's domain, the highest octet first.
        subdomain_uuid: [u8; 16],
        /// The configuration of the phases, the highest octet first.
        ir_data_uuid: [u8; 16],
        /// Length, and begin of the red, orange and green phase, in ns. Bit 31 is 1 where it is valid.
        periods: [u32; 4],
    },
    /// PROFINET 7: more about the line.
    MauTypeExtension(u16),
    /// IEEE 802.3 1: the line.
    MacPhy {
        /// Bit 0: the port can negotiate; bit 1: it does.
        autonegotiation: u8,
        /// What it offers: see [`advertised_speeds`].
        advertised: u16,
        /// What the line is: see [`super::mau_type_name`].
        mau_type: u16,
    },
    /// IEEE 802.3 4: octets of the longest frame.
    MaximumFrameSize(u16),
    /// Any other TLV.
    Octets(&'a [u8]),
}

impl<'a> OrganisationValue<'a> {
    pub(super) fn read(
        oui: [u8; 3],
        subtype: u8,
        octets: &mut Octets<'a>,
    ) -> Result<Self, Malformed> {
        Ok(match (oui, subtype) {
            (PNO, 1) => Self::Delay {
                receive_local: octets.u32()?,
                receive_remote: octets.u32()?,
                transmit_local: octets.u32()?,
                transmit_remote: octets.u32()?,
                cable: octets.u32()?,
            },
            (PNO, 2) => Self::PortStatus { class_2: octets.u16()?, class_3: octets.u16()? },
            (PNO, 3) => Self::Alias(octets.rest()),
            (PNO, 4) => {
                Self::MrpPortStatus { domain_uuid: octets.array()?, mrrt_status: octets.u16()? }
            }
            (PNO, 5) => Self::ChassisMac(MacAddress(octets.array()?)),
            (PNO, 6) => {
                let master = MacAddress(octets.array()?);
                let [subdomain_uuid, ir_data_uuid] = [octets.array()?, octets.array()?];
                let mut period = || octets.u32();
                let periods = [period()?, period()?, period()?, period()?];
                Self::PtcpStatus { master, subdomain_uuid, ir_data_uuid, periods }
            }
            (PNO, 7) => Self::MauTypeExtension(octets.u16()?),
            (IEEE_802_3, 1) => Self::MacPhy {
                autonegotiation: octets.u8()?,
                advertised: octets.u16()?,
                mau_type: octets.u16()?,
            },
            (IEEE_802_3, 4) => Self::MaximumFrameSize(octets.u16()?),
            _ => Self::Octets(octets.rest()),
        })
    }

    /// The TLV in words.
    pub fn name(oui: [u8; 3], subtype: u8) -> &'static str {
        match (oui, subtype) {
            (PNO, 1) => "measured delays",
            (PNO, 2) => "port status",
            (PNO, 3) => "alias name",
            (PNO, 4) => "MRP port status",
            (PNO, 5) => "chassis MAC",
            (PNO, 6) => "PTCP status",
            (PNO, 7) => "MAU type extension",
            (PNO, _) => "PROFINET, other",
            (IEEE_802_3, 1) => "MAC/PHY",
            (IEEE_802_3, 2) => "power over Ethernet",
            (IEEE_802_3, 3) => "link aggregation",
            (IEEE_802_3, 4) => "maximum frame size",
            (IEEE_802_3, _) => "IEEE 802.3, other",
            ([0x00, 0x80, 0xC2], _) => "IEEE 802.1",
            _ => "other organisation",
        }
    }
}

/// The state of a port for RT class 2.
pub fn class_2_name(status: u16) -> &'static str {
    match status {
        0 => "off",
        1 => "not synchronised",
        2 => "synchronised",
        _ => "reserved",
    }
}

/// The state of a port for RT class 3, by its lowest three bits.
pub fn class_3_name(status: u16) -> &'static str {
    match status & 0x07 {
        0 => "off",
        2 => "up",
        3 => "down",
        4 => "running",
        _ => "reserved",
    }
}

/// What a port offers when it negotiates. Bit 0 of the specification is the lowest one here, as the
/// devices send it.
pub fn advertised_speeds(bits: u16) -> impl Iterator<Item = &'static str> {
    const NAMES: [&str; 16] = [
        "1000BASE-T full duplex",
        "1000BASE-T half duplex",
        "1000BASE-X full duplex",
        "1000BASE-X half duplex",
        "asymmetric and symmetric pause for full duplex",
        "symmetric pause for full duplex",
        "asymmetric pause for full duplex",
        "pause for full duplex",
        "100BASE-T2 full duplex",
        "100BASE-T2 half duplex",
        "100BASE-TX full duplex",
        "100BASE-TX half duplex",
        "100BASE-T4",
        "10BASE-T full duplex",
        "10BASE-T half duplex",
        "unknown speed",
    ];
    let is_set = move |&(bit, _): &(u32, _)| bits & 1 << bit != 0;
    (0..).zip(NAMES).filter(is_set).map(|(_, name)| name)
}
