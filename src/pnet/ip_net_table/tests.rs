//! Legal and illegal tables, and that no table leads to an address outside its rules.

use std::net::{Ipv4Addr, SocketAddrV4};

use proptest::prelude::*;

use super::*;
use crate::pnet::wire::{IpNetId, LAST_NODE, NORMAL_PORT, NodeAddress, SECURE_PORT};

fn id(number: u8) -> IpNetId {
    IpNetId::new(number).unwrap()
}

fn node(number: u8) -> NodeAddress {
    NodeAddress::new(number).unwrap()
}

fn to(number: u8) -> Destination {
    Destination::try_from(number).unwrap()
}

/// The own net of PAS 8, Table 4.
const OWN: Fields = Fields {
    nettype: Nettype::IpRange,
    ip_address: Ipv4Addr::new(172, 17, 17, 0),
    udp_port: NORMAL_PORT,
    ..Fields::UNUSED
};
const BEHIND_ROUTER: Fields =
    Fields { ip_address: Ipv4Addr::new(172, 17, 18, 0), router: 1, ..OWN };
const BEHIND_NAT: Fields = Fields {
    nettype: Nettype::UdpRange,
    ip_address: Ipv4Addr::new(203, 0, 113, 5),
    udp_port: 20000,
    use_password: true,
    router: 2,
    ..Fields::UNUSED
};

/// As in PAS 8, Table 4: the own net is the third.
fn rows() -> [(IpNetId, Fields); 3] {
    [(id(1), BEHIND_ROUTER), (id(2), BEHIND_NAT), (id(3), OWN)]
}

fn table() -> IpNetTable {
    IpNetTable::new(node(4), rows()).unwrap()
}

fn errors(rows: impl IntoIterator<Item = (IpNetId, Fields)>) -> Vec<TableError> {
    IpNetTable::new(node(4), rows).unwrap_err().0
}

#[track_caller]
fn refuses(fields: Fields, faults: &[RowFault]) {
    let errors = errors([(id(1), OWN), (id(7), fields)]);
    let expected = faults.iter().map(|&fault| TableError::Row { row: id(7), fault });
    assert_eq!(errors, expected.collect::<Vec<_>>());
}

#[test]
fn r16_method_a_is_the_own_subnet_and_the_port_of_the_table() {
    let way = table().translate(id(3), to(125)).unwrap();
    let expected = Translation {
        method: Method::A,
        address: [172, 17, 17, 125].into(),
        port: NORMAL_PORT,
        next_hop: None,
        use_password: false,
    };
    assert_eq!(way, expected);
    assert_eq!(table().own_net(), id(3));
}

#[test]
fn r16_the_last_octet_of_the_row_does_not_count() {
    let own = Fields { ip_address: [172, 17, 17, 200].into(), ..OWN };
    let table = IpNetTable::new(node(4), [(id(1), own)]).unwrap();
    let way = table.translate(id(1), to(9)).unwrap();
    assert_eq!(way.address, Ipv4Addr::new(172, 17, 17, 9));
    assert_eq!(table.rows().collect::<Vec<_>>(), [(id(1), OWN)]);
}

#[test]
fn r17_method_b_is_the_same_by_a_router() {
    let way = table().translate(id(1), to(9)).unwrap();
    assert_eq!((way.method, way.next_hop), (Method::B, Some(node(1))));
    assert_eq!((way.address, way.port), ([172, 17, 18, 9].into(), NORMAL_PORT));
}

#[test]
fn r10_r19_method_d_is_the_whole_address_and_start_port_plus_node_address() {
    for number in [1, 125] {
        let way = table().translate(id(2), to(number)).unwrap();
        assert_eq!((way.method, way.next_hop), (Method::D, Some(node(2))));
        assert_eq!(way.address, Ipv4Addr::new(203, 0, 113, 5));
        assert_eq!((way.port, way.use_password), (20000 + u16::from(number), true));
    }
}

#[test]
fn r42_a_broadcast_goes_to_255_of_an_ip_range_net_alone() {
    for (net, next_hop) in [(3, None), (1, Some(node(1)))] {
        let way = table().translate(id(net), Destination::Broadcast).unwrap();
        assert_eq!((way.address.octets()[3], way.next_hop), (255, next_hop));
    }
    let error = table().translate(id(2), to(126)).unwrap_err();
    assert_eq!(error, TranslateError::BroadcastOverUdpRange(id(2)));
    assert_eq!(error.to_string(), "row 2, Nettype: a broadcast needs an IP Range net (PAS 10)");
    for number in [0, 127, 128, 255] {
        assert_eq!(Destination::try_from(number), Err(NotADestination), "{number}");
    }
    for number in 1..=126 {
        assert_eq!(to(number).number(), number);
    }
}

