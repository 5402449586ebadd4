//! What stands before the blocks of a PROFINET call: NDR's view of an array (P-5).
//!
//! A request begins with how much the answer may have, a response with its status; then both have the
//! array's length twice. [`Request::read`] and [`Response::read`] check all of it against the octets that
//! are there. Calls to the endpoint mapper look different.

use super::{Malformed, Octets, PnioStatus};

/// The stub data of a request: five numbers, then blocks.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// Octets that the answer may have, and the maximum count of the array.
    pub args_maximum: u32,
    /// The blocks.
    pub args: Octets<'a>,
}

/// The stub data of a response: status and four numbers, then blocks.
#[derive(Clone, Copy, Debug)]
pub struct Response<'a> {
    /// Whether the call succeeded.
    pub status: PnioStatus,
    /// Octets that the answer could have had: the maximum count of the array.
    pub maximum_count: u32,
    /// The blocks.
    pub args: Octets<'a>,
}

impl<'a> Request<'a> {
    /// Octets before the blocks.
    pub const HEADER_LEN: usize = 20;

    /// Reads whole stub data in the byte order of the header.
    pub fn read(mut stub: Octets<'a>) -> Result<Self, Malformed> {
        let args_maximum = stub.u32()?;
        let args_length = stub.u32()?;
        let differs = stub.wrong("the maximum count is not the arguments' maximum");
        let (maximum_count, args) = array(&mut stub, args_length)?;
        if maximum_count != args_maximum {
            return Err(differs);
        }
        Ok(Self { args_maximum, args })
    }
}

impl<'a> Response<'a> {
    /// Reads whole stub data in the byte order of the header.
    pub fn read(mut stub: Octets<'a>) -> Result<Self, Malformed> {
        let status = PnioStatus::from(stub.u32()?);
        let args_length = stub.u32()?;
        let (maximum_count, args) = array(&mut stub, args_length)?;
        Ok(Self { status, maximum_count, args })
    }
}

/// Reads maximum count, offset, actual count and as many octets, which are all that is left.
fn array<'a>(stub: &mut Octets<'a>, args_length: u32) -> Result<(u32, Octets<'a>), Malformed> {
    let too_long = stub.wrong("the array is longer than its maximum count");
    let maximum_count = stub.u32()?;
    let not_from_0 = stub.wrong("the array does not begin at offset 0");
    if stub.u32()? != 0 {
        return Err(not_from_0);
    }
    let differs = stub.wrong("the actual count is not the arguments' length");
    let actual_count = stub.u32()?;
    if actual_count != args_length {
        return Err(differs);
    }
    if actual_count > maximum_count {
        return Err(too_long);
    }
    let args = stub.part(usize::try_from(actual_count).unwrap_or(usize::MAX))?;
    if !stub.is_empty() {
        return Err(stub.wrong("octets behind the array"));
    }
    // Blocks are big-endian, whatever the header's byte order is.
    Ok((maximum_count, args.in_order(super::ByteOrder::Big)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profinet::ByteOrder;

    fn stub(numbers: [u32; 5], blocks: &[u8], order: ByteOrder) -> Vec<u8> {
        let to_octets = |number: u32| match order {
            ByteOrder::Big => number.to_be_bytes(),
            ByteOrder::Little => number.to_le_bytes(),
        };
        [&numbers.map(to_octets).concat(), blocks].concat()
    }

    #[test]
    fn p_5_a_request_has_five_numbers_that_agree() {
        for order in [ByteOrder::Big, ByteOrder::Little] {
            let octets = stub([16, 3, 16, 0, 3], &[7, 8, 9], order);
            let request = Request::read(Octets::new(&octets).in_order(order)).unwrap();
            assert_eq!((request.args_maximum, request.args.rest()), (16, &[7, 8, 9][..]));
            assert_eq!((request.args.order(), request.args.offset()), (ByteOrder::Big, 20));
        }
    }

    #[test]
    fn p_5_a_response_begins_with_its_status() {
        for order in [ByteOrder::Big, ByteOrder::Little] {
            let octets = stub([0xDE80_B000, 3, 16, 0, 3], &[7, 8, 9], order);
            let response = Response::read(Octets::new(&octets).in_order(order)).unwrap();
            assert_eq!(
                response.status,
                PnioStatus { code: 0xDE, decode: 0x80, code1: 0xB0, code2: 0 }
            );
            assert_eq!((response.maximum_count, response.args.rest()), (16, &[7, 8, 9][..]));
        }
    }

    #[test]
    fn p_5_numbers_that_contradict_each_other_are_told_apart() {
        for (numbers, offset, what) in [
            ([16, 3, 15, 0, 3], 8, "the maximum count is not the arguments' maximum"),
            ([16, 3, 16, 1, 3], 12, "the array does not begin at offset 0"),
            ([16, 3, 16, 0, 2], 16, "the actual count is not the arguments' length"),
            ([2, 3, 2, 0, 3], 8, "the array is longer than its maximum count"),
            ([16, 4, 16, 0, 4], 23, "the octets end too early"),
            ([16, 2, 16, 0, 2], 22, "octets behind the array"),
            ([u32::MAX, u32::MAX, u32::MAX, 0, u32::MAX], 23, "the octets end too early"),
        ] {
            let octets = stub(numbers, &[7, 8, 9], ByteOrder::Big);
            let error = Request::read(Octets::new(&octets)).unwrap_err();
            assert_eq!(error, Malformed { offset, what }, "{numbers:?}");
        }
    }
}
