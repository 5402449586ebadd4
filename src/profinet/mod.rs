//! PROFINET, as far as a program beside a P-NET plant meets it: checked views over octets, without
//! I/O.
//!
//! Invariants: nothing here panics or allocates, whatever the octets are, and a view borrows what it
//! shows. What cannot be read is [`Malformed`], with the place. A block or an option that is not
//! known keeps its number and its octets.

pub mod alarm;
pub mod blocks;
pub mod dcp;
pub mod diagnosis;
pub mod endpoint_mapper;
pub mod lldp;
pub mod mrp;
pub mod ndr;
pub mod ptcp;
pub mod records;
pub mod rpc;
pub mod rt;
pub mod status;
pub mod view;

mod address;
mod octets;
mod uuid;
mod writer;

pub use address::MacAddress;
pub use octets::{ByteOrder, Malformed, Octets};
pub use status::PnioStatus;
pub use uuid::{ObjectUuid, Uuid};
pub use writer::BufferTooSmall;

#[cfg(test)]
mod tests;
