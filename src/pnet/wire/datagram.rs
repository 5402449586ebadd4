//! The whole datagram: header, route, control-status, data-field-format, data octets, password.
//!
//! This file knows where the fields are, not what they mean. To keep in mind: every octet of a
//! `Datagram`'s slice belongs to one of its fields, and its password is never shown.

use std::fmt;

use super::{
    CONTROL, DlpduType, Header, MAX_DATA, MAX_DATAGRAM, MIN_DATAGRAM, Password, Route, RouteError,
};

/// Bits of the data-field-format (PAS 5.7.1.5).
mod data_field_format {
    /// Bits 1 to 6: the number of data octets.
    pub(super) const SIZE: u8 = 0x3F;
    /// Bits 7 and 8: the DLS-user's, opaque and kept.
    pub(super) const FLAGS: u8 = !SIZE;
}

/// Why octets are not a datagram, in the order of the checks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DatagramError {
    /// Fewer octets than any datagram has.
    #[error("a datagram has at least {MIN_DATAGRAM} octets")]
    TooShort,
    /// More octets than any datagram has.
    #[error("a datagram has at most {MAX_DATAGRAM} octets")]
    TooLong,
    /// Another header than the expected one.
    #[error("the header is not the expected one")]
    BadHeader,
    /// The octets after the header do not begin with a route.
    #[error("bad route: {0}")]
    BadRoute(#[from] RouteError),
    /// The octets after the route are not as many as the data-field-format says, with or without a
    /// password.
    #[error("the octets behind the route do not fit the data-field-format")]
    BadLength,
}

impl DatagramError {
    /// The index of the fault in `octets`, which [`Datagram::parse`] refused with this error: that
    /// of the first wrong octet, or the length if the octets end too early.
    pub fn position(self, octets: &[u8], header: Header) -> usize {
        let end = octets.len();
        match self {
            Self::TooShort => end,
            Self::TooLong => MAX_DATAGRAM,
            Self::BadHeader => {
                octets.iter().zip(header.0).position(|(&is, should)| is != should).unwrap_or(end)
            }
            Self::BadRoute(error) => Header::LEN + error.position(&octets[Header::LEN.min(end)..]),
            Self::BadLength => data_end(octets).filter(|&data_end| data_end < end).unwrap_or(end),
        }
    }
}

/// Where the data octets should end; `None` if the datagram ends before the data-field-format.
fn data_end(octets: &[u8]) -> Option<usize> {
    let package = octets.get(Header::LEN..)?;
    let data = Header::LEN + Route::parse(package).ok()?.as_bytes().len() + CONTROL;
    let data_field_format = octets.get(data - 1)?;
    Some(data + usize::from(data_field_format & data_field_format::SIZE))
}

/// Why a [`DatagramRepr`] was not emitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EmitError {
    /// More data octets than a datagram can have.
    #[error("{0} data octets are too many: a datagram holds at most {MAX_DATA}")]
    TooMuchData(usize),
    /// The flags use bits of the data size.
    #[error("data-field flags {0:#04x} use other bits than 7 and 8")]
    BadFlags(u8),
    /// The buffer is smaller than the datagram.
    #[error("the datagram needs a buffer of {0} octets")]
    BufferTooSmall(usize),
}

/// A datagram: a view of 8 to 107 checked octets.
#[derive(Clone, Copy)]
pub struct Datagram<'a> {
    header: Header,
    route: Route<'a>,
    control_status: u8,
    data_field_format: u8,
    data_octets: &'a [u8],
    password: Option<&'a [u8; Password::LEN]>,
}

impl<'a> Datagram<'a> {
    /// Checks the format of `octets` as a whole, and that they begin with `header`. After the data
    /// octets there must be a password or nothing.
    #[inline]
    pub fn parse(octets: &'a [u8], header: Header) -> Result<Self, DatagramError> {
        if octets.len() > MAX_DATAGRAM {
            return Err(DatagramError::TooLong);
        }
        let Some((front, package)) = octets.split_first_chunk::<{ Header::LEN }>() else {
            return Err(DatagramError::TooShort);
        };
        if octets.len() < MIN_DATAGRAM {
            return Err(DatagramError::TooShort);
        }
        if *front != header.0 {
            return Err(DatagramError::BadHeader);
        }
        let route = Route::parse(package)?;
        Self::parse_behind(header, route, package).ok_or(DatagramError::BadLength)
    }

