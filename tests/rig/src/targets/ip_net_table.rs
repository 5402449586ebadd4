//! Any text as a client's IPNetTable, and any octets as the one in a device: it is refused with a reason,
//! or every way in it follows the standard.

use std::net::{Ipv4Addr, SocketAddrV4};
use std::path::Path;

use pnet_nat::config::{self, Fault, Faults};
use pnet_nat::pnet::ip_net_table::{
    Destination, DeviceError, Fields, IllegalTable, IpNetTable, Method, Nettype, Sender,
    TranslateError, Translation,
};
use pnet_nat::pnet::wire::{IpNetId, NodeAddress, SECURE_PORT};

/// Octets of a row, and of what stands in front of the rows.
const ROW: usize = 10;
const FRONT: usize = 6;

/// Takes the octets as a text and as a device.
pub fn holds(octets: &[u8]) {
    if let Ok(text) = str::from_utf8(octets) {
        read(text);
    }
    if let Some((front, rows)) = octets.split_first_chunk() {
        device(*front, rows);
    }
}

fn read(text: &str) {
    let path = Path::new("/nowhere/client.toml");
    match config::parse_ip_net_table(text, path) {
        Ok((table, warnings)) => {
            warnings.iter().for_each(|warning| is_told_well(&warning.0, text));
            keeps_its_rules(&table);
        }
        Err(Faults(faults)) => {
            assert!(!faults.is_empty(), "refused without a word");
            faults.iter().for_each(|fault| is_told_well(fault, text));
        }
    }
}

fn is_told_well(fault: &Fault, text: &str) {
    let told = fault.to_string();
    assert!(!fault.problem.is_empty() && !fault.remedy.is_empty(), "{told}");
    assert!(!told.contains(char::is_control), "one line of text: {told:?}");
    let lines = 1 + text.matches('\n').count();
    assert!((1..=lines).contains(&fault.line.expect("a line")), "{told}");
}

/// Address, NoOfIPNets, and rows as far as the octets go.
fn device(front: [u8; FRONT], octets: &[u8]) {
    let [a, b, c, d, high, low] = front;
    let mut rows = [Fields::UNUSED; 124];
    let (given, _) = octets.as_chunks::<ROW>();
    for (row, &[nettype, e, f, g, h, port_high, port_low, use_password, router, without]) in
        rows.iter_mut().zip(given)
    {
        *row = Fields {
            nettype: match nettype % 3 {
                0 => Nettype::Unused,
                1 => Nettype::IpRange,
                _ => Nettype::UdpRange,
            },
            ip_address: Ipv4Addr::new(e, f, g, h),
            udp_port: u16::from_be_bytes([port_high, port_low]),
            use_password: use_password & 1 == 1,
            router,
            allow_without_password: without & 1 == 1,
        };
    }
    let count = u16::from_be_bytes([high, low]);
    match IpNetTable::of_device(Ipv4Addr::new(a, b, c, d), count, &rows) {
        Ok(table) => {
            assert_eq!(table.node_address().get(), d, "R-12");
            keeps_its_rules(&table);
        }
        Err(DeviceError::Rows(IllegalTable(errors))) => assert!(!errors.is_empty()),
        Err(DeviceError::TooManyNets(_)) => assert!((125..0xFFFF).contains(&count), "R-15"),
        Err(DeviceError::NotANode(_)) => assert!(!(1..=125).contains(&d), "R-12"),
    }
}

/// for every number that a route can hold.
fn keeps_its_rules(table: &IpNetTable) {
    let node = table.node_address();
    assert_eq!(IpNetTable::new(node, table.rows()).as_ref(), Ok(table), "its rows are the table");
    let own_nets = table.rows().filter(|(_, fields)| fields.router == 0);
    assert!(own_nets.map(|(id, _)| id).eq([table.own_net()]), "R-15");
    for number in 0..128 {
        let Some(net) = IpNetId::new(number) else {
            assert!(matches!(number, 0 | 126 | 127), "R-13");
            continue;
        };
        let row = table.rows().find(|(id, _)| *id == net).map(|(_, fields)| fields);
        for number in 0..=u8::MAX {
            let Ok(destination) = Destination::try_from(number) else { continue };
            match (table.translate(net, destination), row) {
                (Ok(way), Some(fields)) => {
                    follows(&way, &fields, destination);
                    assert!(way.next_hop != Some(node), "R-20");
                    is_known_back(table, net, destination, &way);
                }
                (Err(TranslateError::BroadcastOverUdpRange(_)), Some(fields)) => {
                    assert_eq!(fields.nettype, Nettype::UdpRange, "R-42");
                    assert_eq!(destination, Destination::Broadcast);
                }
                (Err(TranslateError::UnusedNet(_)), None) => {}
                (Err(TranslateError::DynamicClients(_)), None) => assert_eq!(net.get(), 125),
                wrong => panic!("{net}, {destination:?}: {wrong:?}"),
            }
        }
    }
}

/// PAS 8, methods a to d.
fn follows(way: &Translation, fields: &Fields, destination: Destination) {
    let [a, b, c, _] = fields.ip_address.octets();
    let last = match destination {
        Destination::Node(node_address) => node_address.get(),
        Destination::Broadcast => 255,
    };
    let (method, address, port) = match fields.nettype {
        Nettype::Unused => panic!("a way to an unused net"),
        Nettype::IpRange => {
            let method = if fields.router == 0 { Method::A } else { Method::B };
            (method, Ipv4Addr::new(a, b, c, last), Some(fields.udp_port))
        }
        Nettype::UdpRange => {
            let port = fields.udp_port.checked_add(destination.number().into());
            (Method::D, fields.ip_address, port)
        }
    };
    assert_eq!((way.method, way.address, Some(way.port)), (method, address, port));
    assert_eq!(way.next_hop.map_or(0, NodeAddress::get), fields.router);
    assert_eq!(way.use_password, fields.use_password);
    assert!(way.port > 0 && (1..224).contains(&way.address.octets()[0]));
    let secure = method == Method::D || way.port == SECURE_PORT;
    assert!(!secure || way.use_password || fields.allow_without_password, "R-3, R-4, A4");
}

/// who is where the table has it is known, unless the net is a UDP Range net.
fn is_known_back(table: &IpNetTable, net: IpNetId, destination: Destination, way: &Translation) {
    let Destination::Node(node_address) = destination else { return };
    let address = SocketAddrV4::new(way.address, way.port);
    let sender = Sender { net, node_address, address, has_password: false };
    assert_eq!(table.is_known_client(&sender), way.method != Method::D);
    assert!(!table.is_known_client(&Sender { has_password: true, ..sender }));
    let other = SocketAddrV4::new(way.address, way.port ^ 1);
    assert!(!table.is_known_client(&Sender { address: other, ..sender }));
}
