//! A row of the IPNetTable as it is written down: the fields of PAS 8, Table 4, with any values.

use std::fmt;
use std::net::Ipv4Addr;
use std::str::FromStr;

/// What kind of net a row stands for (R-14, PAS 5.2.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Nettype {
    /// The row stands for no net.
    Unused,
    /// The nodes have addresses of their own in one subnet (PAS 5.2.5).
    IpRange,
    /// The nodes share the address of a NAT router, and each has a UDP port there (PAS 5.2.6).
    UdpRange,
}

impl Nettype {
    /// The name in PAS 8, Table 4.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unused => "Unused",
            Self::IpRange => "IPRange",
            Self::UdpRange => "UDPRange",
        }
    }
}

impl fmt::Display for Nettype {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A text that is no [`Nettype`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the types are IPRange, UDPRange and Unused")]
pub struct NotANettype;

impl FromStr for Nettype {
    type Err = NotANettype;

    fn from_str(text: &str) -> Result<Self, NotANettype> {
        let all = [Self::Unused, Self::IpRange, Self::UdpRange];
        all.into_iter().find(|nettype| nettype.name() == text).ok_or(NotANettype)
    }
}

/// The fields of one row (R-15, PAS 8, Table 4), not checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fields {
    /// What kind of net it is. The other fields of an unused row have no meaning.
    pub nettype: Nettype,
    /// IP Range net: an address of the subnet, of which the upper 24 bits count. UDP Range net: the
    /// address of the NAT router.
    pub ip_address: Ipv4Addr,
    /// IP Range net: the UDP port of every node. UDP Range net: the start port.
    pub udp_port: u16,
    /// Whether packages to this net carry a password.
    pub use_password: bool,
    /// Node address of the router, on the node's own net; 0 for the own net itself.
    pub router: u8,
    /// No field of the standard: a UDP Range net is meant to go without a password (A4), for a
    /// NAT router that asks for none.
    pub allow_without_password: bool,
}

impl Fields {
    /// An unused row.
    pub const UNUSED: Self = Self {
        nettype: Nettype::Unused,
        ip_address: Ipv4Addr::UNSPECIFIED,
        udp_port: 0,
        use_password: false,
        router: 0,
        allow_without_password: false,
    };
}

/// A column of the table, for errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Field {
    /// The index of the row.
    IpNetId,
    /// [`Fields::ip_address`]
    IpAddr,
    /// [`Fields::udp_port`]
    UdpPort,
    /// [`Fields::use_password`]
    UsePw,
    /// [`Fields::router`]
    Router,
}

impl fmt::Display for Field {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::IpNetId => "IPNetID",
            Self::IpAddr => "IPAddr",
            Self::UdpPort => "UDPPort",
            Self::UsePw => "UsePW",
            Self::Router => "Router",
        })
    }
}
