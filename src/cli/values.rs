//! Values of options that several commands have, as P-NET documents and programs write them.

use std::fs::File;
use std::io::Read;

use anyhow::{Context, bail};

use super::decode;
use crate::pnet::wire::Elements;

/// Octets of the largest memory that offsets reach.
const MOST_DATA: u64 = 1 << 16;

/// An octet: 42, 0x2A or $2A.
pub(super) fn octet(text: &str) -> Result<u8, &'static str> {
    let hex = text.strip_prefix("0x").or_else(|| text.strip_prefix('$'));
    let octet = match hex {
        Some(hex) => u8::from_str_radix(hex, 16),
        None => text.parse(),
    };
    octet.map_err(|_| "write an octet as a number from 0 to 255, or as 0x00 to 0xFF")
}

/// Route elements: 2.33.
pub(super) fn elements(text: &str) -> Result<Elements, &'static str> {
    const WRONG: &str = "write route elements from 0 to 127 with dots between them: 2.33";
    let mut elements = Elements::new();
    for element in text.split('.') {
        let element = element.parse().ok().filter(|element| *element <= 127).ok_or(WRONG)?;
        elements.try_push(element).map_err(|_| "these are more elements than a route holds")?;
    }
    Ok(elements)
}

/// Octets as hex text, or those of a file: `dead beef`, `@file`.
pub(super) fn octets(text: &str) -> anyhow::Result<Vec<u8>> {
    let Some(path) = text.strip_prefix('@') else {
        return decode::octets(text.as_bytes())
            .context("write octets as pairs of hexadecimal digits, or the name of a file after @");
    };
    let mut octets = Vec::new();
    let file = File::open(path).with_context(|| format!("{path:?} cannot be opened"))?;
    file.take(MOST_DATA + 1)
        .read_to_end(&mut octets)
        .with_context(|| format!("{path:?} cannot be read"))?;
    if octets.len() as u64 > MOST_DATA {
        bail!("{path:?} has more than {MOST_DATA} octets, which is more than any memory holds");
    }
    Ok(octets)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn octets_are_written_in_three_ways() {
        for (text, expected) in [("42", 42), ("0x2a", 42), ("$2A", 42), ("0", 0), ("0xFF", 255)] {
            assert_eq!(octet(text), Ok(expected));
        }
        for bad in ["", "256", "0x", "0x100", "$", "-1", "2A"] {
            assert!(octet(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn route_elements_have_7_bits() {
        assert_eq!(elements("2.33").unwrap()[..], [2, 33]);
        assert_eq!(elements("0").unwrap()[..], [0]);
        assert_eq!(elements(&["127"; 29].join(".")).unwrap().len(), 29);
        for bad in ["", ".", "2.", "128", "-1", "2,33", "two", &["1"; 30].join(".")] {
            assert!(elements(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn data_are_hex_text_or_a_file() {
        for (text, expected) in
            [("", &[][..]), ("dead BEEF", &[0xDE, 0xAD, 0xBE, 0xEF]), ("0a", &[10])]
        {
            assert_eq!(octets(text).unwrap(), expected);
        }
        for bad in ["a", "0x12", "xy", "12 3"] {
            assert!(octets(bad).is_err(), "{bad:?}");
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data");
        let named = format!("@{}", path.display());
        assert!(octets(&named).unwrap_err().to_string().contains("cannot be opened"));
        for (size, is_taken) in [(0, true), (1 << 16, true), ((1 << 16) + 1, false)] {
            std::fs::write(&path, vec![7; size]).unwrap();
            assert_eq!(octets(&named).is_ok_and(|octets| octets.len() == size), is_taken);
        }
        assert!(octets("@/").is_err());
    }
}
