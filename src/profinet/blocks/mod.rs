//! PNIO blocks: what the calls and the alarms of PROFINET carry (P-6, IEC 61158-6-10).
//!
//! [`Blocks`] goes from block to block, [`Block::contents`] reads one of them. Numbers are big-endian. A
//! record follows its header, which says how long it is; [`Block::record`] has it. Invariants: a block
//! that is not known keeps its number and octets, and blocks inside blocks have a limit, [`MAX_DEPTH`].

mod alarm;
mod connect;
mod contents;
mod control;
mod identification;
mod maintenance;
mod names;
mod physical;
mod record;
mod redundancy;
#[cfg(test)]
mod tests;
mod words;

pub use alarm::{AlarmAck, AlarmItem, AlarmItemContents, AlarmNotification};
pub use connect::{
    AlarmCrBlockReq, AlarmCrBlockRes, ArBlockReq, ArBlockRes, ArRpcBlock, ArServerBlock,
    ArVendorBlock, DataDescription, DiffApi, DiffModule, DiffSubmodule, ExpectedApi,
    ExpectedFields, ExpectedSubmodule, ExpectedSubmoduleBlockReq, IoCrApi, IoCrBlockReq,
    IoCrBlockRes, IoDataObject, McrBlockReq, ModuleDiffBlock, PrmServerBlock,
};
pub use contents::Contents;
pub use control::{ControlBlock, SubmoduleListBlock, SubmoduleListEntry};
pub use identification::{
    ApiData, FilterApi, FilterData, IdentifiedModule, IdentifiedSlot, IdentifiedSubslot, Im0, Im1,
    Im2, Im3, Im4, Im5, Im5Data, RealApi, RealIdentificationData, RealIdentificationSlots,
};
pub use maintenance::{LogBookData, LogEntry, MaintenanceItem, SubstituteValue};
pub use names::block_name;
pub use physical::{
    AdjustMauType, CheckMauType, CheckPeer, CheckPeers, InterfaceAdjust, MultipleBlock,
    PdInterfaceDataReal, PdPortDataReal, PdPortStatistic, Peer, PortBlocks,
};
pub use record::{
    IodReadReqHeader, IodReadResHeader, IodWriteReqHeader, IodWriteResHeader, MULTIPLE_WRITE,
    Record, RecordPlace,
};

pub use redundancy::{
    FastStartUp, FsHelloBlock, FsParameterBlock, IrInfoBlock, IrIocr, MrpAdjust, MrpCheck,
    MrpClientParams, MrpInstanceAdjust, MrpInstanceCheck, MrpInstances, MrpManagerParams,
    MrpRingStateData, PortMrp, PortMrpInstance, RsInfoBlock, SrInfoBlock,
};

use super::view::{Show, Value, View};
use super::{Malformed, Octets};

/// How many blocks may be inside each other. Further inside they are octets only.
pub const MAX_DEPTH: u8 = 6;

/// Octets of number, length and version.
const HEADER: usize = 6;

/// One block: number, length and version are read, its contents are not yet.
#[derive(Clone, Copy, Debug)]
pub struct Block<'a> {
    /// Its number: which kind of block it is.
    pub block_type: u16,
    /// Its version, the higher and the lower part.
    pub version: (u8, u8),
    /// Where it begins, counted like every offset.
    pub offset: usize,
    octets: Octets<'a>,
    record: Option<Octets<'a>>,
}

impl<'a> Block<'a> {
    /// Its name in the standard; none if the number is not known.
    pub fn name(&self) -> Option<&'static str> {
        block_name(self.block_type)
    }

    /// The length that its header says: that of version and contents.
    pub fn length(&self) -> usize {
        self.octets.len() + 2
    }

    /// What comes behind the version.
    pub fn octets(&self) -> Octets<'a> {
        self.octets
    }

    /// Reads what comes behind the version.
    pub fn contents(&self) -> Result<Contents<'a>, Malformed> {
        Contents::of(self)
    }

    /// Which record the header of a read or a write is for; none for another block.
    pub fn record_place(&self) -> Option<RecordPlace> {
        record::place(self.block_type, self.octets)
    }

    /// The record behind the header of a read answer or of a write; of another block there is none.
    pub fn record(&self) -> Option<Record<'a>> {
        self.record.map(|octets| Record::of(self, octets))
    }
}

impl<'a> View<'a> for Block<'a> {
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        let offset = octets.offset();
        let block_type = octets.u16()?;
        let too_short = octets.wrong("a block is shorter than its version");
        let mut body = usize::from(octets.u16()?);
        body = body.checked_sub(2).ok_or(too_short)?;
        let version = (octets.u8()?, octets.u8()?);
        let contents = octets.part(body)?.inside(HEADER);
        let record = match record::len_behind(block_type, contents) {
            Some(len) => Some(octets.part(len)?.inside(0)),
            None => None,
        };
        Ok(Self { block_type, version, offset, octets: contents, record })
    }

    fn value(&self) -> Value<'_> {
        Value::Fields(self)
    }
}

impl Show for Block<'_> {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        visit("type", Value::Number(self.block_type.into()));
        if let Some(name) = self.name() {
            visit("name", Value::Display(&name));
        }
        let (high, low) = self.version;
        visit("version", Value::Display(&format_args!("{high}.{low}")));
        visit("length", Value::Number(self.length() as u64));
        if self.octets.depth() > MAX_DEPTH {
            return visit("octets", Value::Octets(self.octets.rest()));
        }
        match self.contents() {
            Ok(contents) => contents.show(visit),
            Err(fault) => {
                visit("octets", Value::Octets(self.octets.rest()));
                visit("error", Value::Fault(fault));
            }
        }
        match self.record() {
            None => {}
            Some(Record::Blocks(blocks)) => visit("blocks", Value::List(&blocks)),
            Some(Record::Octets(octets)) => visit("record", Value::Octets(octets.rest())),
        }
    }
}

/// Blocks that follow each other. After a malformed one there are no more.
#[derive(Clone, Copy, Debug)]
pub struct Blocks<'a> {
    octets: Octets<'a>,
    is_padded: bool,
}

impl<'a> Blocks<'a> {
    /// The blocks of a call, of an alarm, or of a record.
    pub fn new(octets: Octets<'a>) -> Self {
        Self { octets, is_padded: false }
    }

    /// Those of a record that holds several writes: each begins at a multiple of four.
    fn padded(octets: Octets<'a>) -> Self {
        Self { octets, is_padded: true }
    }

    /// The number of octets that the blocks have.
    pub fn len(&self) -> usize {
        self.octets.len()
    }

    /// Whether there is no block.
    pub fn is_empty(&self) -> bool {
        self.octets.is_empty()
    }

    fn read(&mut self) -> Result<Block<'a>, Malformed> {
        let block = Block::read(&mut self.octets)?;
        // The last write may leave its padding out.
        if self.is_padded && self.octets.align().is_err() {
            self.octets.take(self.octets.len())?;
        }
        Ok(block)
    }
}

impl<'a> Iterator for Blocks<'a> {
    type Item = Result<Block<'a>, Malformed>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.octets.is_empty() {
            return None;
        }
        let block = self.read();
        if block.is_err() {
            self.octets = Octets::new(&[]);
        }
        Some(block)
    }
}

impl super::view::Each for Blocks<'_> {
    fn each(&self, visit: &mut dyn FnMut(Value<'_>)) {
        for block in *self {
            match block {
                Ok(block) => visit(block.value()),
                Err(fault) => visit(Value::Fields(&fault)),
            }
        }
    }
}

impl Show for Malformed {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        visit("error", Value::Fault(*self));
    }
}
