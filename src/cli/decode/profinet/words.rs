//! Values as they are shown: each is the same in JSON and in text.

use std::fmt::{self, Display, Write as _};

use serde::{Serialize, Serializer};

/// A value that is text in JSON, as it is for people.
#[derive(Clone, Copy, Debug)]
pub(in crate::cli::decode) struct Shown<T>(pub(in crate::cli::decode) T);

impl<T: Display> Serialize for Shown<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&self.0)
    }
}

impl<T: Display> Display for Shown<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Octets that should be text. What is no printable character is `\x00`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Text<'a>(pub(super) &'a [u8]);

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.utf8_chunks().try_for_each(|chunk| {
            chunk.valid().chars().try_for_each(|character| {
                if is_printable(character) {
                    return f.write_char(character);
                }
                let mut octets = [0; 4];
                let octets = character.encode_utf8(&mut octets).bytes();
                octets.into_iter().try_for_each(|octet| write!(f, "\\x{octet:02x}"))
            })?;
            chunk.invalid().iter().try_for_each(|octet| write!(f, "\\x{octet:02x}"))
        })
    }
}

/// Not what a terminal takes for an order, and not what turns the direction of a line round.
fn is_printable(character: char) -> bool {
    !character.is_control()
        && !matches!(character, '\u{200E}' | '\u{200F}' | '\u{2028}'..='\u{202E}' | '\u{2066}'..='\u{2069}')
}

/// A UUID whose highest octet comes first.
#[derive(Clone, Copy, Debug)]
pub(super) struct UuidOctets(pub(super) [u8; 16]);

impl Display for UuidOctets {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        (0..).zip(self.0).try_for_each(|(place, octet)| {
            if matches!(place, 4 | 6 | 8 | 10) {
                f.write_char('-')?;
            }
            write!(f, "{octet:02x}")
        })
    }
}

/// Serializes what an iterator gives as a list, without storing it.
pub(super) struct List<I>(pub(super) I);

impl<I> Serialize for List<I>
where
    I: Iterator + Clone,
    I::Item: Serialize,
{
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_of_a_stranger_gives_no_orders_to_a_terminal() {
        let text = |octets: &[u8]| Text(octets).to_string();
        assert_eq!(text(b"plc-1 \xC3\xA4"), "plc-1 ä");
        assert_eq!(text(b"a\0\x1b[2J\x7f\xFF"), "a\\x00\\x1b[2J\\x7f\\xff");
        assert_eq!(text("\u{9b}\u{202e}".as_bytes()), "\\xc2\\x9b\\xe2\\x80\\xae");
    }

    #[test]
    fn a_uuid_has_its_groups() {
        let uuid = UuidOctets(std::array::from_fn(|place| place as u8));
        assert_eq!(uuid.to_string(), "00010203-0405-0607-0809-0a0b0c0d0e0f");
    }
}
