//! What all requests of a client have in common.

use std::time::Duration;

use crate::pnet::wire::{Header, IpNetId, MAX_DATA, MAX_ROUTE, NodeAddress};

/// Octets in the largest package: route, control-status, data-field-format and data. Header and
/// password do not count, for they are not of P-NET itself (PAS 11).
pub const MAX_PDU: usize = MAX_ROUTE + 2 + MAX_DATA;

/// What an endpoint of an application relationship is for (PAS 6.1.1.2.1.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ArepRole {
    /// It sends requests and receives responses.
    Client,
    /// It receives requests and sends responses.
    Server,
}

/// Who a client says that it is: the first two elements of the source route.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Source {
    /// The IPNetID of the client's net.
    pub ip_net_id: IpNetId,
    /// The client's node address in that net.
    pub node_address: NodeAddress,
}

impl Source {
    /// That of PAS Figure 10: node 3 of net 11.
    pub const FIGURE_10: Self = Self {
        ip_net_id: IpNetId::new(11).expect("an IPNetID"),
        node_address: NodeAddress::new(3).expect("a node address"),
    };
}

/// The attributes of the endpoint that all requests of a client leave from (R-44, PAS 6.1.1.2).
///
/// Attributes of serial buses are left out. So is Acknowledgement: over IP, nothing is acknowledged
///
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Arep {
    /// The header of every datagram.
    pub header: Header,
    /// Local DLE address: the client itself, until a server gives it another name.
    pub source: Source,
    /// MaxPDUSize: the most octets in a package without header and password, at most [`MAX_PDU`].
    pub max_pdu_size: usize,
    /// MaxDataSize: the most data octets in a package, at most 63.
    pub max_data_size: usize,
    /// How long a response may take before its request counts as lost on the way.
    pub response_timeout: Duration,
    /// MaxRetryTime: once a request is older than this, it is not sent again. The standard counts
    /// from acknowledgements, and there are none over IP.
    pub max_retry_time: Duration,
    /// MaxRetries: how often a request is sent again, at most.
    pub max_retries: u32,
    /// MaxOutstandingRequests: how many requests may wait for their response at the same time.
    pub max_outstanding_requests: usize,
}

impl Arep {
    /// One request at a time, sent once, with a second for its response.
    pub fn new(source: Source) -> Self {
        Self {
            header: Header::default(),
            source,
            max_pdu_size: MAX_PDU,
            max_data_size: MAX_DATA,
            response_timeout: Duration::from_secs(1),
            max_retry_time: Duration::MAX,
            max_retries: 0,
            max_outstanding_requests: 1,
        }
    }
}
