//! What comes behind the header, by packet type (C706 12.5.3).

use super::super::{Malformed, Octets, status};
use super::PacketType;

/// What a datagram has behind its header.
#[derive(Clone, Copy, Debug)]
pub enum Body<'a> {
    /// Of a request or a response: stub data, or a fragment of them.
    Stub(Octets<'a>),
    /// Of a ping, a working or an ack: nothing.
    Empty,
    /// Of a fack or a nocall: which fragments have come, if it says so.
    Fack(Option<Fack<'a>>),
    /// Of a fault or a reject: why, see [`status::nca_words`].
    Status(u32),
    /// Of a cl_cancel.
    Quit(Quit),
    /// Of a cancel_ack, if it says more.
    CancelAck(Option<CancelAck>),
}

/// Which fragments have come, and how many the receiver takes (P-8).
#[derive(Clone, Copy, Debug)]
pub struct Fack<'a> {
    /// The version of this body: 0 or 1.
    pub version: u8,
    /// How much the receiver takes before it answers again, in the unit of its version.
    pub window_size: u16,
    /// The largest datagram that the receiver can take from below.
    pub max_tsdu: u32,
    /// The largest datagram that the receiver takes without fragments of IP.
    pub max_fragment_size: u32,
    /// The serial number of the datagram that is answered.
    pub serial: u16,
    masks: Octets<'a>,
}

/// A client gives its call up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quit {
    /// The version of this body: 0.
    pub version: u32,
    /// Which cancel of the call this is.
    pub cancel_id: u32,
}

/// The server has seen a cancel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CancelAck {
    /// The version of this body: 0.
    pub version: u32,
    /// The cancel that is answered.
    pub cancel_id: u32,
    /// Whether the call can still be cancelled.
    pub is_accepting: bool,
}

impl<'a> Body<'a> {
    pub(super) fn read(packet_type: PacketType, mut octets: Octets<'a>) -> Result<Self, Malformed> {
        let is_empty = octets.is_empty();
        let body = match packet_type {
            PacketType::Request | PacketType::Response => return Ok(Self::Stub(octets)),
            PacketType::Ping | PacketType::Working | PacketType::Ack => Self::Empty,
            PacketType::Fack | PacketType::Nocall if is_empty => Self::Fack(None),
            PacketType::Fack | PacketType::Nocall => Self::Fack(Some(Fack::read(&mut octets)?)),
            PacketType::Fault | PacketType::Reject => Self::Status(octets.u32()?),
            PacketType::ClCancel => {
                Self::Quit(Quit { version: octets.u32()?, cancel_id: octets.u32()? })
            }
            PacketType::CancelAck if is_empty => Self::CancelAck(None),
            PacketType::CancelAck => Self::CancelAck(Some(CancelAck {
                version: octets.u32()?,
                cancel_id: octets.u32()?,
                is_accepting: octets.u32()? != 0,
            })),
        };
        if octets.is_empty() {
            Ok(body)
        } else {
            Err(octets.wrong("more octets than this packet type has"))
        }
    }

    /// Why a call failed or was not begun, in words.
    pub fn status_words(&self) -> Option<&'static str> {
        match self {
            Self::Status(code) => status::nca_words(*code),
            _ => None,
        }
    }
}

impl<'a> Fack<'a> {
    /// Octets without masks.
    pub const MIN_LEN: usize = 16;

    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        let version = octets.u8()?;
        octets.take(1)?;
        let window_size = octets.u16()?;
        let (max_tsdu, max_fragment_size) = (octets.u32()?, octets.u32()?);
        let serial = octets.u16()?;
        let masks = usize::from(octets.u16()?);
        let masks = octets.part(4 * masks)?;
        Ok(Self { version, window_size, max_tsdu, max_fragment_size, serial, masks })
    }

    /// Behind the first gap: bit 0 of the first mask is the fragment after the next one.
    pub fn masks(&self) -> impl Iterator<Item = u32> + use<'a> {
        let mut masks = self.masks;
        std::iter::from_fn(move || masks.u32().ok())
    }
}
