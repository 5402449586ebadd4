//! From a captured packet to the UDP datagram in it: link layer, IPv4 or IPv6, UDP.

use std::net::{IpAddr, SocketAddr};

use etherparse::{EtherType, LaxNetSlice, LaxSlicedPacket, TransportSlice, UdpHeader};
use pcap_parser::Linktype;

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

/// The datagram in `packet`; none for another protocol, a fragment, or a packet that is too short.
pub(super) fn datagram(link: Linktype, packet: &[u8]) -> Result<Option<Udp<'_>>, UnknownLink> {
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
    Ok(layers.and_then(udp))
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

fn udp(layers: LaxSlicedPacket<'_>) -> Option<Udp<'_>> {
    let (from, to): (IpAddr, IpAddr) = match layers.net? {
        LaxNetSlice::Ipv4(ip) => {
            (ip.header().source_addr().into(), ip.header().destination_addr().into())
        }
        LaxNetSlice::Ipv6(ip) => {
            (ip.header().source_addr().into(), ip.header().destination_addr().into())
        }
        LaxNetSlice::Arp(_) => return None,
    };
    let Some(TransportSlice::Udp(udp)) = layers.transport else { return None };
    Some(Udp {
        from: (from, udp.source_port()).into(),
        to: (to, udp.destination_port()).into(),
        octets: udp.payload(),
        length: usize::from(udp.length()).checked_sub(UdpHeader::LEN)?,
    })
}

#[cfg(test)]
mod tests {
    use etherparse::PacketBuilder;

    use super::*;

    const OCTETS: &[u8] = b"some octets";

    fn v4() -> Vec<u8> {
        let builder = PacketBuilder::ipv4([198, 51, 100, 20], [203, 0, 113, 5], 64);
        let mut packet = Vec::new();
        builder.udp(50000, 40003).write(&mut packet, OCTETS).unwrap();
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

    fn found(link: Linktype, packet: &[u8]) -> String {
        let udp = datagram(link, packet).unwrap().unwrap();
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
            (Linktype::LINUX_SLL, behind(&sll(&[8, 0]), v4())),
            (Linktype::LINUX_SLL2, behind(&sll2(&[8, 0]), v4())),
        ] {
            assert_eq!(found(link, &packet), "198.51.100.20:50000 > 203.0.113.5:40003", "{link}");
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
        let udp = datagram(Linktype::RAW, &packet[..packet.len() - 4]).unwrap().unwrap();
        assert_eq!((udp.octets, udp.length), (&OCTETS[..7], OCTETS.len()));
        for len in 0..28 {
            assert_eq!(datagram(Linktype::RAW, &packet[..len]), Ok(None), "{len}");
        }
    }

    #[test]
    fn what_is_no_udp_datagram_is_left_out() {
        let (mut fragment, mut tcp, mut short) = (v4(), v4(), v4());
        fragment[6] |= 0x20; // more fragments
        tcp[9] = 6;
        short[24..26].fill(0); // a UDP length below that of its header
        for packet in [fragment, tcp, short] {
            assert_eq!(datagram(Linktype::RAW, &packet), Ok(None));
        }
        assert_eq!(datagram(Linktype(127), &v4()), Err(UnknownLink));
    }
}
