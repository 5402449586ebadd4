//! The P-NET-route in front of a P-NET package: the checked view and its owned form.
//!
//! What a route means to the sender and the receiver (DL-routes) is in `dl_route`. To keep in mind:
//! the octets of a `Route` always follow one of the five formats, and are 2 to 30.

use arrayvec::ArrayVec;

use super::MAX_ROUTE;

/// Bit 8 of a route octet, the designator: set for a source, clear for a destination.
pub(super) const SOURCE: u8 = 0x80;
/// Bits 1 to 7 of a route octet: the value of the element.
pub(super) const ELEMENT: u8 = 0x7F;

/// Ranges of octets in a route of more than two octets.
mod field {
    use std::ops::{RangeFrom, RangeTo};

    /// IPNetID and node address, in a route over IP.
    pub(super) const FIRST_TWO: RangeTo<usize> = ..2;
    /// The elements after the first two, in a format without a remaining-route-length.
    pub(super) const REST: RangeFrom<usize> = 2..;
    /// The elements after the remaining-route-length, which is the third octet.
    pub(super) const REMAINING: RangeFrom<usize> = 3..;
}

/// The most octets after the remaining-route-length.
const MAX_REMAINING: usize = MAX_ROUTE - field::REMAINING.start;

/// The five formats of a route. Its designators show which one it has (PAS 5.5.2.1, 5.6.1.1.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RouteFormat {
    /// One destination, one source.
    Simple,
    /// Two destinations, two sources.
    Extended,
    /// Two or more destinations with a remaining-route-length after the second, and one source.
    Complex,
    /// The first element is a source: the answer on a half-duplex bus.
    Immediate,
    /// As [`Complex`](Self::Complex), but with two or more sources: the format that IP uses.
    Ip,
}

/// Why octets do not begin with a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RouteError {
    /// The octets end before the route does.
    #[error("the octets end inside the route")]
    Truncated,
    /// The third octet should be a remaining-route-length and has another value.
    #[error("the remaining-route-length is {0}, not 1 to {MAX_REMAINING}")]
    RemainingLength(u8),
    /// A destination comes after a source.
    #[error("a destination element stands behind a source element")]
    DestinationAfterSource,
    /// All elements are destinations.
    #[error("the route has no source element")]
    NoSource,
}

impl RouteError {
    /// The index of the fault in `octets`, which [`Route::parse`] refused with this error: that of
    /// the first wrong octet, or the length if the octets end too early.
    pub fn position(self, octets: &[u8]) -> usize {
        let end = octets.len();
        let remaining = field::REMAINING.start - 1;
        match self {
            Self::Truncated => end,
            Self::RemainingLength(_) => remaining,
            Self::DestinationAfterSource => (field::REMAINING.start..end)
                .find(|&at| is_source(octets[at - 1]) && !is_source(octets[at]))
                .unwrap_or(end),
            Self::NoSource => remaining + octets.get(remaining).copied().map_or(0, usize::from),
        }
    }
}

/// A route: a view of 2 to 30 checked octets (PAS 5.5.2.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Route<'a> {
    octets: &'a [u8],
    format: RouteFormat,
}

impl<'a> Route<'a> {
    /// Reads the route at the front of `octets`; more octets may follow. The designators show the
    /// format and so the end of the route.
    ///
    /// A remaining-route-length is accepted with any number of elements, also with so few that
    /// route generation would have left it out.
    #[inline]
    pub fn parse(octets: &'a [u8]) -> Result<Self, RouteError> {
        match *octets {
            // PAS says nothing about the second octet, so any value is right.
            [first, _, ..] if is_source(first) => take(octets, 2, RouteFormat::Immediate),
            [_, second, ..] if is_source(second) => take(octets, 2, RouteFormat::Simple),
            [_, _, third, ref rest @ ..] if is_source(third) => match *rest {
                [fourth, ..] if is_source(fourth) => take(octets, 4, RouteFormat::Extended),
                [_, ..] => Err(RouteError::DestinationAfterSource),
                [] => Err(RouteError::Truncated),
            },
            [_, _, remaining, ref rest @ ..] => {
                let format = format_of_remaining(remaining, rest)?;
                take(octets, field::REMAINING.start + usize::from(remaining), format)
            }
            _ => Err(RouteError::Truncated),
        }
    }