#[test]
fn r13_nets_without_a_row_have_no_way() {
    let sparse = IpNetTable::new(node(4), [(id(1), OWN), (id(3), BEHIND_NAT)]).unwrap();
    for (net, error) in [
        (2, TranslateError::UnusedNet(id(2))),
        (4, TranslateError::UnusedNet(id(4))),
        (124, TranslateError::UnusedNet(id(124))),
        (125, TranslateError::DynamicClients(id(125))),
    ] {
        assert_eq!(sparse.translate(id(net), to(1)), Err(error));
    }
}

#[test]
fn r13_r15_rows_are_1_to_124_and_each_there_once() {
    let full = (1..=124).map(|number| (id(number), if number == 9 { OWN } else { BEHIND_NAT }));
    let table = IpNetTable::new(node(4), full).unwrap();
    assert_eq!(table.rows().count(), 124);
    assert!(table.translate(id(124), to(1)).is_ok());
    let row = |row, fault| TableError::Row { row: id(row), fault };
    assert_eq!(errors([(id(1), OWN), (id(125), BEHIND_NAT)]), [row(125, RowFault::DynamicClients)]);
    assert_eq!(
        errors([(id(1), OWN), (id(2), BEHIND_NAT), (id(2), BEHIND_ROUTER)]),
        [row(2, RowFault::Repeated)]
    );
}

#[test]
fn r15_there_is_one_own_net() {
    assert_eq!(errors([(id(2), BEHIND_NAT)]), [TableError::NoOwnNet]);
    assert_eq!(errors([]), [TableError::NoOwnNet]);
    let second = TableError::Row { row: id(2), fault: RowFault::SecondOwnNet(id(1)) };
    assert_eq!(errors([(id(1), OWN), (id(2), OWN)]), [second]);
    // A fault of the own net's row is one fault, not two.
    let own = Fields { udp_port: 0, ..OWN };
    let fault = RowFault::NoPort;
    assert_eq!(errors([(id(1), own)]), [TableError::Row { row: id(1), fault }]);
}

#[test]
fn r18_method_c_is_refused() {
    refuses(Fields { router: 0, ..BEHIND_NAT }, &[RowFault::UdpRangeWithoutRouter]);
}

#[test]
fn r20_a_router_is_another_node_of_the_own_net() {
    for row in [BEHIND_NAT, BEHIND_ROUTER] {
        for number in [126, 127, 255] {
            refuses(Fields { router: number, ..row }, &[RowFault::RouterNotANode(number)]);
        }
        refuses(Fields { router: 4, ..row }, &[RowFault::RouterIsTheNode(node(4))]);
    }
}

#[test]
fn r3_r4_a4_secure_ports_have_a_password() {
    let without = Fields { use_password: false, ..BEHIND_NAT };
    refuses(without, &[RowFault::UdpRangeWithoutPassword]);
    let secure = Fields { udp_port: SECURE_PORT, ..BEHIND_ROUTER };
    refuses(secure, &[RowFault::SecurePortWithoutPassword]);

    let meant = Fields { allow_without_password: true, ..without };
    let secure = Fields { use_password: true, ..secure };
    let rows = [(id(1), OWN), (id(2), meant), (id(3), secure)];
    let table = IpNetTable::new(node(4), rows).unwrap();
    assert!(!table.translate(id(2), to(1)).unwrap().use_password);
    assert!(table.translate(id(3), to(1)).unwrap().use_password);
}

#[test]
fn a15_every_node_of_a_udp_range_has_a_port() {
    let last = Fields { udp_port: 65410, ..BEHIND_NAT };
    let table = IpNetTable::new(node(4), [(id(1), OWN), (id(2), last)]).unwrap();
    assert_eq!(table.translate(id(2), to(125)).unwrap().port, 65535);
    let over = Fields { udp_port: 65411, ..BEHIND_NAT };
    refuses(over, &[RowFault::StartPortTooHigh(65411)]);
    refuses(Fields { udp_port: 0, ..BEHIND_NAT }, &[RowFault::NoPort]);
    refuses(Fields { udp_port: 0, ..BEHIND_ROUTER }, &[RowFault::NoPort]);
}

