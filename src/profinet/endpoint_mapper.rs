//! The endpoint mapper: what a node offers, and at which port (P-4, C706 appendices L and O).
//!
//! [`Lookup`] asks for one entry after the other, [`LookupAnswer`] has them, [`HandleFree`] ends before
//! the last one. A mapper may look at sequence numbers: a look-up begins at 0 and counts up. Octets of
//! towers are little-endian, whatever the header's byte order is.

mod answer;
#[cfg(test)]
mod tests;
mod tower;

pub use answer::{Entry, LookupAnswer};
pub use tower::{Floor, Floors, Tower};

use super::rpc::{Body, Header, Interface, PacketType, Rpc};
use super::view::{Show, Value};
use super::writer::Writer;
use super::{BufferTooSmall, ByteOrder, Malformed, Octets, Uuid};

/// The operation that asks for entries.
pub const LOOKUP: u16 = 2;
/// The operation that gives a handle back.
pub const HANDLE_FREE: u16 = 4;

/// Where a look-up stands; nil at the beginning, and again after the last entry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Handle {
    /// Reserved.
    pub attributes: u32,
    /// The mapper's name for the look-up.
    pub uuid: Uuid,
}

/// An interface and its version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InterfaceId {
    /// The interface.
    pub uuid: Uuid,
    /// The major version.
    pub major: u16,
    /// The minor version.
    pub minor: u16,
}

/// ept_lookup, the request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lookup {
    /// 0: all entries, 1: those of the interface, 2: those of the object, 3: those of both.
    pub inquiry_type: u32,
    /// The object.
    pub object: Option<Uuid>,
    /// The interface.
    pub interface: Option<InterfaceId>,
    /// 1: all versions, 2: compatible, 3: exact, 4: major, 5: up to this one.
    pub version_option: u32,
    /// Where the look-up stands.
    pub handle: Handle,
    /// How many entries are wanted, at most 500.
    pub max_entries: u32,
}

impl Lookup {
    /// The most octets of a request.
    pub const MAX_LEN: usize = Header::LEN + 76;

    /// Asks for the next one of all entries.
    pub fn next_of_all(handle: Handle) -> Self {
        let (object, interface) = (None, None);
        Self { inquiry_type: 0, object, interface, version_option: 1, handle, max_entries: 1 }
    }

    /// Reads whole stub data in the byte order of the header.
    pub fn read(mut stub: Octets<'_>) -> Result<Self, Malformed> {
        let inquiry_type = stub.u32()?;
        let object = if stub.u32()? == 0 { None } else { Some(Uuid::read(&mut stub)?) };
        let interface = if stub.u32()? == 0 { None } else { Some(InterfaceId::read(&mut stub)?) };
        let version_option = stub.u32()?;
        let handle = Handle::read(&mut stub)?;
        let max_entries = stub.u32()?;
        end(stub)?;
        Ok(Self { inquiry_type, object, interface, version_option, handle, max_entries })
    }

    /// Writes the request as a call of this activity. Returns the number of its octets.
    pub fn emit(
        &self,
        order: ByteOrder,
        activity: Uuid,
        sequence: u32,
        buffer: &mut [u8],
    ) -> Result<usize, BufferTooSmall> {
        let mut stub = [0; Self::MAX_LEN - Header::LEN];
        let mut writer = Writer::new(&mut stub, order);
        writer.u32(self.inquiry_type);
        // A pointer is any number but 0; what it points to follows.
        writer.u32(self.object.map_or(0, |_| 1));
        if let Some(object) = self.object {
            writer.uuid(object);
        }
        writer.u32(self.interface.map_or(0, |_| 2));
        if let Some(InterfaceId { uuid, major, minor }) = self.interface {
            writer.uuid(uuid);
            writer.u16(major);
            writer.u16(minor);
        }
        writer.u32(self.version_option);
        self.handle.write(&mut writer);
        writer.u32(self.max_entries);
        let len = writer.finish()?;
        call(order, LOOKUP, activity, sequence).emit(&stub[..len], buffer)
    }
}

/// ept_lookup_handle_free, request and answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HandleFree {
    /// The handle that is given back; nil in the answer.
    pub handle: Handle,
}

impl HandleFree {
    /// Octets of a request.
    pub const LEN: usize = Header::LEN + Handle::LEN;

    /// Reads the whole stub data of a request.
    pub fn read(mut stub: Octets<'_>) -> Result<Self, Malformed> {
        let handle = Handle::read(&mut stub)?;
        end(stub)?;
        Ok(Self { handle })
    }

