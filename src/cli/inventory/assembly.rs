//! Puts the fragments of a response together, in their order (P-8). Invariant: what is kept has a limit.

use crate::profinet::rpc::{Body, Flags1, Header, PacketType, Rpc};
use crate::profinet::{ByteOrder, Octets};

/// Octets of the longest answer that is put together.
const LONGEST: usize = 1 << 16;

/// What has come of a response.
#[derive(Clone, Debug, Default)]
pub(super) struct Assembly {
    octets: Vec<u8>,
    order: ByteOrder,
    /// The fragment that is wanted.
    next: u16,
}

/// What came of a fragment.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Added {
    /// The response is whole.
    Whole,
    /// There is more to come.
    Waits,
    /// It has come before: its acknowledgement was lost.
    Known,
    /// It is not the one that is wanted, or too long.
    Ignored,
}

impl Assembly {
    /// Takes a response, or a fragment of one.
    pub(super) fn add(&mut self, rpc: &Rpc<'_>) -> Added {
        let (header, Body::Stub(stub)) = (rpc.header(), rpc.body()) else { return Added::Ignored };
        let is_fragment = header.flags1.is_fragment();
        let order = header.representation.order;
        if header.fragment_number < self.next {
            return Added::Known;
        }
        if self.next == 0 {
            self.order = order;
        }
        let is_wanted = header.fragment_number == self.next && order == self.order;
        if !is_wanted || self.octets.len() + stub.len() > LONGEST {
            return Added::Ignored;
        }
        self.octets.extend_from_slice(stub.rest());
        self.next = self.next.saturating_add(1);
        if is_fragment && !header.flags1.is_last_fragment() { Added::Waits } else { Added::Whole }
    }

    /// The stub data so far.
    pub(super) fn stub(&self) -> Octets<'_> {
        Octets::new(&self.octets).in_order(self.order)
    }
}

/// Octets of a fack.
pub(super) const FACK: usize = Header::LEN + 16;

/// The acknowledgement of a fragment: all up to this one have come, and one more may be sent at once.
pub(super) fn fack(of: &Header, buffer: &mut [u8; FACK]) {
    let mut header = Header::request(ByteOrder::Big, of.interface, of.operation);
    header.packet_type = PacketType::Fack;
    header.flags1 = Flags1(0);
    header.interface_version = of.interface_version;
    header.object = of.object;
    header.activity = of.activity;
    header.sequence = of.sequence;
    header.fragment_number = of.fragment_number;
    let serial = of.serial.to_be_bytes();
    // Version 0, window 1, two lengths of 1464 octets, serial number, no masks.
    let body = [0, 0, 0, 1, 0, 0, 5, 0xB8, 0, 0, 5, 0xB8, serial[0], serial[1], 0, 0];
    header.emit(&body, buffer).expect("the buffer has the length of a fack");
}
