//! DCE/RPC over UDP without connection, as PROFINET uses it (P-4, C706 chapter 12): one datagram.
//!
//! [`Header`] is the 80 octets, [`Body`] what a packet type has behind them. [`Rpc::parse`] accepts a
//! datagram as a whole or not at all. What the stub data of a request or a response mean is in
//! [`ndr`](super::ndr), [`blocks`](super::blocks) and [`endpoint_mapper`](super::endpoint_mapper);
//! [`ReadImplicit`] is one request that needs no connection.

mod body;
mod header;
mod interface;
mod read_implicit;
mod show;
#[cfg(test)]
mod tests;

pub use body::{Body, CancelAck, Fack, Quit};
pub use header::{Flags1, Flags2, Header, PacketType, Representation};
pub use interface::{Interface, operation_name};
pub use read_implicit::ReadImplicit;

use super::writer::Writer;
use super::{BufferTooSmall, Malformed, Octets};

/// The UDP port at which every node listens for requests (P-4).
pub const PORT: u16 = 34964;
/// The UDP port of cyclic data over UDP (RT_CLASS_UDP), and of some stacks' RPC.
pub const RT_UDP_PORT: u16 = 34962;
/// The most octets of a datagram that fits an Ethernet frame without fragments of IP (P-8).
pub const MAX_DATAGRAM: usize = 1472;

/// A datagram of DCE/RPC: a view of checked octets.
#[derive(Clone, Copy, Debug)]
pub struct Rpc<'a> {
    header: Header,
    octets: &'a [u8],
    body: Body<'a>,
}

impl<'a> Rpc<'a> {
    /// Checks a whole datagram. It refuses another version than 4, an unknown packet type, a data
    /// representation that is reserved, a body that is not as long as the header says or that does not fit
    /// its packet type, and a fragment number of a call that is in one piece.
    pub fn parse(octets: &'a [u8]) -> Result<Self, Malformed> {
        let mut rest = Octets::new(octets);
        let (header, body_len) = Header::read(&mut rest)?;
        let body = rest.part(usize::from(body_len))?;
        if !rest.is_empty() {
            return Err(rest.wrong("octets behind the body"));
        }
        Self::of(header, body)
    }

    /// Checks a header that was read, and the whole body behind it.
    pub fn of(header: Header, body: Octets<'a>) -> Result<Self, Malformed> {
        header.check_fragment()?;
        Ok(Self { header, octets: body.rest(), body: Body::read(header.packet_type, body)? })
    }

    /// The fields of the header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// What comes behind the header.
    pub fn body(&self) -> Body<'a> {
        self.body
    }

    /// Writes the datagram and returns the number of its octets. They are the ones that were parsed.
    pub fn emit(&self, buffer: &mut [u8]) -> Result<usize, BufferTooSmall> {
        self.header.emit(self.octets, buffer)
    }
}

impl Header {
    /// Writes a datagram with this header and `body`, of which a datagram has at most 65,427 octets.
    pub fn emit(&self, body: &[u8], buffer: &mut [u8]) -> Result<usize, BufferTooSmall> {
        let body_len = u16::try_from(body.len()).map_err(|_| BufferTooSmall(usize::MAX))?;
        let mut writer = Writer::new(buffer, self.representation.order);
        self.write(body_len, &mut writer);
        writer.octets(body);
        writer.finish()
    }
}
