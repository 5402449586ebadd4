//! What the programs in the kernel read and write: keys and entries of the map of flows, and where the
//! counters are.
//!
//! An entry is one direction of a flow. Its key is found in a datagram as it comes in, and it says how the
//! datagram has to look when it leaves. Programs never write to an entry.

use std::net::SocketAddrV4;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicU32, AtomicU64};

use crate::nat::{Direction, SharedFlow};

/// What the kernel and a worker share of one flow.
#[derive(Debug, Default)]
#[repr(C)]
pub(in crate::datapath) struct KernelFlow {
    pub(super) shared: SharedFlow,
    /// How the datagrams of each direction leave.
    pub(super) ways: [WayOut; 2],
}

/// How the last datagram of a direction left that went the long way: through firewall, worker and routing.
#[derive(Debug, Default)]
#[repr(C)]
pub(super) struct WayOut {
    /// Until when datagrams may take the short way, in nanoseconds since the relay's start.
    pub(super) lease: AtomicU64,
    /// Destination and source of the Ethernet frame.
    pub(super) hardware: [AtomicU32; 3],
    /// The index of the interface.
    pub(super) interface: AtomicU32,
    /// The one password that passes. It is here, and not in the entry, because here it can be wiped.
    pub(super) password: AtomicU64,
}

impl KernelFlow {
    /// Sets the password of both directions.
    pub(super) fn set_password(&self, octets: [u8; 8]) {
        let password = u64::from_ne_bytes(octets);
        self.ways.iter().for_each(|way| way.password.store(password, Relaxed));
    }

    /// Nothing passes any more, and the password is gone.
    pub(super) fn wipe(&self) {
        self.end_leases();
        self.set_password([0; 8]);
    }

    /// Nothing passes until a datagram has taken the long way.
    pub(super) fn end_leases(&self) {
        self.ways.iter().for_each(|way| way.lease.store(0, Relaxed));
    }
}

/// Addresses and ports of a datagram, in the order and the octets of its headers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Key {
    pub(super) source: SocketAddrV4,
    pub(super) destination: SocketAddrV4,
}

impl Key {
    pub(super) const LEN: usize = 12;

    pub(super) fn to_octets(self) -> [u8; Self::LEN] {
        let Self { source, destination } = self;
        let mut octets = [0; Self::LEN];
        octets[..4].copy_from_slice(&source.ip().octets());
        octets[4..8].copy_from_slice(&destination.ip().octets());
        octets[8..].copy_from_slice(&ports(source, destination));
        octets
    }
}

fn ports(source: SocketAddrV4, destination: SocketAddrV4) -> [u8; 4] {
    let [[a, b], [c, d]] = [source.port(), destination.port()].map(u16::to_be_bytes);
    [a, b, c, d]
}

/// Who takes part in a flow.
pub(super) struct Ends {
    pub(super) client: SocketAddrV4,
    pub(super) public: SocketAddrV4,
    pub(super) upstream: SocketAddrV4,
    pub(super) server: SocketAddrV4,
}

/// What both directions of a flow have in common.
#[derive(Clone, Copy)]
pub(super) struct Terms {
    pub(super) header: [u8; 4],
    /// The node that a request has to name.
    pub(super) node_address: u8,
    /// Its place in the map of [`KernelFlow`]s.
    pub(super) flow: u32,
    /// Where the node and the credential are counted.
    pub(super) node: u32,
    pub(super) credential: u32,
}

/// One direction of a flow.
pub(super) struct Entry {
    pub(super) comes: Key,
    pub(super) leaves: Key,
    direction: Direction,
    terms: Terms,
}

