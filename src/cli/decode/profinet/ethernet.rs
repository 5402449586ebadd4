//! From a captured packet to the payload of an Ethernet frame: those frames that are not IP.

use std::fmt::{self, Display};

use pcap_parser::Linktype;
use serde::Serialize;

use crate::cli::decode::capture::Captured;
use crate::profinet::{MacAddress, lldp, mrp, rt};

/// The Ethertypes of tags: IEEE 802.1Q, 802.1ad, and one that came before it.
const TAGS: [u16; 3] = [0x8100, 0x88A8, 0x9100];
/// Tags that are looked behind.
const MOST_TAGS: usize = 3;

/// A frame of one of the protocols here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::cli::decode) struct Ethernet<'a> {
    pub(in crate::cli::decode) from: MacAddress,
    /// A Linux cooked capture does not have it.
    pub(in crate::cli::decode) to: Option<MacAddress>,
    /// The innermost tag.
    pub(in crate::cli::decode) vlan: Option<Vlan>,
    pub(in crate::cli::decode) ether_type: u16,
    /// Its payload, as far as it was captured.
    pub(in crate::cli::decode) octets: &'a [u8],
    /// Octets of the payload that was sent.
    pub(super) length: usize,
}

/// A VLAN tag (P-1): RT frames have priority 6, alarms and DCP may have others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(in crate::cli::decode) struct Vlan {
    id: u16,
    priority: u8,
    drop_eligible: bool,
}

/// The frame in a packet; none if its Ethertype is another one.
pub(in crate::cli::decode) fn frame<'a>(captured: &Captured<'a>) -> Option<Ethernet<'a>> {
    let packet = captured.octets;
    let (from, to, head) = match captured.link {
        Linktype::ETHERNET => (address(packet, 6)?, address(packet, 0), 14),
        // The address has its length in front, and room for eight octets.
        Linktype::LINUX_SLL => (address(packet, 6)?, None, 16),
        Linktype::LINUX_SLL2 => (address(packet, 12)?, None, 20),
        _ => return None,
    };
    let protocol = if captured.link == Linktype::LINUX_SLL2 { 0 } else { head - 2 };
    let mut ether_type = word(packet, protocol)?;
    let (mut vlan, mut octets) = (None, packet.get(head..)?);
    for _ in 0..MOST_TAGS {
        if !TAGS.contains(&ether_type) {
            break;
        }
        vlan = Some(Vlan::of(word(octets, 0)?));
        ether_type = word(octets, 2)?;
        octets = octets.get(4..)?;
    }
    if ![rt::ETHER_TYPE, lldp::ETHER_TYPE, mrp::ETHER_TYPE].contains(&ether_type) {
        return None;
    }
    let length = octets.len() + captured.length.saturating_sub(packet.len());
    Some(Ethernet { from, to, vlan, ether_type, octets, length })
}

fn word(octets: &[u8], at: usize) -> Option<u16> {
    octets.get(at..)?.first_chunk().copied().map(u16::from_be_bytes)
}

fn address(octets: &[u8], at: usize) -> Option<MacAddress> {
    octets.get(at..)?.first_chunk().copied().map(MacAddress)
}

impl Vlan {
    /// The number of the VLAN; 0 where the tag is only there for its priority.
    pub(super) fn id(&self) -> u16 {
        self.id
    }

    fn of(tag: u16) -> Self {
        let (id, drop_eligible) = (tag & 0x0FFF, tag & 0x1000 != 0);
        Self { id, priority: (tag >> 13) as u8, drop_eligible }
    }
}

impl Display for Vlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("VLAN ")?;
        self.id.fmt(f)?;
        f.write_str(" priority ")?;
        self.priority.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(link: Linktype, octets: &[u8]) -> Option<Ethernet<'_>> {
        let length = octets.len() + 5;
        frame(&Captured { number: 1, time: None, link, octets, length })
    }

    #[test]
    fn frames_are_found_behind_tags_and_in_cooked_captures() {
        let (to, from) = ([1, 0x0E, 0xCF, 0, 0, 0], [2, 0, 0, 0, 0, 9]);
        let source = MacAddress(from);
        let ethernet = |middle: &[u8]| [&to[..], &from, middle, b"payload"].concat();
        let plain = ethernet(&[0x88, 0x92]);
        let it = found(Linktype::ETHERNET, &plain).unwrap();
        assert_eq!((it.from, it.to, it.vlan), (source, Some(MacAddress(to)), None));
        assert_eq!((it.ether_type, it.octets, it.length), (0x8892, &b"payload"[..], 12));

        for middle in
            [&[0x81, 0, 0xD0, 7, 0x88, 0xE3][..], &[0x88, 0xA8, 0, 9, 0x81, 0, 0xD0, 7, 0x88, 0xE3]]
        {
            let tagged = ethernet(middle);
            let it = found(Linktype::ETHERNET, &tagged).unwrap();
            let vlan = it.vlan.unwrap();
            assert_eq!((vlan.id, vlan.priority, vlan.drop_eligible), (7, 6, true));
            assert_eq!((it.ether_type, it.octets), (0x88E3, &b"payload"[..]));
        }

        let cooked = [&[0, 0, 0, 1, 0, 6][..], &from, &[0, 0, 0x88, 0xCC], b"payload"].concat();
        let it = found(Linktype::LINUX_SLL, &cooked).unwrap();
        assert_eq!((it.from, it.to, it.ether_type), (source, None, 0x88CC));
        assert_eq!(it.octets, b"payload");
        let cooked =
            [&[0x88, 0xCC, 0, 0, 0, 0, 0, 2, 0, 1, 0, 6][..], &from, &[0, 0], b"payload"].concat();
        let it = found(Linktype::LINUX_SLL2, &cooked).unwrap();
        assert_eq!((it.from, it.ether_type, it.octets), (source, 0x88CC, &b"payload"[..]));
    }

    #[test]
    fn other_frames_and_what_is_cut_off_are_none() {
        let whole = [&[2; 12][..], &[0x81, 0, 0, 7, 0x88, 0x92]].concat();
        assert!(found(Linktype::ETHERNET, &whole).is_some());
        for end in 0..whole.len() {
            assert_eq!(found(Linktype::ETHERNET, &whole[..end]), None);
        }
        assert_eq!(found(Linktype::ETHERNET, &[&[2; 12][..], &[8, 0], &[0; 40]].concat()), None);
        assert_eq!(found(Linktype::RAW, &whole), None);
        // Tags without end.
        assert_eq!(found(Linktype::ETHERNET, &[0x81, 0].repeat(50)), None);
    }
}
