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