/// Offsets in an entry. Numbers are in the byte order of the processor, what stands in headers in theirs.
pub(super) mod entry {
    /// Source and destination.
    pub(in crate::datapath::offload) const ADDRESSES: i16 = 0;
    pub(in crate::datapath::offload) const PORTS: i16 = 8;
    pub(in crate::datapath::offload) const HEADER: i16 = 12;
    /// What is added to the UDP checksum for the addresses, and for the ports.
    pub(in crate::datapath::offload) const ADDRESSES_CHANGE: i16 = 16;
    pub(in crate::datapath::offload) const PORTS_CHANGE: i16 = 20;
    /// The sum over the new IP header without its total length.
    pub(in crate::datapath::offload) const IP_SUM: i16 = 24;
    pub(in crate::datapath::offload) const FLOW: i16 = 28;
    pub(in crate::datapath::offload) const NODE: i16 = 32;
    pub(in crate::datapath::offload) const CREDENTIAL: i16 = 36;
    /// The second octet of the route; for a response, [`ANY_NODE`].
    pub(in crate::datapath::offload) const NODE_ADDRESS: i16 = 40;
    pub(in crate::datapath::offload) const DIRECTION: i16 = 41;
    pub(in crate::datapath::offload) const LEN: usize = 44;

    /// No node address: an octet of a source.
    pub(in crate::datapath::offload) const ANY_NODE: u8 = 0xFF;
}

/// The first words of an IP header that the relay sends: no options, not to be fragmented, a new time to
/// live, UDP.
pub(super) const VERSION_AND_SERVICE: [u8; 2] = [0x45, 0];
pub(super) const NUMBER_AND_FRAGMENT: [u8; 4] = [0, 0, 0x40, 0];
pub(super) const LIFE_AND_PROTOCOL: [u8; 2] = [64, 17];

impl Entry {
    /// Both directions of a flow, by [`Direction`].
    pub(super) fn both(ends: &Ends, terms: Terms) -> [Self; 2] {
        let Ends { client, public, upstream, server } = *ends;
        let key = |source, destination| Key { source, destination };
        let entry = |direction, comes, leaves| Self { comes, leaves, direction, terms };
        [
            entry(Direction::Request, key(client, public), key(upstream, server)),
            entry(Direction::Response, key(server, upstream), key(public, client)),
        ]
    }

    pub(super) fn to_octets(&self) -> [u8; entry::LEN] {
        let Self { comes, leaves, terms, .. } = self;
        let [was, is] = [comes, leaves].map(|key| key.to_octets());
        let mut all = [0; entry::LEN];
        let mut put = |at: i16, octets: &[u8]| {
            all[at as usize..][..octets.len()].copy_from_slice(octets);
        };
        put(entry::ADDRESSES, &is[..8]);
        put(entry::PORTS, &is[8..]);
        put(entry::HEADER, &terms.header);
        put(entry::ADDRESSES_CHANGE, &change(&was[..8], &is[..8]).to_ne_bytes());
        put(entry::PORTS_CHANGE, &change(&was[8..], &is[8..]).to_ne_bytes());
        let fixed = [&VERSION_AND_SERVICE[..], &NUMBER_AND_FRAGMENT, &LIFE_AND_PROTOCOL, &is[..8]];
        put(entry::IP_SUM, &sum(&fixed.concat()).to_ne_bytes());
        put(entry::FLOW, &terms.flow.to_ne_bytes());
        put(entry::NODE, &terms.node.to_ne_bytes());
        put(entry::CREDENTIAL, &terms.credential.to_ne_bytes());
        let node_address = match self.direction {
            Direction::Request => terms.node_address,
            Direction::Response => entry::ANY_NODE,
        };
        put(entry::NODE_ADDRESS, &[node_address]);
        put(entry::DIRECTION, &[self.direction as u8]);
        all
    }
}

/// The sum of 16-bit words, as RFC 1071 has it: in the byte order of the processor, which does not matter.
fn sum(octets: &[u8]) -> u32 {
    let words =
        octets.chunks_exact(2).map(|word| u32::from(u16::from_ne_bytes([word[0], word[1]])));
    words.sum()
}

/// What is added to a checksum when these octets take the place of those (RFC 1624).
fn change(was: &[u8], is: &[u8]) -> u32 {
    let not = |octets: &[u8]| -> Vec<u8> { octets.iter().map(|octet| !octet).collect() };
    sum(&not(was)) + sum(is)
}
