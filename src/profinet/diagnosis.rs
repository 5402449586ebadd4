//! Diagnosis: which channel, what is wrong with it, how urgent it is (P-10).
//!
//! The user structure identifier (USI) says how an entry is to be read: 0x8000 channel, 0x8002 with an
//! extended error, 0x8003 with a qualifier too; 0x0000 to 0x7FFF is the manufacturer's.

mod words;

pub use words::{channel_error, extended_channel_error};

use super::view::{Each, Show, Value, word};
use super::{Malformed, Octets};

/// The USI of a channel's diagnosis.
pub const CHANNEL: u16 = 0x8000;
/// The USI of a channel's diagnosis with an extended error.
pub const EXTENDED_CHANNEL: u16 = 0x8002;
/// The USI of a channel's diagnosis with an extended error and a qualifier.
pub const QUALIFIED_CHANNEL: u16 = 0x8003;

/// The channel number that means the whole submodule.
pub const WHOLE_SUBMODULE: u16 = 0x8000;

/// One diagnosis of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DiagnosisEntry {
    /// The channel; 0x8000: the whole submodule.
    pub channel_number: u16,
    /// Size, direction, and whether the error came or went.
    pub channel_properties: ChannelProperties,
    /// What is wrong.
    pub channel_error_type: u16,
    /// More about it, with USI 0x8002 and 0x8003.
    pub extended: Option<ExtendedError>,
    /// How urgent it is, with USI 0x8003.
    pub channel_qualifier: Option<ChannelQualifier>,
}

/// More about an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExtendedError {
    /// What is wrong, below the channel error type.
    pub error_type: u16,
    /// A value that belongs to it.
    pub add_value: u32,
}

/// Size, direction and state of a diagnosis, bit by bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChannelProperties(pub u16);

impl ChannelProperties {
    /// The size of the channel: 1 is one bit, 7 is 64 bits; 0: no size.
    pub fn channel_type(self) -> u8 {
        self.0 as u8
    }

    /// Whether the entry stands for several channels.
    pub fn is_accumulative(self) -> bool {
        self.0 & 0x0100 != 0
    }

    /// 0: failure, 1: maintenance required, 2: maintenance demanded, 3: as the qualifier says.
    pub fn maintenance(self) -> u8 {
        (self.0 >> 9) as u8 & 3
    }

    /// 0: no diagnosis is left, 1: it appears, 2: it disappears, 3: it disappears and others remain.
    pub fn specifier(self) -> u8 {
        (self.0 >> 11) as u8 & 3
    }

    /// 0: as the manufacturer says, 1: input, 2: output, 3: both.
    pub fn direction(self) -> u8 {
        (self.0 >> 13) as u8 & 7
    }
}

/// Which severities a diagnosis has: bits 3 to 6 advice, 7 to 16 maintenance required, 17 to 26
/// maintenance demanded, 27 to 31 fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChannelQualifier(pub u32);

impl ChannelQualifier {
    /// The most urgent severity that is set.
    pub fn severity(self) -> Option<&'static str> {
        Some(match self.0.checked_ilog2()? {
            0..3 => "reserved",
            3..7 => "advice",
            7..17 => "maintenance required",
            17..27 => "maintenance demanded",
            _ => "fault",
        })
    }
}

impl DiagnosisEntry {
    /// Reads one entry behind its USI; none if this USI has another structure.
    pub fn read(usi: u16, octets: &mut Octets<'_>) -> Result<Option<Self>, Malformed> {
        if !matches!(usi, CHANNEL | EXTENDED_CHANNEL | QUALIFIED_CHANNEL) {
            return Ok(None);
        }
        let channel_number = octets.u16()?;
        let channel_properties = ChannelProperties(octets.u16()?);
        let channel_error_type = octets.u16()?;
        let extended = match usi {
            CHANNEL => None,
            _ => Some(ExtendedError { error_type: octets.u16()?, add_value: octets.u32()? }),
        };
        let channel_qualifier = match usi {
            QUALIFIED_CHANNEL => Some(ChannelQualifier(octets.u32()?)),
            _ => None,
        };
        Ok(Some(Self {
            channel_number,
            channel_properties,
            channel_error_type,
            extended,
            channel_qualifier,
        }))
    }
}

impl Show for DiagnosisEntry {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        visit("channel_number", channel_number(self.channel_number.into()));
        visit("channel_properties", Value::Fields(&self.channel_properties));
        let error = self.channel_error_type;
        visit("channel_error_type", Value::Word(error.into(), channel_error(error)));
        if let Some(ExtendedError { error_type, add_value }) = self.extended {
            let word = extended_channel_error(error, error_type);
            visit("ext_channel_error_type", Value::Word(error_type.into(), word));
            visit("ext_channel_error_add_value", Value::Number(add_value.into()));
        }
        if let Some(qualifier) = self.channel_qualifier {
            visit("qualified_channel_qualifier", Value::Number(qualifier.0.into()));
            if let Some(severity) = qualifier.severity() {
                visit("severity", Value::Display(&severity));
            }
        }
    }
}

