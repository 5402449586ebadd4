//! The request filter of a PROFINET device: what cannot be a call that only reads does not reach the
//! worker.
//!
//! The program looks at the length, the packet type, the interface and the operation, in either byte
//! order. As every request filter, it never refuses what the relay would accept.

use std::net::IpAddr;

use libc::{
    BPF_ABS, BPF_ALU, BPF_B, BPF_H, BPF_JEQ, BPF_JGE, BPF_JGT, BPF_K, BPF_LD, BPF_LEN, BPF_SUB,
    BPF_W,
};

use crate::profinet::endpoint_mapper::{HANDLE_FREE, LOOKUP};
use crate::profinet::rpc::{Header, Interface, MAX_DATAGRAM, ReadImplicit};

use super::assembler::{Program, To};
use super::request::refuse_many;

/// Offset of the datagram. What the program sees begins with the UDP header.
const DATAGRAM: u32 = 8;

/// The program for a socket that listens at this address.
pub(super) fn program(listen: IpAddr) -> Program {
    let mut program = Program::new();
    refuse_many(&mut program, listen);
    program.step(BPF_LD | BPF_W | BPF_LEN, 0);
    program.step(BPF_ALU | BPF_SUB | BPF_K, DATAGRAM);
    program.compare(BPF_JGE, Header::LEN as u32, To::Next, To::Refuse);
    program.compare(BPF_JGT, MAX_DATAGRAM as u32, To::Refuse, To::Next);
    // The version, then a packet type that clients send: 0, 1 and 7 to 9.
    program.step(BPF_LD | BPF_B | BPF_ABS, DATAGRAM);
    program.compare(BPF_JEQ, 4, To::Next, To::Refuse);
    program.step(BPF_LD | BPF_B | BPF_ABS, DATAGRAM + 1);
    program.compare(BPF_JGT, 9, To::Refuse, To::Next);
    program.compare(BPF_JGE, 7, To::Skip(1), To::Next);
    program.compare(BPF_JGT, 1, To::Refuse, To::Next);
    // The first four octets of the interface, and the operation.
    program.step(BPF_LD | BPF_W | BPF_ABS, DATAGRAM + 24);
    let (device, mapper) = (Interface::Device, Interface::EndpointMapper);
    let calls = [(device, ReadImplicit::OPERATION), (mapper, LOOKUP), (mapper, HANDLE_FREE)];
    for (interface, operation) in calls {
        let [a, b, c, d, ..] = interface.uuid().octets();
        let big = (u32::from_be_bytes([a, b, c, d]), operation);
        let little = (u32::from_le_bytes([a, b, c, d]), operation.swap_bytes());
        for (interface, operation) in [big, little] {
            program.compare(BPF_JEQ, interface, To::Next, To::Skip(3));
            program.step(BPF_LD | BPF_H | BPF_ABS, DATAGRAM + 68);
            program.compare(BPF_JEQ, operation.into(), To::Accept, To::Next);
            program.step(BPF_LD | BPF_W | BPF_ABS, DATAGRAM + 24);
        }
    }
    program
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, UdpSocket};

    use proptest::prelude::*;
    use socket2::SockRef;

    use super::*;
    use crate::profinet::endpoint_mapper::{Handle, HandleFree, Lookup};
    use crate::profinet::{ByteOrder, ObjectUuid, Uuid};

    fn gate() -> (UdpSocket, UdpSocket) {
        let inside = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let outside = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        outside.connect(inside.local_addr().unwrap()).unwrap();
        inside.set_nonblocking(true).unwrap();
        program(Ipv4Addr::UNSPECIFIED.into()).attach(&SockRef::from(&inside)).unwrap();
        (inside, outside)
    }

    fn lets_through(gate: &(UdpSocket, UdpSocket), octets: &[u8]) -> bool {
        gate.1.send(octets).unwrap();
        // On loopback, a datagram has either arrived or been refused when its send returns.
        gate.0.recv(&mut [0; 2048]).is_ok()
    }

    fn calls(order: ByteOrder) -> [Vec<u8>; 3] {
        let read = ReadImplicit {
            order,
            object: ObjectUuid { instance: 1, device: 2, vendor: 3 }.to_uuid(),
            activity: Uuid::new(7),
            sequence: 0,
            api: 0,
            slot: 0,
            subslot: 1,
            index: 0xAFF0,
            record_length: 1000,
            target_ar: Uuid::NIL,
        };
        let (mut one, mut two, mut three) = ([0; 200], [0; 200], [0; 200]);
        let lengths = [
            read.emit(&mut one).unwrap(),
            Lookup::next_of_all(Handle::default()).emit(order, Uuid::new(7), 0, &mut two).unwrap(),
            HandleFree { handle: Handle::default() }
                .emit(order, Uuid::new(7), 1, &mut three)
                .unwrap(),
        ];
        [one[..lengths[0]].to_vec(), two[..lengths[1]].to_vec(), three[..lengths[2]].to_vec()]
    }

    #[test]
    fn calls_that_read_get_through_and_others_do_not() {
        let gate = gate();
        for order in [ByteOrder::Big, ByteOrder::Little] {
            for call in calls(order) {
                assert!(lets_through(&gate, &call));
                for (at, octet) in [(0, 5), (1, 2), (1, 10), (24, 9), (68, 7), (69, 9)] {
                    let mut other = call.clone();
                    other[at] = octet;
                    assert!(!lets_through(&gate, &other), "octet {at} is {octet}");
                }
                assert!(!lets_through(&gate, &call[..79]));
                assert!(!lets_through(&gate, &[&call[..], &[0; 1400]].concat()));
            }
        }
        assert!(!lets_through(&gate, b"not at all"));
    }

    proptest! {
        #[test]
        fn never_refuses_what_the_relay_accepts(
            which in 0..3_usize, little in any::<bool>(),
            changes in prop::collection::vec((0..150_usize, any::<u8>()), 0..3),
        ) {
            let order = if little { ByteOrder::Little } else { ByteOrder::Big };
            let mut octets = calls(order)[which].clone();
            for (at, octet) in changes {
                if let Some(place) = octets.get_mut(at) {
                    *place = octet;
                }
            }
            if crate::nat::is_sound_call(&octets) {
                prop_assert!(lets_through(&gate(), &octets));
            }
        }
    }
}
