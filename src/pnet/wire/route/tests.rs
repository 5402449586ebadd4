use super::*;

fn parse(octets: &[u8]) -> Result<Route<'_>, RouteError> {
    Route::parse(octets)
}

/// A route with its format, destinations and sources, also with other octets after it.
#[track_caller]
fn reads(octets: &[u8], format: RouteFormat, destinations: &[u8], sources: &[u8]) {
    for behind in [&[][..], &[0x00], &[0x83, 0x04, 0xFF]] {
        let longer = [octets, behind].concat();
        let route = parse(&longer).unwrap();
        assert_eq!(route.as_bytes(), octets);
        assert_eq!(route.format(), format);
        assert!(route.destinations().eq(destinations.iter().copied()), "{route:?}");
        assert!(route.sources().eq(sources.iter().copied()), "{route:?}");
    }
}

#[test]
fn r22_simple_is_one_destination_and_one_source() {
    reads(&[0x04, 0x83], RouteFormat::Simple, &[4], &[3]);
    reads(&[0x7F, 0xFF], RouteFormat::Simple, &[127], &[127]);
}

#[test]
fn r23_extended_is_two_destinations_and_two_sources() {
    reads(&[0x0B, 0x04, 0x8B, 0x83], RouteFormat::Extended, &[11, 4], &[11, 3]);
}

#[test]
fn r24_complex_has_one_source_behind_its_length() {
    reads(&[0x04, 0x02, 0x03, 0x21, 0x05, 0x83], RouteFormat::Complex, &[4, 2, 33, 5], &[3]);
}

#[test]
fn r31_immediate_begins_with_a_source_and_keeps_any_second_octet() {
    reads(&[0x83, 0x04], RouteFormat::Immediate, &[4], &[3]);
    reads(&[0x83, 0x84], RouteFormat::Immediate, &[], &[3, 4]);
}

#[test]
fn r25_pas_figure_9_two_sources_are_ip_on_udp() {
    reads(&[0x04, 0x02, 0x03, 0x21, 0x83, 0x9F], RouteFormat::Ip, &[4, 2, 33], &[3, 31]);
}

#[test]
fn r25_pas_figure_10_names_ip_net_and_node() {
    let octets = [0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F];
    reads(&octets, RouteFormat::Ip, &[11, 4, 2, 33], &[11, 3, 31]);
    let route = parse(&octets).unwrap();
    assert_eq!((route.ip_net_id(), route.node_address()), (Some(11), Some(4)));
}

#[test]
fn r25_only_extended_and_ip_name_an_ip_net() {
    let route = parse(&[0x0B, 0x04, 0x8B, 0x83]).unwrap();
    assert_eq!((route.ip_net_id(), route.node_address()), (Some(11), Some(4)));
    for octets in [&[0x04, 0x83][..], &[0x04, 0x02, 0x02, 0x21, 0x83], &[0x83, 0x04]] {
        let route = parse(octets).unwrap();
        assert_eq!((route.ip_net_id(), route.node_address()), (None, None), "{route:?}");
    }
}

#[test]
fn r24_a_length_that_generation_would_leave_out_is_believed() {
    reads(&[0x0B, 0x04, 0x02, 0x8B, 0x83], RouteFormat::Ip, &[11, 4], &[11, 3]);
    reads(&[0x0B, 0x04, 0x01, 0x83], RouteFormat::Complex, &[11, 4], &[3]);
}

#[test]
fn r21_a_route_ends_at_30_octets() {
    let mut octets = [0x05; 31];
    octets[2] = 27;
    octets[29] = 0x83;
    reads(&octets[..30], RouteFormat::Complex, &[5; 28], &[3]);
    octets[29..].fill(0x83);
    octets[2] = 28;
    assert_eq!(parse(&octets), Err(RouteError::RemainingLength(28)));
}

#[test]
fn r24_a_length_of_zero_or_over_27_is_refused() {
    for remaining in [0, 28, 0x7F] {
        let mut octets = [0x84; 200];
        octets[..3].copy_from_slice(&[0x0B, 0x04, remaining]);
        assert_eq!(parse(&octets), Err(RouteError::RemainingLength(remaining)));
    }
}

#[test]
fn r21_a_destination_behind_a_source_is_refused() {
    for octets in [
        &[0x0B, 0x04, 0x8B, 0x03][..],
        &[0x0B, 0x04, 0x02, 0x8B, 0x03],
        &[0x0B, 0x04, 0x04, 0x02, 0x8B, 0x03, 0x83],
        &[0x0B, 0x04, 0x03, 0x8B, 0x83, 0x03],
    ] {
        assert_eq!(parse(octets), Err(RouteError::DestinationAfterSource), "{octets:02X?}");
    }
}

#[test]
fn r21_a_route_without_a_source_is_refused() {
    assert_eq!(parse(&[0x0B, 0x04, 0x01, 0x02, 0x83]), Err(RouteError::NoSource));
    assert_eq!(parse(&[0x0B, 0x04, 0x03, 0x02, 0x03, 0x04, 0x83]), Err(RouteError::NoSource));
}

#[test]
fn a_fault_has_its_place() {
    for (octets, position) in [
        (&[0x0B, 0x04, 0x8B, 0x03][..], 3),
        (&[0x0B, 0x04, 0x04, 0x02, 0x8B, 0x03, 0x83], 5),
        (&[0x0B, 0x04, 0x03, 0x8B, 0x83, 0x03], 5),
        (&[0x0B, 0x04, 0x00, 0x8B], 2),
        (&[0x0B, 0x04, 0x03, 0x02, 0x03, 0x04, 0x83], 5),
        (&[0x0B, 0x04, 0x05, 0x02], 4),
        (&[], 0),
    ] {
        let error = parse(octets).unwrap_err();
        assert_eq!(error.position(octets), position, "{octets:02X?}");
    }
}

#[test]
fn r21_every_beginning_of_a_route_is_truncated() {
    for octets in [
        &[0x04, 0x83][..],
        &[0x83, 0x04],
        &[0x0B, 0x04, 0x8B, 0x83],
        &[0x04, 0x02, 0x02, 0x21, 0x83],
        &[0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F],
    ] {
        for len in 0..octets.len() {
            assert_eq!(parse(&octets[..len]), Err(RouteError::Truncated), "{octets:02X?} {len}");
        }
    }
}
