//! DL-routes: the two lists of addresses that a user of the data link layer sees. A P-NET-route is
//! made from them (PAS 5.7.2, 5.7.1.5), and they are made from a P-NET-route (PAS 5.7.3).
//!
//! To keep in mind: the first destination of a P-NET-route does not come into the DL-route. So the
//! receiver's DL-route is one element shorter than the sender's, as the route shrinks hop by hop.

use arrayvec::ArrayVec;

use super::route::{ELEMENT, SOURCE};
use super::{MAX_ELEMENTS, MAX_ROUTE, Route, RouteBuf, RouteFormat};

/// The elements of a DL-route, 7 bits each.
pub type Elements = ArrayVec<u8, MAX_ELEMENTS>;

/// A Destination DL-route and a Source DL-route.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DlRoute {
    /// The way to the destination, the next hop first.
    pub destination: Elements,
    /// The way back to the source, the nearest node first.
    pub source: Elements,
}

/// Why a DL-route has no P-NET-route.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DlRouteError {
    /// PAS 5.7.2 has no rule for these numbers of elements.
    #[error(
        "no route format holds {destinations} destination and {sources} source elements: use \
         1 + 1, 2 + 2, or at least 2 destinations and more than 4 elements in all"
    )]
    NoFormat {
        /// Elements of the Destination DL-route.
        destinations: usize,
        /// Elements of the Source DL-route.
        sources: usize,
    },
    /// An element needs more than 7 bits.
    #[error("route element {0} is over 127")]
    ElementTooLarge(u8),
    /// The route would be longer than 30 octets.
    #[error("{0} route elements are too many: a route holds at most {MAX_ELEMENTS}")]
    TooLong(usize),
}

impl DlRoute {
    /// The DL-route with these elements.
    ///
    /// Fails if one of the lists is longer than any route. Their values and the sum of their
    /// lengths are checked by [`to_route`](Self::to_route).
    pub fn new(destination: &[u8], source: &[u8]) -> Result<Self, DlRouteError> {
        Ok(Self { destination: elements(destination)?, source: elements(source)? })
    }

    /// Adds the sender to the front of the source route, the first step of forming a DLPDU: its
    /// node address (R-27, PAS 5.7.1.5) and, over IP, its IPNetID before that.
    ///
    /// Fails if the source route is full.
    pub fn sent_by(
        mut self,
        ip_net_id: Option<u8>,
        node_address: u8,
    ) -> Result<Self, DlRouteError> {
        for element in [Some(node_address), ip_net_id].into_iter().flatten() {
            let len = self.source.len();
            self.source.try_insert(0, element).map_err(|_| DlRouteError::TooLong(len + 1))?;
        }
        Ok(self)
    }

    /// Request P-NET-route generation (PAS 5.7.2). It follows the rules of the standard to the
    /// letter.
    ///
    /// Fails if no rule covers these numbers of elements, if an element needs more than 7 bits, and
    /// if the route would be too long.
    pub fn to_route(&self) -> Result<RouteBuf, DlRouteError> {
        let (destinations, sources) = (self.destination.len(), self.source.len());
        let format = match (destinations, sources) {
            (1, 1) => RouteFormat::Simple,    // R-22, PAS 5.7.2 a
            (2, 2) => RouteFormat::Extended,  // R-23, PAS 5.7.2 b
            (4.., 1) => RouteFormat::Complex, // R-24, PAS 5.7.2 c: more than four in all
            (2.., 2..) => RouteFormat::Ip,
            _ => return Err(DlRouteError::NoFormat { destinations, sources }),
        };
        let total = destinations + sources;
        if total > MAX_ELEMENTS {
            return Err(DlRouteError::TooLong(total));
        }
        let mut all = self.destination.iter().chain(&self.source);
        if let Some(&large) = all.find(|&&element| element > ELEMENT) {
            return Err(DlRouteError::ElementTooLarge(large));
        }

        let mut octets = ArrayVec::<u8, MAX_ROUTE>::new();
        octets.extend(self.destination.iter().copied());
        octets.extend(self.source.iter().map(|element| element | SOURCE));
        if matches!(format, RouteFormat::Complex | RouteFormat::Ip) {
            octets.insert(2, (total - 2) as u8); // 3 to 27, all elements but the first two
        }
        Ok(RouteBuf::new(octets, format))
    }
}

impl Route<'_> {
    /// DL-route generation (R-26, PAS 5.7.3): the first destination is left out, all other elements
    /// are copied. From the Immediate format the standard generates nothing: both lists are empty.
    pub fn to_dl_route(&self) -> DlRoute {
        if self.format() == RouteFormat::Immediate {
            return DlRoute::default();
        }
        // A route has at most MAX_ELEMENTS elements, so collecting cannot overflow.
        DlRoute {
            destination: self.destinations().skip(1).collect(),
            source: self.sources().collect(),
        }
    }
}

