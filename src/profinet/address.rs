//! The address of an Ethernet interface.

use std::fmt;

/// A MAC address. It is shown as `00:0e:cf:12:34:56`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MacAddress(pub [u8; MacAddress::LEN]);

impl MacAddress {
    /// Octets in an address.
    pub const LEN: usize = 6;
}

impl fmt::Display for MacAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const DIGITS: &[u8; 16] = b"0123456789abcdef";
        let mut text = [b':'; 3 * Self::LEN - 1];
        for (pair, octet) in text.chunks_mut(3).zip(self.0) {
            pair[0] = DIGITS[usize::from(octet >> 4)];
            pair[1] = DIGITS[usize::from(octet & 0x0F)];
        }
        // Only ASCII was written.
        f.write_str(str::from_utf8(&text).unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_shown_with_colons() {
        let address = MacAddress([0x00, 0x0E, 0xCF, 0x12, 0xA0, 0xFF]);
        assert_eq!(address.to_string(), "00:0e:cf:12:a0:ff");
    }
}
