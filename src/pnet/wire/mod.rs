//! The octets of P-NET on IP: datagram, route, DLPDU.
//!
//! A datagram is a 4-octet header, a P-NET package without checksum (route, control-status,
//! data-field-format, data octets) and, towards the Secure port, an 8-octet password (PAS 11,
//! 5.5.1.1). A view ([`Datagram`], [`Route`]) borrows octets that its `parse` has checked. An owned
//! form ([`DatagramRepr`], [`RouteBuf`], [`DlRoute`]) is built field by field and then emitted.
//!
//! The contract: nothing here does I/O, allocates, or panics on any input. Whatever octets a
//! `parse` accepts, the matching `emit` writes the same ones.
//!
//! PAS Figure 10, a request to node 4 of IP net 11, sent by node 3:
//!
//! ```
//! use pnet_nat::pnet::wire::{Datagram, Header, RouteFormat};
//!
//! let octets = [
//!     0x02, 0x00, 0x00, 0x00, // header
//!     0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F, // route
//!     0x00, 0x03, // control-status, data-field-format
//!     0x12, 0x34, 0x56, // data octets
//! ];
//! let datagram = Datagram::parse(&octets, Header::default())?;
//! assert_eq!(datagram.route().format(), RouteFormat::Ip);
//! assert_eq!(datagram.route().ip_net_id(), Some(11));
//! assert_eq!(datagram.route().node_address(), Some(4));
//! assert_eq!(datagram.data_octets(), [0x12, 0x34, 0x56]);
//! # Ok::<(), pnet_nat::pnet::wire::DatagramError>(())
//! ```

mod address;
mod datagram;
mod dl_route;
mod dlpdu;
mod header;
mod password;
mod route;
#[cfg(test)]
mod tests;

pub use address::{
    BNA, IpNetId, LAST_NODE, LAST_START_PORT, NCNA, NORMAL_PORT, NodeAddress, NotAnIpNetId,
    SECURE_PORT, SNA,
};
pub use datagram::{Datagram, DatagramError, DatagramRepr, EmitError, replace_password};
pub use dl_route::{DlRoute, DlRouteError, Elements};
pub use dlpdu::{DlpduType, Indication};
pub use header::Header;
pub use password::Password;
pub use route::{Route, RouteBuf, RouteError, RouteFormat};

/// Octets in the smallest route, Simple or Immediate (PAS 5.5.2.1).
pub const MIN_ROUTE: usize = 2;
/// Octets in the largest route (PAS 5.5.2.1; the serial bus stops at 24).
pub const MAX_ROUTE: usize = 30;
/// Elements in the largest route: one of its octets is the remaining-route-length.
pub const MAX_ELEMENTS: usize = MAX_ROUTE - 1;
/// The most data octets: the data-field-format has six bits for their number (PAS 5.7.1.5).
pub const MAX_DATA: usize = 63;

/// Octets of control-status and data-field-format.
const CONTROL: usize = 2;

/// Octets in the smallest datagram: a Simple or Immediate route, no data, no password.
pub const MIN_DATAGRAM: usize = Header::LEN + MIN_ROUTE + CONTROL;
/// Octets in the smallest datagram with a password.
pub const MIN_SECURE_DATAGRAM: usize = MIN_DATAGRAM + Password::LEN;
/// Octets in the largest datagram, which has a password.
pub const MAX_DATAGRAM: usize = Header::LEN + MAX_ROUTE + CONTROL + MAX_DATA + Password::LEN;
