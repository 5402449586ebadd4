//! One row that was checked, and why a row is refused. Rules that need several rows are in `table`.

use std::net::Ipv4Addr;

use super::{Field, Fields, Nettype};
use crate::pnet::wire::{IpNetId, LAST_NODE, LAST_START_PORT, NodeAddress, SECURE_PORT};

/// A legal row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Row {
    Unused,
    IpRange(IpRange),
    UdpRange(UdpRange),
}

/// A net whose nodes have addresses of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct IpRange {
    /// The upper 24 bits of the nodes' addresses.
    prefix: [u8; 3],
    pub(super) port: u16,
    pub(super) use_password: bool,
    /// None for the node's own net.
    pub(super) router: Option<NodeAddress>,
}

impl IpRange {
    /// The address of this subnet with this last octet.
    pub(super) fn address(&self, last_octet: u8) -> Ipv4Addr {
        let [a, b, c] = self.prefix;
        Ipv4Addr::new(a, b, c, last_octet)
    }
}

/// A net whose nodes are ports of a NAT router.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct UdpRange {
    pub(super) address: Ipv4Addr,
    start_port: u16,
    pub(super) use_password: bool,
    pub(super) router: NodeAddress,
}

impl UdpRange {
    /// The port of a node; the start port leaves room for each of them (A15).
    pub(super) fn port(&self, node_address: NodeAddress) -> u16 {
        self.start_port + u16::from(node_address.get())
    }
}

/// What is wrong with a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RowFault {
    /// Row 125 would be that of the dynamic clients.
    #[error("125 is the net of dynamic clients, which has no row")]
    DynamicClients,
    /// Another row has the same index.
    #[error("the table already has this row")]
    Repeated,
    /// The address is none that a host can have.
    #[error("{0} is not a host address")]
    NotAHost(Ipv4Addr),
    /// The subnet is none that hosts can be in.
    #[error("{0} is not a subnet of hosts")]
    NotASubnet(Ipv4Addr),
    /// Port 0 stands for no port.
    #[error("0 is no port")]
    NoPort,
    /// The last nodes would have no port (A15).
    #[error("{0} + {LAST_NODE} is over {last}", last = u16::MAX)]
    StartPortTooHigh(u16),
    /// A UDP Range net is reached through the Internet, and so at Secure ports (R-4, A4).
    #[error("a UDP Range net needs a password")]
    UdpRangeWithoutPassword,
    /// A server takes nothing without a password at its Secure port.
    #[error("port {SECURE_PORT}, the Secure port, needs a password")]
    SecurePortWithoutPassword,
    /// The number is no node address.
    #[error("{0} is no node address on the own net")]
    RouterNotANode(u8),
    /// The row would have the node send to itself.
    #[error("{0} is the node itself, not a router")]
    RouterIsTheNode(NodeAddress),
    /// Method c.
    #[error("a UDP Range net is never the own net: it needs a router")]
    UdpRangeWithoutRouter,
    /// Two rows have router 0.
    #[error("row {0} has router 0 already, and there is only one own net")]
    SecondOwnNet(IpNetId),
}

impl RowFault {
    /// The field that is wrong.
    pub const fn field(self) -> Field {
        match self {
            Self::DynamicClients | Self::Repeated => Field::IpNetId,
            Self::NotAHost(_) | Self::NotASubnet(_) => Field::IpAddr,
            Self::NoPort | Self::StartPortTooHigh(_) => Field::UdpPort,
            Self::UdpRangeWithoutPassword | Self::SecurePortWithoutPassword => Field::UsePw,
            Self::RouterNotANode(_)
            | Self::RouterIsTheNode(_)
            | Self::UdpRangeWithoutRouter
            | Self::SecondOwnNet(_) => Field::Router,
        }
    }

