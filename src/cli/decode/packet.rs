//! From a captured packet to the UDP datagram in it, or to a fragment of one: link layer, IPv4 or IPv6, UDP.

use std::net::{IpAddr, SocketAddr};

use etherparse::{
    EtherType, IpNumber, Ipv6ExtensionSlice, LaxIpv4Slice, LaxIpv6Slice, LaxNetSlice,
    LaxSlicedPacket, TransportSlice, UdpHeader, UdpSlice,
};
use pcap_parser::Linktype;

use super::fragments::{Fragment, Identity};

/// What a packet has of UDP.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Found<'a> {
    Datagram(Udp<'a>),
    Fragment(Fragment<'a>),
}

/// A UDP datagram in a capture.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Udp<'a> {
    pub(super) from: SocketAddr,
    pub(super) to: SocketAddr,
    /// Its payload, as far as it was captured.
    pub(super) octets: &'a [u8],
    /// Octets of the payload that was sent.
    pub(super) length: usize,
}

/// A link type that this program does not know.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct UnknownLink;

/// What is in `packet`; none for another protocol, or a packet that is too short.
pub(super) fn find(link: Linktype, packet: &[u8]) -> Result<Option<Found<'_>>, UnknownLink> {
    // Other numbers of raw IP, used by some systems.
    const RAW_12: Linktype = Linktype(12);
    const RAW_14: Linktype = Linktype(14);
    let layers = match link {
        Linktype::ETHERNET => LaxSlicedPacket::from_ethernet(packet).ok(),
        Linktype::RAW | Linktype::IPV4 | Linktype::IPV6 | RAW_12 | RAW_14 => ip(packet),
        // Loopback: after four octets with the address family, which the IP version shows too.
        Linktype::NULL | Linktype::LOOP => packet.get(4..).and_then(ip),
        Linktype::LINUX_SLL => cooked(packet, 14, 16),
        Linktype::LINUX_SLL2 => cooked(packet, 0, 20),
        _ => return Err(UnknownLink),
    };
    Ok(layers.and_then(found))
}

fn ip(packet: &[u8]) -> Option<LaxSlicedPacket<'_>> {
    LaxSlicedPacket::from_ip(packet).ok()
}

/// Linux cooked capture: `header` is the length of its header, `protocol` the offset of the protocol.
fn cooked(packet: &[u8], protocol: usize, header: usize) -> Option<LaxSlicedPacket<'_>> {
    let behind = packet.get(header..)?;
    let protocol = u16::from_be_bytes(*packet.get(protocol..)?.first_chunk()?);
    Some(LaxSlicedPacket::from_ether_type(EtherType(protocol), behind))
}

fn found(layers: LaxSlicedPacket<'_>) -> Option<Found<'_>> {
    let (from, to, fragment): (IpAddr, IpAddr, _) = match &layers.net {
        Some(LaxNetSlice::Ipv4(ip)) => {
            let header = ip.header();
            (header.source_addr().into(), header.destination_addr().into(), fragment_v4(ip))
        }
        Some(LaxNetSlice::Ipv6(ip)) => {
            let header = ip.header();
            (header.source_addr().into(), header.destination_addr().into(), fragment_v6(ip))
        }
        Some(LaxNetSlice::Arp(_)) | None => return None,
    };
    if let Some(fragment) = fragment {
        return Some(Found::Fragment(fragment));
    }
    let Some(TransportSlice::Udp(udp)) = &layers.transport else { return None };
    Some(Found::Datagram(Udp::of(from, to, udp)?))
}

fn fragment_v4<'a>(ip: &LaxIpv4Slice<'a>) -> Option<Fragment<'a>> {
    let (header, payload) = (ip.header(), ip.payload());
    (payload.fragmented && payload.ip_number == IpNumber::UDP).then(|| Fragment {
        whole: Identity {
            from: header.source_addr().into(),
            to: header.destination_addr().into(),
            identification: header.identification().into(),
        },
        offset: header.fragments_offset(),
        more_follow: header.more_fragments(),
        octets: payload.payload,
        is_complete: !payload.incomplete,
    })
}

