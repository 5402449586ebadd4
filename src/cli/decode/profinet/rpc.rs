//! Datagrams of PROFINET's DCE/RPC: header, and the blocks of a call that is whole.
//!
//! Fields are those of the views, by their names there. A call in fragments has its blocks at the fragment
//! that makes it whole; `rpc_fragments` keeps the others until then.

use std::fmt::{self, Display};

use serde::{Serialize, Serializer};

use super::connections::Connections;
use super::rpc_fragments::{Fragment, Key};
use super::rpc_value::Fields;
use crate::profinet::blocks::Blocks;
use crate::profinet::endpoint_mapper::Message;
use crate::profinet::rpc::{
    Body, Header, Interface, PORT, PacketType, RT_UDP_PORT, Rpc, operation_name,
};
use crate::profinet::view::{Show, Value, first_fault};
use crate::profinet::{Malformed, Octets, PnioStatus, ndr};

/// The operation that makes a connection.
const CONNECT: u16 = 0;

/// What a datagram says, as far as it can be read.
#[derive(Debug)]
pub(in crate::cli::decode) struct RpcFields<'a> {
    length: usize,
    header: Option<Header>,
    body: Option<Body<'a>>,
    /// How many octets were put together, where there were fragments.
    whole: Option<usize>,
    call: Option<Call<'a>>,
    fault: Option<Malformed>,
}

/// The stub data of a whole call.
#[derive(Clone, Copy, Debug)]
enum Call<'a> {
    Request {
        args_maximum: u32,
        blocks: Blocks<'a>,
    },
    Response {
        status: PnioStatus,
        maximum_count: u32,
        blocks: Blocks<'a>,
    },
    EndpointMapper(Message<'a>),
    /// Of an operation that is not known.
    Octets(&'a [u8]),
}

impl<'a> RpcFields<'a> {
    /// Reads the payload of a datagram. None if it is not DCE/RPC of PROFINET: the interface is none of its
    /// interfaces, and no port is one of its ports.
    pub(in crate::cli::decode) fn of(payload: &'a [u8], ports: [u16; 2]) -> Option<Self> {
        let is_port = ports.iter().any(|port| matches!(*port, PORT | RT_UDP_PORT));
        let header = Header::read(&mut Octets::new(payload)).map(|(header, _)| header);
        let is_ours = header.as_ref().is_ok_and(|header| Interface::of(header.interface).is_some());
        let is_rpc = payload.len() >= Header::LEN && payload.first() == Some(&4);
        if !(is_ours || is_port && is_rpc) {
            return None;
        }
        let length = payload.len();
        let none = Self { length, header: None, body: None, whole: None, call: None, fault: None };
        let header = match header {
            Ok(header) => header,
            Err(fault) => return Some(Self { fault: Some(fault), ..none }),
        };
        let fields = Self { header: Some(header), ..none };
        Some(match Rpc::parse(payload) {
            Ok(rpc) => Self { body: Some(rpc.body()), ..fields }.with_body(),
            Err(fault) => Self { fault: Some(fault), ..fields },
        })
    }

    fn with_body(self) -> Self {
        let Some((header, Body::Stub(stub))) = self.header.zip(self.body) else { return self };
        if header.flags1.is_fragment() { self } else { self.with_stub(&header, stub) }
    }

    /// The same with the stub data that fragments were put together to. Errors count as if all of it had come
    /// in one datagram.
    pub(in crate::cli::decode) fn with_call(self, stub: &'a [u8]) -> Self {
        let Some(header) = self.header else { return self };
        let octets = Octets::new(stub).in_order(header.representation.order);
        Self { whole: Some(stub.len()), ..self }.with_stub(&header, octets.starting_at(Header::LEN))
    }

    fn with_stub(self, header: &Header, stub: Octets<'a>) -> Self {
        match Call::read(header, stub) {
            Ok(call) => {
                let fault = self.fault.or_else(|| first_fault(&call));
                Self { call: Some(call), fault, ..self }
            }
            Err(fault) => Self { fault: Some(fault), ..self },
        }
    }

    /// The fragment of a call, if this is one.
    pub(super) fn fragment(&self) -> Option<Fragment<'a>> {
        let (header, Body::Stub(stub)) = self.header.zip(self.body)? else { return None };
        let key = Key {
            activity: header.activity,
            sequence: header.sequence,
            packet_type: header.packet_type,
        };
        header.flags1.is_fragment().then(|| Fragment {
            key,
            number: header.fragment_number,
            is_last: header.flags1.is_last_fragment(),
            octets: stub.rest(),
        })
    }

    /// Tells the connections what a whole Connect says.
    pub(in crate::cli::decode) fn teach(&self, connections: &mut Connections) {
        let Some((header, call)) = self.header.zip(self.call) else { return };
        match call {
            Call::Request { blocks, .. } if header.operation == CONNECT => {
                connections.request(blocks);
            }
            Call::Response { blocks, .. } if header.operation == CONNECT => {
                connections.answer(blocks);
            }
            _ => {}
        }
    }

    /// Why it cannot be read to its end.
    pub(in crate::cli::decode) fn fault(&self) -> Option<Malformed> {
        self.fault
    }
}

