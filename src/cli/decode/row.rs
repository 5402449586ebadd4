//! A payload that is a row of whole datagrams. A capture on the router itself shows a burst like that,
//! since the kernel splits it later (UDP_SEGMENT). All have one length, only the last may be shorter.
//!
//! Invariant: every datagram of a row is well-formed, so nothing of the next one is shown with it.

use std::fmt;
use std::slice::Chunks;

use serde::Serialize;

use crate::pnet::wire::{Datagram, Header, MAX_DATAGRAM, MIN_DATAGRAM};

/// The most datagrams in one message to the kernel.
const MOST: usize = 64;

/// The number of a datagram in its row, from 1, and the length of the row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) struct InRow {
    pub(super) datagram: usize,
    pub(super) datagrams: usize,
}

impl fmt::Display for InRow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {}", self.datagram, self.datagrams)
    }
}

/// The datagrams of a row; none when the payload is one datagram, or not a row.
pub(super) fn datagrams(payload: &[u8], header: Header) -> Option<Chunks<'_, u8>> {
    let is_datagram = |octets| Datagram::parse(octets, header).is_ok();
    if is_datagram(payload) {
        return None;
    }
    // Only two lengths make the first chunk a datagram: with password and without. All others fail at
    // their first chunk.
    (MIN_DATAGRAM..=MAX_DATAGRAM)
        .map(|length| payload.chunks(length))
        .filter(|datagrams| (2..=MOST).contains(&datagrams.len()))
        .find(|datagrams| datagrams.clone().all(is_datagram))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 38 octets: a route of four, 20 data octets, a password.
    const SECURE: &[u8; 38] = b"\x02\0\0\0\x0B\x04\x8B\x83\x0C\x14twenty data octets..PNETPASS";
    /// The same without its password.
    const NORMAL: &[u8; 30] = b"\x02\0\0\0\x0B\x04\x8B\x83\x0C\x14twenty data octets..";
    /// 21 octets, and 13 without the password.
    const SHORTER: &[u8; 21] = b"\x02\0\0\0\x0B\x04\x8B\x83\x0C\x03abcPNETPASS";

    fn lengths(payload: &[u8]) -> Option<Vec<usize>> {
        Some(datagrams(payload, Header::default())?.map(<[u8]>::len).collect())
    }

    #[test]
    fn a_row_is_cut_to_its_datagrams() {
        assert_eq!(SECURE.repeat(11).len(), 418);
        assert_eq!(lengths(&SECURE.repeat(11)), Some(vec![38; 11]));
        assert_eq!(lengths(&NORMAL.repeat(2)), Some(vec![30; 2]));
        assert_eq!(lengths(&SECURE.repeat(64)), Some(vec![38; 64]));
        let shorter = [&SECURE.repeat(2)[..], SHORTER].concat();
        assert_eq!(lengths(&shorter), Some(vec![38, 38, 21]));
        let shorter = [&NORMAL[..], &SHORTER[..13]].concat();
        assert_eq!(lengths(&shorter), Some(vec![30, 13]));
        // Of one length, the second without a password.
        let mixed = b"\x02\0\0\0\x0B\x04\x8B\x83\0\x02abPNETPASS\
                      \x02\0\0\0\x0B\x04\x8B\x83\0\x0A0123456789\
                      \x02\0\0\0\x04\x83\0\0";
        assert_eq!(lengths(mixed), Some(vec![20, 20, 8]));
    }

    #[test]
    fn what_is_no_row_stays_whole() {
        for alone in [&SECURE[..], NORMAL, &NORMAL[..29], b"", b"\x02", &[0; 300]] {
            assert_eq!(lengths(alone), None, "{alone:02X?}");
        }
        // Header and route of the third.
        for broken in 76..84 {
            let mut row = SECURE.repeat(4);
            row[broken] ^= 0x80;
            assert_eq!(lengths(&row), None, "{broken}");
        }
        for row in [
            &SECURE.repeat(65)[..],
            &[&SECURE[..], SHORTER, SECURE].concat(),
            &[&SHORTER[..], SECURE].concat(),
            &[&SECURE[..], NORMAL, b"x"].concat(),
            &SECURE.repeat(3)[..100],
        ] {
            assert_eq!(lengths(row), None, "{row:02X?}");
        }
    }

    #[test]
    fn octets_that_are_a_datagram_by_themselves_are_no_row() {
        // Its last 8 octets are a password, whatever they look like.
        let both = b"\x02\0\0\0\x0B\x04\x8B\x83\0\x03abc\x02\0\0\0\x04\x83\0\0";
        assert_eq!(lengths(both), None);
    }
}