    /// The clause of the standard that it is against.
    pub const fn clause(self) -> &'static str {
        match self {
            Self::DynamicClients => "PAS 9",
            Self::Repeated => "PAS 5.2.1",
            Self::NotASubnet(_) => "PAS 8 a, b",
            Self::NotAHost(_) | Self::StartPortTooHigh(_) => "PAS 8 d",
            Self::UdpRangeWithoutPassword | Self::SecurePortWithoutPassword => "PAS 7",
            Self::UdpRangeWithoutRouter => "PAS 8 c",
            Self::NoPort
            | Self::RouterNotANode(_)
            | Self::RouterIsTheNode(_)
            | Self::SecondOwnNet(_) => "PAS 8",
        }
    }
}

impl Row {
    /// The row with these fields in the table of a node; otherwise everything that is wrong with it.
    pub(super) fn new(fields: &Fields, node: NodeAddress) -> Result<Self, Vec<RowFault>> {
        let Fields { nettype, ip_address, udp_port, use_password, .. } = *fields;
        let mut faults = Vec::new();
        let router = router(fields.router, node).unwrap_or_else(|fault| {
            faults.push(fault);
            None
        });
        let row = match nettype {
            Nettype::Unused => return Ok(Self::Unused),
            Nettype::IpRange => {
                let [a, b, c, _] = ip_address.octets();
                if !is_a_host(Ipv4Addr::new(a, b, c, 1)) {
                    faults.push(RowFault::NotASubnet(Ipv4Addr::new(a, b, c, 0)));
                }
                if udp_port == SECURE_PORT && !use_password {
                    faults.push(RowFault::SecurePortWithoutPassword);
                }
                let prefix = [a, b, c];
                Some(Self::IpRange(IpRange { prefix, port: udp_port, use_password, router }))
            }
            Nettype::UdpRange => {
                if !is_a_host(ip_address) {
                    faults.push(RowFault::NotAHost(ip_address));
                }
                if udp_port > LAST_START_PORT {
                    faults.push(RowFault::StartPortTooHigh(udp_port));
                }
                if !use_password && !fields.allow_without_password {
                    faults.push(RowFault::UdpRangeWithoutPassword);
                }
                if fields.router == 0 {
                    faults.push(RowFault::UdpRangeWithoutRouter);
                }
                let row = |router| UdpRange {
                    address: ip_address,
                    start_port: udp_port,
                    use_password,
                    router,
                };
                router.map(row).map(Self::UdpRange)
            }
        };
        if udp_port == 0 {
            faults.push(RowFault::NoPort);
        }
        row.filter(|_| faults.is_empty()).ok_or(faults)
    }

    /// The fields that this row was made of, as far as they count.
    pub(super) fn fields(&self) -> Fields {
        match self {
            Self::Unused => Fields::UNUSED,
            Self::IpRange(row) => Fields {
                nettype: Nettype::IpRange,
                ip_address: row.address(0),
                udp_port: row.port,
                use_password: row.use_password,
                router: row.router.map_or(0, NodeAddress::get),
                allow_without_password: false,
            },
            Self::UdpRange(row) => Fields {
                nettype: Nettype::UdpRange,
                ip_address: row.address,
                udp_port: row.start_port,
                use_password: row.use_password,
                router: row.router.get(),
                allow_without_password: !row.use_password,
            },
        }
    }
}

/// a router is a node on the own net, so only its number has to be checked. None for router 0.
fn router(number: u8, node: NodeAddress) -> Result<Option<NodeAddress>, RowFault> {
    if number == 0 {
        return Ok(None);
    }
    let router = NodeAddress::new(number).ok_or(RowFault::RouterNotANode(number))?;
    if router == node { Err(RowFault::RouterIsTheNode(node)) } else { Ok(Some(router)) }
}

/// Whether a host can have this address.
fn is_a_host(address: Ipv4Addr) -> bool {
    let first = address.octets()[0];
    // 0.0.0.0/8 is this network, 224.0.0.0 and above are multicast and reserved (RFC 6890).
    (1..224).contains(&first)
}