    /// Reads the fields after the route; `None` if they do not end where `package` ends.
    #[inline]
    fn parse_behind(header: Header, route: Route<'a>, package: &'a [u8]) -> Option<Self> {
        let behind = package.get(route.as_bytes().len()..)?;
        let (&[control_status, data_field_format], body) = behind.split_first_chunk::<CONTROL>()?;
        let data_size = usize::from(data_field_format & data_field_format::SIZE);
        let (data_octets, tail) = body.split_at_checked(data_size)?;
        let password = if tail.is_empty() { None } else { Some(tail.try_into().ok()?) };
        Some(Self { header, route, control_status, data_field_format, data_octets, password })
    }

    /// The route.
    #[inline]
    pub fn route(&self) -> Route<'a> {
        self.route
    }

    /// Control-status. The standard does not give its codes, so it is opaque.
    #[inline]
    pub fn control_status(&self) -> u8 {
        self.control_status
    }

    /// Data-field-format: bits 1 to 6 are the number of data octets, bits 7 and 8 are opaque.
    #[inline]
    pub fn data_field_format(&self) -> u8 {
        self.data_field_format
    }

    /// The data octets, at most 63: the DLSDU.
    #[inline]
    pub fn data_octets(&self) -> &'a [u8] {
        self.data_octets
    }

    /// The octets of the password, if there is one.
    #[inline]
    pub fn password(&self) -> Option<&'a [u8; Password::LEN]> {
        self.password
    }

    /// Its type; `None` if it fits no row of PAS Table 1.
    pub fn dlpdu_type(&self) -> Option<DlpduType> {
        DlpduType::of(self.route, self.data_octets.len())
    }
}

impl fmt::Debug for Datagram<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        DatagramRepr::parse(self).fmt(f)
    }
}

/// A datagram to be emitted.
#[derive(Clone, Debug)]
pub struct DatagramRepr<'a> {
    /// The header.
    pub header: Header,
    /// The route; [`DlRoute::to_route`](super::DlRoute::to_route) makes one.
    pub route: Route<'a>,
    /// Control-status.
    pub control_status: u8,
    /// Bits 7 and 8 of the data-field-format at their position. The other bits are clear.
    pub data_field_flags: u8,
    /// The data octets, at most 63.
    pub data_octets: &'a [u8],
    /// The password, for a Secure port.
    pub password: Option<Password>,
}

impl<'a> DatagramRepr<'a> {
    /// The fields of `datagram`.
    pub fn parse(datagram: &Datagram<'a>) -> Self {
        Self {
            header: datagram.header,
            route: datagram.route,
            control_status: datagram.control_status,
            data_field_flags: datagram.data_field_format & data_field_format::FLAGS,
            data_octets: datagram.data_octets,
            password: datagram.password.map(|octets| Password::new(*octets)),
        }
    }

    /// The number of octets that [`emit`](Self::emit) writes.
    pub fn buffer_len(&self) -> usize {
        let password = if self.password.is_some() { Password::LEN } else { 0 };
        Header::LEN + self.route.as_bytes().len() + CONTROL + self.data_octets.len() + password
    }

    /// Writes the datagram to the front of `buffer` and returns the number of its octets. A buffer
    /// of [`MAX_DATAGRAM`] octets is always large enough.
    pub fn emit(&self, buffer: &mut [u8]) -> Result<usize, EmitError> {
        let data_size = self.data_octets.len();
        if data_size > MAX_DATA {
            return Err(EmitError::TooMuchData(data_size));
        }
        if self.data_field_flags & data_field_format::SIZE != 0 {
            return Err(EmitError::BadFlags(self.data_field_flags));
        }
        let len = self.buffer_len();
        let mut rest = buffer.get_mut(..len).ok_or(EmitError::BufferTooSmall(len))?;

        let control = [self.control_status, self.data_field_flags | data_size as u8];
        let password = self.password.as_ref().map_or(&[][..], |password| password.octets());
        for field in [&self.header.0, self.route.as_bytes(), &control, self.data_octets, password] {
            let (place, behind) = rest.split_at_mut(field.len());
            place.copy_from_slice(field);
            rest = behind;
        }
        Ok(len)
    }
}

/// Overwrites the last 8 octets with `password`. The octets must have been parsed as a [`Datagram`]
/// with a password. If there are fewer than 8, they stay as they are.
#[inline]
pub fn replace_password(octets: &mut [u8], password: &Password) {
    if let Some(tail) = octets.last_chunk_mut() {
        *tail = *password.octets();
    }
}

#[cfg(test)]
mod tests;