    /// The format of the route.
    #[inline]
    pub fn format(&self) -> RouteFormat {
        self.format
    }

    /// The octets of the route, as on the wire.
    #[inline]
    pub fn as_bytes(&self) -> &'a [u8] {
        self.octets
    }

    /// The remaining-route-length: the number of octets after it. `None` in a format without one.
    pub fn remaining_route_length(&self) -> Option<u8> {
        match self.format {
            RouteFormat::Complex | RouteFormat::Ip => self.octets.get(2).copied(),
            RouteFormat::Simple | RouteFormat::Extended | RouteFormat::Immediate => None,
        }
    }

    /// The destination elements in order, 7 bits each. The remaining-route-length is not an
    /// element.
    #[inline]
    pub fn destinations(&self) -> impl Iterator<Item = u8> + use<'a> {
        self.elements().filter(|&octet| !is_source(octet))
    }

    /// The source elements in order, 7 bits each.
    #[inline]
    pub fn sources(&self) -> impl Iterator<Item = u8> + use<'a> {
        self.elements().filter(|&octet| is_source(octet)).map(|octet| octet & ELEMENT)
    }

    /// The IPNetID that the datagram goes to: the first destination of a route in Extended or IP
    /// format.
    #[inline]
    pub fn ip_net_id(&self) -> Option<u8> {
        self.ip_destination().map(|[ip_net_id, _]| ip_net_id)
    }

    /// The node that the datagram goes to: the second destination of a route in Extended or IP
    /// format.
    #[inline]
    pub fn node_address(&self) -> Option<u8> {
        self.ip_destination().map(|[_, node_address]| node_address)
    }

    #[inline]
    fn ip_destination(&self) -> Option<[u8; 2]> {
        match self.format {
            RouteFormat::Extended | RouteFormat::Ip => self.octets.first_chunk().copied(),
            RouteFormat::Simple | RouteFormat::Complex | RouteFormat::Immediate => None,
        }
    }

    /// All elements with their designators, but not the remaining-route-length.
    #[inline]
    fn elements(&self) -> impl Iterator<Item = u8> + use<'a> {
        let rest = match self.format {
            RouteFormat::Complex | RouteFormat::Ip => field::REMAINING,
            RouteFormat::Simple | RouteFormat::Extended | RouteFormat::Immediate => field::REST,
        };
        self.octets[field::FIRST_TWO].iter().chain(&self.octets[rest]).copied()
    }
}

/// A route that owns its octets. Route generation makes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RouteBuf {
    octets: ArrayVec<u8, MAX_ROUTE>,
    format: RouteFormat,
}

impl RouteBuf {
    /// `octets` must be a route of this `format`.
    pub(super) fn new(octets: ArrayVec<u8, MAX_ROUTE>, format: RouteFormat) -> Self {
        Self { octets, format }
    }

    /// The route as a view.
    #[inline]
    pub fn as_route(&self) -> Route<'_> {
        Route { octets: &self.octets, format: self.format }
    }
}

#[inline]
fn is_source(octet: u8) -> bool {
    octet & SOURCE != 0
}

#[inline]
fn take(octets: &[u8], len: usize, format: RouteFormat) -> Result<Route<'_>, RouteError> {
    let octets = octets.get(..len).ok_or(RouteError::Truncated)?;
    Ok(Route { octets, format })
}

/// The format, Complex or IP, of a route whose `remaining` last octets are at the front of `rest`:
/// any number of destinations, then one or more sources.
#[inline]
fn format_of_remaining(remaining: u8, rest: &[u8]) -> Result<RouteFormat, RouteError> {
    let count = usize::from(remaining);
    if count == 0 || count > MAX_REMAINING {
        return Err(RouteError::RemainingLength(remaining));
    }
    let elements = rest.get(..count).ok_or(RouteError::Truncated)?;

    // There is no branch for each element: an attacker can make designators that no processor
    // predicts.
    let (mut previous, mut misplaced, mut sources) = (0, 0, 0);
    for &octet in elements {
        misplaced |= previous & !octet;
        previous = octet;
        sources += octet >> 7;
    }
    if is_source(misplaced) {
        return Err(RouteError::DestinationAfterSource);
    }
    match sources {
        0 => Err(RouteError::NoSource),
        1 => Ok(RouteFormat::Complex),
        _ => Ok(RouteFormat::Ip),
    }
}

#[cfg(test)]
mod tests;
