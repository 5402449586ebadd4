//! The IPNetTable of a P-NET node: from IPNetID and node address to IP address and UDP port (PAS 8).
//!
//! Rows go in as [`Fields`], whatever their values. An [`IpNetTable`] holds legal rows alone, so a
//! translation fails only where the table has no way to the destination. It is about IPv4, as the
//! standard is, and about 8-octet passwords only in that a row says whether there is one.
//!
//! A client of subnet 172.17.18.0 reaches node 4 of a plant section behind a NAT router:
//!
//! ```
//! use pnet_nat::pnet::ip_net_table::{Destination, Fields, IpNetTable, Nettype};
//! use pnet_nat::pnet::wire::{IpNetId, NORMAL_PORT, NodeAddress};
//!
//! let own = Fields {
//!     nettype: Nettype::IpRange,
//!     ip_address: [172, 17, 18, 0].into(),
//!     udp_port: NORMAL_PORT,
//!     ..Fields::UNUSED
//! };
//! let plant = Fields {
//!     nettype: Nettype::UdpRange,
//!     ip_address: [203, 0, 113, 5].into(),
//!     udp_port: 20000,
//!     use_password: true,
//!     router: 1,
//!     ..Fields::UNUSED
//! };
//! let [one, two] = [1, 2].map(|number| IpNetId::new(number).unwrap());
//! let client = NodeAddress::new(4).unwrap();
//! let table = IpNetTable::new(client, [(one, own), (two, plant)])?;
//!
//! let node = NodeAddress::new(4).unwrap();
//! let way = table.translate(two, Destination::Node(node))?;
//! assert_eq!((way.address, way.port), ([203, 0, 113, 5].into(), 20004));
//! assert_eq!(way.next_hop, NodeAddress::new(1));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod fields;
mod row;
mod table;
#[cfg(test)]
mod tests;
mod translate;

pub use fields::{Field, Fields, Nettype, NotANettype};
pub use row::RowFault;
pub use table::{DeviceError, IllegalTable, IpNetTable, TableError};
pub use translate::{Destination, Method, NotADestination, Sender, TranslateError, Translation};
