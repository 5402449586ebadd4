//! Why a datagram was dropped and why a flow ended. Every label, log line and table takes its
//! reasons from these two enums.

mod words;

use strum::VariantArray;

/// The direction of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, VariantArray)]
pub enum Direction {
    /// From a client to a server node.
    Request,
    /// From a server node to a client.
    Response,
}

impl Direction {
    /// Both directions, in the order of their counters.
    pub const ALL: [Self; Self::VARIANTS.len()] = *Self::VARIANTS.first_chunk().unwrap();

    /// The value of the metrics' label `direction`.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Request => "request",
            Self::Response => "response",
        }
    }

    /// The reasons for which a datagram of this direction can be dropped, of any protocol: each
    /// once.
    pub fn drop_reasons(self) -> impl Iterator<Item = DropReason> {
        let (p_net, rpc) = match self {
            Self::Request => (&DropReason::REQUEST[..], &DropReason::RPC_REQUEST[..]),
            Self::Response => (&DropReason::RESPONSE[..], &DropReason::RPC_RESPONSE[..]),
        };
        let others = rpc.iter().filter(|reason| !p_net.contains(reason));
        p_net.iter().chain(others).copied()
    }
}

/// Why a datagram did not pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, VariantArray)]
pub enum DropReason {
    /// Sent to a broadcast or multicast address.
    NotUnicast,
    /// Fewer octets than any datagram that could pass.
    TooShort,
    /// More octets than the largest datagram has: 107 of P-NET, 1472 of PROFINET.
    TooLong,
    /// The first four octets are not the configured header.
    BadHeader,
    /// The route is malformed, or a response's route has a format that is not used over IP.
    BadRoute,
    /// The request's route is well formed, but Simple, Immediate, or Complex with one source.
    RouteFormat,
    /// The octets after the route are not as many as the data-field-format says.
    BadLength,
    /// The request has no password.
    PasswordMissing,
    /// The request has a password, although the net puts it on itself.
    PasswordUnexpected,
    /// The request's password is none of the net's passwords.
    PasswordWrong,
    /// The request comes from one of the relay's own upstream sockets: a server's address leads
    /// back to the router.
    Loop,
    /// No answer could reach the sender: its port is 0, no host can have its address, or no route
    /// leads there.
    Unanswerable,
    /// The client's address is in none of the net's allowed networks, or in the plant.
    SourceNotAllowed,
    /// The sender, or its whole address, sent too many wrong passwords and is refused for a while.
    Throttled,
    /// The node address in the route is not that of the public port.
    NodeMismatch,
    /// A destination in the route is a broadcast address, [`BNA`](crate::pnet::wire::BNA) or
    /// [`SNA`](crate::pnet::wire::SNA).
    Broadcast,
    /// The datagram is of a type that does not travel in this direction.
    PacketType,
    /// The call is for another interface than that of an IO device or an endpoint mapper, or for an
    /// operation that these do not have.
    RpcInterface,
    /// The call would open a connection to a device.
    RpcConnect,
    /// The call would end a connection.
    RpcRelease,
    /// The call reads in a connection.
    RpcRead,
    /// The call would write a record.
    RpcWrite,
    /// The call would control a connection.
    RpcControl,
    /// The arguments of the call, or of its answer, are malformed.
    BadNdr,
    /// The record that is to be read is not one of those that may be.
    RecordNotAllowed,
    /// The datagram belongs to no call that is under way.
    UnknownExchange,
    /// More requests a second than the flow or the net may send.
    RequestLimit,
    /// The net's or the router's limit of flows is reached, by open flows or by flows that ended
    /// within the last two minutes.
    FlowLimit,
    /// No upstream socket is free for a new flow to this server.
    UpstreamExhausted,
    /// The system refused to send.
    SendFailed,
    /// No flow of this server is open on this socket.
    UnknownFlow,
    /// The response's password is none that the flow used, or is missing although the net requires
    /// one.
    PasswordMismatch,
}

impl DropReason {
    /// How many reasons there are.
    pub const COUNT: usize = Self::VARIANTS.len();

    /// The reasons to drop a request of P-NET, in the order of the checks.
    ///
    /// Before a flow opens, [`Loop`](Self::Loop) and [`Unanswerable`](Self::Unanswerable) are
    /// checked again, then with the help of the system.
    pub const REQUEST: [Self; 20] = [
        Self::NotUnicast,
        Self::TooShort,
        Self::TooLong,
        Self::BadHeader,
        Self::BadRoute,
        Self::BadLength,
        Self::RouteFormat,
        Self::PasswordMissing,
        Self::PasswordUnexpected,
        Self::Loop,
        Self::Unanswerable,
        Self::SourceNotAllowed,
        Self::Throttled,
        Self::PasswordWrong,
        Self::Broadcast,
        Self::NodeMismatch,
        Self::RequestLimit,
        Self::FlowLimit,
        Self::UpstreamExhausted,
        Self::SendFailed,
    ];

    /// The reasons to drop a response of P-NET, in the order of the checks.
    ///
    /// [`BadRoute`](Self::BadRoute) is checked again after [`BadLength`](Self::BadLength): the
    /// format of a route that is well formed may not be used over IP.
    pub const RESPONSE: [Self; 8] = [
        Self::UnknownFlow,
        Self::TooShort,
        Self::TooLong,
        Self::BadHeader,
        Self::BadRoute,
        Self::BadLength,
        Self::PasswordMismatch,
        Self::SendFailed,
    ];

