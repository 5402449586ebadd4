//! What the [core](super::Core) asks a protocol about a datagram. Nothing else in the NAT reads
//! octets.

mod pnet;

pub(super) use pnet::{Header, Password, Request, for_client, for_server, response};
