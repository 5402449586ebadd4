//! A protocol tower: from the interface down to the address, floor by floor (C706 appendix L).

use std::net::Ipv4Addr;

use super::super::view::{Each, Show, Value};
use super::super::{ByteOrder, Malformed, Octets, Uuid};

/// A tower: a view of checked octets.
#[derive(Clone, Copy, Debug)]
pub struct Tower<'a> {
    floors: Octets<'a>,
}

/// One floor of a tower.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Floor<'a> {
    /// An interface, or how the data of its calls are written.
    Uuid {
        /// The interface, or the syntax.
        uuid: Uuid,
        /// The major version.
        major: u16,
        /// The minor version.
        minor: u16,
    },
    /// DCE/RPC without connection.
    Connectionless {
        /// The minor version.
        minor: u16,
    },
    /// UDP.
    Udp {
        /// The port that calls go to.
        port: u16,
    },
    /// IPv4.
    Ip(Ipv4Addr),
    /// Another protocol.
    Other {
        /// Its number and what belongs to the number.
        protocol: &'a [u8],
        /// Its address.
        address: &'a [u8],
    },
}

/// The floors of a tower, from the top.
#[derive(Clone, Copy, Debug)]
pub struct Floors<'a> {
    octets: Octets<'a>,
    left: u16,
}

impl<'a> Tower<'a> {
    /// Reads the two lengths, the octets, and their padding.
    pub(super) fn read(stub: &mut Octets<'a>) -> Result<Self, Malformed> {
        let differs = stub.wrong("the tower's lengths contradict each other");
        let [maximum, len] = [stub.u32()?, stub.u32()?];
        if maximum != len {
            return Err(differs);
        }
        let len = usize::try_from(len).unwrap_or(usize::MAX);
        let floors = stub.part(len)?.in_order(ByteOrder::Little);
        stub.align()?;
        let mut all = Floors::of(floors)?;
        while all.left > 0 {
            all.read()?;
        }
        if all.octets.is_empty() {
            Ok(Self { floors })
        } else {
            Err(all.octets.wrong("octets behind the tower's floors"))
        }
    }

    /// Its floors, from the top.
    pub fn floors(&self) -> Floors<'a> {
        // They have been read before.
        Floors::of(self.floors).unwrap_or(Floors { octets: self.floors, left: 0 })
    }

    /// The port that calls go to.
    pub fn udp_port(&self) -> Option<u16> {
        self.floors().find_map(|floor| match floor {
            Floor::Udp { port } => Some(port),
            _ => None,
        })
    }

    /// The interface that can be called.
    pub fn interface(&self) -> Option<Uuid> {
        self.floors().find_map(|floor| match floor {
            Floor::Uuid { uuid, .. } => Some(uuid),
            _ => None,
        })
    }
}

impl<'a> Floors<'a> {
    fn of(mut octets: Octets<'a>) -> Result<Self, Malformed> {
        let left = octets.u16()?;
        Ok(Self { octets, left })
    }

    fn read(&mut self) -> Result<Floor<'a>, Malformed> {
        let len = self.octets.u16()?;
        let protocol = self.octets.part(len.into())?;
        let len = self.octets.u16()?;
        let address = self.octets.part(len.into())?;
        self.left -= 1;
        Ok(Floor::of(protocol, address))
    }
}

impl<'a> Iterator for Floors<'a> {
    type Item = Floor<'a>;

    fn next(&mut self) -> Option<Floor<'a>> {
        if self.left == 0 { None } else { self.read().ok() }
    }
}

impl<'a> Floor<'a> {
    fn of(protocol: Octets<'a>, address: Octets<'a>) -> Self {
        let other = Self::Other { protocol: protocol.rest(), address: address.rest() };
        match (protocol.rest(), address.rest()) {
            ([0x0D, ..], [low, high]) if protocol.len() == 19 => {
                Self::uuid(protocol, u16::from_le_bytes([*low, *high])).unwrap_or(other)
            }
            ([0x0A], [low, high]) => {
                Self::Connectionless { minor: u16::from_le_bytes([*low, *high]) }
            }
            ([0x08], [high, low]) => Self::Udp { port: u16::from_be_bytes([*high, *low]) },
            ([0x09], [a, b, c, d]) => Self::Ip(Ipv4Addr::new(*a, *b, *c, *d)),
            _ => other,
        }
    }

    fn uuid(mut protocol: Octets<'a>, minor: u16) -> Result<Self, Malformed> {
        protocol.take(1)?;
        Ok(Self::Uuid { uuid: Uuid::read(&mut protocol)?, major: protocol.u16()?, minor })
    }
}

impl Each for Tower<'_> {
    fn each(&self, visit: &mut dyn FnMut(Value<'_>)) {
        self.floors().for_each(|floor| visit(Value::Fields(&floor)));
    }
}

impl Show for Floor<'_> {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        match self {
            Self::Uuid { uuid, major, minor } => {
                visit("uuid", Value::Display(uuid));
                visit("version", Value::Display(&format_args!("{major}.{minor}")));
            }
            Self::Connectionless { minor } => {
                visit("rpc_connectionless", Value::Display(&format_args!("4.{minor}")));
            }
            Self::Udp { port } => visit("udp_port", Value::Number((*port).into())),
            Self::Ip(address) => visit("ip_address", Value::Display(address)),
            Self::Other { protocol, address } => {
                visit("protocol", Value::Octets(protocol));
                visit("address", Value::Octets(address));
            }
        }
    }
}
