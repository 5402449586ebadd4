//! A request, cut into pieces that fit (MaxDataSize, PAS 6.1.1.2.1.5).
//!
//! The standard says that a request is cut, and not how. So only those with flat addressing are, for a
//! piece of a memory area is a request of its own. Its form is that of
//! [`Memory`](crate::pnet::endpoint::Memory): the offset in two octets, the upper one first, then the
//! data to be written, or one octet with the number of octets to be read.

use super::{Loss, RequestError};
use crate::pnet::endpoint::Data;
use crate::pnet::wire::MAX_DATA;

/// Octets of the offset in front of a piece.
const OFFSET: usize = 2;
/// Octets of a request to read a piece.
const READ: usize = OFFSET + 1;
/// Octets that offsets reach.
const MEMORY: usize = 1 << 16;

/// The codes for a memory area (PAS 6.1.1.1.1.10). The standard does not give them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FlatAddressing {
    /// Control-status of requests that read.
    pub read: Option<u8>,
    /// Control-status of requests that write.
    pub write: Option<u8>,
}

/// What a client asks for.
#[derive(Clone, Copy, Debug)]
pub enum Request<'a> {
    /// Data that say by themselves what they are for. They are not cut.
    Data {
        /// The control-status.
        control_status: u8,
        /// The data, at most 63 octets.
        data_octets: &'a [u8],
    },
    /// Some octets of a memory area, with flat addressing.
    Read {
        /// Where they begin.
        offset: u16,
        /// How many.
        size: u16,
    },
    /// To write into a memory area, with flat addressing.
    Write {
        /// Where to begin.
        offset: u16,
        /// What to write.
        data_octets: &'a [u8],
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Data,
    Read,
    Write,
}

/// The pieces of one request.
#[derive(Clone, Debug)]
pub(super) struct Segments {
    kind: Kind,
    pub(super) control_status: u8,
    offset: u16,
    /// What is sent; of a request to read, nothing.
    sent: Vec<u8>,
    /// Octets that are read or written.
    size: usize,
    /// Octets of them in a piece, but for the last one.
    piece: usize,
    pub(super) delivered: u32,
    pub(super) total: u32,
    /// What came. There is room for all of it.
    pub(super) received: Vec<u8>,
}

impl Segments {
    /// Cuts a request into pieces of at most `max_data_size` octets.
    pub(super) fn new(
        request: &Request<'_>,
        flat: Option<FlatAddressing>,
        max_data_size: usize,
    ) -> Result<Self, RequestError> {
        let most = max_data_size.min(MAX_DATA);
        let codes = flat.unwrap_or_default();
        let (kind, control_status, offset, sent, size, piece) = match *request {
            Request::Data { control_status, data_octets } => {
                if data_octets.len() > most {
                    return Err(RequestError::TooMuchData { octets: data_octets.len(), most });
                }
                (Kind::Data, control_status, 0, data_octets, data_octets.len(), MAX_DATA)
            }
            Request::Read { offset, size } => {
                let code = codes.read.ok_or(RequestError::NotFlat)?;
                let piece = if most < READ { 0 } else { most };
                (Kind::Read, code, offset, &[][..], size.into(), piece)
            }
            Request::Write { offset, data_octets } => {
                let code = codes.write.ok_or(RequestError::NotFlat)?;
                let piece = most.saturating_sub(OFFSET);
                (Kind::Write, code, offset, data_octets, data_octets.len(), piece)
            }
        };
        if piece == 0 {
            return Err(RequestError::NoRoomForPieces { most });
        }
        if usize::from(offset) + size > MEMORY {
            return Err(RequestError::BeyondMemory);
        }
        let total = size.div_ceil(piece).max(1) as u32; // at most 65536
        let received = Vec::with_capacity(size.max(MAX_DATA));
        let sent = sent.to_vec();
        Ok(Self { kind, control_status, offset, sent, size, piece, delivered: 0, total, received })
    }

    /// Whether it makes no sense without a response.
    pub(super) fn reads(&self) -> bool {
        self.kind == Kind::Read
    }

    pub(super) fn is_complete(&self) -> bool {
        self.delivered == self.total
    }

    /// The data of the piece that is to be delivered next.
    pub(super) fn data(&self) -> Data {
        let (begin, length) = self.current();
        let offset = (usize::from(self.offset) + begin) as u16; // within the memory, see `new`
        let mut data = Data::new();
        match self.kind {
            Kind::Data => data.extend(self.sent.iter().copied()),
            Kind::Read => {
                data.extend(offset.to_be_bytes());
                data.push(length as u8); // at most 63
            }
            Kind::Write => {
                data.extend(offset.to_be_bytes());
                data.extend(self.sent[begin..begin + length].iter().copied());
            }
        }
        data
    }

