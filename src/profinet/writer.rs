//! Writes octets from front to back, in either byte order, into a buffer that may be too small.

use super::{ByteOrder, Uuid};

/// The buffer was smaller than what should be written: how many octets are needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a buffer of {0} octets is needed")]
pub struct BufferTooSmall(pub usize);

/// What has been written. Octets that do not fit are counted only.
pub(super) struct Writer<'a> {
    buffer: &'a mut [u8],
    len: usize,
    order: ByteOrder,
}

impl<'a> Writer<'a> {
    pub(super) fn new(buffer: &'a mut [u8], order: ByteOrder) -> Self {
        Self { buffer, len: 0, order }
    }

    pub(super) fn octets(&mut self, octets: &[u8]) {
        let end = self.len + octets.len();
        if let Some(place) = self.buffer.get_mut(self.len..end) {
            place.copy_from_slice(octets);
        }
        self.len = end;
    }

    pub(super) fn u16(&mut self, number: u16) {
        self.octets(&match self.order {
            ByteOrder::Big => number.to_be_bytes(),
            ByteOrder::Little => number.to_le_bytes(),
        });
    }

    pub(super) fn u32(&mut self, number: u32) {
        self.octets(&match self.order {
            ByteOrder::Big => number.to_be_bytes(),
            ByteOrder::Little => number.to_le_bytes(),
        });
    }

    pub(super) fn uuid(&mut self, uuid: Uuid) {
        self.octets(&uuid.on_wire(self.order));
    }

    /// The number of octets that were written.
    pub(super) fn finish(self) -> Result<usize, BufferTooSmall> {
        if self.len > self.buffer.len() { Err(BufferTooSmall(self.len)) } else { Ok(self.len) }
    }
}
