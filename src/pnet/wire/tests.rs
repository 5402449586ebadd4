//! Property tests of the whole codec: what holds for every datagram, and for any octets at all.
//!
//! The strategies build octets by hand, so that the codec does not test itself.

use proptest::collection::vec;
use proptest::prelude::*;

use super::*;

/// Destinations, then sources, each octet with its designator.
fn designated(destinations: &[u8], sources: &[u8]) -> Vec<u8> {
    let sources = sources.iter().map(|element| element + 128);
    destinations.iter().copied().chain(sources).collect()
}

/// Any route that follows one of the five formats.
fn route_octets() -> impl Strategy<Value = (RouteFormat, Vec<u8>)> {
    let element = 0u8..128;
    let simple = (element.clone(), element.clone())
        .prop_map(|(to, from)| (RouteFormat::Simple, vec![to, from + 128]));
    let immediate = (element.clone(), any::<u8>())
        .prop_map(|(from, second)| (RouteFormat::Immediate, vec![from + 128, second]));
    let extended = ([element.clone(), element.clone()], [element.clone(), element.clone()])
        .prop_map(|(to, from)| (RouteFormat::Extended, designated(&to, &from)));
    let with_length = (2usize..29)
        .prop_flat_map(|destinations| (Just(destinations), 1..=29 - destinations))
        .prop_flat_map(move |(to, from)| (vec(element.clone(), to), vec(element.clone(), from)))
        .prop_map(|(to, from)| {
            let format = if from.len() == 1 { RouteFormat::Complex } else { RouteFormat::Ip };
            let mut octets = designated(&to, &from);
            octets.insert(2, (to.len() + from.len() - 2) as u8);
            (format, octets)
        });
    prop_oneof![simple, immediate, extended, with_length]
}

/// Any valid datagram with the default header.
fn datagram_octets() -> impl Strategy<Value = Vec<u8>> {
    let data = (0u8..4, vec(any::<u8>(), 0..=63));
    let password = prop_oneof![vec(any::<u8>(), 0), vec(any::<u8>(), 8)];
    (route_octets(), any::<u8>(), data, password).prop_map(
        |((_, route), control_status, (flags, data), password)| {
            let control = [control_status, flags * 64 + data.len() as u8];
            [&[2, 0, 0, 0], &route[..], &control, &data, &password].concat()
        },
    )
}

/// Octets that an attacker may send: noise, noise after a good header, and valid datagrams with a
/// few octets changed, cut off or added.
fn hostile_octets() -> impl Strategy<Value = Vec<u8>> {
    let noise = vec(any::<u8>(), 0..200);
    let behind_header =
        vec(any::<u8>(), 0..120).prop_map(|noise| [&[2, 0, 0, 0], &noise[..]].concat());
    let changes = vec((any::<prop::sample::Index>(), any::<u8>()), 0..4);
    let damaged =
        (datagram_octets(), changes, 0usize..20).prop_map(|(mut octets, changes, more)| {
            for (index, value) in changes {
                *index.get_mut(&mut octets) = value;
            }
            octets.resize((octets.len() + more).saturating_sub(10), 0x85);
            octets
        });
    prop_oneof![noise, behind_header, damaged]
}

fn emit(datagram: &DatagramRepr<'_>) -> Vec<u8> {
    let mut buffer = [0; MAX_DATAGRAM];
    let len = datagram.emit(&mut buffer).unwrap();
    assert_eq!(len, datagram.buffer_len());
    buffer[..len].to_vec()
}

/// Calls every function of a route.
fn ask_route(route: Route<'_>) {
    assert!((MIN_ROUTE..=MAX_ROUTE).contains(&route.as_bytes().len()));
    assert!(route.destinations().chain(route.sources()).all(|element| element < 128));
    assert!(route.ip_net_id().is_some() == route.node_address().is_some());
    for data_size in [0, 2, 3, MAX_DATA, usize::MAX] {
        let _ = DlpduType::of(route, data_size);
    }
    ask_dl_route(&route.to_dl_route());
}

