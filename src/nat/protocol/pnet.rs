//! P-NET: what its octets say about a request or a response.
//!
//! These checks need nothing but the octets. Who sent them, and whether the password is right, is
//! checked in `core`.

use crate::nat::net::Net;
use crate::nat::reason::DropReason;
use crate::pnet::wire::{self, Datagram, DatagramError, RouteFormat};

pub(in crate::nat) use crate::pnet::wire::{Header, Password};

/// A well-formed request: what the core needs to know about it.
#[derive(Debug)]
pub(in crate::nat) struct Request {
    /// The password, if the request has one.
    pub password: Option<[u8; 8]>,
    /// The second destination of the route (PAS 7).
    node_address: u8,
    /// Whether a destination is a broadcast address.
    broadcast: bool,
    /// Whether it wants an answer: the last source is not 0.
    pub confirmed: bool,
}

impl Request {
    /// Checks the structure of a request (PAS 11, A6, A12).
    #[inline]
    pub(in crate::nat) fn parse(
        octets: &[u8],
        header: Header,
        net: &Net,
    ) -> Result<Self, DropReason> {
        let is_remote = net.kind.is_remote();
        let needs_password = !net.allow_without_password && !is_remote;
        if octets.len() < wire::MIN_SECURE_DATAGRAM && needs_password {
            return Err(DropReason::TooShort);
        }
        let datagram = parse(octets, header)?;
        let route = datagram.route();
        // A6: over IP, the route names both the node and the client by IPNetID and node address.
        let Some(node_address) = route.node_address() else {
            return Err(DropReason::RouteFormat);
        };
        let password = datagram.password().copied();
        match password {
            None if needs_password => return Err(DropReason::PasswordMissing),
            Some(_) if is_remote => return Err(DropReason::PasswordUnexpected),
            _ => {}
        }
        // IPNetIDs 126 and 127 are reserved too, so every destination is checked.
        let broadcast = route.destinations().any(|element| element >= wire::BNA);
        let confirmed = route.sources().last() != Some(wire::NCNA);
        Ok(Self { password, node_address, broadcast, confirmed })
    }

    /// Checks that the request is meant for the one node behind its public port.
    #[inline]
    pub(in crate::nat) fn is_for(&self, node_address: u8) -> Result<(), DropReason> {
        if self.broadcast {
            return Err(DropReason::Broadcast);
        }
        if self.node_address != node_address {
            return Err(DropReason::NodeMismatch);
        }
        Ok(())
    }
}

/// Checks the structure of a response and returns its password, if it has one (A16).
#[inline]
pub(in crate::nat) fn response(
    octets: &[u8],
    header: Header,
) -> Result<Option<[u8; 8]>, DropReason> {
    let datagram = parse(octets, header)?;
    match datagram.route().format() {
        RouteFormat::Extended | RouteFormat::Ip => Ok(datagram.password().copied()),
        RouteFormat::Simple | RouteFormat::Complex | RouteFormat::Immediate => {
            Err(DropReason::BadRoute) // no Acknowledge, no Immediate-reply on IP
        }
    }
}

#[inline]
fn parse(octets: &[u8], header: Header) -> Result<Datagram<'_>, DropReason> {
    Datagram::parse(octets, header).map_err(|error| match error {
        DatagramError::TooShort => DropReason::TooShort,
        DatagramError::TooLong => DropReason::TooLong,
        DatagramError::BadHeader => DropReason::BadHeader,
        DatagramError::BadRoute(_) => DropReason::BadRoute,
        DatagramError::BadLength => DropReason::BadLength,
    })
}
