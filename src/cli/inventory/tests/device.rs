//! A device that is written by hand, so that a fault of the program cannot hide itself: it answers the
//! endpoint mapper, I&M0FilterData, I&M0 and I&M1.

use std::net::SocketAddrV4;

use crate::profinet::rpc::{Flags1, Header, Interface, PacketType, ReadImplicit, Rpc};
use crate::profinet::{ByteOrder, ObjectUuid};

pub(super) type Datagram = Vec<u8>;

/// I&M0: vendor 0x1F2E, hardware 3, V1.2.3, I&M1 too. The order ID is filled in.
const IM0: [u8; 60] =
    *b"\x00\x20\x00\x38\x01\x00\x1f\x2e                    SN 0815         \x00\x03V\x01\x02\x03\
       \x00\x00\x00\x00\x00\x00\x01\x01\x00\x02";
/// Slot 0 of API 0, and slot 2 of API 0x3A00, each with subslot 1.
const FILTER_DATA: &[u8] = b"\x00\x30\x00\x2C\x01\x00\x00\x02\
    \x00\x00\x00\x00\x00\x01\x00\x00\x00\x00\x00\x01\x00\x01\x00\x01\x00\x00\x00\x02\
    \x00\x00\x3A\x00\x00\x01\x00\x02\x00\x00\x00\x03\x00\x01\x00\x01\x00\x00\x00\x04";
/// Interface, NDR, connectionless, UDP port, IP address.
const TOWER: &[u8] =
    b"\x05\x00\x13\x00\x0d\x01\x00\xa0\xde\x97\x6c\xd1\x11\x82\x71\x00\xa0\x24\x42\
    \xdf\x7d\x01\x00\x02\x00\x00\x00\x13\x00\x0d\x04\x5d\x88\x8a\xeb\x1c\xc9\x11\x9f\xe8\x08\x00\
    \x2b\x10\x48\x60\x02\x00\x02\x00\x00\x00\x01\x00\x0a\x02\x00\x00\x00\x01\x00\x08\x02\x00";

pub(super) struct FakeDevice {
    pub(super) order: ByteOrder,
    /// Where its mapper says that records are read, and where alone they are.
    pub(super) port: u16,
    pub(super) order_id: [u8; 20],
    pub(super) has_mapper: bool,
    pub(super) has_filter_data: bool,
    pub(super) has_im: bool,
    /// It answers each call with `working`.
    pub(super) is_working: bool,
    /// Octets of a fragment; 0: answers are in one piece.
    pub(super) fragment: usize,
    /// An octet of each answer that is another one.
    pub(super) changed: Option<usize>,
    /// Fragments that wait for the fack of the one before.
    pub(super) waiting: Vec<Datagram>,
}

impl Default for FakeDevice {
    fn default() -> Self {
        Self {
            order: ByteOrder::Big,
            port: 34964,
            order_id: *b"VALVE 7             ",
            has_mapper: true,
            has_filter_data: true,
            has_im: true,
            is_working: false,
            fragment: 0,
            changed: None,
            waiting: Vec::new(),
        }
    }
}

impl FakeDevice {
    pub(super) fn answer(&mut self, to: SocketAddrV4, octets: &[u8]) -> Vec<Datagram> {
        let rpc = Rpc::parse(octets).unwrap();
        let header = rpc.header();
        if header.packet_type == PacketType::Fack {
            return self.waiting.pop().into_iter().collect();
        }
        if self.is_working {
            return vec![self.datagram(header, PacketType::Working, 0, &[])];
        }
        if Interface::of(header.interface) == Some(Interface::EndpointMapper) {
            if !self.has_mapper {
                return Vec::new();
            }
            let stub = self.endpoints(header.sequence);
            return vec![self.datagram(header, PacketType::Response, 0, &stub)];
        }
        if to.port() != self.port {
            let unknown_interface = self.u32(0x1C01_0003);
            return vec![self.datagram(header, PacketType::Reject, 0, &unknown_interface)];
        }
        let read = ReadImplicit::parse(&rpc).unwrap().unwrap();
        let stub = match self.record(&read) {
            Some(record) => {
                // The header of the answer begins as that of the request.
                let mut blocks = octets[100..164].to_vec();
                (blocks[0], blocks[1]) = (0x80, 0x09);
                blocks[36..40].copy_from_slice(&(record.len() as u32).to_be_bytes());
                self.stub(0, &[blocks, record].concat())
            }
            None => self.stub(0xDE80_B000, &[]),
        };
        self.fragments(header, &stub)
    }