/// Calls every function of a DL-route.
fn ask_dl_route(dl_route: &DlRoute) {
    let sent = dl_route.clone().sent_by(Some(255), 0);
    for dl_route in [Ok(dl_route.clone()), sent].into_iter().flatten() {
        if let Ok(route) = dl_route.to_route() {
            let octets = route.as_route().as_bytes();
            assert!((MIN_ROUTE..=MAX_ROUTE).contains(&octets.len()));
            assert_eq!(Route::parse(octets), Ok(route.as_route()));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..Default::default() })]

    #[test]
    fn r5_emit_gives_back_what_parse_took(octets in datagram_octets()) {
        let datagram = Datagram::parse(&octets, Header::default()).unwrap();
        prop_assert_eq!(emit(&DatagramRepr::parse(&datagram)), octets);
    }

    #[test]
    fn r21_every_route_is_read_in_its_format((format, octets) in route_octets()) {
        let route = Route::parse(&octets).unwrap();
        prop_assert_eq!(route.as_bytes(), &octets);
        prop_assert_eq!(route.format(), format);
        let has_length = matches!(format, RouteFormat::Complex | RouteFormat::Ip);
        let elements = route.destinations().count() + route.sources().count();
        prop_assert_eq!(elements + usize::from(has_length), octets.len());
        ask_route(route);
    }

    #[test]
    fn no_octets_make_the_codec_panic(octets in hostile_octets(), room in 0usize..120) {
        if let Ok(route) = Route::parse(&octets) {
            ask_route(route);
        }
        if let Err(error) = Datagram::parse(&octets, Header::default()) {
            prop_assert!(error.position(&octets, Header::default()) <= octets.len());
        }
        if let Ok(datagram) = Datagram::parse(&octets, Header::default()) {
            let _ = (format!("{datagram:?}"), datagram.dlpdu_type(), Indication::parse(&datagram));
            ask_route(datagram.route());
            let repr = DatagramRepr::parse(&datagram);
            let _ = repr.emit(&mut vec![0; room]);
            prop_assert_eq!(emit(&repr), octets.clone());
        }
        let mut replaced = octets.clone();
        replace_password(&mut replaced, &Password::new([0x85; 8]));
        let kept = octets.len().saturating_sub(8);
        prop_assert_eq!(replaced.len(), octets.len());
        prop_assert_eq!(&replaced[..kept], &octets[..kept]);
    }

    #[test]
    fn r21_no_dl_route_makes_a_route_over_30_octets(
        destination in vec(any::<u8>(), 0..=29),
        source in vec(0u8..128, 0..=29),
    ) {
        ask_dl_route(&DlRoute::new(&destination, &source).unwrap());
    }

    #[test]
    fn r26_generation_both_ways_loses_the_first_destination_alone(
        destination in vec(0u8..128, 1..=16),
        source in vec(0u8..128, 1..=13),
    ) {
        let sent = DlRoute::new(&destination, &source).unwrap();
        if let Ok(route) = sent.to_route() {
            let received = route.as_route().to_dl_route();
            prop_assert_eq!(received, DlRoute::new(&destination[1..], &source).unwrap());
        }
    }

    #[test]
    fn r24_a_received_route_is_generated_again((format, octets) in route_octets()) {
        // Generation makes neither Immediate routes nor a length for up to four elements.
        prop_assume!(format != RouteFormat::Immediate && octets.len() != 5);
        prop_assume!(octets.len() != 4 || format == RouteFormat::Extended);
        let mut dl_route = Route::parse(&octets).unwrap().to_dl_route();
        dl_route.destination.insert(0, octets[0]);
        let route = dl_route.to_route().unwrap();
        prop_assert_eq!(route.as_route().as_bytes(), octets);
        prop_assert_eq!(route.as_route().format(), format);
    }
}
