//! The four octets in front of every package.

use std::fmt;
use std::str::FromStr;

/// The package header (PAS 11). The standard prints it with seven hexadecimal digits. The default
/// reads it as `02 00 00 00`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header(pub [u8; Header::LEN]);

impl Header {
    /// Octets in a header.
    pub const LEN: usize = 4;
}

impl Default for Header {
    fn default() -> Self {
        Self([0x02, 0, 0, 0])
    }
}

impl fmt::Display for Header {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|octet| write!(f, "{octet:02x}"))
    }
}

/// A text that is not eight hexadecimal digits.
#[derive(Debug, thiserror::Error)]
#[error("a header is 8 hexadecimal digits, like \"02000000\"")]
pub struct NotAHeader;

impl FromStr for Header {
    type Err = NotAHeader;

    fn from_str(text: &str) -> Result<Self, NotAHeader> {
        if text.len() != 2 * Self::LEN || !text.bytes().all(|digit| digit.is_ascii_hexdigit()) {
            return Err(NotAHeader);
        }
        let value = u32::from_str_radix(text, 16).map_err(|_| NotAHeader)?;
        Ok(Self(value.to_be_bytes()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_octets_agree() {
        assert_eq!("02000000".parse::<Header>().unwrap(), Header::default());
        assert_eq!("0aBC0001".parse::<Header>().unwrap().to_string(), "0abc0001");
        for bad in ["0200000", "020000000", "+2000000", "0x020000", ""] {
            assert!(bad.parse::<Header>().is_err(), "{bad:?}");
        }
    }
}
