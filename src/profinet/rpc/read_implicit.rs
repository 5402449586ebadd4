//! Read Implicit: one record of a device that nobody is connected to (P-4, operation 5).
//!
//! Stub data are five numbers (P-5) and one IODReadReqHeader. It changes nothing at the device.

use super::super::blocks::IodReadReqHeader;
use super::super::view::Skip;
use super::super::writer::Writer;
use super::super::{BufferTooSmall, ByteOrder, Malformed, Uuid, ndr};
use super::{Body, Header, Interface, PacketType, Rpc};

/// A request for one record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadImplicit {
    /// The byte order of the header; the block is always big-endian.
    pub order: ByteOrder,
    /// The node that is asked: an [`ObjectUuid`](super::super::ObjectUuid).
    pub object: Uuid,
    /// The conversation, which a client makes up.
    pub activity: Uuid,
    /// Which call of the activity this is, from 0.
    pub sequence: u32,
    /// The application process that the slot belongs to.
    pub api: u32,
    /// The slot.
    pub slot: u16,
    /// The subslot.
    pub subslot: u16,
    /// The record: see [`records`](super::super::records).
    pub index: u16,
    /// The most octets of the record that are wanted.
    pub record_length: u32,
    /// The AR whose data are asked for; nil for most records.
    pub target_ar: Uuid,
}

impl ReadImplicit {
    /// The operation's number.
    pub const OPERATION: u16 = 5;
    /// Octets of a request.
    pub const LEN: usize = Header::LEN + ndr::Request::HEADER_LEN + Self::BLOCK;
    /// Octets of the block.
    const BLOCK: usize = IodReadReqHeader::LEN;

    /// Octets that the answer may have: a header like the request's, and the record.
    pub fn args_maximum(&self) -> u32 {
        self.record_length.saturating_add(Self::BLOCK as u32)
    }

    /// Writes the request and returns the number of its octets, [`Self::LEN`].
    pub fn emit(&self, buffer: &mut [u8]) -> Result<usize, BufferTooSmall> {
        let mut stub = [0; Self::LEN - Header::LEN];
        let mut numbers = Writer::new(&mut stub, self.order);
        let length = Self::BLOCK as u32;
        for number in [self.args_maximum(), length, self.args_maximum(), 0, length] {
            numbers.u32(number);
        }
        let block = IodReadReqHeader {
            sequence: self.sequence as u16,
            ar_uuid: Uuid::NIL,
            api: self.api,
            slot: self.slot,
            subslot: self.subslot,
            padding: Skip,
            index: self.index,
            record_data_length: self.record_length,
            target_ar_uuid: self.target_ar,
        };
        numbers.octets(&block.to_octets());
        numbers.finish()?;
        let mut header = Header::request(self.order, Interface::Device.uuid(), Self::OPERATION);
        header.object = self.object;
        header.activity = self.activity;
        header.sequence = self.sequence;
        header.emit(&stub, buffer)
    }

    /// The request in a datagram; none if it is another one.
    pub fn parse(rpc: &Rpc<'_>) -> Result<Option<Self>, Malformed> {
        let header = rpc.header();
        let is_read = header.packet_type == PacketType::Request
            && header.interface == Interface::Device.uuid()
            && header.operation == Self::OPERATION
            && !header.flags1.is_fragment();
        let Body::Stub(stub) = rpc.body() else { return Ok(None) };
        if !is_read {
            return Ok(None);
        }
        let mut args = ndr::Request::read(stub)?.args;
        let block = IodReadReqHeader::parse(&mut args)?;
        Ok(Some(Self {
            order: header.representation.order,
            object: header.object,
            activity: header.activity,
            sequence: header.sequence,
            api: block.api,
            slot: block.slot,
            subslot: block.subslot,
            index: block.index,
            record_length: block.record_data_length,
            target_ar: block.target_ar_uuid,
        }))
    }
}