    fn record(&self, read: &ReadImplicit) -> Option<Vec<u8>> {
        match (read.index, read.api, read.slot, read.subslot) {
            (0xF840, ..) => self.has_filter_data.then(|| FILTER_DATA.to_vec()),
            (0xAFF0, 0, 0, 1) | (0xAFF0, 0x3A00, 2, 1) => self.has_im.then(|| {
                let mut im0 = IM0.to_vec();
                im0[8..28].copy_from_slice(&self.order_id);
                im0
            }),
            (0xAFF1, 0, 0, 1) => {
                let texts = format!("{:32}{:22}", "steam", "cellar");
                Some([b"\x00\x21\x00\x38\x01\x00", texts.as_bytes()].concat())
            }
            _ => None,
        }
    }

    /// One entry, then the end.
    fn endpoints(&self, sequence: u32) -> Vec<u8> {
        let number = |number| self.u32(number);
        if sequence > 0 {
            let numbers = [0, 0, 1, 0, 0, 0x16C9_A0D6].map(number).concat();
            return [vec![0; 16], numbers].concat();
        }
        let object = ObjectUuid { instance: 1, device: 0x42, vendor: 0x1F2E }.to_uuid();
        let port = self.port.to_be_bytes();
        let tower = [TOWER, &port, b"\x01\x00\x09\x04\x00\x00\x00\x00\x00"].concat();
        let length = number(tower.len() as u32);
        [
            &number(0)[..],
            &[1; 16],
            &[1, 1, 0, 1].map(number).concat(),
            &object.on_wire(self.order),
            &[3, 0, 8].map(number).concat(),
            b"VALVE 7\0",
            &length,
            &length,
            &tower,
            &vec![0; tower.len().wrapping_neg() % 4],
            &number(0),
        ]
        .concat()
    }

    fn u32(&self, number: u32) -> [u8; 4] {
        match self.order {
            ByteOrder::Big => number.to_be_bytes(),
            ByteOrder::Little => number.to_le_bytes(),
        }
    }

    fn stub(&self, status: u32, blocks: &[u8]) -> Vec<u8> {
        let length = blocks.len() as u32;
        let numbers = [status, length, 4160, 0, length].map(|number| self.u32(number));
        [numbers.as_flattened(), blocks].concat()
    }

    /// The first fragment; the others wait.
    fn fragments(&mut self, header: &Header, stub: &[u8]) -> Vec<Datagram> {
        if self.fragment == 0 || stub.len() <= self.fragment {
            return vec![self.datagram(header, PacketType::Response, 0, stub)];
        }
        let count = stub.len().div_ceil(self.fragment);
        let all = stub.chunks(self.fragment).zip(0..).map(|(part, number)| {
            let last = if usize::from(number) + 1 == count { Flags1::LAST_FRAGMENT } else { 0 };
            let mut header = *header;
            header.flags1 = Flags1(Flags1::FRAGMENT | last);
            self.datagram(&header, PacketType::Response, number, part)
        });
        self.waiting = all.collect();
        self.waiting.reverse();
        self.waiting.pop().into_iter().collect()
    }

    fn datagram(&self, request: &Header, kind: PacketType, fragment: u16, body: &[u8]) -> Datagram {
        let mut header = *request;
        header.packet_type = kind;
        header.representation.order = self.order;
        header.fragment_number = fragment;
        let mut buffer = vec![0; 80 + body.len()];
        header.emit(body, &mut buffer).unwrap();
        if let Some(octet) = self.changed {
            buffer[octet] ^= 1;
        }
        buffer
    }
}
