//! The headers of records that are read and written (P-9), and where the record behind them is.

use std::fmt;

use super::super::records::{self, Scope};
use super::super::view::{Skip, View, view};
use super::super::{Malformed, Octets, PnioStatus, Uuid};
use super::{Block, Blocks};

/// The index under which several records are written at once.
pub const MULTIPLE_WRITE: u16 = 0xE040;

view! {
    /// 0x0009: which record is to be read.
    pub struct IodReadReqHeader {
        /// Counts the reads and writes of a connection.
        sequence: u16,
        /// The connection; nil for Read Implicit.
        ar_uuid: Uuid,
        /// The application process.
        api: u32,
        /// The slot.
        slot: u16,
        /// The subslot.
        subslot: u16,
        /// Padding.
        padding: Skip<2>,
        /// The record.
        index: u16 => records::word,
        /// The most octets that are wanted.
        record_data_length: u32,
        /// The connection whose data are asked for.
        target_ar_uuid: Uuid,
    }
}

view! {
    /// 0x8009: which record was read. It follows, unless reading failed.
    pub struct IodReadResHeader {
        /// That of the request.
        sequence: u16,
        /// The connection; nil for Read Implicit.
        ar_uuid: Uuid,
        /// The application process.
        api: u32,
        /// The slot.
        slot: u16,
        /// The subslot.
        subslot: u16,
        /// Padding.
        padding: Skip<2>,
        /// The record.
        index: u16 => records::word,
        /// Octets of the record.
        record_data_length: u32,
        /// More about the answer, as the record's definition says.
        additional_value1: u16,
        /// More about the answer, as the record's definition says.
        additional_value2: u16,
    }
}

view! {
    /// 0x0008: which record is to be written. It follows.
    pub struct IodWriteReqHeader {
        /// Counts the reads and writes of a connection.
        sequence: u16,
        /// The connection.
        ar_uuid: Uuid,
        /// The application process.
        api: u32,
        /// The slot.
        slot: u16,
        /// The subslot.
        subslot: u16,
        /// Padding.
        padding: Skip<2>,
        /// The record.
        index: u16 => records::word,
        /// Octets of the record.
        record_data_length: u32,
    }
}

view! {
    /// 0x8008: which record was written, and whether that succeeded.
    pub struct IodWriteResHeader {
        /// That of the request.
        sequence: u16,
        /// The connection.
        ar_uuid: Uuid,
        /// The application process.
        api: u32,
        /// The slot.
        slot: u16,
        /// The subslot.
        subslot: u16,
        /// Padding.
        padding: Skip<2>,
        /// The record.
        index: u16 => records::word,
        /// Octets that were written.
        record_data_length: u32,
        /// More about the answer, as the record's definition says.
        additional_value1: u16,
        /// More about the answer, as the record's definition says.
        additional_value2: u16,
        /// Whether this record was written.
        status: PnioStatus,
    }
}

/// Where index and length are in the contents of all four headers.
const INDEX: usize = 28;

/// How many octets of a record follow a block, if it is a header that a record follows.
pub(super) fn len_behind(block_type: u16, mut contents: Octets<'_>) -> Option<usize> {
    if !matches!(block_type, 0x0008 | 0x8009) {
        return None;
    }
    contents.take(INDEX + 2).ok()?;
    // What does not fit `usize` does not fit the datagram either.
    contents.u32().ok().map(|len| usize::try_from(len).unwrap_or(usize::MAX))
}

/// The slot, subslot and index in one of the four headers.
pub(super) fn place(block_type: u16, mut contents: Octets<'_>) -> Option<RecordPlace> {
    if !matches!(block_type, 0x0008 | 0x0009 | 0x8008 | 0x8009) {
        return None;
    }
    contents.take(INDEX - 6).ok()?;
    let [slot, subslot, _, index] = [(); 4].map(|()| contents.u16().ok());
    Some(RecordPlace { slot: slot?, subslot: subslot?, index: index? })
}

/// Which record it is, and of what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordPlace {
    /// The slot.
    pub slot: u16,
    /// The subslot.
    pub subslot: u16,
    /// The record.
    pub index: u16,
}

/// Its name, or its index where it has none, and the slot and subslot that it is of, if it is of one.
impl fmt::Display for RecordPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match records::record_name(self.index) {
            Some(name) => f.write_str(name)?,
            None => write!(f, "{:#06x}", self.index)?,
        }
        let scope = Scope::of(self.index);
        if matches!(scope, Scope::User | Scope::Subslot | Scope::Slot) {
            write!(f, " of slot {}", self.slot)?;
        }
        match records::subslot_words(self.subslot) {
            _ if !matches!(scope, Scope::User | Scope::Subslot) => Ok(()),
            Some(words) => write!(f, " {words}"),
            None => write!(f, " subslot {}", self.subslot),
        }
    }
}

/// A record behind its header.
#[derive(Clone, Copy, Debug)]
pub enum Record<'a> {
    /// One that is made of blocks.
    Blocks(Blocks<'a>),
    /// One whose octets mean what the vendor or a profile says.
    Octets(Octets<'a>),
}

impl<'a> Record<'a> {
    pub(super) fn of(header: &Block<'_>, octets: Octets<'a>) -> Self {
        match place(header.block_type, header.octets).map_or(0, |place| place.index) {
            MULTIPLE_WRITE => Self::Blocks(Blocks::padded(octets)),
            index if records::has_blocks(index) => Self::Blocks(Blocks::new(octets)),
            _ => Self::Octets(octets),
        }
    }
}

impl IodReadReqHeader {
    /// Octets of the whole block.
    pub const LEN: usize = 64;

    /// Reads the one block that the arguments of a read are.
    pub fn parse(args: &mut Octets<'_>) -> Result<Self, Malformed> {
        let wrong = args.wrong("the block is not an IODReadReqHeader");
        let block = Block::read(args)?;
        if block.block_type != 0x0009 || block.length() != Self::LEN - 4 {
            return Err(wrong);
        }
        if !args.is_empty() {
            return Err(args.wrong("octets behind the IODReadReqHeader"));
        }
        Self::read(&mut block.octets())
    }

    /// The whole block.
    pub fn to_octets(&self) -> [u8; Self::LEN] {
        let mut octets = [0; Self::LEN];
        let mut rest = &mut octets[..];
        for field in [
            &[0x00, 0x09, 0x00, 0x3C, 0x01, 0x00][..],
            &self.sequence.to_be_bytes(),
            &self.ar_uuid.octets(),
            &self.api.to_be_bytes(),
            &self.slot.to_be_bytes(),
            &self.subslot.to_be_bytes(),
            &[0; 2],
            &self.index.to_be_bytes(),
            &self.record_data_length.to_be_bytes(),
            &self.target_ar_uuid.octets(),
        ] {
            let (place, behind) = rest.split_at_mut(field.len());
            place.copy_from_slice(field);
            rest = behind;
        }
        octets
    }
}