impl Show for ChannelProperties {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        const TYPES: [(u64, &str); 8] = [
            (0, "no size"),
            (1, "1 bit"),
            (2, "2 bits"),
            (3, "4 bits"),
            (4, "8 bits"),
            (5, "16 bits"),
            (6, "32 bits"),
            (7, "64 bits"),
        ];
        const MAINTENANCE: [(u64, &str); 4] = [
            (0, "failure"),
            (1, "maintenance required"),
            (2, "maintenance demanded"),
            (3, "qualified"),
        ];
        const SPECIFIERS: [(u64, &str); 4] = [
            (0, "no diagnosis is left"),
            (1, "appears"),
            (2, "disappears"),
            (3, "disappears, others remain"),
        ];
        const DIRECTIONS: [(u64, &str); 4] =
            [(0, "manufacturer's"), (1, "input"), (2, "output"), (3, "input and output")];
        visit("value", Value::Number(self.0.into()));
        visit("type", word(self.channel_type().into(), &TYPES));
        visit("accumulative", Value::Number(self.is_accumulative().into()));
        visit("maintenance", word(self.maintenance().into(), &MAINTENANCE));
        visit("specifier", word(self.specifier().into(), &SPECIFIERS));
        visit("direction", word(self.direction().into(), &DIRECTIONS));
    }
}

/// A channel number: of the manufacturer up to 0x7FFF, else the whole submodule.
fn channel_number(number: u64) -> Value<'static> {
    word(number, &[(WHOLE_SUBMODULE as u64, "whole submodule")])
}

/// A USI and the word for it.
pub fn user_structure_identifier(number: u64) -> Value<'static> {
    if number <= 0x7FFF {
        return Value::Word(number, Some("manufacturer's"));
    }
    word(
        number,
        &[
            (0x8000, "channel diagnosis"),
            (0x8001, "multiple"),
            (0x8002, "extended channel diagnosis"),
            (0x8003, "qualified channel diagnosis"),
            (0x8100, "maintenance"),
            (0x8200, "upload and retrieval"),
            (0x8201, "iParameter"),
            (0x8300, "reporting system: low watermark"),
            (0x8301, "reporting system: timeout"),
            (0x8302, "reporting system: overflow"),
            (0x8303, "reporting system: event"),
            (0x8310, "energy saving status"),
            (0x8320, "channel-related process alarm"),
        ],
    )
}

/// Block 0x0010: the diagnoses of one submodule.
#[derive(Clone, Copy, Debug)]
pub struct DiagnosisData<'a> {
    /// The application process, from version 1.1 on.
    pub api: Option<u32>,
    /// The slot.
    pub slot: u16,
    /// The subslot.
    pub subslot: u16,
    /// 0x8000: the entries say their channels; else the channel of a manufacturer's diagnosis.
    pub channel_number: u16,
    /// What all entries have in common.
    pub channel_properties: ChannelProperties,
    /// How the entries are to be read.
    pub user_structure_identifier: u16,
    octets: Octets<'a>,
}

impl<'a> DiagnosisData<'a> {
    pub(super) fn read(mut octets: Octets<'a>, has_api: bool) -> Result<Self, Malformed> {
        let mut data = Self {
            api: if has_api { Some(octets.u32()?) } else { None },
            slot: octets.u16()?,
            subslot: octets.u16()?,
            channel_number: octets.u16()?,
            channel_properties: ChannelProperties(octets.u16()?),
            user_structure_identifier: octets.u16()?,
            octets,
        };
        data.octets = octets;
        while !octets.is_empty() {
            if DiagnosisEntry::read(data.user_structure_identifier, &mut octets)?.is_none() {
                break;
            }
        }
        Ok(data)
    }

    /// Its entries; none where the manufacturer says what the octets mean.
    pub fn entries(&self) -> impl Iterator<Item = DiagnosisEntry> + use<'a> {
        let (usi, mut octets) = (self.user_structure_identifier, self.octets);
        std::iter::from_fn(move || {
            if octets.is_empty() {
                return None;
            }
            DiagnosisEntry::read(usi, &mut octets).ok().flatten()
        })
    }

    /// The octets behind the USI.
    pub fn octets(&self) -> &'a [u8] {
        self.octets.rest()
    }
}

impl Show for DiagnosisData<'_> {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        if let Some(api) = self.api {
            visit("api", Value::Number(api.into()));
        }
        visit("slot", Value::Number(self.slot.into()));
        visit("subslot", Value::Number(self.subslot.into()));
        visit("channel_number", channel_number(self.channel_number.into()));
        visit("channel_properties", Value::Fields(&self.channel_properties));
        let usi = self.user_structure_identifier;
        visit("user_structure_identifier", user_structure_identifier(usi.into()));
        if self.entries().next().is_some() {
            visit("entries", Value::List(self));
        } else {
            visit("data", Value::Octets(self.octets()));
        }
    }
}

impl Each for DiagnosisData<'_> {
    fn each(&self, visit: &mut dyn FnMut(Value<'_>)) {
        self.entries().for_each(|entry| visit(Value::Fields(&entry)));
    }
}

#[cfg(test)]
mod tests;
