//! How fields are shown, for the tests of all views; lists and texts, and where they end.

use std::fmt::Write;

use super::*;

/// All fields on one line: `{name: value, …}`.
pub(in crate::profinet) fn shown(show: &dyn Show) -> String {
    let mut text = String::new();
    write_value(&mut text, Value::Fields(show));
    text
}

/// Octets of hexadecimal digits; spaces are left out.
pub(in crate::profinet) fn hex(digits: &str) -> Vec<u8> {
    let digits: Vec<u8> = digits.bytes().filter(u8::is_ascii_hexdigit).collect();
    let pairs = digits.chunks(2).map(|pair| std::str::from_utf8(pair).unwrap());
    pairs.map(|pair| u8::from_str_radix(pair, 16).unwrap()).collect()
}

fn write_value(text: &mut String, value: Value<'_>) {
    match value {
        Value::Nothing => text.push('_'),
        Value::Number(number) => write!(text, "{number}").unwrap(),
        Value::Word(number, word) => write!(text, "{number} ({})", word.unwrap_or("?")).unwrap(),
        Value::Bits(number, parts) => {
            write!(text, "{number:#x}").unwrap();
            for (name, lowest, count) in parts {
                let part = bits(number, *lowest, *count);
                if part != 0 {
                    write!(text, " {name}={part}").unwrap();
                }
            }
        }
        Value::Text(octets) => write!(text, "\"{}\"", octets.escape_ascii()).unwrap(),
        Value::Octets(octets) => write!(text, "{octets:02x?}").unwrap(),
        Value::Display(display) => write!(text, "{display}").unwrap(),
        Value::Fields(show) => {
            text.push('{');
            show.show(&mut |name, value| {
                if !matches!(value, Value::Nothing) {
                    write!(text, "{}{name}: ", if text.ends_with('{') { "" } else { ", " })
                        .unwrap();
                    write_value(text, value);
                }
            });
            text.push('}');
        }
        Value::Fault(fault) => write!(text, "{fault}").unwrap(),
        Value::List(each) => {
            text.push('[');
            each.each(&mut |value| {
                text.push_str(if text.ends_with('[') { "" } else { ", " });
                write_value(text, value);
            });
            text.push(']');
        }
    }
}

view! {
    /// One of each.
    struct Sample<'a> {
        /// Numbers.
        numbers: List<'a, u16, 1>,
        /// A name.
        name: Text<'a, 2>,
        /// Padding.
        padding: Align,
        /// An address.
        address: Ipv4Addr,
        /// Octets.
        rest: &'a [u8],
    }
}

#[test]
fn fields_are_read_in_order_and_shown_by_name() {
    let octets = hex("02 0001 0203  0003 414220  0000  C0000207  FF");
    let sample = Sample::read(&mut Octets::new(&octets)).unwrap();
    assert_eq!(
        shown(&sample),
        r#"{numbers: [1, 515], name: "AB ", address: 192.0.2.7, rest: [ff]}"#
    );
    assert_eq!((sample.numbers.len(), sample.numbers.is_empty()), (2, false));
}

#[test]
fn a_list_that_says_more_than_there_is_ends_where_the_octets_end() {
    let octets = hex("03 0001 0203");
    let error = Sample::read(&mut Octets::new(&octets)).unwrap_err();
    assert_eq!(error, Malformed { offset: 5, what: "the octets end too early" });
    // Elements without octets would not end the list.
    let error = Rest::<Skip<0>>::read(&mut Octets::new(&octets)).unwrap_err();
    assert_eq!(error, Malformed { offset: 0, what: "an element without octets" });
}

#[test]
fn bits_of_a_number() {
    assert_eq!((bits(0b1101_0000, 4, 3), bits(u64::MAX, 0, 64), bits(7, 64, 1)), (5, u64::MAX, 0));
}