    /// The reasons to drop what a client sends to a PROFINET device.
    ///
    /// The first ones are in the order of the checks. [`BadNdr`](Self::BadNdr) is checked last
    /// among those that octets alone show.
    pub const RPC_REQUEST: [Self; 23] = [
        Self::NotUnicast,
        Self::TooShort,
        Self::TooLong,
        Self::BadHeader,
        Self::BadLength,
        Self::Broadcast,
        Self::PacketType,
        Self::RpcInterface,
        Self::RpcConnect,
        Self::RpcRelease,
        Self::RpcRead,
        Self::RpcWrite,
        Self::RpcControl,
        Self::RecordNotAllowed,
        Self::BadNdr,
        Self::Loop,
        Self::Unanswerable,
        Self::SourceNotAllowed,
        Self::UnknownExchange,
        Self::RequestLimit,
        Self::FlowLimit,
        Self::UpstreamExhausted,
        Self::SendFailed,
    ];

    /// The reasons to drop what a PROFINET device sends, in the order of the checks.
    pub const RPC_RESPONSE: [Self; 9] = [
        Self::UnknownFlow,
        Self::TooShort,
        Self::TooLong,
        Self::BadHeader,
        Self::BadLength,
        Self::PacketType,
        Self::BadNdr,
        Self::UnknownExchange,
        Self::SendFailed,
    ];

    /// Whether the octets alone show that the datagram is no one of the protocol. Scanners cause
    /// these; a client with a mistyped setting sends well-formed datagrams.
    pub const fn is_malformed(self) -> bool {
        matches!(
            self,
            Self::TooShort
                | Self::TooLong
                | Self::BadHeader
                | Self::BadRoute
                | Self::BadLength
                | Self::BadNdr
        )
    }

    /// The value of the metrics' label `reason`.
    pub const fn label(self) -> &'static str {
        match self {
            Self::NotUnicast => "not_unicast",
            Self::TooShort => "too_short",
            Self::TooLong => "too_long",
            Self::BadHeader => "bad_header",
            Self::BadRoute => "bad_route",
            Self::RouteFormat => "route_format",
            Self::BadLength => "bad_length",
            Self::PasswordMissing => "password_missing",
            Self::PasswordUnexpected => "password_unexpected",
            Self::PasswordWrong => "password_wrong",
            Self::Loop => "loop",
            Self::Unanswerable => "unanswerable",
            Self::SourceNotAllowed => "source_not_allowed",
            Self::Throttled => "throttled",
            Self::NodeMismatch => "node_mismatch",
            Self::Broadcast => "broadcast",
            Self::PacketType => "packet_type",
            Self::RpcInterface => "rpc_interface",
            Self::RpcConnect => "rpc_connect",
            Self::RpcRelease => "rpc_release",
            Self::RpcRead => "rpc_read",
            Self::RpcWrite => "rpc_write",
            Self::RpcControl => "rpc_control",
            Self::BadNdr => "bad_ndr",
            Self::RecordNotAllowed => "record_not_allowed",
            Self::UnknownExchange => "unknown_exchange",
            Self::RequestLimit => "request_limit",
            Self::FlowLimit => "flow_limit",
            Self::UpstreamExhausted => "upstream_exhausted",
            Self::SendFailed => "send_failed",
            Self::UnknownFlow => "unknown_flow",
            Self::PasswordMismatch => "password_mismatch",
        }
    }
}

/// Why a flow ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, VariantArray)]
pub enum CloseReason {
    /// Nothing passed in either direction for the net's idle timeout (RFC 4787 REQ-5, REQ-6).
    Idle,
    /// A new configuration does not have the public port any more, or has it for another server.
    MappingRemoved,
    /// A new configuration does not allow the client's address any more.
    SourceWithdrawn,
    /// A new configuration does not have the flow's password any more.
    PasswordWithdrawn,
    /// A new configuration has a public port that the flow's upstream socket used.
    PortWanted,
    /// The relay stopped.
    Shutdown,
}

impl CloseReason {
    /// Every reason, in the order of their counters.
    pub const ALL: [Self; Self::VARIANTS.len()] = *Self::VARIANTS.first_chunk().unwrap();

    /// The value of the metrics' label `reason`.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::MappingRemoved => "mapping_removed",
            Self::SourceWithdrawn => "source_withdrawn",
            Self::PasswordWithdrawn => "password_withdrawn",
            Self::PortWanted => "port_wanted",
            Self::Shutdown => "shutdown",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reason_belongs_to_a_direction_once() {
        for reason in DropReason::VARIANTS {
            let has_it = |direction: Direction| direction.drop_reasons().any(|it| it == *reason);
            assert!(Direction::ALL.into_iter().any(has_it), "{reason:?}");
        }
        for direction in Direction::ALL {
            let distinct: std::collections::HashSet<_> = direction.drop_reasons().collect();
            assert_eq!(distinct.len(), direction.drop_reasons().count(), "{direction:?}");
        }
    }

    #[test]
    fn variants_are_listed_by_their_index() {
        let indices = |count| (0..count).collect::<Vec<_>>();
        let found: Vec<_> = DropReason::VARIANTS.iter().map(|&reason| reason as usize).collect();
        assert_eq!(found, indices(DropReason::COUNT));
        let found: Vec<_> = CloseReason::ALL.iter().map(|&reason| reason as usize).collect();
        assert_eq!(found, indices(CloseReason::ALL.len()));
    }
}
