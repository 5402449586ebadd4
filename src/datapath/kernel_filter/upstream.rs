//! The upstream filter: a classic BPF program on an upstream socket refuses what no server sent. It
//! is on only while such datagrams flood the socket. Without it they would take the room that
//! answers to other clients need.
//!
//! The program looks at the sender of a datagram, never at the content. It lets every server of the
//! table through.

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, Ipv4Addr};

use libc::{BPF_ABS, BPF_ALU, BPF_AND, BPF_H, BPF_JEQ, BPF_JGE, BPF_JGT, BPF_K, BPF_LD, BPF_W};

use crate::nat::{NetKind, Table};
use crate::pnet::wire::LAST_NODE;

use crate::datapath::kernel_filter::assembler::{MOST_STEPS, Program, To};

/// Offset of the source port. What the program sees begins with the UDP header.
const SOURCE_PORT: u32 = 0;
/// Offset of the source address, counted from the IPv4 header.
const SOURCE: u32 = libc::SKF_NET_OFF as u32 + 12;

/// The mask of a plant section's network, which is a /24, and that of the address of a single
/// server or of another plant's router.
const SECTION: u32 = 0xffff_ff00;
const SERVER: u32 = 0xffff_ffff;

/// Makes the program that refuses, on an IPv4 socket, what comes from no server of the table. Fails
/// where one program cannot hold all servers.
pub(in crate::datapath) fn program(table: &Table) -> io::Result<Program> {
    let mut networks: BTreeMap<(u16, u16, u32), Vec<u32>> = BTreeMap::new();
    for mapping in table.mappings() {
        let IpAddr::V4(address) = mapping.server.ip() else { continue };
        let port = mapping.server.port();
        let (first, last, mask) = match table.net(mapping.net).kind {
            NetKind::UdpRange { .. } => (port, port, SECTION),
            NetKind::Server => (port, port, SERVER),
            NetKind::Remote { start_port } => {
                (start_port, start_port.saturating_add(LAST_NODE.into()), SERVER)
            }
            NetKind::ProfinetDevice { .. } => (0, u16::MAX, SERVER),
        };
        let network = Ipv4Addr::to_bits(address) & mask;
        let of_ports = networks.entry((first, last, mask)).or_default();
        if !of_ports.contains(&network) {
            of_ports.push(network);
        }
    }
    let steps: usize = networks.values().map(|of_ports| of_ports.len() + 5).sum();
    if steps > MOST_STEPS {
        return Err(io::Error::other("too many plant sections for a program"));
    }
    let mut program = Program::new();
    for ((first, last, mask), networks) in networks {
        let others = |more: u8| To::Skip(networks.len() as u8 + 2 + more);
        program.step(BPF_LD | BPF_H | BPF_ABS, SOURCE_PORT);
        program.compare(BPF_JGE, first.into(), To::Next, others(1));
        program.compare(BPF_JGT, last.into(), others(0), To::Next);
        program.step(BPF_LD | BPF_W | BPF_ABS, SOURCE);
        program.step(BPF_ALU | BPF_AND | BPF_K, mask);
        for network in networks {
            program.compare(BPF_JEQ, network, To::Accept, To::Next);
        }
    }
    Ok(program)
}

#[cfg(test)]
mod tests {
    use std::net::{SocketAddr, UdpSocket};

    use socket2::SockRef;

    use super::*;
    use crate::nat::{Mapping, Net, NetId};
    use crate::pnet::wire::Header;

    fn net(kind: NetKind) -> Net {
        Net { allow_without_password: true, ..Net::new("", kind) }
    }

    fn mapping(net: u16, server: SocketAddr) -> Mapping {
        let (node_address, public_port) = (1, 1);
        Mapping { net: NetId(net), node_address, local_address: None, public_port, server }
    }

    /// A socket on a free port of loopback.
    fn peer(address: &str) -> UdpSocket {
        UdpSocket::bind((address, 0)).unwrap()
    }

    #[test]
    fn servers_get_through_and_nobody_else() {
        let (section, press) = (peer("127.88.17.3"), peer("127.88.18.7"));
        let range = peer("127.88.20.5");
        let start_port = range.local_addr().unwrap().port() - 3;
        let nets = vec![
            net(NetKind::UdpRange { start_port: 1 }),
            net(NetKind::Server),
            net(NetKind::Remote { start_port }),
        ];
        let mappings = vec![
            mapping(2, ("127.88.20.5".parse::<Ipv4Addr>().unwrap(), start_port + 1).into()),
            mapping(0, section.local_addr().unwrap()),
            mapping(1, press.local_addr().unwrap()),
            mapping(1, "[::1]:34379".parse().unwrap()),
        ];
        let socket = peer("127.0.0.1");
        socket.set_nonblocking(true).unwrap();
        let to = socket.local_addr().unwrap();
        let table = Table::new(Header::default(), nets, mappings);
        program(&table).unwrap().attach(&SockRef::from(&socket)).unwrap();
        let gets_through = |from: &UdpSocket| {
            from.send_to(b"answer", to).unwrap();
            // On loopback, a datagram has either arrived or been refused when its send returns.
            socket.recv(&mut [0; 8]).is_ok()
        };
        let at = |address: &str, like: &UdpSocket| {
            UdpSocket::bind((address, like.local_addr().unwrap().port())).unwrap()
        };
        assert!(gets_through(&section) && gets_through(&press));
        assert!(gets_through(&range), "another port of another plant's router");
        assert!(!gets_through(&at("127.88.20.6", &range)), "a neighbour of that router");
        assert!(gets_through(&at("127.88.17.4", &section)), "another node of the section");
        assert!(!gets_through(&at("127.88.18.8", &press)), "a neighbour of a single server");
        assert!(!gets_through(&at("127.88.19.3", &section)), "another network");
        assert!(!gets_through(&peer("127.88.17.3")), "another port");
        assert!(!gets_through(&peer("127.0.0.1")));
    }

    #[test]
    fn where_there_are_too_many_sections_there_is_no_program() {
        let table = |sections: u16| {
            let server = |n: u16| SocketAddr::from(([10, (n >> 8) as u8, n as u8, 1], 34379));
            let mappings = (0..sections).map(|n| mapping(0, server(n))).collect();
            Table::new(Header::default(), vec![net(NetKind::UdpRange { start_port: 1 })], mappings)
        };
        assert!(program(&table(250)).is_ok());
        assert!(program(&table(251)).is_err());
    }
}
