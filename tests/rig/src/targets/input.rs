//! Choices and datagrams from the octets of a fuzzer. The datagrams are valid, damaged, or any
//! octets.

use pnet_nat::pnet::wire::MAX_DATAGRAM;

/// What clients may try as a password, or that they have none.
const PASSWORDS: [&[u8]; 6] =
    [b"service!", b"rotated!", b"press!!!", b"device!!", b"gu3ss3d!", b""];

/// The rest of the input. At its end, every choice is the first one.
pub(super) struct Input<'a>(&'a [u8]);

impl<'a> Input<'a> {
    pub(super) fn new(octets: &'a [u8]) -> Self {
        Self(octets)
    }

    pub(super) fn is_over(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn octet(&mut self) -> u8 {
        let Some((&octet, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        octet
    }

    pub(super) fn choice<T: Clone>(&mut self, among: &[T]) -> T {
        among[usize::from(self.octet()) % among.len()].clone()
    }

    /// Any octets, as many as one octet says, but not more than `most`.
    pub(super) fn octets(&mut self, most: usize) -> Vec<u8> {
        let length = usize::from(self.octet()).min(most).min(self.0.len());
        let (octets, rest) = self.0.split_at(length);
        self.0 = rest;
        octets.to_vec()
    }

    /// A request to this P-NET node, maybe damaged, or any octets.
    pub(super) fn datagram(&mut self, node_address: u8) -> Vec<u8> {
        let shape = self.octet();
        if shape >= 0xF0 {
            return self.octets(MAX_DATAGRAM + 1);
        }
        let route: &[u8] = match shape % 4 {
            0 => &[0x0B, node_address, 0x8B, 0x83], // Extended
            1 => &[0x0B, node_address, 0x04, 0x05, 0x8B, 0x83, 0x80], // IP, wants no answer
            _ => &[0x0B, node_address, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F], // PAS Figure 10
        };
        let password = PASSWORDS[usize::from(shape / 4) % PASSWORDS.len()];
        let mut octets = [&[2, 0, 0, 0], route, &[0x0C, 2, 0x11, 0x22], password].concat();
        if shape & 0x80 != 0 {
            self.damage(&mut octets);
        }
        octets
    }

    /// Changes some octets, cuts some off or adds some, or leaves all as they are.
    pub(super) fn damage(&mut self, octets: &mut Vec<u8>) {
        match self.octet() {
            fewer @ 128..192 => octets.truncate(octets.len().saturating_sub((fewer - 127).into())),
            more @ 192.. => octets.resize(octets.len() + usize::from(more - 191), 0x41),
            changes => {
                for _ in 0..changes % 4 {
                    let at = usize::from(self.octet()) % octets.len().max(1);
                    let to = self.octet();
                    if let Some(octet) = octets.get_mut(at) {
                        *octet = to;
                    }
                }
            }
        }
    }
}
