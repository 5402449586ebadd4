//! Fields of PROFINET's views as JSON. The views say name and value; this says how a value is written.
//!
//! A number with a word becomes two fields, `name` and `name_name`; a number of parts becomes an object with
//! `value` and the parts. Nothing here allocates.

use std::fmt::{self, Display};

use serde::ser::{Error as _, SerializeMap, SerializeSeq};
use serde::{Serialize, Serializer};

use super::words::{Shown, Text};
use crate::cli::output::Hex;
use crate::profinet::Malformed;
use crate::profinet::view::{Each, Show, Value, bits};

/// Something with fields, as an object.
pub(super) struct Fields<'v>(pub(super) &'v dyn Show);

/// Something with elements, as a list.
pub(super) struct Elements<'v>(pub(super) &'v dyn Each);

/// A value that is one field.
struct Plain<'v>(Value<'v>);

/// The name of a number's word.
struct NameOf(&'static str);

impl Display for NameOf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}_name", self.0)
    }
}

/// Characters without their padding.
pub(super) struct Characters<'a>(pub(super) &'a [u8]);

impl Display for Characters<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let end = self.0.iter().rposition(|octet| !matches!(octet, 0 | b' '));
        Text(&self.0[..end.map_or(0, |last| last + 1)]).fmt(f)
    }
}

impl Serialize for Fields<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        let mut result = Ok(());
        self.0.show(&mut |name, value| {
            if result.is_ok() {
                result = entry(&mut map, name, value);
            }
        });
        result?;
        map.end()
    }
}

fn entry<M: SerializeMap>(
    map: &mut M,
    name: &'static str,
    value: Value<'_>,
) -> Result<(), M::Error> {
    match value {
        Value::Nothing => Ok(()),
        Value::Word(number, word) => {
            map.serialize_entry(name, &number)?;
            word.map_or(Ok(()), |word| map.serialize_entry(&Shown(NameOf(name)), word))
        }
        Value::Fault(Malformed { offset, what }) => {
            map.serialize_entry("error", what)?;
            map.serialize_entry("error_offset", &offset)
        }
        value => map.serialize_entry(name, &Plain(value)),
    }
}

impl Serialize for Elements<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut list = serializer.serialize_seq(None)?;
        let mut result = Ok(());
        self.0.each(&mut |value| {
            if result.is_ok() {
                result = list.serialize_element(&Plain(value));
            }
        });
        result?;
        list.end()
    }
}

impl Serialize for Plain<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            Value::Number(number) | Value::Word(number, _) => serializer.serialize_u64(number),
            Value::Bits(number, parts) => {
                let mut map = serializer.serialize_map(Some(parts.len() + 1))?;
                map.serialize_entry("value", &number)?;
                for (name, lowest, count) in parts {
                    match bits(number, *lowest, *count) {
                        part if *count == 1 => map.serialize_entry(name, &(part == 1))?,
                        part => map.serialize_entry(name, &part)?,
                    }
                }
                map.end()
            }
            Value::Text(octets) => serializer.collect_str(&Characters(octets)),
            Value::Octets(octets) => serializer.collect_str(&Hex(octets)),
            Value::Display(display) => serializer.collect_str(display),
            Value::Fields(show) => Fields(show).serialize(serializer),
            Value::List(each) => Elements(each).serialize(serializer),
            Value::Fault(fault) => serializer.collect_str(&fault),
            Value::Nothing => Err(S::Error::custom("padding has no value")),
        }
    }
}
