//! Reads octets from front to back, in either byte order, and knows where it is.

/// The order of the octets of a number. RT, DCP, LLDP and the PNIO blocks are big-endian; DCE/RPC and
/// NDR say in their header what they are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ByteOrder {
    /// The highest octet first.
    #[default]
    Big,
    /// The lowest octet first.
    Little,
}

/// Why octets are not what they should be, and which octet shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what} at octet {offset}")]
pub struct Malformed {
    /// The first octet that is wrong, or the first one that is missing. It is counted from 0 at the
    /// beginning of the frame's payload, or of the datagram.
    pub offset: usize,
    /// What is wrong.
    pub what: &'static str,
}

/// Octets that are still to be read.
#[derive(Clone, Copy, Debug)]
pub struct Octets<'a> {
    left: &'a [u8],
    offset: usize,
    order: ByteOrder,
    base: usize,
    depth: u8,
}

impl<'a> Octets<'a> {
    /// All of these octets. The first one is octet 0, and numbers are big-endian.
    pub fn new(octets: &'a [u8]) -> Self {
        Self { left: octets, offset: 0, order: ByteOrder::Big, base: 0, depth: 0 }
    }

    /// The same octets, with numbers of this order.
    pub fn in_order(self, order: ByteOrder) -> Self {
        Self { order, ..self }
    }

    /// The same octets, of which the first one is at this offset. Padding counts from there.
    pub fn starting_at(self, offset: usize) -> Self {
        Self { offset, base: offset, ..self }
    }

    /// The same octets, one level further inside: those that a block holds. Padding counts from the next
    /// octet less `header`.
    pub(super) fn inside(self, header: usize) -> Self {
        Self {
            base: self.offset - header.min(self.offset),
            depth: self.depth.saturating_add(1),
            ..self
        }
    }

    /// In how many blocks these octets are.
    pub(super) fn depth(&self) -> u8 {
        self.depth
    }

    /// The order of numbers.
    pub fn order(&self) -> ByteOrder {
        self.order
    }

    /// The offset of the next octet.
    pub fn offset(&self) -> usize {
        self.offset
    }

    /// How many octets are left.
    pub fn len(&self) -> usize {
        self.left.len()
    }

    /// Whether no octet is left.
    pub fn is_empty(&self) -> bool {
        self.left.is_empty()
    }

    /// What is left, without reading it.
    pub fn rest(&self) -> &'a [u8] {
        self.left
    }

    /// An error at the next octet.
    pub fn wrong(&self, what: &'static str) -> Malformed {
        Malformed { offset: self.offset, what }
    }

    /// The next `len` octets.
    pub fn take(&mut self, len: usize) -> Result<&'a [u8], Malformed> {
        let end = self.offset + self.left.len();
        let Some((taken, left)) = self.left.split_at_checked(len) else {
            return Err(Malformed { offset: end, what: "the octets end too early" });
        };
        (self.left, self.offset) = (left, self.offset + len);
        Ok(taken)
    }

    /// The next `len` octets as octets of their own, which keep their offsets.
    pub fn part(&mut self, len: usize) -> Result<Self, Malformed> {
        let whole = *self;
        Ok(Self { left: self.take(len)?, ..whole })
    }

    /// The next `N` octets.
    pub fn array<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let taken = self.take(N)?;
        taken.try_into().map_err(|_| self.wrong("the octets end too early"))
    }

    /// Leaves out octets until a multiple of four has been read since the beginning of what is padded.
    pub fn align(&mut self) -> Result<(), Malformed> {
        let read = self.offset - self.base;
        self.take(read.next_multiple_of(4) - read).map(drop)
    }

    /// The next octet.
    pub fn u8(&mut self) -> Result<u8, Malformed> {
        self.array().map(u8::from_be_bytes)
    }

    /// The next eight octets as a number.
    pub fn u64(&mut self) -> Result<u64, Malformed> {
        let octets = self.array()?;
        Ok(match self.order {
            ByteOrder::Big => u64::from_be_bytes(octets),
            ByteOrder::Little => u64::from_le_bytes(octets),
        })
    }

    /// The next two octets as a number.
    pub fn u16(&mut self) -> Result<u16, Malformed> {
        let octets = self.array()?;
        Ok(match self.order {
            ByteOrder::Big => u16::from_be_bytes(octets),
            ByteOrder::Little => u16::from_le_bytes(octets),
        })
    }

    /// The next four octets as a number.
    pub fn u32(&mut self) -> Result<u32, Malformed> {
        let octets = self.array()?;
        Ok(match self.order {
            ByteOrder::Big => u32::from_be_bytes(octets),
            ByteOrder::Little => u32::from_le_bytes(octets),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_in_their_order() {
        let mut octets = Octets::new(&[1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(octets.u16(), Ok(0x0102));
        let mut little = octets.in_order(ByteOrder::Little);
        assert_eq!((little.u32(), little.u8()), (Ok(0x0605_0403), Ok(7)));
        assert!(little.is_empty());
    }

    #[test]
    fn a_part_keeps_its_place_and_what_is_missing_is_told_where() {
        let mut octets = Octets::new(&[0; 6]);
        octets.take(2).unwrap();
        let mut part = octets.part(3).unwrap();
        assert_eq!((part.offset(), part.len(), octets.offset()), (2, 3, 5));
        assert_eq!(part.u32().unwrap_err().offset, 5);
        assert_eq!(octets.u16().unwrap_err().to_string(), "the octets end too early at octet 6");
    }

    #[test]
    fn padding_goes_to_the_next_multiple_of_four() {
        let mut octets = Octets::new(&[1, 0, 0, 0, 7]).starting_at(5);
        octets.align().unwrap();
        assert_eq!(octets.u8(), Ok(1));
        octets.align().unwrap();
        assert_eq!((octets.offset(), octets.u8()), (9, Ok(7)));
        assert_eq!(octets.align().unwrap_err().offset, 10);
    }
}
