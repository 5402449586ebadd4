//! A throttled sender, for the log.

use std::net::SocketAddr;
use std::time::Duration;

use ipnet::IpNet;

/// Whose wrong passwords one bucket counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThrottleScope {
    /// One address and port.
    Sender,
    /// All ports of an IPv4 address or of an IPv6 /64.
    Address,
}

/// A sender or an address that is throttled.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Throttled {
    /// Whether the sender alone is throttled, or its whole address.
    pub scope: ThrottleScope,
    /// The sender that was refused first.
    pub sender: SocketAddr,
    /// How long it has been throttled.
    pub age: Duration,
    /// Requests that were refused so far.
    pub refused: u64,
}

impl Throttled {
    /// The sender's IPv4 address or IPv6 /64.
    pub fn address(&self) -> IpNet {
        let address = self.sender.ip().to_canonical();
        let prefix = if address.is_ipv4() { 32 } else { 64 };
        IpNet::new_assert(address, prefix).trunc()
    }
}

impl ThrottleScope {
    /// Its name in the log.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Sender => "sender",
            Self::Address => "address",
        }
    }
}
