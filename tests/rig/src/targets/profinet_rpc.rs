//! Any octets, as a datagram of PROFINET's RPC and as blocks. Accepted datagrams are emitted again unchanged,
//! and what is wrong has its place among the octets.

use pnet_nat::profinet::blocks::Blocks;
use pnet_nat::profinet::endpoint_mapper::Message;
use pnet_nat::profinet::rpc::{Body, Header, ReadImplicit, Rpc};
use pnet_nat::profinet::view::first_fault;
use pnet_nat::profinet::{Malformed, Octets, ndr};

/// Takes the octets as a datagram and as blocks.
pub fn holds(octets: &[u8]) {
    match Rpc::parse(octets) {
        Ok(rpc) => datagram(&rpc, octets),
        Err(fault) => is_inside(fault, octets.len()),
    }
    blocks(Blocks::new(Octets::new(octets)), octets.len());
}

fn datagram(rpc: &Rpc<'_>, octets: &[u8]) {
    let mut buffer = vec![0; octets.len()];
    assert_eq!(rpc.emit(&mut buffer), Ok(octets.len()));
    assert_eq!(buffer, octets, "what is parsed is emitted alike");

    let end = octets.len();
    match ReadImplicit::parse(rpc) {
        Ok(None) => {}
        Ok(Some(read)) => {
            let mut buffer = [0; ReadImplicit::LEN];
            read.emit(&mut buffer).unwrap();
            assert_eq!(ReadImplicit::parse(&Rpc::parse(&buffer).unwrap()), Ok(Some(read)));
        }
        Err(fault) => is_inside(fault, end),
    }
    match Message::of(rpc) {
        Ok(message) => assert_eq!(message.and_then(|message| first_fault(&message)), None),
        Err(fault) => is_inside(fault, end),
    }
    let Body::Stub(stub) = rpc.body() else { return };
    assert_eq!((stub.offset(), stub.len()), (Header::LEN, end - Header::LEN));
    match ndr::Request::read(stub) {
        Ok(request) => blocks(Blocks::new(request.args), end),
        Err(fault) => is_inside(fault, end),
    }
    match ndr::Response::read(stub) {
        Ok(response) => blocks(Blocks::new(response.args), end),
        Err(fault) => is_inside(fault, end),
    }
}

/// Looks at every field of every block.
fn blocks(blocks: Blocks<'_>, end: usize) {
    let mut next = None;
    for block in blocks {
        let fault = match block {
            Ok(block) => {
                assert!(next.is_none_or(|next| block.offset >= next), "blocks do not overlap");
                next = Some(block.offset + 4 + block.length());
                assert!(next <= Some(end));
                first_fault(&block)
            }
            Err(fault) => Some(fault),
        };
        if let Some(fault) = fault {
            is_inside(fault, end);
        }
    }
}

fn is_inside(Malformed { offset, what }: Malformed, end: usize) {
    assert!(offset <= end, "{what} at {offset} of {end}");
}
