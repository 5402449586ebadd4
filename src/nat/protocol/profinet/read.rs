//! The stub data of a Read Implicit, octet by octet, so that those of a request in fragments can be
//! checked as they come.

use crate::profinet::ByteOrder;
use crate::profinet::blocks::IodReadReqHeader;
use crate::profinet::ndr;

use super::Records;
use crate::nat::reason::DropReason;

/// Octets of the stub data: five numbers and one block, and nothing behind them (P-5).
pub(super) const LEN: usize = ndr::Request::HEADER_LEN + IodReadReqHeader::LEN;

const BLOCK: usize = ndr::Request::HEADER_LEN;
/// Number, length and version of an IODReadReqHeader (P-6).
const BLOCK_HEADER: [u8; 6] = [0x00, 0x09, 0x00, IodReadReqHeader::LEN as u8 - 4, 0x01, 0x00];
/// The AR: behind the block's header and a sequence number.
const AR: usize = BLOCK + BLOCK_HEADER.len() + 2;
/// The index: behind AR, API, slot, subslot and padding.
const INDEX: usize = AR + 16 + 4 + 2 + 2 + 2;

/// Whether a fragment may end behind so many octets of the stub data. A device may put together
/// fragments of two requests with the same activity and sequence number, if the first one was
/// forgotten here. As all numbers are in the first fragment, and the index is in one, that makes
/// nothing that was not checked.
pub(super) fn may_end_behind(octets: usize) -> bool {
    octets >= BLOCK && octets != INDEX + 1
}

/// Checks the beginning of the stub data, or all of them, as far as they are there.
pub(super) fn check(stub: &[u8], order: ByteOrder, records: Records) -> Result<(), DropReason> {
    let numbers = [0, 4, 8, 12, 16].map(|at| number(stub, at, order));
    let [args_maximum, args_length, maximum_count, offset, actual_count] = numbers;
    let block = IodReadReqHeader::LEN as u32;
    let differs = |number: Option<u32>, from: u32| number.is_some_and(|number| number != from);
    let is_malformed = stub.len() > LEN
        || args_maximum.is_some_and(|maximum| maximum < block)
        || maximum_count.is_some() && maximum_count != args_maximum
        || differs(args_length, block)
        || differs(offset, 0)
        || differs(actual_count, block)
        || stub.iter().skip(BLOCK).zip(BLOCK_HEADER).any(|(octet, is)| *octet != is);
    if is_malformed {
        return Err(DropReason::BadNdr);
    }
    if stub.iter().skip(AR).take(16).any(|octet| *octet != 0) {
        return Err(DropReason::RpcRead);
    }
    let index = stub.get(INDEX..).and_then(|index| index.first_chunk());
    match index.map(|index| u16::from_be_bytes(*index)) {
        Some(index) if !records.include(index) => Err(DropReason::RecordNotAllowed),
        _ => Ok(()),
    }
}

/// A number of the header's byte order, if all of it is there.
fn number(stub: &[u8], at: usize, order: ByteOrder) -> Option<u32> {
    let octets = *stub.get(at..)?.first_chunk()?;
    Some(match order {
        ByteOrder::Big => u32::from_be_bytes(octets),
        ByteOrder::Little => u32::from_le_bytes(octets),
    })
}
