//! Chooses the ports of the upstream sockets.
//!
//! The relay picks them itself, at random (RFC 6056), from the ports that the router's system lends
//! to programs. It picks none that belongs to the NAT table: otherwise a later configuration could
//! not listen on that port. The relay reads once what the system lends, because the confinement
//! hides that later.

use std::fs;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::SeqCst};

use socket2::Socket;

use crate::config::Config;
use crate::nat::NetKind;
use crate::pnet::wire::{NORMAL_PORT, SECURE_PORT, SNA};

const WORDS: usize = 1 << 10;

/// Linux's default of `ip_local_port_range`, for when the setting cannot be read.
pub(crate) const USUAL_PORT_RANGE: RangeInclusive<u16> = 32_768..=60_999;

/// How many ports of other programs are tried before the relay reports that no port is left.
const TRIES: usize = 128;

/// P-NET's own ports. They stay free because a node may be started on this machine.
const P_NET: RangeInclusive<u16> = NORMAL_PORT..=SECURE_PORT;

/// The last port of a block, counted from its start port. It stands for a broadcast address.
const BLOCK_END: u16 = SNA as u16;

/// The ports of the upstream sockets of all workers.
#[derive(Debug)]
pub(in crate::datapath) struct Ports {
    host: Host,
    /// The ports that may be taken under the configurations that were named last.
    allowed: PortSet,
    /// The ports that upstream sockets have.
    taken: PortSet,
}

/// A port that belongs to the relay until this value is dropped. Drop its socket first.
#[derive(Debug)]
pub(in crate::datapath) struct Port {
    ports: Arc<Ports>,
    number: u16,
}

/// What the system says about its ports.
#[derive(Debug)]
struct Host {
    /// The ports that it lends to programs that ask for any port.
    lent: Vec<RangeInclusive<u16>>,
    /// The ports that it lends to nobody.
    reserved: Vec<RangeInclusive<u16>>,
    /// A port below this one needs a privilege.
    lowest: u16,
}

impl Ports {
    /// The ports of this machine without those that the configuration needs itself. Call this
    /// before the confinement, because it reads files that the confinement hides.
    pub(in crate::datapath) fn new(config: &Config) -> Self {
        // In a static program the system's random generator is a file. This call opens it for later
        // use.
        let _ = getrandom::u32();
        Self::of_host(Host::read(), config)
    }

    fn of_host(host: Host, config: &Config) -> Self {
        let ports = Self { host, allowed: PortSet::default(), taken: PortSet::default() };
        ports.keep_out_of(&[config]);
        ports
    }

    /// From now on, no upstream socket is opened on a port that one of these configurations needs.
    /// A socket that is open already may have such a port: see [`is_taken`](Self::is_taken).
    pub(in crate::datapath) fn keep_out_of(&self, configs: &[&Config]) {
        let allowed = |ports: &[RangeInclusive<u16>]| {
            let allowed = PortSet::default();
            for range in ports {
                let (first, last) = (*range.start(), *range.end());
                (first.max(self.host.lowest)..=last).for_each(|port| _ = allowed.insert(port));
            }
            let needed = configs.iter().flat_map(|config| needed(config));
            for port in self.host.reserved.iter().cloned().chain(needed).flatten() {
                allowed.remove(port);
            }
            allowed
        };
        let mut next = allowed(&self.host.lent);
        if next.is_empty() {
            tracing::warn!(
                "every port that the host lends belongs to a block or is reserved: sockets \
                 towards the servers take others; see sysctl net.ipv4.ip_local_port_range"
            );
            next = allowed(&[1..=u16::MAX]);
        }
        for (word, next) in self.allowed.0.iter().zip(next.0.iter()) {
            word.store(next.load(SeqCst), SeqCst);
        }
    }

    /// Whether an upstream socket has this port or is about to get it.
    #[inline]
    pub(in crate::datapath) fn is_taken(&self, port: u16) -> bool {
        self.taken.contains(port)
    }

    /// Binds the socket to a random port. An error of the kind `AddrInUse` means that no port is
    /// left.
    pub(in crate::datapath) fn bind(
        self: &Arc<Self>,
        socket: &Socket,
        address: IpAddr,
    ) -> io::Result<Port> {
        for _ in 0..TRIES {
            let Some(port) = self.take()? else { break };
            match socket.bind(&SocketAddr::new(address, port.number).into()) {
                Ok(()) => return Ok(port),
                Err(error) if error.kind() == io::ErrorKind::AddrInUse => {}
                Err(error) => return Err(error),
            }
        }
        let none = "no port is left; see sysctl net.ipv4.ip_local_port_range";
        Err(io::Error::new(io::ErrorKind::AddrInUse, none))
    }