impl<'a> Call<'a> {
    fn read(header: &Header, stub: Octets<'a>) -> Result<Self, Malformed> {
        let Some(interface) = Interface::of(header.interface) else {
            return Ok(Self::Octets(stub.rest()));
        };
        if !interface.has_blocks() {
            let message = Message::read(header, stub)?;
            return Ok(message.map_or(Self::Octets(stub.rest()), Self::EndpointMapper));
        }
        Ok(match header.packet_type {
            PacketType::Request => {
                let ndr::Request { args_maximum, args } = ndr::Request::read(stub)?;
                Self::Request { args_maximum, blocks: Blocks::new(args) }
            }
            _ => {
                let ndr::Response { status, maximum_count, args } = ndr::Response::read(stub)?;
                Self::Response { status, maximum_count, blocks: Blocks::new(args) }
            }
        })
    }

    fn blocks(&self) -> Option<Blocks<'a>> {
        match self {
            Self::Request { blocks, .. } | Self::Response { blocks, .. } => Some(*blocks),
            Self::EndpointMapper(_) | Self::Octets(_) => None,
        }
    }
}

impl Show for Call<'_> {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        match self {
            Self::Request { args_maximum, blocks } => {
                visit("args_maximum", Value::Number((*args_maximum).into()));
                visit("args_length", Value::Number(blocks.len() as u64));
                visit("blocks", Value::List(blocks));
            }
            Self::Response { status, maximum_count, blocks } => {
                visit("status", Value::Fields(status));
                visit("maximum_count", Value::Number((*maximum_count).into()));
                visit("args_length", Value::Number(blocks.len() as u64));
                visit("blocks", Value::List(blocks));
            }
            Self::EndpointMapper(message) => message.show(visit),
            Self::Octets(octets) => visit("octets", Value::Octets(octets)),
        }
    }
}

impl Show for RpcFields<'_> {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        visit("length", Value::Number(self.length as u64));
        if let Some(header) = &self.header {
            header.show(visit);
        }
        if let Some(body) = &self.body {
            body.show(visit);
        }
        if let Some(octets) = self.whole {
            visit("reassembled_length", Value::Number(octets as u64));
        }
        if let Some(call) = &self.call {
            call.show(visit);
        }
        if let Some(fault) = self.fault {
            visit("error", Value::Fault(fault));
        }
    }
}

impl Serialize for RpcFields<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Fields(self).serialize(serializer)
    }
}

impl Display for RpcFields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("RPC")?;
        if let Some(header) = &self.header {
            write_heading(header, f)?;
        }
        if let Some(body @ Body::Status(status)) = &self.body {
            match body.status_words() {
                Some(words) => write!(f, ", {words}")?,
                None => write!(f, ", status {status:#010x}")?,
            }
        }
        if let Some(fragment) = self.fragment() {
            write!(f, ", fragment {} of {} octets", fragment.number, fragment.octets.len())?;
        }
        match &self.call {
            Some(Call::Response { status, .. }) => write!(f, ": {status}")?,
            Some(Call::EndpointMapper(Message::LookupAnswer(answer))) => {
                for entry in answer.entries() {
                    write!(f, ": {}", super::rpc_value::Characters(entry.annotation))?;
                }
            }
            _ => {}
        }
        if let Some(blocks) = self.call.as_ref().and_then(Call::blocks) {
            write_blocks(blocks, f)?;
        }
        match self.fault {
            Some(Malformed { offset, what }) => write!(f, "; malformed at octet {offset}: {what}"),
            None => Ok(()),
        }
    }
}

/// What is asked or answered, of whom.
fn write_heading(header: &Header, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    let interface = Interface::of(header.interface);
    match interface.and_then(|interface| operation_name(interface, header.operation)) {
        Some(operation) => write!(f, " {operation}")?,
        None => write!(f, " operation {}", header.operation)?,
    }
    write!(f, " {}", header.packet_type.name())?;
    if let Some(interface) = interface.filter(|_| header.packet_type.is_from_client()) {
        write!(f, " to {}", interface.name())?;
    }
    write!(f, ", sequence {}", header.sequence)
}

/// The names of the blocks, and of records what they are. A name that is repeated is counted.
pub(super) fn write_blocks(blocks: Blocks<'_>, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    let mut blocks = blocks.flatten().peekable();
    let mut separator = "; ";
    while let Some(block) = blocks.next() {
        let mut count = 1;
        while blocks.next_if(|next| next.block_type == block.block_type).is_some() {
            count += 1;
        }
        f.write_str(separator)?;
        match block.name() {
            Some(name) => f.write_str(name)?,
            None => write!(f, "block {:#06x}", block.block_type)?,
        }
        if let Some(place) = block.record_place() {
            write!(f, " {place}")?;
        }
        if count > 1 {
            write!(f, " ({count})")?;
        }
        separator = ", ";
    }
    Ok(())
}

#[cfg(test)]
pub(super) mod tests;
