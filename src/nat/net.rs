//! A net: its clients, its passwords and its rules; and the server nodes that belong to it.

use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use ipnet::IpNet;
use subtle::ConditionallySelectable;

use super::gcra::RequestRate;
use super::ids::NetId;
use super::protocol::{Password, Records};
use super::reason::{Direction, DropReason};

/// What a net is to its clients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NetKind {
    /// A block of public ports, one for each node: start port + node address (PAS 5.2.6, 8 d).
    UdpRange {
        /// UDPPort in the client's IPNetTable.
        start_port: u16,
    },
    /// One server outside any range.
    Server,
    /// Nodes of another plant, for local programs that know neither UDP Range nets nor passwords.
    /// They find them in an IP Range net here, and send without a password. It is put on the way to
    /// the other plant's router, and taken off on the way back.
    Remote {
        /// UDPPort of the other plant's UDP Range net.
        start_port: u16,
    },
    /// One PROFINET device, of which some records may be read. Its protocol has no passwords.
    ProfinetDevice {
        /// These records.
        records: Records,
    },
}

impl NetKind {
    /// The name of its block in the configuration, and in the API.
    pub const fn label(self) -> &'static str {
        match self {
            Self::UdpRange { .. } => "udp_range_net",
            Self::Server => "server",
            Self::Remote { .. } => "remote_net",
            Self::ProfinetDevice { .. } => "profinet_device",
        }
    }

    /// Whether clients send without a password, which is put on here.
    #[inline]
    pub fn is_remote(self) -> bool {
        matches!(self, Self::Remote { .. })
    }

    /// The reasons for which a datagram of this direction can be dropped.
    pub const fn drop_reasons(self, direction: Direction) -> &'static [DropReason] {
        match (self, direction) {
            (Self::ProfinetDevice { .. }, Direction::Request) => &DropReason::RPC_REQUEST,
            (Self::ProfinetDevice { .. }, Direction::Response) => &DropReason::RPC_RESPONSE,
            (_, Direction::Request) => &DropReason::REQUEST,
            (_, Direction::Response) => &DropReason::RESPONSE,
        }
    }

    /// Whether the server answers from any port, so that its address alone tells who answers.
    #[inline]
    pub fn answers_from_any_port(self) -> bool {
        matches!(self, Self::ProfinetDevice { .. })
    }

    /// Whether datagrams may be longer than those of P-NET.
    #[inline]
    pub fn has_long_datagrams(self) -> bool {
        matches!(self, Self::ProfinetDevice { .. })
    }
}

/// One plant section, or one single server: its clients and its rules.
#[derive(Clone, Debug)]
pub struct Net {
    /// Name in metrics, logs and the API; unique in the table.
    pub name: String,
    /// UDP Range net or single server.
    pub kind: NetKind,
    /// Networks that clients may send from; see [`Table::allows`](super::Table::allows).
    pub allow: Vec<IpNet>,
    /// The passwords of the net; empty only with `allow_without_password`. Requests of a remote net
    /// get the first one; answers to earlier requests may have the others.
    pub credentials: Vec<Credential>,
    /// Requests without a password pass. PAS 7 forbids it, so it has to be configured.
    pub allow_without_password: bool,
    /// Responses without a password are dropped.
    pub require_response_password: bool,
    /// A flow ends after this time without a datagram in either direction (RFC 4787 REQ-5).
    pub idle_timeout: Duration,
    /// Flows that may be open at once.
    pub max_flows: u32,
    /// Requests a second of all clients together; none: any number.
    pub max_requests: Option<RequestRate>,
    /// Requests a second of each flow; none: any number.
    pub max_flow_requests: Option<RequestRate>,
}

impl Net {
    /// A net that no client may use yet: it has no networks and no passwords. Flows end after five
    /// minutes (RFC 4787 REQ-5 recommends them), and nothing has a limit.
    pub fn new(name: impl Into<String>, kind: NetKind) -> Self {
        Self {
            name: name.into(),
            kind,
            allow: Vec::new(),
            credentials: Vec::new(),
            allow_without_password: false,
            require_response_password: false,
            idle_timeout: Duration::from_secs(5 * 60),
            max_flows: u32::MAX,
            max_requests: None,
            max_flow_requests: None,
        }
    }

    /// Index of the credential with this password. All passwords of the net are compared, so that
    /// the time does not depend on them.
    #[inline]
    pub fn credential(&self, password: &[u8; Password::LEN]) -> Option<u16> {
        let mut found = u16::MAX;
        for (index, credential) in (0..).zip(&self.credentials) {
            found.conditional_assign(&index, credential.password.matches(password));
        }
        (found != u16::MAX).then_some(found)
    }

    /// Index of the credential with the same two passwords, the clients' and the servers'.
    pub(super) fn same_credential(&self, other: &Credential) -> Option<u16> {
        self.credential(other.password.octets()).filter(|&index| {
            let here = &self.credentials[usize::from(index)];
            bool::from(here.at_server().matches(other.at_server().octets()))
        })
    }
}

/// One of a net's passwords.
#[derive(Clone, Debug)]
pub struct Credential {
    /// Name in metrics and logs.
    pub name: String,
    /// What clients send.
    pub password: Password,
    /// What the servers expect, if that is another password. It takes the place of the client's in
    /// a request, and gives it back in a response.
    pub device_password: Option<Password>,
}

impl Credential {
    /// The password that servers expect in a request and put into a response.
    pub fn at_server(&self) -> &Password {
        self.device_password.as_ref().unwrap_or(&self.password)
    }
}

/// Stands for the node address of a PROFINET device, which has none.
pub const NO_NODE: u8 = 0;

/// One element of the NAT table (PAS 5.2.6): a public port and the server node behind it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mapping {
    /// The net it belongs to.
    pub net: NetId,
    /// P-NET node address of the server, 1 to [`LAST_NODE`](crate::pnet::wire::LAST_NODE); [`NO_NODE`]
    /// for a PROFINET device.
    pub node_address: u8,
    /// The one address of the router to which clients send, in a remote net; none: every address of
    /// `[public] listen`.
    pub local_address: Option<IpAddr>,
    /// UDP port of the router to which clients send.
    pub public_port: u16,
    /// The server's address and Secure UDP port.
    pub server: SocketAddr,
}
