//! Any octets, through every view of the codec. Accepted octets are emitted again unchanged, and
//! each of them belongs to a field.

use pnet_nat::pnet::wire::{
    Datagram, DatagramError, DatagramRepr, DlRoute, Header, Indication, MAX_DATA, MAX_DATAGRAM,
    MAX_ROUTE, MIN_DATAGRAM, MIN_ROUTE, Password, Route, RouteFormat, replace_password,
};

/// Takes the octets as a datagram, as a route, and as two lists of route elements.
pub fn holds(octets: &[u8]) {
    datagram(octets, Header::default());
    if let Some(&front) = octets.first_chunk() {
        datagram(octets, Header(front));
    }
    if let Ok(found) = Route::parse(octets) {
        route(found, octets);
    }
    if let Some((&destinations, elements)) = octets.split_first() {
        let (destination, source) = elements.split_at(elements.len().min(destinations.into()));
        dl_route(destination, source);
    }
}

fn datagram(octets: &[u8], header: Header) {
    let datagram = match Datagram::parse(octets, header) {
        Ok(datagram) => datagram,
        Err(error) => {
            assert_eq!(error == DatagramError::TooLong, octets.len() > MAX_DATAGRAM);
            assert_eq!(error == DatagramError::TooShort, octets.len() < MIN_DATAGRAM);
            return;
        }
    };
    let (behind_header, password) = (&octets[Header::LEN..], datagram.password());
    route(datagram.route(), behind_header);
    let data = datagram.data_octets();
    assert!(data.len() <= MAX_DATA);
    assert_eq!(usize::from(datagram.data_field_format() % 64), data.len());
    let control = [datagram.control_status(), datagram.data_field_format()];
    let tail = password.map_or(&[][..], |password| password);
    let parts = [&header.0, datagram.route().as_bytes(), &control, data, tail].concat();
    assert_eq!(parts, octets, "R-5: the parts are the whole");

    let mut buffer = [0; MAX_DATAGRAM];
    let length = DatagramRepr::parse(&datagram).emit(&mut buffer).unwrap();
    assert_eq!(buffer[..length], *octets);
    assert!(format!("{datagram:?}").contains("hidden") == password.is_some());
    datagram.dlpdu_type();
    let indication = Indication::parse(&datagram);
    assert_eq!(indication.is_none(), datagram.route().format() == RouteFormat::Immediate);
    if let Some(indication) = indication {
        assert_eq!(indication.dlsdu, data);
    }
    if password.is_some() {
        replace_password(&mut buffer[..length], &Password::new(*b"DEVICEPW"));
        let replaced = Datagram::parse(&buffer[..length], header).unwrap();
        assert_eq!(replaced.password(), Some(b"DEVICEPW"));
        assert_eq!(buffer[..length - Password::LEN], octets[..length - Password::LEN], "R-8");
    }
}

/// `octets` begin with this route.
fn route(route: Route<'_>, octets: &[u8]) {
    let length = route.as_bytes().len();
    assert!((MIN_ROUTE..=MAX_ROUTE).contains(&length), "R-21");
    assert_eq!(route.as_bytes(), &octets[..length]);
    assert_eq!(Route::parse(route.as_bytes()), Ok(route), "nothing behind a route matters");
    let (destinations, sources): (Vec<_>, Vec<_>) =
        (route.destinations().collect(), route.sources().collect());
    assert!(destinations.iter().chain(&sources).all(|&element| element < 128));
    let over_ip = matches!(route.format(), RouteFormat::Extended | RouteFormat::Ip);
    assert_eq!(route.ip_net_id(), over_ip.then(|| destinations[0]));
    assert_eq!(route.node_address(), over_ip.then(|| destinations[1]));
    let dl_route = route.to_dl_route();
    if route.format() == RouteFormat::Immediate {
        return assert_eq!(dl_route, DlRoute::default());
    }
    assert_eq!(dl_route.destination[..], destinations[1..], "R-26");
    assert_eq!(dl_route.source[..], sources[..], "R-26");
    // A length that generation leaves out is accepted too, so the format may become another.
    let whole = DlRoute::new(&destinations, &sources).unwrap();
    if let Ok(generated) = whole.to_route()
        && generated.as_route().format() == route.format()
    {
        assert_eq!(generated.as_route().as_bytes(), route.as_bytes());
    }
}

fn dl_route(destination: &[u8], source: &[u8]) {
    let Ok(dl_route) = DlRoute::new(destination, source) else { return };
    // There may be no room left for the sender, or no format for the route.
    let _ = dl_route.clone().sent_by(Some(11), 3).map(|forming| forming.to_route());
    if let Ok(generated) = dl_route.to_route() {
        let generated = generated.as_route();
        route(generated, generated.as_bytes());
        assert!(generated.destinations().eq(destination.iter().copied()));
        assert!(generated.sources().eq(source.iter().copied()));
    }
}
