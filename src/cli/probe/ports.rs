//! The checks of public ports: who has them, and whether the kernel lends them to others.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

use super::host::Owner;
use crate::config::runs;
use crate::datapath::{port_range, port_ranges};
use crate::probe::Check;

/// The name that the relay's process has.
const RELAY: &str = "pnet-nat";

/// A UDP socket of this host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Bound {
    pub(super) address: SocketAddr,
    pub(super) inode: u64,
}

/// The sockets in a table of the kernel, /proc/net/udp or /proc/net/udp6.
pub(super) fn bound(table: &str) -> impl Iterator<Item = Bound> {
    table.lines().skip(1).filter_map(|line| {
        let columns: Vec<_> = line.split_whitespace().collect();
        let (ip, port) = columns.get(1)?.split_once(':')?;
        let port = u16::from_str_radix(port, 16).ok()?;
        let words = ip.len() / 8;
        let word = |index: usize| u32::from_str_radix(ip.get(index * 8..index * 8 + 8)?, 16).ok();
        // The kernel prints each word in the order of the processor.
        let octets: Vec<u8> = (0..words).filter_map(word).flat_map(u32::to_ne_bytes).collect();
        let ip: IpAddr = match octets.len() {
            4 => Ipv4Addr::from(<[u8; 4]>::try_from(octets).ok()?).into(),
            16 => Ipv6Addr::from(<[u8; 16]>::try_from(octets).ok()?).into(),
            _ => return None,
        };
        Some(Bound { address: (ip, port).into(), inode: columns.get(9)?.parse().ok()? })
    })
}

/// The sockets of this host and whose they are.
pub(super) struct Sockets {
    pub(super) bound: Vec<Bound>,
    pub(super) owners: HashMap<u64, Owner>,
}

impl Sockets {
    /// The inodes of the sockets that get what is sent to this address, or that are in its way.
    fn at(&self, address: SocketAddr) -> impl Iterator<Item = u64> {
        self.bound.iter().filter_map(move |bound| {
            let (here, there) = (bound.address.ip(), address.ip());
            let same = here == there
                || here.is_ipv4() == there.is_ipv4()
                    && (here.is_unspecified() || there.is_unspecified());
            (same && bound.address.port() == address.port()).then_some(bound.inode)
        })
    }

    /// The process of the relay that has one of these addresses.
    pub(super) fn relay(&self, addresses: &[SocketAddr]) -> Option<u32> {
        let inodes = addresses.iter().flat_map(|address| self.at(*address));
        let owners = inodes.filter_map(|inode| self.owners.get(&inode));
        owners.filter(|owner| owner.name == RELAY).map(|owner| owner.pid).next()
    }

    /// Whether the relay has all public ports of a net.
    pub(super) fn judge(&self, net: &str, addresses: &[SocketAddr]) -> Check {
        const CHECK: &str = "ports";
        let (mut closed, mut unknown) = (Vec::new(), Vec::new());
        for address in addresses {
            let inodes: Vec<_> = self.at(*address).collect();
            let owners: Vec<_> = inodes.iter().filter_map(|inode| self.owners.get(inode)).collect();
            if let Some(Owner { pid, name }) = owners.iter().find(|owner| owner.name != RELAY) {
                let text = format!("UDP port {address} belongs to {name}, process {pid}");
                return Check::bad(CHECK, net, text)
                    .remedy("stop that program, or move the net to free ports");
            }
            if inodes.is_empty() {
                closed.push(address.port());
            } else if owners.is_empty() {
                unknown.push(address.port());
            }
        }
        let all: Vec<_> = addresses.iter().map(SocketAddr::port).collect();
        let list = |ports: &[u16]| {
            let mut ports = ports.to_vec();
            ports.sort_unstable();
            ports.dedup();
            format!("UDP {}", runs(&ports))
        };
        if !closed.is_empty() {
            let text = format!("nothing listens on {}", list(&closed));
            return Check::bad(CHECK, net, text).remedy(
                "start the relay, or reload it if the ports are new: `systemctl status pnet-nat`",
            );
        }
        if !unknown.is_empty() {
            let text = format!("{} are bound, and only root sees by whom", list(&unknown));
            return Check::unknown(CHECK, net, text).remedy("run the probe as root");
        }
        Check::good(CHECK, net, format!("the relay has {}", list(&all)))
    }
}

