//! The records of a PROFINET device that may be read through the router.

use std::str::FromStr;

use strum::VariantArray;

/// A record, or several that say the same of different parts of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, VariantArray)]
pub enum Record {
    /// Who made the device.
    Im0,
    /// What it is for, and where it is.
    Im1,
    /// When it was installed.
    Im2,
    /// A text about it.
    Im3,
    /// A signature.
    Im4,
    /// Who made its modules.
    Im5,
    /// Which submodules have I&M records of their own.
    Im0FilterData,
    /// Interface and ports as they are.
    PdRealData,
    /// Diagnosis of a subslot, a slot, an application process or the device.
    Diagnosis,
    /// What the device remembers.
    LogBook,
    /// Which modules are plugged.
    RealIdentificationData,
    /// The application processes of the device.
    ApiData,
}

/// A text that names no record.
#[derive(Debug, thiserror::Error)]
#[error("no record has this name")]
pub struct NoSuchRecord;

impl Record {
    /// The name that the configuration has for it.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Im0 => "im0",
            Self::Im1 => "im1",
            Self::Im2 => "im2",
            Self::Im3 => "im3",
            Self::Im4 => "im4",
            Self::Im5 => "im5",
            Self::Im0FilterData => "im0_filter_data",
            Self::PdRealData => "pd_real_data",
            Self::Diagnosis => "diagnosis",
            Self::LogBook => "log_book",
            Self::RealIdentificationData => "real_identification_data",
            Self::ApiData => "api_data",
        }
    }

    /// The record with this index (P-9), if it is one that may be let through at all.
    pub(super) fn of(index: u16) -> Option<Self> {
        Some(match index {
            0xAFF0 => Self::Im0,
            0xAFF1 => Self::Im1,
            0xAFF2 => Self::Im2,
            0xAFF3 => Self::Im3,
            0xAFF4 => Self::Im4,
            0xAFF5 => Self::Im5,
            0xF840 => Self::Im0FilterData,
            // PDPortDataReal, PDPortStatistic and PDInterfaceDataReal are parts of PDRealData.
            0x802A | 0x8072 | 0x8080 | 0xF841 => Self::PdRealData,
            // Those of an AR are not read without a connection.
            0x800A..=0x800C | 0x8010..=0x8013 | 0xC00A..=0xC00C | 0xC010..=0xC013 => {
                Self::Diagnosis
            }
            0xF00A..=0xF00C | 0xF010..=0xF013 | 0xF80C => Self::Diagnosis,
            0xF830 => Self::LogBook,
            0x8001 | 0xC001 | 0xF000 => Self::RealIdentificationData,
            0xF821 => Self::ApiData,
            _ => return None,
        })
    }
}

impl FromStr for Record {
    type Err = NoSuchRecord;

    fn from_str(text: &str) -> Result<Self, NoSuchRecord> {
        Self::VARIANTS.iter().copied().find(|record| record.label() == text).ok_or(NoSuchRecord)
    }
}

/// A set of records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Records(u16);

impl Records {
    /// All that there are.
    pub fn all() -> Self {
        Record::VARIANTS.iter().copied().collect()
    }

    /// The records of the set.
    pub fn iter(self) -> impl Iterator<Item = Record> {
        Record::VARIANTS.iter().copied().filter(move |record| self.has(*record))
    }

    /// Whether a record is in the set.
    #[inline]
    pub const fn has(self, record: Record) -> bool {
        self.0 & (1 << record as u16) != 0
    }

    /// Whether the record with this index is in the set.
    #[inline]
    pub(super) fn include(self, index: u16) -> bool {
        Record::of(index).is_some_and(|record| self.has(record))
    }
}

impl Default for Records {
    /// What an inventory and a diagnosis need: all but the list of application processes.
    fn default() -> Self {
        let all = Record::VARIANTS.iter().copied();
        all.filter(|record| *record != Record::ApiData).collect()
    }
}

impl FromIterator<Record> for Records {
    fn from_iter<T: IntoIterator<Item = Record>>(records: T) -> Self {
        Self(records.into_iter().fold(0, |set, record| set | 1 << record as u16))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn p_9_a_record_is_let_through_by_its_index() {
        let records: Records = [Record::Im0, Record::Diagnosis].into_iter().collect();
        assert!(records.include(0xAFF0) && records.include(0xF80C) && records.include(0x800B));
        for other in [0xAFF1, 0xF841, 0xE00A, 0x0001, 0xE040, 0x802B, 0x8071] {
            assert!(!records.include(other), "{other:#06x}");
        }
        assert_eq!(records.iter().count(), 2);
        assert!(Records::default().include(0xF841) && !Records::default().include(0xF821));
    }

    #[test]
    fn names_are_read_as_they_are_written() {
        for record in Record::VARIANTS {
            assert_eq!(record.label().parse::<Record>().unwrap(), *record);
        }
        assert!("im6".parse::<Record>().is_err());
    }
}
