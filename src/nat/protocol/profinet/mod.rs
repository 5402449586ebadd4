//! PROFINET: what the octets of a remote procedure call say, and which calls may pass.
//!
//! Only reading passes: Read Implicit of listed records, and look-ups at the endpoint mapper. All
//! else is refused, each kind for a reason of its own. A request is checked whole, since malformed
//! ones have hung devices.

mod exchanges;
mod read;
mod records;
#[cfg(test)]
mod tests;

use crate::profinet::endpoint_mapper::{self, Message};
use crate::profinet::rpc::{Body, Header, Interface, MAX_DATAGRAM, PacketType, ReadImplicit, Rpc};
use crate::profinet::{ByteOrder, ObjectUuid, Octets, ndr};

use crate::nat::reason::DropReason;
use crate::nat::time::Nanos;

use exchanges::Call;
pub(in crate::nat) use exchanges::Exchanges;
pub use records::{NoSuchRecord, Record, Records};

/// A well-formed request, or what else a client sends.
#[derive(Clone, Copy, Debug)]
pub(in crate::nat) struct Request<'a> {
    call: Call,
    operation: u16,
    part: Part<'a>,
    records: Records,
    is_maybe: bool,
}

/// Which part of a call it is.
#[derive(Clone, Copy, Debug)]
enum Part<'a> {
    /// The whole request.
    Whole,
    /// A piece of the request.
    Fragment(Fragment<'a>),
    /// A ping, an ack, a fack or a cancel.
    Signal,
}

/// A fragment of a Read Implicit.
#[derive(Clone, Copy, Debug)]
struct Fragment<'a> {
    number: u16,
    is_last: bool,
    stub: &'a [u8],
    order: ByteOrder,
}

impl<'a> Request<'a> {
    /// Checks what a client sends (P-4 to P-7), as far as that needs nothing else.
    pub(in crate::nat) fn parse(octets: &'a [u8], records: Records) -> Result<Self, DropReason> {
        let rpc = parse(octets)?;
        let header = rpc.header();
        if header.flags1.is_broadcast() {
            return Err(DropReason::Broadcast);
        }
        let is_fack = header.packet_type == PacketType::Fack;
        if !header.packet_type.is_from_client() && !is_fack {
            return Err(DropReason::PacketType);
        }
        let operation = operation(header)?;
        let part = match rpc.body() {
            Body::Stub(stub) => part_of(header, operation, stub, records)?,
            _ => Part::Signal,
        };
        let (call, is_maybe) = (Call::of(header), header.flags1.is_maybe());
        Ok(Self { call, operation: header.operation, part, records, is_maybe })
    }

    /// Checks that it belongs to a call of the flow, if it does not begin one.
    pub(in crate::nat) fn goes_on(
        &self,
        exchanges: Option<&Exchanges>,
        now: Nanos,
    ) -> Result<(), DropReason> {
        match (self.part, exchanges) {
            (Part::Whole, _) | (Part::Fragment(Fragment { number: 0, .. }), None) => Ok(()),
            (_, Some(exchanges)) => exchanges.know(self, now),
            (_, None) => Err(DropReason::UnknownExchange),
        }
    }

    /// Whether an answer is due once it is sent. A request in fragments asks with its last one.
    pub(in crate::nat) fn wants_answer(&self) -> bool {
        match self.part {
            Part::Whole => !self.is_maybe,
            Part::Fragment(fragment) => fragment.is_last && !self.is_maybe,
            Part::Signal => false,
        }
    }
}

