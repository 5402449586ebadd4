//! Who is not listened to for a while, as the log tells of it.

use std::net::SocketAddr;
use std::time::Duration;

use ipnet::IpNet;

/// What a bucket stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThrottleScope {
    /// One address and port.
    Sender,
    /// All of an IPv4 address or of an IPv6 /64.
    Address,
}

/// Who is throttled, for the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Throttled {
    /// The sender alone, or its address.
    pub scope: ThrottleScope,
    /// Who was refused first.
    pub sender: SocketAddr,
    /// Since when.
    pub age: Duration,
    /// Requests that were refused.
    pub refused: u64,
}

impl Throttled {
    /// The IPv4 address or the IPv6 /64 that shares one bucket.
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
