//! Octets of a password that look like a mistake: a line break from an editor, a space at the end, a
//! letter that takes two octets. Only a warning, since a password may be any 8 octets.

use crate::pnet::wire::Password;

/// A password with at least this many printable octets counts as text. Of 8 random octets, that many are
/// printable once in 200 times.
const TEXT: usize = 7;

/// Which octets look like a mistake, by position and kind; none when the password is random octets.
/// Never shows an octet that could be a character of the password.
pub(super) fn oddities(password: &Password) -> Option<String> {
    let octets = password.octets();
    // Random octets are almost never UTF-8, so text that is was typed.
    let is_text = str::from_utf8(octets).is_ok()
        || octets.iter().filter(|octet| is_printable(**octet)).count() >= TEXT;
    let beginning = octets.iter().take_while(|octet| is_blank(**octet)).count();
    let end = octets.iter().rposition(|octet| !is_blank(*octet)).map_or(0, |last| last + 1);
    let odd = octets.iter().enumerate().filter_map(|(index, &octet)| {
        let kind = if index >= end {
            blank(octet)?
        } else if !is_text {
            return None;
        } else if index < beginning {
            blank(octet)?
        } else {
            inside(octet)?
        };
        Some(format!("octet {} is {kind}", index + 1))
    });
    let odd: Vec<_> = odd.collect();
    (!odd.is_empty()).then(|| odd.join(", "))
}

fn is_printable(octet: u8) -> bool {
    matches!(octet, b' '..=b'~')
}

fn is_blank(octet: u8) -> bool {
    matches!(octet, b' ' | b'\t' | b'\r' | b'\n')
}

/// What is probably not intended at the beginning or end.
fn blank(octet: u8) -> Option<String> {
    if octet == b' ' { Some("a space".into()) } else { inside(octet) }
}

/// What is not a character that everybody can type.
fn inside(octet: u8) -> Option<String> {
    match octet {
        b'\n' => Some("a line break (LF)".into()),
        b'\r' => Some("a line break (CR)".into()),
        b'\t' => Some("a tab".into()),
        octet if is_printable(octet) => None,
        octet if octet.is_ascii() => Some(format!("a control character ({octet:#04x})")),
        _ => Some("not ASCII: part of a letter that other systems may encode differently".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn odd(octets: &[u8; 8]) -> String {
        oddities(&Password::new(*octets)).unwrap_or_default()
    }

    #[test]
    fn what_editors_and_keyboards_leave_is_named_by_its_position() {
        for (octets, expected) in [
            (b"k7Zq+4L\n", "octet 8 is a line break (LF)"),
            (b"k7Zq+4\r\n", "octet 7 is a line break (CR), octet 8 is a line break (LF)"),
            (b"k7Zq+4L\r", "octet 8 is a line break (CR)"),
            (b"k7Zq+4L ", "octet 8 is a space"),
            (b" k7Zq+4L", "octet 1 is a space"),
            (b"k7Zq\t4Lx", "octet 5 is a tab"),
            (b"k7Zq+4L\t", "octet 8 is a tab"),
            (b"k7Zq\x1b4Lx", "octet 5 is a control character (0x1b)"),
            (b"k7Zq+4L\0", "octet 8 is a control character (0x00)"),
        ] {
            assert_eq!(odd(octets), expected);
        }
        for octets in ["P\u{e4}5word", "\u{feff}k7Zq+", "\u{df}\u{e4}\u{fc}k7"] {
            let odd = odd(octets.as_bytes().try_into().unwrap());
            assert!(odd.contains(" is not ASCII"), "{octets}: {odd}");
        }
        assert!(odd(b"P\xe45wordx").starts_with("octet 2 is not ASCII"), "Latin-1");
        assert!(odd(b"\0\xff\x80\x81\x01\x02\x03\n").contains("octet 8 is a line break"));
    }

    #[test]
    fn what_is_well_typed_or_random_is_not_odd() {
        for octets in [b"k7Zq+4Lx", b"k7Z q4Lx", b"\0\xff\n\r\x7f\0\0\0", b"~!@#$%^&"] {
            assert_eq!(odd(octets), "");
        }
        let mut random = fastrand::Rng::with_seed(7);
        let told = (0..20_000).filter(|_| !odd(&std::array::from_fn(|_| random.u8(..))).is_empty());
        let told = told.count();
        // One in 64 ends with a space or a line break.
        assert!(told < 20_000 / 30, "{told} of 20,000");
    }
}