fn elements(values: &[u8]) -> Result<Elements, DlRouteError> {
    values.try_into().map_err(|_| DlRouteError::TooLong(values.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dl_route(destination: &[u8], source: &[u8]) -> DlRoute {
        DlRoute::new(destination, source).unwrap()
    }

    #[track_caller]
    fn generates(destination: &[u8], source: &[u8], format: RouteFormat, octets: &[u8]) {
        let route = dl_route(destination, source).to_route().unwrap();
        assert_eq!(route.as_route().as_bytes(), octets);
        assert_eq!(route.as_route().format(), format);
        assert_eq!(Route::parse(octets), Ok(route.as_route()));
    }

    #[track_caller]
    fn receives(octets: &[u8], destination: &[u8], source: &[u8]) {
        let route = Route::parse(octets).unwrap();
        assert_eq!(route.to_dl_route(), dl_route(destination, source));
    }

    #[test]
    fn r22_pas_figure_3_one_and_one_generate_simple() {
        generates(&[4], &[3], RouteFormat::Simple, &[0x04, 0x83]);
    }

    #[test]
    fn r23_pas_figure_4_two_and_two_generate_extended() {
        generates(&[11, 4], &[11, 3], RouteFormat::Extended, &[0x0B, 0x04, 0x8B, 0x83]);
    }

    #[test]
    fn r24_pas_figure_5_more_than_four_generate_complex_or_ip() {
        let octets = [0x04, 0x02, 0x03, 0x21, 0x05, 0x83];
        generates(&[4, 2, 33, 5], &[3], RouteFormat::Complex, &octets);
        // No destination is left behind the length.
        generates(&[11, 4], &[11, 3, 31], RouteFormat::Ip, &[0x0B, 0x04, 0x03, 0x8B, 0x83, 0x9F]);
    }

    #[test]
    fn r24_the_third_octet_is_the_total_minus_two() {
        for destinations in 2..MAX_ELEMENTS {
            for sources in 1..=MAX_ELEMENTS - destinations {
                let total = destinations + sources;
                if total <= 4 {
                    continue;
                }
                let dl_route = dl_route(&vec![5; destinations], &vec![6; sources]);
                let route = dl_route.to_route().unwrap();
                let octets = route.as_route().as_bytes();
                assert_eq!(usize::from(octets[2]), total - 2);
                assert_eq!(octets.len(), total + 1);
            }
        }
    }

    #[test]
    fn r22_r23_r24_numbers_without_a_rule_have_no_route() {
        let numbers =
            [(0, 0), (0, 1), (0, 5), (1, 0), (2, 0), (5, 0), (1, 2), (1, 9), (2, 1), (3, 1)];
        for (destinations, sources) in numbers {
            let dl_route = dl_route(&vec![1; destinations], &vec![1; sources]);
            let error = dl_route.to_route().unwrap_err();
            assert_eq!(error, DlRouteError::NoFormat { destinations, sources });
        }
        let text = dl_route(&[1, 2], &[3]).to_route().unwrap_err().to_string();
        assert!(
            text.contains("no route format holds 2 destination and 1 source elements"),
            "{text}"
        );
    }

    #[test]
    fn r21_29_elements_fill_a_route_and_30_are_too_many() {
        let route = dl_route(&[1; 26], &[2; 3]).to_route().unwrap();
        assert_eq!(route.as_route().as_bytes().len(), MAX_ROUTE);
        assert_eq!(dl_route(&[1; 27], &[2; 3]).to_route(), Err(DlRouteError::TooLong(30)));
        assert_eq!(dl_route(&[1; 29], &[2; 29]).to_route(), Err(DlRouteError::TooLong(58)));
        assert_eq!(DlRoute::new(&[1; 30], &[2]), Err(DlRouteError::TooLong(30)));
        assert_eq!(DlRoute::new(&[1], &[2; 31]), Err(DlRouteError::TooLong(31)));
    }

    #[test]
    fn r21_an_element_over_127_has_no_route() {
        assert_eq!(dl_route(&[4], &[128]).to_route(), Err(DlRouteError::ElementTooLarge(128)));
        assert_eq!(
            dl_route(&[255, 4], &[1, 2]).to_route(),
            Err(DlRouteError::ElementTooLarge(255))
        );
        assert!(dl_route(&[127], &[127]).to_route().is_ok());
    }

    #[test]
    fn r26_pas_figure_6_simple_leaves_no_destination() {
        receives(&[0x04, 0x83], &[], &[3]);
    }

    #[test]
    fn r26_pas_figure_7_extended_leaves_the_second_destination() {
        receives(&[0x0B, 0x04, 0x8B, 0x83], &[4], &[11, 3]);
    }

    #[test]
    fn r26_pas_figure_8_complex_and_ip_leave_out_first_destination_and_length() {
        receives(&[0x04, 0x02, 0x03, 0x21, 0x05, 0x83], &[2, 33, 5], &[3]);
        receives(&[0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F], &[4, 2, 33], &[11, 3, 31]);
    }

    #[test]
    fn r26_immediate_generates_nothing() {
        receives(&[0x83, 0x04], &[], &[]);
        receives(&[0x83, 0x84], &[], &[]);
    }

    #[test]
    fn r27_pas_figures_9_and_10_the_sender_goes_in_front_of_the_source() {
        let bus = dl_route(&[4, 2, 33], &[31]).sent_by(None, 3).unwrap();
        let octets = [0x04, 0x02, 0x03, 0x21, 0x83, 0x9F];
        assert_eq!(bus.to_route().unwrap().as_route().as_bytes(), octets);

        let ip = dl_route(&[11, 4, 2, 33], &[31]).sent_by(Some(11), 3).unwrap();
        let octets = [0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F];
        assert_eq!(ip.to_route().unwrap().as_route().as_bytes(), octets);
    }

    #[test]
    fn r27_a_full_source_route_takes_no_sender() {
        assert_eq!(dl_route(&[], &[1; 29]).sent_by(None, 3), Err(DlRouteError::TooLong(30)));
        assert_eq!(dl_route(&[], &[1; 28]).sent_by(Some(11), 3), Err(DlRouteError::TooLong(30)));
        assert!(dl_route(&[], &[1; 28]).sent_by(None, 3).is_ok());
    }
}
