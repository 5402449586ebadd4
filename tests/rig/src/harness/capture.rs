//! Captures the packets of one network namespace, with their UDP payloads.
//!
//! The kernel hands a packet to the capture before it hands it to the receiver. So the capture is
//! complete as soon as the receiver has seen the last packet.

use std::io::{ErrorKind, Read};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use socket2::{Domain, Protocol, Socket, Type};

/// Every protocol, in network byte order: <linux/if_ether.h>.
const ETH_P_ALL: i32 = 0x0003_u16.to_be() as i32;
const ICMP: u8 = 1;
const UDP: u8 = 17;
const ICMP_V6: u8 = 58;

/// A captured packet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Packet {
    /// A UDP datagram.
    Udp {
        /// Its source.
        from: SocketAddr,
        /// Its destination.
        to: SocketAddr,
        /// Its payload.
        octets: Vec<u8>,
    },
    /// An ICMP message which says that nobody listens on a port.
    PortUnreachable {
        /// Its source.
        from: IpAddr,
        /// Its destination.
        to: IpAddr,
    },
    /// Any other ICMP message.
    Icmp {
        /// Its source.
        from: IpAddr,
        /// Its destination.
        to: IpAddr,
        /// Its type, as ICMP or ICMPv6 numbers them.
        kind: u8,
    },
}

/// A capture that is running.
#[derive(Debug)]
pub struct Capture {
    seen: Arc<Mutex<Vec<Packet>>>,
    ended: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

impl Capture {
    /// Begins a capture in the calling thread's network namespace.
    pub fn start() -> Self {
        let protocol = Some(Protocol::from(ETH_P_ALL));
        let socket = Socket::new(Domain::PACKET, Type::DGRAM, protocol).unwrap();
        socket.set_recv_buffer_size(4 << 20).unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        let (seen, ended) = (Arc::default(), Arc::new(AtomicBool::new(false)));
        let (list, end) = (Arc::clone(&seen), Arc::clone(&ended));
        let reader = thread::spawn(move || take_down(socket, &list, &end));
        Self { seen, ended, reader: Some(reader) }
    }

    /// The packets captured so far. The newest ones may still be missing.
    pub fn so_far(&self) -> Vec<Packet> {
        self.seen.lock().unwrap().clone()
    }

    /// Ends the capture and returns all packets.
    pub fn end(mut self) -> Vec<Packet> {
        self.ended.store(true, Relaxed);
        self.reader.take().unwrap().join().unwrap();
        self.so_far()
    }
}

impl Drop for Capture {
    fn drop(&mut self) {
        self.ended.store(true, Relaxed);
    }
}

fn take_down(mut socket: Socket, seen: &Mutex<Vec<Packet>>, ended: &AtomicBool) {
    let mut octets = [0; 2048];
    loop {
        // The end is checked before the read, so that packets that came before the end are still
        // read.
        let last = ended.load(Relaxed);
        match socket.read(&mut octets) {
            Ok(length) => seen.lock().unwrap().extend(Packet::parse(&octets[..length])),
            Err(error) if error.kind() == ErrorKind::WouldBlock && last => return,
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            // An interface went down, or a process was stopped or traced in the meantime.
            Err(error)
                if matches!(error.kind(), ErrorKind::NetworkDown | ErrorKind::Interrupted) => {}
            Err(error) => panic!("{error}"),
        }
    }
}

impl Packet {
    /// Reads UDP and ICMP packets. The others only help hosts to find each other.
    fn parse(octets: &[u8]) -> Option<Self> {
        let (from, to, protocol, body): (IpAddr, IpAddr, u8, &[u8]) = match octets[0] >> 4 {
            4 => {
                let address = |at: usize| Ipv4Addr::from(*octets[at..].first_chunk().unwrap());
                let header = usize::from(octets[0] & 0x0F) * 4;
                (address(12).into(), address(16).into(), octets[9], &octets[header..])
            }
            6 => {
                let address = |at: usize| Ipv6Addr::from(*octets[at..].first_chunk().unwrap());
                (address(8).into(), address(24).into(), octets[6], &octets[40..])
            }
            _ => return None, // ARP
        };
        match (protocol, body) {
            (UDP, _) => {
                let field = |at: usize| u16::from_be_bytes([body[at], body[at + 1]]);
                let octets = body[8..usize::from(field(4))].to_vec();
                let (from, to) = ((from, field(0)).into(), (to, field(2)).into());
                Some(Self::Udp { from, to, octets })
            }
            (ICMP, [3, 3, ..]) | (ICMP_V6, [1, 4, ..]) => Some(Self::PortUnreachable { from, to }),
            // The types from 130 on serve to find neighbours and routers in IPv6.
            (ICMP_V6, [130..=255, ..]) => None,
            (ICMP | ICMP_V6, &[kind, ..]) => Some(Self::Icmp { from, to, kind }),
            _ => None,
        }
    }

    /// The UDP payload.
    pub fn octets(&self) -> &[u8] {
        match self {
            Self::Udp { octets, .. } => octets,
            _ => panic!("{self:?} is no datagram"),
        }
    }
}