    /// Takes what came for that piece, at most 63 octets. A memory area says nothing of an error, so
    /// whatever is not of the expected form counts as one.
    pub(super) fn take(&mut self, control_status: u8, data_octets: &[u8]) -> Result<(), Loss> {
        if self.kind != Kind::Data {
            if control_status != self.control_status {
                return Err(Loss::Refused { control_status });
            }
            let expected = if self.reads() { self.current().1 } else { 0 };
            if data_octets.len() != expected {
                return Err(Loss::WrongSize { expected, came: data_octets.len() });
            }
        }
        self.received.extend_from_slice(data_octets);
        self.delivered += 1;
        Ok(())
    }

    /// Notes that the piece was sent, where there is no response to wait for.
    pub(super) fn sent(&mut self) {
        self.delivered += 1;
    }

    /// Where the piece begins, counted from the offset, and its length.
    fn current(&self) -> (usize, usize) {
        let begin = self.piece * self.delivered as usize;
        (begin, self.piece.min(self.size.saturating_sub(begin)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLAT: Option<FlatAddressing> = Some(FlatAddressing { read: Some(1), write: Some(2) });

    #[test]
    fn r44_a_memory_is_written_in_pieces() {
        let data_octets: Vec<u8> = (0..130).collect();
        let request = Request::Write { offset: 0x1FF, data_octets: &data_octets };
        let mut segments = Segments::new(&request, FLAT, 63).unwrap();
        let mut written = Vec::new();
        for (offset, length) in [(0x1FF, 61), (0x1FF + 61, 61), (0x1FF + 122, 8_usize)] {
            let data = segments.data();
            let (at, piece) = data.split_first_chunk().unwrap();
            assert_eq!((u16::from_be_bytes(*at), piece.len()), (offset, length));
            written.extend_from_slice(piece);
            assert!(!segments.is_complete());
            segments.take(2, &[]).unwrap();
        }
        assert_eq!(written, data_octets);
        assert!(segments.is_complete());
    }

    #[test]
    fn r44_a_memory_is_read_in_pieces() {
        let mut segments = Segments::new(&Request::Read { offset: 5, size: 25 }, FLAT, 10).unwrap();
        for (asked, came) in [([0, 5, 10], 10), ([0, 15, 10], 10), ([0, 25, 5], 5_u8)] {
            assert_eq!(segments.data()[..], asked);
            segments.take(1, &vec![came; came.into()]).unwrap();
        }
        assert!(segments.is_complete());
        assert_eq!(segments.received, [&[10; 20][..], &[5; 5]].concat());
    }

    #[test]
    fn what_is_empty_is_one_piece() {
        for request in [
            Request::Data { control_status: 7, data_octets: &[] },
            Request::Read { offset: 0, size: 0 },
            Request::Write { offset: u16::MAX, data_octets: &[] },
        ] {
            assert_eq!(Segments::new(&request, FLAT, 63).unwrap().total, 1);
        }
    }

    #[test]
    fn an_error_of_a_memory_is_no_data() {
        let mut segments = Segments::new(&Request::Read { offset: 0, size: 9 }, FLAT, 63).unwrap();
        assert_eq!(segments.take(0x81, &[0; 9]), Err(Loss::Refused { control_status: 0x81 }));
        assert_eq!(segments.take(1, &[0; 8]), Err(Loss::WrongSize { expected: 9, came: 8 }));
        assert!(!segments.is_complete() && segments.received.is_empty());
    }

    #[test]
    fn what_cannot_be_cut_is_refused() {
        let data = |octets| Request::Data { control_status: 0, data_octets: octets };
        let too_much = RequestError::TooMuchData { octets: 11, most: 10 };
        assert_eq!(Segments::new(&data(&[0; 11]), FLAT, 10).unwrap_err(), too_much);
        let read = Request::Read { offset: 0, size: 1 };
        let write = Request::Write { offset: 0, data_octets: &[1] };
        assert_eq!(Segments::new(&read, None, 63).unwrap_err(), RequestError::NotFlat);
        let reads_alone = Some(FlatAddressing { read: Some(1), write: None });
        assert_eq!(Segments::new(&write, reads_alone, 63).unwrap_err(), RequestError::NotFlat);
        for request in [read, write] {
            let refused = Segments::new(&request, FLAT, 2).unwrap_err();
            assert_eq!(refused, RequestError::NoRoomForPieces { most: 2 });
            Segments::new(&request, FLAT, 3).unwrap();
        }
        for request in [
            Request::Read { offset: u16::MAX, size: 2 },
            Request::Write { offset: u16::MAX, data_octets: &[1, 2] },
        ] {
            assert_eq!(Segments::new(&request, FLAT, 63).unwrap_err(), RequestError::BeyondMemory);
        }
    }
}
