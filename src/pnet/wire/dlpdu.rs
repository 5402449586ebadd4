//! The type of a received DLPDU (PAS Table 1), and what is indicated to its receiver (PAS 5.7.1.6).
//!
//! To keep in mind: only a node address can be the BNA. A remaining-route-length or, in the IP
//! format, an IPNetID of the same value is not.

use super::route::ELEMENT;
use super::{BNA, Datagram, DlRoute, NCNA, Route, RouteFormat};

/// The four types of DLPDU (PAS Table 1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DlpduType {
    /// The sender waits for an answer.
    Confirmed,
    /// The sender does not wait for an answer: a response or a broadcast.
    Unconfirmed,
    /// An answer with data on a half-duplex bus.
    ImmediateReply,
    /// An answer without data on a half-duplex bus.
    Acknowledge,
}

impl DlpduType {
    /// The type of a DLPDU with this route and this number of data octets; `None` if it fits no row
    /// of Table 1.
    ///
    /// In Table 1, codes of the control-status distinguish an Acknowledge from an empty
    /// Immediate-reply. The standard does not give these codes, so every empty one counts as an
    /// Acknowledge.
    pub fn of(route: Route<'_>, data_size: usize) -> Option<Self> {
        match route.format() {
            RouteFormat::Immediate if data_size == 0 => Some(Self::Acknowledge),
            RouteFormat::Immediate => Some(Self::ImmediateReply),
            // with any destination, as PAS 5.6.1.1.1 says in words.
            RouteFormat::Complex | RouteFormat::Ip if last_source(route) == NCNA => {
                Some(Self::Unconfirmed)
            }
            _ if last_source(route) == NCNA || data_size <= 2 => None,
            _ if names_broadcast(route) => Some(Self::Unconfirmed),
            _ => Some(Self::Confirmed),
        }
    }
}

/// What is indicated to the receiver of a Confirmed or Unconfirmed DLPDU (R-28, PAS 5.7.1.6).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Indication<'a> {
    /// Whether the sender waits for an answer.
    pub confirm: bool,
    /// The way on from the receiver, and the way back to the sender.
    pub dl_route: DlRoute,
    /// Control-status. It is opaque.
    pub control_status: u8,
    /// Data-field-format: bits 1 to 6 are the size of the data unit, bits 7 and 8 are opaque.
    pub data_field_format: u8,
    /// The data unit.
    pub dlsdu: &'a [u8],
}

impl<'a> Indication<'a> {
    /// The indication of `datagram`; `None` for the Immediate format, which no Confirmed or
    /// Unconfirmed DLPDU has.
    ///
    /// Two destinations are left out: the first (over IP, the IPNetID) by DL-route generation, the
    /// second (the receiver's node address) by this step. `confirm` depends on the destinations of
    /// the P-NET-route, as in Table 1, because the DL-route does not have the node address of a
    /// Simple or Complex route any more.
    pub fn parse(datagram: &Datagram<'a>) -> Option<Self> {
        let route = datagram.route();
        if route.format() == RouteFormat::Immediate {
            return None;
        }
        let mut dl_route = route.to_dl_route();
        dl_route.destination.pop_at(0); // a Simple route has no second one
        Some(Self {
            confirm: !names_broadcast(route) && last_source(route) != NCNA,
            dl_route,
            control_status: datagram.control_status(),
            data_field_format: datagram.data_field_format(),
            dlsdu: datagram.data_octets(),
        })
    }
}

/// Whether a node address among the destinations is the BNA.
fn names_broadcast(route: Route<'_>) -> bool {
    let ip_net_ids = usize::from(route.format() == RouteFormat::Ip);
    route.destinations().skip(ip_net_ids).any(|element| element == BNA)
}

