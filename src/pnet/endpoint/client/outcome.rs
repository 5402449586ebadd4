//! What comes of a request, and of a datagram.

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::time::Duration;

use crate::pnet::wire::{DatagramError, DlRouteError, Elements};

/// What became of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// There is a response.
    Answered(Response),
    /// It was sent, and nobody answers it: it is unconfirmed.
    Sent,
    /// There is no response.
    Lost(Loss),
}

/// The response to a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Response {
    /// The destination elements as they came, of the last segment. The first two may differ from those
    /// of the request.
    pub destinations: Elements,
    /// The source elements as they came.
    pub sources: Elements,
    /// The control-status. The standard does not give its codes.
    pub control_status: u8,
    /// The data of all segments.
    pub data_octets: Vec<u8>,
    /// The time from the first sending of the request to its response.
    pub round_trip: Duration,
}

/// Why there is no response: what was seen last of the request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Loss {
    /// Nothing came in time.
    #[error("no answer within {waited:?}{}", sent_again(*sent))]
    NoAnswer {
        /// How long the client waited.
        waited: Duration,
        /// How often it sent the request.
        sent: u32,
    },
    /// The network reported that the request did not arrive.
    #[error("{0}")]
    Undelivered(Undelivered),
    /// A response came, but not from where the request was sent to (A14).
    #[error("answers came from another port, {0}")]
    OtherPort(SocketAddr),
    /// A response came with another password than the request, or one of the two has none.
    #[error("answers with a wrong password")]
    WrongPassword,
    /// A memory area answered with another control-status.
    #[error("the memory was not served: control-status ${control_status:02X}")]
    Refused {
        /// That control-status.
        control_status: u8,
    },
    /// A memory area answered with another number of octets.
    #[error("the memory was not served: {came} octets in place of {expected}")]
    WrongSize {
        /// What a piece has.
        expected: usize,
        /// What came.
        came: usize,
    },
}

fn sent_again(sent: u32) -> String {
    if sent > 1 { format!(", sent {sent} times") } else { String::new() }
}

/// What the network said of a request that did not arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Undelivered {
    /// No socket has the port.
    #[error("nothing listens there")]
    NothingListens,
    /// No such host, or it is off.
    #[error("the host there cannot be reached")]
    HostUnreachable,
    /// No route leads there.
    #[error("network unreachable")]
    NetworkUnreachable,
    /// A packet filter refused it.
    #[error("a firewall forbids it")]
    Forbidden,
    /// Any other error.
    #[error("it did not arrive: {0}")]
    Other(ErrorKind),
}

impl From<ErrorKind> for Undelivered {
    fn from(kind: ErrorKind) -> Self {
        match kind {
            ErrorKind::ConnectionRefused => Self::NothingListens,
            ErrorKind::HostUnreachable => Self::HostUnreachable,
            ErrorKind::NetworkUnreachable => Self::NetworkUnreachable,
            ErrorKind::PermissionDenied => Self::Forbidden,
            other => Self::Other(other),
        }
    }
}

/// Why a client takes no notice of a datagram, in the order of the checks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Ignored {
    /// The octets are no P-NET datagram.
    #[error("{0}")]
    Garbage(#[from] DatagramError),
    /// It is no response, which is unconfirmed and comes from a node of an IP net.
    #[error("no response")]
    NotAResponse,
    /// It answers no request of this client: another route, or another node.
    #[error("not for this client")]
    NotForUs,
    /// The request was answered before.
    #[error("answered before")]
    Duplicate,
    /// The request was given up before.
    #[error("too late")]
    Late,
    /// It comes from elsewhere than where the request was sent to (A14).
    #[error("from another port, {0}")]
    OtherPort(SocketAddr),
    /// It has another password than the request, or one of the two has none.
    #[error("a wrong password")]
    WrongPassword,
}

/// Why a request is not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// Nobody has reserved the endpoint.
    #[error("the endpoint is not in use")]
    NotInUse,
    /// The endpoint waits for the response to another request.
    #[error("the endpoint waits for a response")]
    Busy,
    /// The elements form no P-NET-route.
    #[error("no route to the node: {0}")]
    Route(#[from] DlRouteError),
    /// The data are more than MaxDataSize, and are not cut.
    #[error(
        "the request is too large: {octets} data octets, of which a package has room for {most}"
    )]
    TooMuchData {
        /// What was to be sent.
        octets: usize,
        /// What a package holds.
        most: usize,
    },
    /// MaxPDUSize leaves no room for any data.
    #[error("a package without data has {octets} octets, and may have {most}")]
    PackageTooLong {
        /// What it has.
        octets: usize,
        /// What it may have.
        most: usize,
    },
    /// MaxDataSize and MaxPDUSize leave no room for a piece.
    #[error("{most} data octets in a package have no room for a piece of a memory")]
    NoRoomForPieces {
        /// What a package holds.
        most: usize,
    },
    /// Flat addressing is not set, or has no code for this.
    #[error("the endpoint has no code for this with flat addressing")]
    NotFlat,
    /// Offsets have 16 bits.
    #[error("a memory ends with offset 65535")]
    BeyondMemory,
    /// Nobody would answer it.
    #[error("a request to read needs a response")]
    UnconfirmedRead,
}