    fn take(self: &Arc<Self>) -> io::Result<Option<Port>> {
        loop {
            let free = |word: usize| self.allowed.word(word) & !self.taken.word(word);
            let count: u32 = (0..WORDS).map(|word| free(word).count_ones()).sum();
            if count == 0 {
                return Ok(None);
            }
            let random = u64::from(getrandom::u32()?);
            let mut nth = ((random * u64::from(count)) >> 32) as u32;
            let found = (0..WORDS).find_map(|word| {
                let free = free(word);
                let here = free.count_ones();
                if nth < here {
                    return Some(64 * word as u16 + nth_one(free, nth));
                }
                nth -= here;
                None
            });
            // There is none when other workers were faster. A reload first forbids a port and then
            // checks whether it is taken. So a worker first takes a port and then checks whether it
            // is allowed: one of the two sees the other.
            let Some(number) = found.filter(|&number| self.taken.insert(number)) else { continue };
            let port = Port { ports: Arc::clone(self), number };
            if self.allowed.contains(number) {
                return Ok(Some(port));
            }
        }
    }
}

impl Port {
    pub(in crate::datapath) fn number(&self) -> u16 {
        self.number
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        self.ports.taken.remove(self.number);
    }
}

/// The ports that a configuration needs on this machine.
fn needed(config: &Config) -> impl Iterator<Item = RangeInclusive<u16>> {
    let blocks = config.table.nets().iter().filter_map(|net| match net.kind {
        NetKind::UdpRange { start_port } => Some(start_port..=start_port.saturating_add(BLOCK_END)),
        NetKind::Server | NetKind::Remote { .. } | NetKind::ProfinetDevice { .. } => None,
    });
    let servers = config.table.mappings().iter().map(|mapping| mapping.public_port);
    let admin = config.admin.iter().map(|admin| admin.listen.port());
    blocks.chain(servers.chain(admin).map(|port| port..=port)).chain([P_NET])
}

impl Host {
    fn read() -> Self {
        let read = |name| fs::read_to_string(format!("/proc/sys/net/ipv4/{name}"));
        let lent = read("ip_local_port_range").ok().and_then(|text| port_range(&text));
        let reserved = read("ip_local_reserved_ports").unwrap_or_default();
        let lowest = read("ip_unprivileged_port_start").ok();
        let lowest = lowest.and_then(|text| text.trim().parse().ok()).unwrap_or(0);
        Self {
            lent: vec![lent.unwrap_or(USUAL_PORT_RANGE)],
            reserved: port_ranges(&reserved),
            lowest: lowest.max(1024),
        }
    }
}

/// Reads the one range of `ip_local_port_range`.
pub(crate) fn port_range(text: &str) -> Option<RangeInclusive<u16>> {
    let (first, last) = text.trim().split_once(char::is_whitespace)?;
    Some(first.parse().ok()?..=last.trim().parse().ok()?)
}

/// Reads the ranges of `ip_local_reserved_ports`, such as "8080,40000-40127".
pub(crate) fn port_ranges(text: &str) -> Vec<RangeInclusive<u16>> {
    let range = |text: &str| {
        let (first, last) = text.split_once('-').unwrap_or((text, text));
        Some(first.parse().ok()?..=last.parse().ok()?)
    };
    text.trim().split(',').filter_map(range).collect()
}

/// A set of ports with one bit each, for several threads.
#[derive(Debug)]
struct PortSet(Box<[AtomicU64; WORDS]>);

impl Default for PortSet {
    fn default() -> Self {
        Self(Box::new([const { AtomicU64::new(0) }; WORDS]))
    }
}

impl PortSet {
    /// Adds a port. Tells whether the port was new.
    fn insert(&self, port: u16) -> bool {
        let bit = bit(port);
        self.0[index(port)].fetch_or(bit, SeqCst) & bit == 0
    }

    fn remove(&self, port: u16) {
        self.0[index(port)].fetch_and(!bit(port), SeqCst);
    }

    fn contains(&self, port: u16) -> bool {
        self.word(index(port)) & bit(port) != 0
    }

    fn is_empty(&self) -> bool {
        (0..WORDS).all(|word| self.word(word) == 0)
    }

    fn word(&self, index: usize) -> u64 {
        self.0[index].load(SeqCst)
    }
}

fn index(port: u16) -> usize {
    usize::from(port) / 64
}

fn bit(port: u16) -> u64 {
    1 << (port % 64)
}

/// The position of the set bit that has `n` set bits below it.
fn nth_one(mut word: u64, n: u32) -> u16 {
    (0..n).for_each(|_| word &= word - 1);
    word.trailing_zeros() as u16
}

#[cfg(test)]
mod tests;