    /// Reads the whole stub data of an answer, and its status; 0: it succeeded.
    pub fn read_answer(mut stub: Octets<'_>) -> Result<(Self, u32), Malformed> {
        let (handle, status) = (Handle::read(&mut stub)?, stub.u32()?);
        end(stub)?;
        Ok((Self { handle }, status))
    }

    /// Writes the request as a call of this activity. Returns the number of its octets.
    pub fn emit(
        &self,
        order: ByteOrder,
        activity: Uuid,
        sequence: u32,
        buffer: &mut [u8],
    ) -> Result<usize, BufferTooSmall> {
        let mut stub = [0; Handle::LEN];
        let mut writer = Writer::new(&mut stub, order);
        self.handle.write(&mut writer);
        writer.finish()?;
        call(order, HANDLE_FREE, activity, sequence).emit(&stub, buffer)
    }
}

fn call(order: ByteOrder, operation: u16, activity: Uuid, sequence: u32) -> Header {
    let interface = Interface::EndpointMapper;
    Header {
        activity,
        sequence,
        interface_version: interface.version(),
        ..Header::request(order, interface.uuid(), operation)
    }
}

fn end(stub: Octets<'_>) -> Result<(), Malformed> {
    if stub.is_empty() { Ok(()) } else { Err(stub.wrong("octets behind the arguments")) }
}

impl Handle {
    const LEN: usize = 20;

    fn read(octets: &mut Octets<'_>) -> Result<Self, Malformed> {
        Ok(Self { attributes: octets.u32()?, uuid: Uuid::read(octets)? })
    }

    fn write(self, writer: &mut Writer<'_>) {
        writer.u32(self.attributes);
        writer.uuid(self.uuid);
    }
}

impl InterfaceId {
    fn read(octets: &mut Octets<'_>) -> Result<Self, Malformed> {
        Ok(Self { uuid: Uuid::read(octets)?, major: octets.u16()?, minor: octets.u16()? })
    }
}

/// A call to the endpoint mapper, or its answer.
#[derive(Clone, Copy, Debug)]
pub enum Message<'a> {
    /// ept_lookup, the request.
    Lookup(Lookup),
    /// ept_lookup, the answer.
    LookupAnswer(LookupAnswer<'a>),
    /// ept_lookup_handle_free, the request.
    HandleFree(HandleFree),
    /// ept_lookup_handle_free, the answer and its status.
    HandleFreeAnswer(HandleFree, u32),
}

impl<'a> Message<'a> {
    /// Reads the stub data of a whole call; none if it is for somebody else or another operation.
    pub fn of(rpc: &Rpc<'a>) -> Result<Option<Self>, Malformed> {
        let (header, body) = (rpc.header(), rpc.body());
        let Body::Stub(stub) = body else { return Ok(None) };
        Self::read(header, stub)
    }

    /// The same, of stub data that may have come in fragments.
    pub fn read(header: &Header, stub: Octets<'a>) -> Result<Option<Self>, Malformed> {
        if Interface::of(header.interface) != Some(Interface::EndpointMapper) {
            return Ok(None);
        }
        Ok(Some(match (header.packet_type, header.operation) {
            (PacketType::Request, LOOKUP) => Self::Lookup(Lookup::read(stub)?),
            (PacketType::Response, LOOKUP) => Self::LookupAnswer(LookupAnswer::read(stub)?),
            (PacketType::Request, HANDLE_FREE) => Self::HandleFree(HandleFree::read(stub)?),
            (PacketType::Response, HANDLE_FREE) => {
                let (answer, status) = HandleFree::read_answer(stub)?;
                Self::HandleFreeAnswer(answer, status)
            }
            _ => return Ok(None),
        }))
    }
}

impl Show for Message<'_> {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        match self {
            Self::Lookup(lookup) => lookup.show(visit),
            Self::LookupAnswer(answer) => answer.show(visit),
            Self::HandleFree(free) => visit("handle", Value::Display(&free.handle.uuid)),
            Self::HandleFreeAnswer(free, status) => {
                visit("handle", Value::Display(&free.handle.uuid));
                visit("mapper_status", Value::Number((*status).into()));
            }
        }
    }
}

impl Show for Lookup {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        visit("inquiry_type", Value::Number(self.inquiry_type.into()));
        if let Some(object) = &self.object {
            visit("inquiry_object", Value::Display(object));
        }
        if let Some(InterfaceId { uuid, major, minor }) = &self.interface {
            visit("inquiry_interface", Value::Display(uuid));
            visit("inquiry_version", Value::Display(&format_args!("{major}.{minor}")));
        }
        visit("version_option", Value::Number(self.version_option.into()));
        visit("handle", Value::Display(&self.handle.uuid));
        visit("max_entries", Value::Number(self.max_entries.into()));
    }
}