fn part_of<'a>(
    header: &Header,
    operation: Operation,
    stub: Octets<'a>,
    records: Records,
) -> Result<Part<'a>, DropReason> {
    let (flags, number) = (header.flags1, header.fragment_number);
    let is_last = !flags.is_fragment() || flags.is_last_fragment();
    let is_whole = number == 0 && is_last;
    match operation {
        Operation::LookUp if is_whole => {
            Message::read(header, stub).ok().flatten().ok_or(DropReason::BadNdr)?;
            Ok(Part::Whole)
        }
        Operation::LookUp => Err(DropReason::BadNdr), // nobody cuts so little
        Operation::ReadImplicit => {
            if ObjectUuid::of(header.object).is_none() {
                return Err(DropReason::BadNdr);
            }
            let (order, stub) = (stub.order(), stub.rest());
            if stub.is_empty() {
                return Err(DropReason::BadNdr); // it has no place in the request
            }
            if number == 0 {
                read::check(stub, order, records)?;
                if is_whole != (stub.len() == read::LEN)
                    || !is_whole && !read::may_end_behind(stub.len())
                {
                    return Err(DropReason::BadNdr);
                }
            }
            let fragment = Fragment { number, is_last, stub, order };
            Ok(if is_whole { Part::Whole } else { Part::Fragment(fragment) })
        }
    }
}

/// Checks what a device sends from this port, and that it belongs to a call of the flow. True if
/// the call has its answer with it.
pub(in crate::nat) fn response(
    octets: &[u8],
    exchanges: &mut Exchanges,
    port: u16,
    now: Nanos,
) -> Result<bool, DropReason> {
    let rpc = parse(octets)?;
    let header = rpc.header();
    // What a device calls itself, such as Application Ready, has no way out.
    if header.packet_type.is_from_client() {
        return Err(DropReason::PacketType);
    }
    if let (PacketType::Response, Body::Stub(stub), false) =
        (header.packet_type, rpc.body(), header.flags1.is_fragment())
    {
        let is_sound = match Interface::of(header.interface) {
            Some(Interface::EndpointMapper) => Message::read(header, stub).is_ok(),
            _ => ndr::Response::read(stub).is_ok(),
        };
        if !is_sound {
            return Err(DropReason::BadNdr);
        }
    }
    exchanges.answered(header, port, now)
}

/// Whether a datagram may begin a call.
#[cfg(test)]
pub(crate) fn is_sound_call(octets: &[u8]) -> bool {
    Request::parse(octets, Records::default())
        .is_ok_and(|request| matches!(request.part, Part::Whole))
}

/// The datagram, with lengths and header checked.
fn parse(octets: &[u8]) -> Result<Rpc<'_>, DropReason> {
    if octets.len() < Header::LEN {
        return Err(DropReason::TooShort);
    }
    if octets.len() > MAX_DATAGRAM {
        return Err(DropReason::TooLong);
    }
    let mut rest = Octets::new(octets);
    let (header, body_len) = Header::read(&mut rest).map_err(|_| DropReason::BadHeader)?;
    if rest.len() != usize::from(body_len) {
        return Err(DropReason::BadLength);
    }
    if header.auth_protocol != 0 {
        return Err(DropReason::BadHeader); // PROFINET has no such proofs
    }
    Rpc::of(header, rest).map_err(|_| DropReason::BadNdr)
}

/// The operations that may pass.
enum Operation {
    ReadImplicit,
    LookUp,
}

/// What is called. The names of the reasons are those of the operations (P-4).
fn operation(header: &Header) -> Result<Operation, DropReason> {
    let interface = Interface::of(header.interface)
        .filter(|interface| header.interface_version == interface.version())
        .ok_or(DropReason::RpcInterface)?;
    match (interface, header.operation) {
        (Interface::Device, 0) => Err(DropReason::RpcConnect),
        (Interface::Device, 1) => Err(DropReason::RpcRelease),
        (Interface::Device, 2) => Err(DropReason::RpcRead),
        (Interface::Device, 3) => Err(DropReason::RpcWrite),
        (Interface::Device, 4) => Err(DropReason::RpcControl),
        (Interface::Device, ReadImplicit::OPERATION) => Ok(Operation::ReadImplicit),
        (Interface::EndpointMapper, endpoint_mapper::LOOKUP | endpoint_mapper::HANDLE_FREE) => {
            Ok(Operation::LookUp)
        }
        _ => Err(DropReason::RpcInterface),
    }
}