#[test]
fn addresses_are_those_of_hosts() {
    for first in [0, 224, 240, 255] {
        let ip_address = Ipv4Addr::new(first, 0, 0, 1);
        refuses(Fields { ip_address, ..BEHIND_NAT }, &[RowFault::NotAHost(ip_address)]);
        let subnet = Ipv4Addr::new(first, 0, 0, 0);
        refuses(Fields { ip_address, ..BEHIND_ROUTER }, &[RowFault::NotASubnet(subnet)]);
    }
}

#[test]
fn every_fault_of_every_row_is_told_with_row_field_and_clause() {
    let wrong = Fields {
        ip_address: [255; 4].into(),
        udp_port: 65500,
        use_password: false,
        router: 0,
        ..BEHIND_NAT
    };
    let rows = [(id(2), wrong), (id(3), Fields { router: 200, ..BEHIND_ROUTER })];
    let error = IpNetTable::new(node(4), rows).unwrap_err();
    assert_eq!(
        error.to_string().replace("; ", "\n"),
        "row 2, IPAddr: 255.255.255.255 is not a host address (PAS 8 d)\n\
         row 2, UDPPort: 65500 + 125 is over 65535 (PAS 8 d)\n\
         row 2, UsePW: a UDP Range net needs a password (PAS 7)\n\
         row 2, Router: a UDP Range net is never the own net: it needs a router (PAS 8 c)\n\
         row 3, Router: 200 is no node address on the own net (PAS 8)\n\
         no IP Range net has router 0, so the node has no own net (PAS 8)"
    );
}

#[test]
fn the_fields_of_an_unused_row_do_not_matter() {
    let odd = Fields { nettype: Nettype::Unused, ip_address: [255; 4].into(), router: 255, ..OWN };
    let table = IpNetTable::new(node(4), [(id(1), odd), (id(2), OWN)]).unwrap();
    assert_eq!(table.own_net(), id(2));
    assert_eq!(table.rows().collect::<Vec<_>>(), [(id(2), OWN)]);
}

#[test]
fn r15_a_device_counts_its_rows() {
    let mut ip_nets = [Fields::UNUSED; 124];
    for (id, fields) in rows() {
        ip_nets[usize::from(id.get()) - 1] = fields;
    }
    let device = |count| IpNetTable::of_device([172, 17, 17, 4].into(), count, &ip_nets);
    assert_eq!(device(3), Ok(table()));
    assert!(device(124).unwrap().rows().eq(rows()));
    assert_eq!(
        device(2),
        Err(IllegalTable(vec![TableError::NoOwnNet]).into()),
        "the own net is row 3"
    );
    for count in [125, 65534] {
        assert_eq!(device(count), Err(DeviceError::TooManyNets(count)));
    }
}

/// As the vendor describes it.
#[test]
fn r15_a_device_that_was_not_set_up_knows_its_own_subnet() {
    let odd = [Fields { router: 200, ..BEHIND_NAT }; 124];
    for count in [0, 0xFFFF] {
        let table = IpNetTable::of_device([172, 17, 17, 33].into(), count, &odd).unwrap();
        assert_eq!((table.node_address(), table.own_net()), (node(33), id(1)));
        assert!(table.rows().eq([(id(1), OWN)]));
    }
    for last in [0, 126, 255] {
        let address = Ipv4Addr::new(172, 17, 17, last);
        let error = IpNetTable::of_device(address, 0, &odd).unwrap_err();
        assert_eq!(error, DeviceError::NotANode(address), "R-12");
    }
}

#[test]
fn r35_a_client_is_known_by_all_of_four_conditions() {
    let known = Sender {
        net: id(1),
        node_address: node(9),
        address: SocketAddrV4::new([172, 17, 18, 9].into(), NORMAL_PORT),
        has_password: false,
    };
    let table = table();
    let is_known = |sender| table.is_known_client(&sender);
    assert!(is_known(known));
    let own = SocketAddrV4::new([172, 17, 17, 9].into(), NORMAL_PORT);
    assert!(is_known(Sender { net: id(3), address: own, ..known }));

    let nat = SocketAddrV4::new([203, 0, 113, 5].into(), 20009);
    assert!(!is_known(Sender { net: id(2), address: nat, ..known }), "a UDP Range net");
    for net in [4, 125] {
        assert!(!is_known(Sender { net: id(net), ..known }), "no row");
    }
    assert!(!is_known(Sender { node_address: node(8), ..known }));
    assert!(!is_known(Sender { address: own, ..known }), "another subnet");
    let other_port = SocketAddrV4::new(*known.address.ip(), SECURE_PORT);
    assert!(!is_known(Sender { address: other_port, ..known }));
    assert!(!is_known(Sender { has_password: true, ..known }));
}

