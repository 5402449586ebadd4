//! UUIDs: one value, whatever the byte order on the wire is (P-7).
//!
//! A UUID is kept as it is printed. DCE/RPC sends its first three fields as numbers of the header's
//! byte order, the blocks of PROFINET always big-endian; so two UUIDs from two headers can be compared.

use std::fmt;

use super::{ByteOrder, Malformed, Octets};

/// A universally unique identifier (C706, appendix A).
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Uuid([u8; 16]);

/// The octets of every object UUID of PROFINET before instance, device and vendor.
const OBJECT: [u8; 10] = [0xDE, 0xA0, 0x00, 0x00, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71];

impl Uuid {
    /// All octets are 0.
    pub const NIL: Self = Self([0; 16]);

    /// The UUID whose 32 digits are this number's.
    pub const fn new(digits: u128) -> Self {
        Self(digits.to_be_bytes())
    }

    /// The UUID of these octets in the order in which they are printed.
    pub const fn from_octets(octets: [u8; 16]) -> Self {
        Self(octets)
    }

    /// Its octets in the order in which they are printed.
    pub const fn octets(self) -> [u8; 16] {
        self.0
    }

    /// Reads a UUID in the byte order of `octets`.
    pub fn read(octets: &mut Octets<'_>) -> Result<Self, Malformed> {
        let order = octets.order();
        Ok(Self(Self(octets.array()?).on_wire(order)))
    }

    /// Its octets as a header of this byte order has them.
    pub fn on_wire(self, order: ByteOrder) -> [u8; 16] {
        let mut octets = self.0;
        if order == ByteOrder::Little {
            for number in [0..4, 4..6, 6..8] {
                octets[number].reverse();
            }
        }
        octets
    }

    /// Whether all octets are 0.
    pub fn is_nil(self) -> bool {
        self == Self::NIL
    }
}

/// What the object UUID of a PROFINET node says (P-7).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ObjectUuid {
    /// The instance of the node's application, from the device description.
    pub instance: u16,
    /// The device number, which the vendor gives.
    pub device: u16,
    /// The vendor number, which PROFIBUS & PROFINET International gives.
    pub vendor: u16,
}

impl ObjectUuid {
    /// Reads an object UUID; none if it is not one of PROFINET.
    pub fn of(uuid: Uuid) -> Option<Self> {
        let rest = uuid.0.strip_prefix(&OBJECT)?;
        let [instance, device, vendor] =
            [0, 2, 4].map(|at| u16::from_be_bytes([rest[at], rest[at + 1]]));
        Some(Self { instance, device, vendor })
    }

    /// The whole UUID.
    pub fn to_uuid(self) -> Uuid {
        let mut octets = [0; 16];
        octets[..10].copy_from_slice(&OBJECT);
        for (place, number) in
            octets[10..].chunks_exact_mut(2).zip([self.instance, self.device, self.vendor])
        {
            place.copy_from_slice(&number.to_be_bytes());
        }
        Uuid(octets)
    }
}

impl fmt::Display for Uuid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, octet) in self.0.iter().enumerate() {
            if matches!(index, 4 | 6 | 8 | 10) {
                f.write_str("-")?;
            }
            write!(f, "{octet:02x}")?;
        }
        Ok(())
    }
}

impl fmt::Debug for Uuid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BIG: [u8; 16] = [0xDE, 0xA0, 0, 1, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71, 0, 1, 2, 3, 4, 5];
    const LITTLE: [u8; 16] =
        [1, 0, 0xA0, 0xDE, 0x97, 0x6C, 0xD1, 0x11, 0x82, 0x71, 0, 1, 2, 3, 4, 5];

    #[test]
    fn p_7_both_byte_orders_give_one_value() {
        let big = Uuid::read(&mut Octets::new(&BIG)).unwrap();
        let little = Uuid::read(&mut Octets::new(&LITTLE).in_order(ByteOrder::Little)).unwrap();
        assert_eq!(big, little);
        assert_eq!(big.to_string(), "dea00001-6c97-11d1-8271-000102030405");
        assert_eq!((big.on_wire(ByteOrder::Big), big.on_wire(ByteOrder::Little)), (BIG, LITTLE));
        assert!(!big.is_nil() && Uuid::new(0).is_nil());
    }

    #[test]
    fn p_7_an_object_uuid_names_instance_device_and_vendor() {
        let node = ObjectUuid { instance: 1, device: 0x0203, vendor: 0x002A };
        let uuid = node.to_uuid();
        assert_eq!(uuid.to_string(), "dea00000-6c97-11d1-8271-00010203002a");
        assert_eq!(ObjectUuid::of(uuid), Some(node));
        assert_eq!(ObjectUuid::of(Uuid::from_octets(BIG)), None);
    }
}
