//! What a protocol answers the [core](super::Core) about a datagram. Nothing else in the NAT knows
//! octets.

mod pnet;

pub(super) use pnet::{Header, Password, Request, replace_password, response};