/// Fields that are legal more often than by chance.
fn fields() -> impl Strategy<Value = Fields> {
    let nettype = prop::sample::select(vec![
        Nettype::Unused,
        Nettype::IpRange,
        Nettype::UdpRange,
        Nettype::UdpRange,
    ]);
    let port = prop_oneof![
        Just(NORMAL_PORT),
        Just(SECURE_PORT),
        Just(65410_u16),
        Just(65411_u16),
        1000..60000_u16,
        any::<u16>(),
    ];
    let router = prop_oneof![Just(0_u8), 1..=125_u8, 1..=125_u8, any::<u8>()];
    let address = prop_oneof![
        (1..224_u8, any::<[u8; 3]>()).prop_map(|(a, [b, c, d])| Ipv4Addr::new(a, b, c, d)),
        any::<[u8; 4]>().prop_map(Ipv4Addr::from)
    ];
    (nettype, address, port, any::<bool>(), router, any::<bool>()).prop_map(
        |(nettype, ip_address, udp_port, use_password, router, allow_without_password)| Fields {
            nettype,
            ip_address,
            udp_port,
            use_password,
            router,
            allow_without_password,
        },
    )
}

/// for each destination of each row that was taken.
fn keeps_its_rules(table: &IpNetTable, given: &[(IpNetId, Fields)]) {
    for &(net, fields) in given {
        let [a, b, c, _] = fields.ip_address.octets();
        for destination in NodeAddress::all().map(Destination::Node).chain([Destination::Broadcast])
        {
            let Ok(way) = table.translate(net, destination) else {
                let is_broadcast = destination == Destination::Broadcast;
                let is_udp_range = fields.nettype == Nettype::UdpRange;
                assert!(fields.nettype == Nettype::Unused || is_broadcast && is_udp_range);
                continue;
            };
            let last = match destination {
                Destination::Node(node_address) => node_address.get(),
                Destination::Broadcast => 255,
            };
            assert_eq!(way.use_password, fields.use_password);
            assert_eq!(way.next_hop.map_or(0, NodeAddress::get), fields.router);
            assert_eq!(way.next_hop.is_none(), net == table.own_net());
            assert_ne!(way.next_hop, Some(table.node_address()));
            match fields.nettype {
                Nettype::Unused => panic!("a way to an unused net"),
                Nettype::IpRange => {
                    assert_eq!(way.method == Method::A, fields.router == 0);
                    assert_eq!(way.address, Ipv4Addr::new(a, b, c, last));
                    assert_eq!(way.port, fields.udp_port);
                    assert!(way.port != SECURE_PORT || way.use_password);
                }
                Nettype::UdpRange => {
                    assert_eq!(way.method, Method::D);
                    assert_eq!(way.address, fields.ip_address);
                    assert_eq!(u32::from(way.port), u32::from(fields.udp_port) + u32::from(last));
                    assert!(last <= LAST_NODE);
                }
            }
            assert!((1..224).contains(&way.address.octets()[0]) && way.port > 0);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// No table that is taken leads anywhere but where its fields say.
    #[test]
    fn no_table_leads_outside_its_rules(
        own in fields(),
        others in prop::collection::vec((2..=125_u8, fields()), 0..6),
    ) {
        let own = Fields { nettype: Nettype::IpRange, router: 0, ..own };
        let rows: Vec<_> = [(id(1), own)]
            .into_iter()
            .chain(others.into_iter().map(|(number, fields)| (id(number), fields)))
            .collect();
        match IpNetTable::new(node(4), rows.iter().copied()) {
            Ok(table) => {
                keeps_its_rules(&table, &rows);
                prop_assert_eq!(IpNetTable::new(node(4), table.rows()), Ok(table));
            }
            Err(IllegalTable(errors)) => prop_assert!(!errors.is_empty()),
        }
        // Each by itself, so that most are taken.
        for &row in &rows[1..] {
            let alone = [(id(1), OWN), row];
            if let Ok(table) = IpNetTable::new(node(4), alone) {
                keeps_its_rules(&table, &alone);
            }
        }
    }
}
