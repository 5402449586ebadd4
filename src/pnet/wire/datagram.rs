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
mod tests {
    use super::*;
    use crate::pnet::wire::{MAX_ROUTE, MIN_SECURE_DATAGRAM, RouteFormat};

    /// PAS Figure 10 as a request to the Secure port.
    const FIGURE_10: [u8; 25] = [
        0x02, 0x00, 0x00, 0x00, // header
        0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F, // route
        0x2A, 0xC3, // control-status, data-field-format: both flags, 3 data octets
        0x12, 0x34, 0x56, // data octets
        b'P', b'N', b'E', b'T', b'P', b'A', b'S', b'S', // password
    ];

    fn parse(octets: &[u8]) -> Result<Datagram<'_>, DatagramError> {
        Datagram::parse(octets, Header::default())
    }

    /// The largest datagram: 30 octets of route, 63 of data, a password.
    fn largest() -> [u8; MAX_DATAGRAM] {
        let mut octets = [0x05; MAX_DATAGRAM];
        octets[..4].copy_from_slice(&[0x02, 0x00, 0x00, 0x00]);
        octets[6] = 27;
        octets[32] = 0x8B;
        octets[33] = 0x83;
        octets[35] = 63;
        octets
    }

    #[test]
    fn r5_pas_figure_10_with_a_password() {
        let datagram = parse(&FIGURE_10).unwrap();
        assert_eq!(datagram.route().format(), RouteFormat::Ip);
        assert_eq!(datagram.route().as_bytes(), &FIGURE_10[4..12]);
        assert_eq!(datagram.control_status(), 0x2A);
        assert_eq!(datagram.data_field_format(), 0xC3);
        assert_eq!(datagram.data_octets(), [0x12, 0x34, 0x56]);
        assert_eq!(datagram.password(), Some(b"PNETPASS"));
        assert_eq!(datagram.dlpdu_type(), Some(DlpduType::Confirmed));
    }

    #[test]
    fn r5_pas_figure_10_without_a_password() {
        let datagram = parse(&FIGURE_10[..17]).unwrap();
        assert_eq!(datagram.data_octets(), [0x12, 0x34, 0x56]);
        assert_eq!(datagram.password(), None);
    }

    #[test]
    fn r5_smallest_datagrams_have_8_and_16_octets() {
        let octets = *b"\x02\0\0\0\x04\x83\0\0PNETPASS";
        assert_eq!((MIN_DATAGRAM, MIN_SECURE_DATAGRAM, octets.len()), (8, 16, 16));
        assert_eq!(parse(&octets).unwrap().password(), Some(b"PNETPASS"));
        assert_eq!(parse(&octets[..8]).unwrap().password(), None);
        for len in 0..8 {
            assert_eq!(parse(&octets[..len]).unwrap_err(), DatagramError::TooShort);
        }
    }

    #[test]
    fn r5_largest_datagram_has_107_octets() {
        let octets = largest();
        assert_eq!(octets.len(), 107);
        let datagram = parse(&octets).unwrap();
        assert_eq!(datagram.route().as_bytes().len(), MAX_ROUTE);
        assert_eq!(datagram.data_octets().len(), MAX_DATA);
        assert_eq!(datagram.password(), Some(&[0x05; 8]));

        let longer = [&octets[..], &[0]].concat();
        assert_eq!(parse(&longer).unwrap_err(), DatagramError::TooLong);
    }

    #[test]
    fn r5_every_octet_of_the_header_is_compared() {
        for octet in 0..4 {
            let mut octets = FIGURE_10;
            octets[octet] ^= 0x01;
            assert_eq!(parse(&octets).unwrap_err(), DatagramError::BadHeader);
        }
        let mut octets = FIGURE_10;
        octets[0] = 0x20;
        assert!(Datagram::parse(&octets, Header([0x20, 0, 0, 0])).is_ok());
    }

    #[test]
    fn r6_a12_octets_behind_the_data_are_a_password_or_an_error() {
        for behind in 0..20 {
            let octets = [&FIGURE_10[..17], &[0xAA; 20][..behind]].concat();
            match behind {
                0 => assert_eq!(parse(&octets).unwrap().password(), None),
                8 => assert_eq!(parse(&octets).unwrap().password(), Some(&[0xAA; 8])),
                _ => assert_eq!(parse(&octets).unwrap_err(), DatagramError::BadLength, "{behind}"),
            }
        }
    }

    #[test]
    fn a12_octets_that_end_before_the_data_do_are_an_error() {
        for len in 12..17 {
            assert_eq!(parse(&FIGURE_10[..len]).unwrap_err(), DatagramError::BadLength, "{len}");
        }
    }

    #[test]
    fn the_checks_come_in_order() {
        let bad_header = [0u8; 107];
        assert_eq!(parse(&bad_header[..7]).unwrap_err(), DatagramError::TooShort);
        assert_eq!(parse(&[0u8; 108]).unwrap_err(), DatagramError::TooLong);
        assert_eq!(parse(&bad_header).unwrap_err(), DatagramError::BadHeader);

        let mut bad_route_and_length = largest();
        bad_route_and_length[6] = 0;
        bad_route_and_length[35] = 62;
        let error = parse(&bad_route_and_length).unwrap_err();
        assert_eq!(error, DatagramError::BadRoute(RouteError::RemainingLength(0)));

        let cut_in_the_route = &FIGURE_10[..11];
        let error = parse(cut_in_the_route).unwrap_err();
        assert_eq!(error, DatagramError::BadRoute(RouteError::Truncated));
    }

    #[test]
    fn a_fault_has_its_place() {
        let behind = [&FIGURE_10[..], &[0]].concat();
        let mut header = FIGURE_10;
        header[2] = 1;
        let mut remaining = FIGURE_10;
        remaining[6] = 0;
        for (octets, position) in [
            (&FIGURE_10[..7], 7),
            (&[0; 108], 107),
            (&header, 2),
            (&remaining, 6),
            (&FIGURE_10[..11], 11),
            (&FIGURE_10[..13], 13),
            (&FIGURE_10[..16], 16),
            (&FIGURE_10[..24], 17),
            (&behind, 17),
        ] {
            let error = parse(octets).unwrap_err();
            assert_eq!(error.position(octets, Header::default()), position, "{error}");
        }
    }

    #[test]
    fn r5_a_representation_emits_pas_figure_10() {
        let datagram = DatagramRepr {
            header: Header::default(),
            route: Route::parse(&FIGURE_10[4..12]).unwrap(),
            control_status: 0x2A,
            data_field_flags: 0xC0,
            data_octets: &[0x12, 0x34, 0x56],
            password: Some(Password::new(*b"PNETPASS")),
        };
        assert_eq!(datagram.buffer_len(), 25);
        let mut buffer = [0xEE; 27];
        assert_eq!(datagram.emit(&mut buffer), Ok(25));
        assert_eq!(buffer[..25], FIGURE_10);
        assert_eq!(buffer[25..], [0xEE, 0xEE]);

        let without = DatagramRepr { password: None, ..datagram };
        assert_eq!(without.emit(&mut buffer), Ok(17));
        assert_eq!(buffer[..17], FIGURE_10[..17]);
    }

    #[test]
    fn what_fits_no_datagram_is_not_emitted() {
        let datagram = DatagramRepr::parse(&parse(&FIGURE_10).unwrap());
        let mut small = [0xEE; 24];
        assert_eq!(datagram.emit(&mut small), Err(EmitError::BufferTooSmall(25)));
        assert_eq!(small, [0xEE; 24]);

        let mut buffer = [0; 200];
        let large = DatagramRepr { data_octets: &[0; 64], ..datagram.clone() };
        assert_eq!(large.emit(&mut buffer), Err(EmitError::TooMuchData(64)));
        let flags = DatagramRepr { data_field_flags: 0x41, ..datagram };
        assert_eq!(flags.emit(&mut buffer), Err(EmitError::BadFlags(0x41)));
    }

    #[test]
    fn r8_a_replaced_password_changes_the_last_8_octets_alone() {
        let mut octets = FIGURE_10;
        replace_password(&mut octets, &Password::new(*b"DEVICEPW"));
        assert_eq!(octets[..17], FIGURE_10[..17]);
        assert_eq!(parse(&octets).unwrap().password(), Some(b"DEVICEPW"));

        let mut short = [1, 2, 3, 4, 5, 6, 7];
        replace_password(&mut short, &Password::new(*b"DEVICEPW"));
        assert_eq!(short, [1, 2, 3, 4, 5, 6, 7]);
    }

    #[test]
    fn debug_hides_the_password() {
        let datagram = parse(&FIGURE_10).unwrap();
        for text in [format!("{datagram:?}"), format!("{:?}", DatagramRepr::parse(&datagram))] {
            assert!(text.contains("hidden"), "{text}");
            assert!(!text.contains("PNETPASS") && !text.contains("80, 78, 69, 84"), "{text}");
        }
    }
}
