//! Captures written by hand, in pcap format, with a raw IPv4 packet for each UDP datagram.

use std::net::{Ipv4Addr, SocketAddrV4};

/// The link type of packets that begin with their IP header.
const RAW: u32 = 101;

/// The header of a pcap file.
pub fn header() -> Vec<u8> {
    let magic_and_version = [0xD4, 0xC3, 0xB2, 0xA1, 2, 0, 4, 0];
    let rest = [0, 0, 65535, RAW].map(u32::to_le_bytes);
    [&magic_and_version, rest.as_flattened()].concat()
}

/// A packet in a pcap file. The file has only its first `captured` octets.
pub fn frame(packet: &[u8], captured: usize) -> Vec<u8> {
    let front = [1_790_000_000, 7, captured as u32, packet.len() as u32].map(u32::to_le_bytes);
    [front.as_flattened(), &packet[..captured]].concat()
}

/// A UDP datagram in an IPv4 packet, from 198.51.100.20:50000 to this port of 203.0.113.5.
pub fn udp(port: u16, payload: &[u8]) -> Vec<u8> {
    let ends = (Ipv4Addr::new(198, 51, 100, 20), Ipv4Addr::new(203, 0, 113, 5));
    packet(SocketAddrV4::new(ends.0, 50000), SocketAddrV4::new(ends.1, port), payload)
}

/// A UDP datagram in an IPv4 packet.
pub(super) fn packet(from: SocketAddrV4, to: SocketAddrV4, payload: &[u8]) -> Vec<u8> {
    let length = 8 + payload.len() as u16;
    let ip = [0x45, 0, 0, 0, 0, 0, 0, 0, 64, 17, 0, 0];
    let udp = [from.port(), to.port(), length, 0].map(u16::to_be_bytes);
    let addresses = [from.ip().octets(), to.ip().octets()];
    let mut packet = [&ip, addresses.as_flattened(), udp.as_flattened(), payload].concat();
    packet[2..4].copy_from_slice(&(20 + length).to_be_bytes());
    packet
}

/// A capture of these payloads. Each is sent to the port next to it.
pub fn pcap<'a>(payloads: impl IntoIterator<Item = (u16, &'a [u8])>) -> Vec<u8> {
    let packets = payloads.into_iter().map(|(port, payload)| udp(port, payload));
    packets.fold(header(), |file, packet| [file, frame(&packet, packet.len())].concat())
}
