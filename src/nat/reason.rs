//! Why a datagram was dropped and why a flow ended. Every label, log line and table takes its
//! reasons from these two enums.

use strum::VariantArray;

/// The direction of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, VariantArray)]
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

    /// The reason with a number, for the log: "37 wrong passwords".
    pub fn counted(self, count: u64) -> String {
        let (one, many) = match self {
            Self::NotUnicast => ("request to many", "requests to many"),
            Self::TooShort => ("datagram too short", "datagrams too short"),
            Self::TooLong => ("datagram too long", "datagrams too long"),
            Self::BadHeader => ("wrong header", "wrong headers"),
            Self::BadRoute => ("malformed route", "malformed routes"),
            Self::RouteFormat => ("route not meant for IP", "routes not meant for IP"),
            Self::BadLength => ("wrong length", "wrong lengths"),
            Self::PasswordMissing => ("missing password", "missing passwords"),
            Self::PasswordUnexpected => ("unexpected password", "unexpected passwords"),
            Self::PasswordWrong => ("wrong password", "wrong passwords"),
            Self::Loop => ("request in a loop", "requests in a loop"),
            Self::Unanswerable => ("unanswerable request", "unanswerable requests"),
            Self::SourceNotAllowed => ("request not allowed", "requests not allowed"),
            Self::Throttled => ("throttled request", "throttled requests"),
            Self::NodeMismatch => ("wrong node address", "wrong node addresses"),
            Self::Broadcast => ("broadcast", "broadcasts"),
            Self::PacketType => ("packet of another type", "packets of another type"),
            Self::RpcInterface => ("call to another interface", "calls to another interface"),
            Self::RpcConnect => ("refused Connect", "refused Connects"),
            Self::RpcRelease => ("refused Release", "refused Releases"),
            Self::RpcRead => ("refused Read in a connection", "refused Reads in a connection"),
            Self::RpcWrite => ("refused Write", "refused Writes"),
            Self::RpcControl => ("refused Control", "refused Controls"),
            Self::BadNdr => ("malformed call", "malformed calls"),
            Self::RecordNotAllowed => ("record not allowed", "records not allowed"),
            Self::UnknownExchange => ("datagram without its call", "datagrams without their call"),
            Self::RequestLimit => ("request over the limit", "requests over the limit"),
            Self::FlowLimit => ("flow over the limit", "flows over the limit"),
            Self::UpstreamExhausted => ("flow without a socket", "flows without a socket"),
            Self::SendFailed => ("failed send", "failed sends"),
            Self::UnknownFlow => ("response without a flow", "responses without a flow"),
            Self::PasswordMismatch => ("response password wrong", "response passwords wrong"),
        };
        format!("{count} {}", if count == 1 { one } else { many })
    }

    /// What it means and what to do about it, for the documentation and the status page.
    pub const fn explanation(self) -> &'static str {
        match self {
            Self::NotUnicast => {
                "Sent to a broadcast or multicast address, where others may carry it out too. Give the client an address of this router."
            }
            Self::TooShort => {
                "Fewer octets than a package with its password can have (16): noise, or a scanner."
            }
            Self::TooLong => "More octets than the largest package (107): noise, or a scanner.",
            Self::BadHeader => {
                "Does not begin with the configured header: not P-NET on IP, or `[protocol] header` differs from the plant's."
            }
            Self::BadRoute => {
                "The source/destination bits of the route make none of the five formats (requests), or none used over IP (responses)."
            }
            Self::RouteFormat => {
                "A Simple, Immediate or one-source Complex route: formats of the serial bus, not of IP. Check the client's IPNetTable."
            }
            Self::BadLength => {
                "The data-field-format announces another length than the datagram has, or octets trail behind it."
            }
            Self::PasswordMissing => "No password: set UsePW in the client's IPNetTable.",
            Self::PasswordUnexpected => {
                "A password in a request to a `[[remote_net]]`, which puts it on itself: clear UsePW in the local program's IPNetTable."
            }
            Self::PasswordWrong => {
                "A password that is none of the net's: a mistyped one, or someone who guesses."
            }
            Self::Loop => {
                "It comes from one of the relay's own ports: a server's address leads back to the router. Correct that address, or the address translation on the way."
            }
            Self::Unanswerable => {
                "No answer could reach the sender: its port is 0, or its address is a broadcast's, or no route leads there from the public address. A forged source, or a route that is missing."
            }
            Self::SourceNotAllowed => {
                "The source address is in none of the net's `allow` networks, or it is in the plant, where `allow` has to name the plant's subnet. A client's address may have changed."
            }
            Self::Throttled => {
                "The sender, or its address, sent too many wrong passwords; see `[limits]`. Correct the password and wait."
            }
            Self::NodeMismatch => {
                "The route's node address is not the public port's: the client's start port or node address is off."
            }
            Self::Broadcast => {
                "The route names node address 126 or 127. Broadcasts do not cross a NAT router."
            }
            Self::PacketType => {
                "A packet type that only the other side sends: a device that calls by itself, as in a connection, or noise."
            }
            Self::RpcInterface => {
                "A call to something else than an IO device or an endpoint mapper, or an operation that these do not have."
            }
            Self::RpcConnect => {
                "Connect: a controller that wants to control the device. Only reading crosses the router."
            }
            Self::RpcRelease => "Release: it ends a connection, and none crosses the router.",
            Self::RpcRead => {
                "Read in a connection. Outside of one, the client has to use Read Implicit."
            }
            Self::RpcWrite => "Write: it would change the device. Only reading crosses the router.",
            Self::RpcControl => "Control: it belongs to a connection, and none crosses the router.",
            Self::BadNdr => {
                "The arguments contradict each other or the length of the datagram. Such calls have hung devices."
            }
            Self::RecordNotAllowed => {
                "A record that `records` does not list. Add it if the client should read it."
            }
            Self::UnknownExchange => {
                "It belongs to no call that is known: late by more than 10 s, or noise."
            }
            Self::RequestLimit => {
                "With the right password, but more a second than `max_requests_per_second` or `max_flow_requests_per_second` lets through: a client that polls too fast, or one that is taken over."
            }
            Self::FlowLimit => {
                "A new client found `max_flows` reached, or that as many flows have ended in the last two minutes. Those already known are served; raise the limit if it is right."
            }
            Self::UpstreamExhausted => {
                "No upstream socket left for a new flow. Raise the limit of file descriptors."
            }
            Self::SendFailed => {
                "The system did not take the datagram: no route, no buffer. See the log and the host's network."
            }
            Self::UnknownFlow => {
                "From an address or to a socket for which no flow is open: a late answer, another port than the Secure one, or noise in the plant."
            }
            Self::PasswordMismatch => {
                "The answer ends with another password than the request did, or with none where one is required."
            }
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