/// The last source of a route. Only a route in Immediate format may not end with a source.
fn last_source(route: Route<'_>) -> u8 {
    route.as_bytes().last().map_or(NCNA, |octet| octet & ELEMENT)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pnet::wire::{DatagramRepr, Header, MAX_DATA, MAX_DATAGRAM};

    const SIMPLE: &[u8] = &[0x04, 0x83];
    const SIMPLE_BNA: &[u8] = &[0x7E, 0x83];
    const SIMPLE_0: &[u8] = &[0x04, 0x80];
    const EXTENDED: &[u8] = &[0x0B, 0x04, 0x8B, 0x83];
    const EXTENDED_BNA: &[u8] = &[0x0B, 0x7E, 0x8B, 0x83];
    const EXTENDED_0: &[u8] = &[0x0B, 0x04, 0x8B, 0x80];
    const COMPLEX: &[u8] = &[0x04, 0x02, 0x03, 0x21, 0x05, 0x83];
    const COMPLEX_BNA: &[u8] = &[0x7E, 0x02, 0x03, 0x21, 0x05, 0x83];
    const COMPLEX_0: &[u8] = &[0x04, 0x02, 0x03, 0x21, 0x05, 0x80];
    const IP: &[u8] = &[0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F];
    const IP_BNA: &[u8] = &[0x0B, 0x7E, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F];
    const IP_0: &[u8] = &[0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x80];
    const IMMEDIATE: &[u8] = &[0x83, 0x04];

    /// The type of a datagram with this route and this number of data octets.
    fn dlpdu_type(route: &[u8], data_size: usize) -> Option<DlpduType> {
        with_datagram(route, data_size, |datagram| datagram.dlpdu_type())
    }

    fn with_datagram<T>(route: &[u8], data_size: usize, look: impl Fn(Datagram<'_>) -> T) -> T {
        let datagram = DatagramRepr {
            header: Header::default(),
            route: Route::parse(route).unwrap(),
            control_status: 0x55,
            data_field_flags: 0x40,
            data_octets: &[0xDA; MAX_DATA][..data_size],
            password: None,
        };
        let mut buffer = [0; MAX_DATAGRAM];
        let len = datagram.emit(&mut buffer).unwrap();
        look(Datagram::parse(&buffer[..len], Header::default()).unwrap())
    }

    #[test]
    fn r29_table_1_rows_of_confirmed() {
        for route in [SIMPLE, EXTENDED, COMPLEX, IP] {
            assert_eq!(dlpdu_type(route, 3), Some(DlpduType::Confirmed), "{route:02X?}");
            assert_eq!(dlpdu_type(route, 63), Some(DlpduType::Confirmed), "{route:02X?}");
        }
    }

    #[test]
    fn r30_table_1_rows_of_unconfirmed_to_bna() {
        for route in [SIMPLE_BNA, EXTENDED_BNA, COMPLEX_BNA, IP_BNA] {
            assert_eq!(dlpdu_type(route, 3), Some(DlpduType::Unconfirmed), "{route:02X?}");
            assert_eq!(dlpdu_type(route, 63), Some(DlpduType::Unconfirmed), "{route:02X?}");
        }
    }

    #[test]
    fn r30_table_1_rows_of_unconfirmed_with_last_source_0() {
        for route in [COMPLEX_0, IP_0] {
            for data_size in [0, 2, 3, 63] {
                let found = dlpdu_type(route, data_size);
                assert_eq!(found, Some(DlpduType::Unconfirmed), "{route:02X?} {data_size}");
            }
        }
    }

    #[test]
    fn r31_table_1_rows_of_the_immediate_format() {
        assert_eq!(dlpdu_type(IMMEDIATE, 0), Some(DlpduType::Acknowledge));
        assert_eq!(dlpdu_type(IMMEDIATE, 1), Some(DlpduType::ImmediateReply));
        assert_eq!(dlpdu_type(IMMEDIATE, 63), Some(DlpduType::ImmediateReply));
    }

    #[test]
    fn r29_r30_two_data_octets_fit_no_row_unless_the_last_source_is_0() {
        let routes = [SIMPLE, EXTENDED, COMPLEX, IP, SIMPLE_BNA, EXTENDED_BNA, COMPLEX_BNA, IP_BNA];
        for route in routes {
            for data_size in 0..=2 {
                assert_eq!(dlpdu_type(route, data_size), None, "{route:02X?} {data_size}");
            }
        }
    }

    #[test]
    fn r30_simple_and_extended_with_last_source_0_fit_no_row() {
        for route in [SIMPLE_0, EXTENDED_0, &[0x7E, 0x80]] {
            for data_size in [0, 3, 63] {
                assert_eq!(dlpdu_type(route, data_size), None, "{route:02X?} {data_size}");
            }
        }
    }

    #[test]
    fn r30_bna_and_last_source_0_together_are_unconfirmed() {
        let route = [0x0B, 0x7E, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x80];
        assert_eq!(dlpdu_type(&route, 0), Some(DlpduType::Unconfirmed));
        assert_eq!(dlpdu_type(&route, 3), Some(DlpduType::Unconfirmed));
    }

    #[test]
    fn r29_ip_net_id_and_sources_of_126_are_no_bna() {
        let route = [0x7E, 0x04, 0x05, 0x02, 0x21, 0xFE, 0x83, 0xFE];
        assert_eq!(dlpdu_type(&route, 3), Some(DlpduType::Confirmed));
        assert!(with_datagram(&route, 3, |datagram| Indication::parse(&datagram).unwrap().confirm));
    }

    #[test]
    fn r30_bna_counts_wherever_a_destination_stands() {
        for place in [1, 3, 4] {
            let mut route = IP.to_vec();
            route[place] = 0x7E;
            assert_eq!(dlpdu_type(&route, 3), Some(DlpduType::Unconfirmed), "{route:02X?}");
        }
    }

    #[test]
    fn r28_indication_of_pas_figure_10() {
        with_datagram(IP, 3, |datagram| {
            let indication = Indication::parse(&datagram).unwrap();
            assert!(indication.confirm);
            assert_eq!(indication.dl_route, DlRoute::new(&[2, 33], &[11, 3, 31]).unwrap());
            assert_eq!(indication.control_status, 0x55);
            assert_eq!(indication.data_field_format, 0x43);
            assert_eq!(indication.dlsdu, [0xDA; 3]);
        });
    }

    #[test]
    fn r28_the_first_element_of_the_destination_dl_route_is_removed() {
        let rows: [(&[u8], &[u8], &[u8]); 3] =
            [(SIMPLE, &[], &[3]), (EXTENDED, &[], &[11, 3]), (COMPLEX, &[33, 5], &[3])];
        for (route, destination, source) in rows {
            let dl_route =
                with_datagram(route, 3, |datagram| Indication::parse(&datagram).unwrap().dl_route);
            assert_eq!(dl_route, DlRoute::new(destination, source).unwrap());
        }
    }

    #[test]
    fn r28_confirm_is_false_for_bna_and_for_last_source_0() {
        let confirm = |route| {
            with_datagram(route, 0, |datagram| Indication::parse(&datagram).unwrap().confirm)
        };
        for route in [SIMPLE, EXTENDED, COMPLEX, IP] {
            assert!(confirm(route), "{route:02X?}");
        }
        for route in [SIMPLE_BNA, EXTENDED_BNA, COMPLEX_BNA, IP_BNA] {
            assert!(!confirm(route), "{route:02X?}");
        }
        for route in [SIMPLE_0, EXTENDED_0, COMPLEX_0, IP_0] {
            assert!(!confirm(route), "{route:02X?}");
        }
    }

    #[test]
    fn r28_the_immediate_format_has_no_indication() {
        assert!(with_datagram(IMMEDIATE, 3, |datagram| Indication::parse(&datagram).is_none()));
    }
}
