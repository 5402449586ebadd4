//! The addresses and UDP ports that the standard gives a meaning to.

use std::fmt;
use std::str::FromStr;

/// The UDP port on which a server takes packages without a password, `p-net-local` (PAS 5.2.3, 11).
pub const NORMAL_PORT: u16 = 34378;
/// The UDP port on which a server takes packages with a password, `p-net-remote` (PAS 5.2.3, 11).
pub const SECURE_PORT: u16 = 34379;

/// The last address that a server node can have; the first is 1 (R-11, PAS 8, 10).
pub const LAST_NODE: u8 = 125;
/// The highest start port of a UDP Range net: there, the last node still has a UDP port (A15).
pub const LAST_START_PORT: u16 = u16::MAX - LAST_NODE as u16;
/// Broadcast-Node-address: every node of the net (PAS 10).
pub const BNA: u8 = 126;
/// Service-Node-address: every node accepts it, as it does [`BNA`] (PAS 5.4.1.2 a).
pub const SNA: u8 = 127;
/// As the last source element: no confirmation is wanted (PAS 5.7.1.6).
pub const NCNA: u8 = 0;

/// The address of one node in its net, 1 to 125 (R-11, PAS 8).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeAddress(u8);

impl NodeAddress {
    /// The node address with this number, if there is one.
    pub const fn new(number: u8) -> Option<Self> {
        match number {
            1..=LAST_NODE => Some(Self(number)),
            _ => None,
        }
    }

    /// All of them, from 1 to 125.
    pub fn all() -> impl Iterator<Item = Self> {
        (1..=LAST_NODE).map(Self)
    }

    /// The number, 1 to 125.
    pub const fn get(self) -> u8 {
        self.0
    }
}

impl fmt::Display for NodeAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// The number of an IP net in a node's IPNetTable, 1 to 125 (R-13, PAS 5.2.2, 9).
///
/// The standard reserves 0, 126 and 127. 125 stands for the dynamic clients of a server, so it has no
/// row in the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct IpNetId(u8);

/// A text that is no IPNetID.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an IPNetID is a number from 1 to 125: 0, 126 and 127 are reserved (PAS 5.2.2)")]
pub struct NotAnIpNetId;

impl IpNetId {
    /// The net of those clients that a server has no row for (PAS 9).
    pub const DYNAMIC_CLIENTS: Self = Self(125);
    /// The first net.
    pub const FIRST: Self = Self(1);
    /// The last net that has a row (R-15, PAS 8).
    pub const LAST_ROW: Self = Self(124);

    /// The IPNetID with this number, if it is not reserved.
    pub const fn new(number: u8) -> Option<Self> {
        match number {
            1..=125 => Some(Self(number)),
            _ => None,
        }
    }

    /// The number, 1 to 125.
    pub const fn get(self) -> u8 {
        self.0
    }
}

impl FromStr for IpNetId {
    type Err = NotAnIpNetId;

    fn from_str(text: &str) -> Result<Self, NotAnIpNetId> {
        text.parse().ok().and_then(Self::new).ok_or(NotAnIpNetId)
    }
}

impl fmt::Display for IpNetId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn r11_r13_reserved_numbers_are_none() {
        for number in 0..=u8::MAX {
            let taken = (1..=125).contains(&number);
            assert_eq!(NodeAddress::new(number).map(NodeAddress::get), taken.then_some(number));
            assert_eq!(IpNetId::new(number).map(IpNetId::get), taken.then_some(number));
            assert_eq!(number.to_string().parse::<IpNetId>().is_ok(), taken);
        }
        assert_eq!(NodeAddress::all().count(), 125);
        for bad in ["", "-1", "+", "256", "1-2", "one"] {
            assert_eq!(bad.parse::<IpNetId>(), Err(NotAnIpNetId), "{bad:?}");
        }
    }
}
