//! The reasons in words, for people.

use super::DropReason;

impl DropReason {
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