/// Whether the kernel may lend a public port to another program. `range` and `reserved` are the texts of
/// net.ipv4.ip_local_port_range and ip_local_reserved_ports.
pub(super) fn ephemeral(net: &str, ports: &[u16], range: Option<&str>, reserved: &str) -> Check {
    const CHECK: &str = "port range";
    let Some(limits) = range.and_then(port_range) else {
        return Check::unknown(CHECK, net, "net.ipv4.ip_local_port_range cannot be read");
    };
    let reserved = port_ranges(reserved);
    let is_reserved = |port: u16| reserved.iter().any(|run| run.contains(&port));
    let mut lent: Vec<_> = ports.to_vec();
    lent.sort_unstable();
    lent.dedup();
    lent.retain(|port| limits.contains(port) && !is_reserved(*port));
    if lent.is_empty() {
        return Check::good(
            CHECK,
            net,
            "the kernel lends none of the public ports to other programs",
        );
    }
    let (first, last) = (lent[0], lent[lent.len() - 1]);
    let text = format!("the kernel may lend UDP {} to another program", runs(&lent));
    Check::doubtful(CHECK, net, text).remedy(format!(
        "choose a start port below {}, or `sysctl net.ipv4.ip_local_reserved_ports={first}-{last}`",
        limits.start()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::Verdict;

    /// As the kernel prints an address.
    fn shown<const N: usize>(octets: [u8; N]) -> String {
        let words = octets.chunks(4).map(|word| u32::from_ne_bytes(word.try_into().unwrap()));
        words.map(|word| format!("{word:08X}")).collect()
    }

    fn table() -> String {
        let (loopback, any) = (shown([127, 0, 0, 1]), shown([0; 4]));
        format!(
            "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode ref pointer drops\n\
            10: {loopback}:4E21 {any}:0000 07 00000000:00000000 00:00000000 00000000     0        0 77 2 0000000000000000 0\n\
            11: {any}:4E22 {any}:0000 07 00000000:00000000 00:00000000 00000000     0        0 78 2 0000000000000000 0\n\
            odd\n"
        )
    }

    fn at(port: u16) -> SocketAddr {
        (Ipv4Addr::LOCALHOST, port).into()
    }

    fn sockets(owners: &[(u64, &str)]) -> Sockets {
        let owner = |&(inode, name): &(u64, &str)| (inode, Owner { pid: 7, name: name.into() });
        Sockets { bound: bound(&table()).collect(), owners: owners.iter().map(owner).collect() }
    }

    #[test]
    fn the_kernels_table_is_read() {
        let found: Vec<_> = bound(&table()).collect();
        let any = SocketAddr::from(([0, 0, 0, 0], 20002));
        assert_eq!(
            found,
            [Bound { address: at(20001), inode: 77 }, Bound { address: any, inode: 78 }]
        );
        let v6: Ipv6Addr = "2001:db8::1".parse().unwrap();
        let table = format!("head\n1: {}:4E21 0:0 07 0:0 0:0 0 0 0 79\n", shown(v6.octets()));
        assert_eq!(bound(&table).next().unwrap().address, (v6, 20001).into());
    }

    #[test]
    fn whoever_has_the_ports_is_named() {
        let judge = |owners: &[(u64, &str)], ports: &[u16]| {
            let addresses: Vec<_> = ports.iter().map(|port| at(*port)).collect();
            let check = sockets(owners).judge("section-1", &addresses);
            (check.verdict, check.text)
        };
        let relay = [(77, "pnet-nat"), (78, "pnet-nat")];
        let good = (Verdict::Good, "the relay has UDP 20001-20002".into());
        assert_eq!(judge(&relay, &[20001, 20002]), good);
        let closed = (Verdict::Bad, "nothing listens on UDP 20003-20004".into());
        assert_eq!(judge(&relay, &[20001, 20003, 20004]), closed);
        let text = "UDP port 127.0.0.1:20001 belongs to dnsmasq, process 7";
        assert_eq!(judge(&[(77, "dnsmasq")], &[20001]), (Verdict::Bad, text.into()));
        assert_eq!(judge(&[], &[20001]).0, Verdict::Unknown);
        assert_eq!(sockets(&relay).relay(&[at(20009), at(20002)]), Some(7));
        assert_eq!(sockets(&[]).relay(&[at(20001)]), None);
    }

    #[test]
    fn ports_that_the_kernel_lends_have_to_be_reserved() {
        let judge = |ports: &[u16], reserved| {
            let check = ephemeral("n", ports, Some("32768\t60999\n"), reserved);
            (check.verdict, check.text)
        };
        assert_eq!(judge(&[20001, 20125], "\n").0, Verdict::Good);
        assert_eq!(
            judge(&[40001, 40002, 40004], "\n"),
            (
                Verdict::Doubtful,
                "the kernel may lend UDP 40001-40002, 40004 to another program".into()
            )
        );
        assert_eq!(judge(&[40001, 40125], "8080,40000-40127\n").0, Verdict::Good);
        assert_eq!(ephemeral("n", &[1], None, "").verdict, Verdict::Unknown);
        assert_eq!(ephemeral("n", &[1], Some("odd"), "").verdict, Verdict::Unknown);
    }
}
