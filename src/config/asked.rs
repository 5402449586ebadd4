//! What the reader asks of each key, as it reads: of this the tests make `config/pnet-nat.schema.json`, so
//! that no key is in one of the two alone.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::RangeInclusive;

/// What is asked of a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Wanted {
    /// Only whether it is there, so far.
    Key,
    /// To be there.
    Required,
    Boolean,
    Text,
    OneOf(Vec<&'static str>),
    /// A whole number from one to the other.
    Integer(i64, i64),
    Duration,
    List,
    Section,
    Sections,
}

impl Wanted {
    pub(super) fn integer<T: Display>(bounds: &RangeInclusive<T>) -> Self {
        let number = |bound: &T| bound.to_string().parse().expect("a bound fits into TOML");
        Self::Integer(number(bounds.start()), number(bounds.end()))
    }
}

/// By the path of the key, where a list's elements have no numbers: `udp_range_net[].nodes[]`.
#[derive(Debug, Default)]
pub(super) struct Asked(RefCell<BTreeMap<String, Vec<Wanted>>>);

impl Asked {
    pub(super) fn note(&self, path: &str, wanted: Wanted) {
        let mut parts = path.split('[');
        let mut key = parts.next().unwrap_or_default().to_owned();
        for part in parts {
            key.push('[');
            key.push_str(part.trim_start_matches(|c: char| c.is_ascii_digit()));
        }
        let mut asked = self.0.borrow_mut();
        let of_key = asked.entry(key).or_default();
        if !of_key.contains(&wanted) {
            of_key.push(wanted);
        }
    }

    pub(super) fn into_inner(self) -> BTreeMap<String, Vec<Wanted>> {
        self.0.into_inner()
    }
}
