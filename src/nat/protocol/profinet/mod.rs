//! PROFINET: what the octets of a remote procedure call say, and which calls may pass.
//!
//! Only reading passes: Read Implicit of listed records, and look-ups at the endpoint mapper. All
//! else is refused, each kind for a reason of its own. A request is checked whole, since malformed
//! ones have hung devices.

mod exchanges;
mod records;
#[cfg(test)]
mod tests;

use crate::profinet::blocks::IodReadReqHeader;
use crate::profinet::endpoint_mapper::{self, Message};
use crate::profinet::rpc::{Body, Header, Interface, PacketType, ReadImplicit, Rpc};
use crate::profinet::{ObjectUuid, Octets, ndr};

use crate::nat::reason::DropReason;
use crate::nat::time::Nanos;

pub(in crate::nat) use exchanges::Exchanges;
use exchanges::{Call, Rest};
pub use records::{NoSuchRecord, Record, Records};

/// The most octets of a datagram that fits an Ethernet frame (P-8).
const MAX_DATAGRAM: usize = 1472;
/// The most octets of arguments that a request in fragments may have.
const MAX_ARGS: u32 = 4096;

/// A well-formed request, or what else a client sends.
#[derive(Debug)]
pub(in crate::nat) struct Request {
    call: Call,
    operation: u16,
    /// How it goes on with a call; none: it begins one, or is sent again.
    continued: Option<Continued>,
    /// The fragments that are still to come after it.
    rest: Rest,
    is_maybe: bool,
}

/// What a client sends in a call that has begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Continued {
    /// A further fragment of the request, with so many octets.
    Fragment { number: u16, octets: u32, is_last: bool },
    /// A ping, an ack, a fack or a cancel.
    Signal,
}

impl Request {
    /// Checks what a client sends (P-4 to P-7).
    pub(in crate::nat) fn parse(octets: &[u8], records: Records) -> Result<Self, DropReason> {
        let rpc = parse(octets)?;
        let header = rpc.header();
        let call = Call::of(header);
        if header.flags1.is_broadcast() {
            return Err(DropReason::Broadcast);
        }
        let continued = match (header.packet_type, rpc.body()) {
            (PacketType::Request, Body::Stub(stub)) => {
                return Self::of_call(header, call, stub, records);
            }
            (PacketType::Fack, _) => Continued::Signal,
            (packet_type, _) if packet_type.is_from_client() => Continued::Signal,
            _ => return Err(DropReason::PacketType),
        };
        operation(header)?;
        let (rest, operation) = (Rest::default(), header.operation);
        Ok(Self { call, operation, continued: Some(continued), rest, is_maybe: false })
    }

    fn of_call(
        header: &Header,
        call: Call,
        stub: Octets<'_>,
        records: Records,
    ) -> Result<Self, DropReason> {
        let operation = operation(header)?;
        let (flags, number) = (header.flags1, header.fragment_number);
        let is_whole = !flags.is_fragment() || number == 0 && flags.is_last_fragment();
        let mut request = Self {
            call,
            operation: header.operation,
            continued: None,
            rest: Rest::default(),
            is_maybe: flags.is_maybe(),
        };
        if number > 0 {
            let (octets, is_last) = (stub.len() as u32, flags.is_last_fragment());
            request.continued = Some(Continued::Fragment { number, octets, is_last });
            return Ok(request);
        }
        match operation {
            Operation::LookUp if is_whole => {
                Message::read(header, stub).ok().flatten().ok_or(DropReason::BadNdr)?;
            }
            Operation::LookUp => return Err(DropReason::BadNdr),
            Operation::ReadImplicit => {
                let (read, left) = read_header(stub)?;
                if ObjectUuid::of(header.object).is_none() || is_whole != (left == 0) {
                    return Err(DropReason::BadNdr);
                }
                if !read.ar_uuid.is_nil() {
                    return Err(DropReason::RpcRead);
                }
                if !records.include(read.index) {
                    return Err(DropReason::RecordNotAllowed);
                }
                request.rest = Rest { next: 1, octets: left };
            }
        }
        Ok(request)
    }

    /// Checks that it belongs to a call of the flow, if it does not begin one.
    pub(in crate::nat) fn goes_on(
        &self,
        exchanges: Option<&Exchanges>,
        now: Nanos,
    ) -> Result<(), DropReason> {
        let Some(continued) = self.continued else { return Ok(()) };
        let exchanges = exchanges.ok_or(DropReason::UnknownExchange)?;
        exchanges.know(self.call, self.operation, continued, now)
    }

    /// Whether an answer is due once it is sent. A request in fragments asks with its last one.
    pub(in crate::nat) fn wants_answer(&self) -> bool {
        match self.continued {
            None => !self.is_maybe && self.rest.octets == 0,
            Some(Continued::Fragment { is_last, .. }) => is_last && !self.is_maybe,
            Some(Continued::Signal) => false,
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
    Request::parse(octets, Records::default()).is_ok_and(|request| request.continued.is_none())
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
    Rpc::parse(octets).map_err(|_| DropReason::BadNdr)
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

/// The header of a read at the beginning of its arguments, and how many octets of them are still to
/// come. A query may stand behind the header, and only a request with one has several fragments.
fn read_header(mut stub: Octets<'_>) -> Result<(IodReadReqHeader, u32), DropReason> {
    let mut numbers = [0; 5];
    for number in &mut numbers {
        *number = stub.u32().map_err(|_| DropReason::BadNdr)?;
    }
    let [args_maximum, args_length, maximum_count, offset, actual_count] = numbers;
    let here = stub.len() as u32;
    let agree = args_maximum == maximum_count
        && offset == 0
        && actual_count == args_length
        && args_length <= maximum_count
        && here <= args_length
        && args_length <= MAX_ARGS;
    if !agree {
        return Err(DropReason::BadNdr);
    }
    let block = stub.in_order(Default::default()).part(IodReadReqHeader::LEN);
    let read = block.and_then(|mut block| IodReadReqHeader::parse(&mut block));
    Ok((read.map_err(|_| DropReason::BadNdr)?, args_length - here))
}

const _: () = assert!(ndr::Request::HEADER_LEN == 5 * size_of::<u32>());
