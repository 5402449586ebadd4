//! The discovery and configuration protocol (DCP): who is there, and its name and address (P-3).
//!
//! `block` has what the blocks say, `words` the names of numbers. Invariant: a block that is not known, or
//! whose manufacturer alone knows it, keeps its numbers and its octets.

mod block;
mod words;

use super::octets::{Malformed, Octets};

pub use block::{DcpBlock, DcpValue, IpParameter};
pub use words::{
    block_error_name, ip_block_info_name, option_name, reset_name, role_names, suboption_name,
};

/// A DCP frame.
#[derive(Clone, Copy, Debug)]
pub struct Dcp<'a> {
    /// What is wanted.
    pub service_id: ServiceId,
    /// Request or answer.
    pub service_type: ServiceType,
    /// A request's number, which its answer has too.
    pub xid: u32,
    /// Of an identify request: answers may take up to this many times 10 ms. In other frames it is 0.
    pub response_delay: u16,
    /// Octets of the blocks.
    pub data_length: u16,
    blocks: Octets<'a>,
}

/// What is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServiceId {
    /// Read.
    Get,
    /// Write.
    Set,
    /// Who is there?
    Identify,
    /// A device tells that it is there.
    Hello,
    /// Of a manufacturer, or not in use.
    Other(u8),
}

/// Request or answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServiceType {
    /// A request.
    Request,
    /// It was understood.
    Success,
    /// The receiver does not know such a request.
    NotSupported,
    /// Not in use.
    Other(u8),
}

impl<'a> Dcp<'a> {
    /// Octets of the header.
    pub const HEADER_LEN: usize = 10;

    /// Reads what is behind the frame ID. Padding behind the blocks is left out.
    pub fn parse(mut octets: Octets<'a>) -> Result<Self, Malformed> {
        let service_id = octets.u8()?.into();
        let service_type = octets.u8()?.into();
        let (xid, response_delay) = (octets.u32()?, octets.u16()?);
        let data_length = octets.u16()?;
        let blocks = octets.part(data_length.into())?;
        Ok(Self { service_id, service_type, xid, response_delay, data_length, blocks })
    }

    /// The blocks. After an error come no more.
    pub fn blocks(&self) -> DcpBlocks<'a> {
        let head = match (self.service_id, self.service_type) {
            (ServiceId::Get, ServiceType::Request) => BlockHead::NamesAlone,
            (ServiceId::Set, ServiceType::Request) => BlockHead::Qualifier,
            (ServiceId::Hello, _) | (_, ServiceType::Success) => BlockHead::Info,
            _ => BlockHead::None,
        };
        DcpBlocks { left: Some(self.blocks), head }
    }
}

/// What stands in a block in front of its contents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum BlockHead {
    /// Nothing: what a device is looked for by.
    None,
    /// How to set it.
    Qualifier,
    /// What has become of it.
    Info,
    /// There are no contents, not even a length: what is to be read.
    NamesAlone,
}

/// The blocks of a frame, one after the other.
#[derive(Clone, Debug)]
pub struct DcpBlocks<'a> {
    left: Option<Octets<'a>>,
    head: BlockHead,
}

impl<'a> Iterator for DcpBlocks<'a> {
    type Item = Result<DcpBlock<'a>, Malformed>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut octets = self.left.take().filter(|octets| !octets.is_empty())?;
        let block = DcpBlock::read(&mut octets, self.head);
        self.left = block.is_ok().then_some(octets);
        Some(block)
    }
}

impl From<u8> for ServiceId {
    fn from(number: u8) -> Self {
        match number {
            3 => Self::Get,
            4 => Self::Set,
            5 => Self::Identify,
            6 => Self::Hello,
            other => Self::Other(other),
        }
    }
}

impl ServiceId {
    /// The number in the frame.
    pub fn number(self) -> u8 {
        match self {
            Self::Get => 3,
            Self::Set => 4,
            Self::Identify => 5,
            Self::Hello => 6,
            Self::Other(number) => number,
        }
    }

    /// The service in a word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Get => "get",
            Self::Set => "set",
            Self::Identify => "identify",
            Self::Hello => "hello",
            Self::Other(1 | 2) => "manufacturer's service",
            Self::Other(_) => "reserved service",
        }
    }
}

impl From<u8> for ServiceType {
    fn from(number: u8) -> Self {
        match number {
            0 => Self::Request,
            1 => Self::Success,
            5 => Self::NotSupported,
            other => Self::Other(other),
        }
    }
}

impl ServiceType {
    /// The number in the frame.
    pub fn number(self) -> u8 {
        match self {
            Self::Request => 0,
            Self::Success => 1,
            Self::NotSupported => 5,
            Self::Other(number) => number,
        }
    }

    /// The type in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Request => "request",
            Self::Success => "response",
            Self::NotSupported => "response, not supported",
            Self::Other(_) => "reserved type",
        }
    }
}

#[cfg(test)]
mod tests;