fn fragment_v6<'a>(ip: &LaxIpv6Slice<'a>) -> Option<Fragment<'a>> {
    let (header, payload) = (ip.header(), ip.payload());
    if !payload.fragmented || payload.ip_number != IpNumber::UDP {
        return None;
    }
    ip.extensions().clone().into_iter().find_map(|extension| match extension {
        Ipv6ExtensionSlice::Fragment(fragment) => Some(Fragment {
            whole: Identity {
                from: header.source_addr().into(),
                to: header.destination_addr().into(),
                identification: fragment.identification(),
            },
            offset: fragment.fragment_offset(),
            more_follow: fragment.more_fragments(),
            octets: payload.payload,
            is_complete: !payload.incomplete,
        }),
        _ => None,
    })
}

impl<'a> Udp<'a> {
    /// The datagram between these two; none when its length is below that of its header.
    pub(super) fn of(from: IpAddr, to: IpAddr, udp: &UdpSlice<'a>) -> Option<Self> {
        Some(Self {
            from: (from, udp.source_port()).into(),
            to: (to, udp.destination_port()).into(),
            octets: udp.payload(),
            length: usize::from(udp.length()).checked_sub(UdpHeader::LEN)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use etherparse::PacketBuilder;

    use super::*;

    const OCTETS: &[u8] = b"some octets";

    fn v4() -> Vec<u8> {
        let builder = PacketBuilder::ipv4([198, 51, 100, 20], [203, 0, 113, 5], 64);
        let mut packet = Vec::new();
        builder.udp(50000, 20003).write(&mut packet, OCTETS).unwrap();
        packet
    }

    fn v6() -> Vec<u8> {
        let [mut from, mut to] = [[0; 16]; 2];
        (from[15], to[15]) = (1, 2);
        let mut packet = Vec::new();
        let builder = PacketBuilder::ipv6(from, to, 64).udp(50000, 34379);
        builder.write(&mut packet, OCTETS).unwrap();
        packet
    }

    fn datagram(link: Linktype, packet: &[u8]) -> Option<Udp<'_>> {
        match find(link, packet).unwrap()? {
            Found::Datagram(udp) => Some(udp),
            Found::Fragment(fragment) => panic!("{fragment:?}"),
        }
    }

    fn found(link: Linktype, packet: &[u8]) -> String {
        let udp = datagram(link, packet).unwrap();
        assert_eq!((udp.octets, udp.length), (OCTETS, OCTETS.len()));
        format!("{} > {}", udp.from, udp.to)
    }

    #[test]
    fn the_payload_is_found_behind_every_link_layer() {
        let behind = |front: &[u8], packet: Vec<u8>| [front, &packet].concat();
        let ethernet = |protocol: &[u8]| [&[0x02; 12], protocol].concat();
        let sll = |protocol: &[u8]| [&[0; 14], protocol].concat();
        let sll2 = |protocol: &[u8]| [protocol, &[0; 18]].concat();
        for (link, packet) in [
            (Linktype::RAW, v4()),
            (Linktype(12), v4()),
            (Linktype::IPV4, v4()),
            (Linktype::NULL, behind(&[2, 0, 0, 0], v4())),
            (Linktype::LOOP, behind(&[0, 0, 0, 2], v4())),
            (Linktype::ETHERNET, behind(&ethernet(&[8, 0]), v4())),
            // One VLAN tag, and the padding of a short frame.
            (
                Linktype::ETHERNET,
                behind(&ethernet(&[0x81, 0, 0, 7, 8, 0]), [v4(), vec![0; 9]].concat()),
            ),
            // Two tags.
            (Linktype::ETHERNET, behind(&ethernet(&[0x88, 0xA8, 0, 7, 0x81, 0, 0, 8, 8, 0]), v4())),
            (Linktype::LINUX_SLL, behind(&sll(&[8, 0]), v4())),
            (Linktype::LINUX_SLL, behind(&sll(&[0x81, 0, 0, 7, 8, 0]), v4())),
            (Linktype::LINUX_SLL2, behind(&sll2(&[8, 0]), v4())),
            (Linktype::LINUX_SLL2, behind(&sll2(&[0x81, 0]), behind(&[0, 7, 8, 0], v4()))),
        ] {
            assert_eq!(found(link, &packet), "198.51.100.20:50000 > 203.0.113.5:20003", "{link}");
        }
        for (link, packet) in [
            (Linktype::RAW, v6()),
            (Linktype::IPV6, v6()),
            (Linktype::NULL, behind(&[30, 0, 0, 0], v6())),
            (Linktype::ETHERNET, behind(&ethernet(&[0x86, 0xDD]), v6())),
            (Linktype::LINUX_SLL, behind(&sll(&[0x86, 0xDD]), v6())),
            (Linktype::LINUX_SLL2, behind(&sll2(&[0x86, 0xDD]), v6())),
        ] {
            assert_eq!(found(link, &packet), "[::1]:50000 > [::2]:34379", "{link}");
        }
    }

    #[test]
    fn a_packet_captured_in_part_has_the_length_that_was_sent() {
        let packet = v4();
        let udp = datagram(Linktype::RAW, &packet[..packet.len() - 4]).unwrap();
        assert_eq!((udp.octets, udp.length), (&OCTETS[..7], OCTETS.len()));
        for len in 0..28 {
            assert_eq!(datagram(Linktype::RAW, &packet[..len]), None, "{len}");
        }
    }

    #[test]
    fn what_is_no_udp_datagram_is_left_out() {
        let (mut tcp, mut tcp_fragment, mut short) = (v4(), v4(), v4());
        tcp[9] = 6;
        tcp_fragment[9] = 6;
        tcp_fragment[6] |= 0x20; // more fragments
        short[24..26].fill(0); // a UDP length below that of its header
        for packet in [tcp, tcp_fragment, short] {
            assert_eq!(datagram(Linktype::RAW, &packet), None);
        }
        assert_eq!(find(Linktype(127), &v4()), Err(UnknownLink));
    }

    #[test]
    fn a_fragment_has_its_place_in_the_datagram() {
        let fragment = |packet| match find(Linktype::RAW, packet).unwrap() {
            Some(Found::Fragment(fragment)) => fragment,
            other => panic!("{other:?}"),
        };
        let mut packet = v4();
        packet[4..8].copy_from_slice(&[0x12, 0x34, 0x20, 2]); // identification, more, offset 16
        let Fragment { whole, offset, more_follow, octets, is_complete } = fragment(&packet);
        let [from, to] = ["198.51.100.20", "203.0.113.5"].map(|text| text.parse().unwrap());
        assert_eq!(whole, Identity { from, to, identification: 0x1234 });
        assert_eq!((offset.byte_offset(), more_follow, is_complete), (16, true, true));
        assert_eq!(octets, &packet[20..]);
        assert!(!fragment(&packet[..30]).is_complete);

        let mut packet = v6();
        packet.splice(40..40, [17, 0, 0, 16 | 1, 0, 0, 0x12, 0x34]); // offset 16, more
        (packet[5], packet[6]) = (packet[5] + 8, 44);
        let Fragment { whole, offset, more_follow, octets, is_complete } = fragment(&packet);
        let [from, to] = ["::1", "::2"].map(|text| text.parse().unwrap());
        assert_eq!(whole, Identity { from, to, identification: 0x1234 });
        assert_eq!((offset.byte_offset(), more_follow, is_complete), (16, true, true));
        assert_eq!(octets, &packet[48..]);
        // A fragment header without need (RFC 6946).
        packet[43] = 0;
        assert_eq!(found(Linktype::RAW, &packet), "[::1]:50000 > [::2]:34379");
    }
}
