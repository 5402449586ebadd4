//! Reads TOML key by key: a [`Section`] is a table, an [`Entry`] is the value at one of its keys, which
//! may be absent.
//!
//! A value that cannot be read is reported as a fault and then counts as absent, so that everything else
//! is still checked. [`Section::finish`] refuses the keys that were not asked for.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;
use std::time::Duration;

use toml::Spanned;
use toml::de::{DeInteger, DeTable, DeValue};

use crate::pnet::wire::SECURE_PORT;

#[cfg(test)]
use super::asked::Wanted;
use super::report::{MISSING, Report, SourceSpan, Unknown, quoted, shortened};

/// The longest time in a setting: more than anybody needs, and safe to add to a clock.
pub(super) const LONGEST: Duration = Duration::from_secs(24 * 60 * 60);

/// The most octets of a key.
const LONGEST_KEY: usize = 63;

/// A table of the file; one that is left out has no keys.
#[derive(Debug)]
pub(super) struct Section<'a> {
    pub(super) place: SourceSpan,
    /// As written in the file: `[public]`, `[[server.password]]`; empty for the whole document.
    header: String,
    table: Option<&'a DeTable<'a>>,
    known: Vec<&'static str>,
    pub(super) report: &'a Report<'a>,
}

impl<'a> Section<'a> {
    /// The whole document.
    pub(super) fn root(table: &'a DeTable<'a>, report: &'a Report<'a>) -> Self {
        let place = SourceSpan { line: 1, key: String::new() };
        Self { place, header: String::new(), table: Some(table), known: Vec::new(), report }
    }

    /// The value at `key`; `example` is a valid one, written as TOML.
    pub(super) fn key(&mut self, key: &'static str, example: &'static str) -> Entry<'a> {
        self.known.push(key);
        let found = self.table.and_then(|table| table.get_key_value(key));
        let line = found.map_or(self.place.line, |(key, _)| self.report.line(key.span().start));
        let place = SourceSpan { line, key: self.path_of(key) };
        let value = found.map(|(_, value)| value);
        let entry = Entry { place, key, example, value, report: self.report };
        #[cfg(test)]
        entry.asks(Wanted::Key);
        entry
    }

    /// Refuses the keys that were not asked for.
    pub(super) fn finish(self) {
        for key in self.table.iter().copied().flat_map(DeTable::keys) {
            let name: &str = key.get_ref();
            if self.known.contains(&name) {
                continue;
            }
            let line = self.report.line(key.span().start);
            let place = SourceSpan { line, key: self.path_of(name) };
            let keys = self.known.join(", ");
            let close = closest(name, &self.known);
            let remedy = match close {
                Some(close) => format!("did you mean `{close}`? The keys here are {keys}"),
                None => format!("remove it; the keys here are {keys}"),
            };
            let (header, line) = (self.header.clone(), self.place.line);
            let unknown =
                Unknown { name: name.to_owned(), header, line, is_close: close.is_some() };
            self.report.unknown_key(&place, unknown, remedy);
        }
        self.report.learn(self.header, self.known);
    }

    fn path_of(&self, key: &str) -> String {
        // A key that had to be quoted may hold anything, line breaks included.
        let bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        let is_bare = key.len() <= LONGEST_KEY && key.chars().all(bare);
        let key = if is_bare { key.into() } else { quoted(key) };
        if self.place.key.is_empty() { key } else { format!("{}.{key}", self.place.key) }
    }
}

fn closest(name: &str, known: &[&'static str]) -> Option<&'static str> {
    // A name that is far longer than any key is not a mistyped key.
    if name.len() > LONGEST_KEY {
        return None;
    }
    let distance = |key: &&&str| strsim::osa_distance(name, key);
    known.iter().min_by_key(distance).filter(|key| distance(key) <= 1 + key.len() / 5).copied()
}

/// The value at a key or in a list, if there is one.
#[derive(Clone, Debug)]
pub(super) struct Entry<'a> {
    pub(super) place: SourceSpan,
    pub(super) report: &'a Report<'a>,
    key: &'static str,
    example: &'static str,
    value: Option<&'a Spanned<DeValue<'a>>>,
}

impl<'a> Entry<'a> {
    pub(super) fn is_absent(&self) -> bool {
        self.value.is_none()
    }

    pub(super) fn fault(&self, problem: impl Into<String>, remedy: impl Into<String>) {
        self.report.fault(&self.place, problem.into(), remedy.into());
    }

    pub(super) fn fault_that_passes(&self, problem: impl Into<String>, remedy: impl Into<String>) {
        self.report.fault_that_passes(&self.place, problem.into(), remedy.into());
    }

    pub(super) fn warn(&self, problem: impl Into<String>, remedy: impl Into<String>) {
        self.report.warn(&self.place, problem.into(), remedy.into());
    }

    /// Remembers what is asked for here: the schema is made of it.
    #[cfg(test)]
    pub(super) fn asks(&self, wanted: Wanted) {
        self.report.asked.note(&self.place.key, wanted);
    }

    /// Reports a fault when the key is left out.
    pub(super) fn required(self) -> Self {
        #[cfg(test)]
        self.asks(Wanted::Required);
        if self.is_absent() {
            self.fault(MISSING, format!("add `{} = {}`", self.key, self.example));
        }
        self
    }

    pub(super) fn boolean(&self) -> Option<bool> {
        #[cfg(test)]
        self.asks(Wanted::Boolean);
        self.expect("true or false", DeValue::as_bool)
    }

    pub(super) fn text(&self) -> Option<&'a str> {
        #[cfg(test)]
        self.asks(Wanted::Text);
        self.expect("a text in quotes", DeValue::as_str)
    }

    /// A text that `T` can be parsed from.
    pub(super) fn parse<T: FromStr<Err: Display>>(&self) -> Option<T> {
        self.parse_with(str::parse)
    }

    /// A whole number within bounds.
    pub(super) fn integer<T>(&self, bounds: RangeInclusive<T>) -> Option<T>
    where
        T: Copy + Display + PartialOrd + TryFrom<i64>,
    {
        #[cfg(test)]
        self.asks(Wanted::integer(&bounds));
        let integer = self.expect("a whole number", DeValue::as_integer)?;
        let number = i64_of(integer).and_then(|number| T::try_from(number).ok());
        let number = number.filter(|number| bounds.contains(number));
        if number.is_none() {
            let (first, last) = (bounds.start(), bounds.end());
            let remedy = format!("choose a whole number from {first} to {last}");
            self.fault(format!("{} is out of bounds", shortened(&integer.to_string())), remedy);
        }
        number
    }

    /// A time within bounds, written like "5m".
    pub(super) fn duration(&self, bounds: RangeInclusive<Duration>) -> Option<Duration> {
        #[cfg(test)]
        self.asks(Wanted::Duration);
        let duration = self.parse_with(humantime::parse_duration)?;
        if !bounds.contains(&duration) {
            let [found, shortest, longest] =
                [duration, *bounds.start(), *bounds.end()].map(humantime::format_duration);
            let remedy = format!("choose a time from {shortest} to {longest}");
            self.fault(format!("{found} is out of bounds"), remedy);
            return None;
        }
        Some(duration)
    }

    /// The values of a list, which must not be empty.
    pub(super) fn list(&self) -> Vec<Self> {
        #[cfg(test)]
        self.asks(Wanted::List);
        let Some(list) = self.expect("a list in brackets", DeValue::as_array) else {
            return Vec::new();
        };
        if list.is_empty() {
            self.fault("the list is empty", self.like());
        }
        list.iter().enumerate().map(|(index, value)| self.element(index, value)).collect()
    }

    /// Whether there is a value.
    pub(super) fn is_there(&self) -> bool {
        self.value.is_some()
    }

    /// Whether this value is a whole number, for keys that allow other kinds too.
    pub(super) fn is_integer(&self) -> bool {
        self.value.is_some_and(|value| value.get_ref().is_integer())
    }

    /// The one table with this name; if it is left out, a table without keys.
    pub(super) fn section(self) -> Section<'a> {
        #[cfg(test)]
        self.asks(Wanted::Section);
        let header = format!("[{}]", self.key);
        let table = self.value.and_then(|value| match value.get_ref() {
            DeValue::Table(table) => Some(table),
            DeValue::Array(list) => {
                self.fault(
                    "this section can appear only once",
                    format!("write its header as {header}"),
                );
                list.iter().find_map(|value| value.get_ref().as_table())
            }
            other => {
                self.wrong_kind("a section", other, &format!("write it under {header}"));
                None
            }
        });
        Section { place: self.place, header, table, known: Vec::new(), report: self.report }
    }

    /// The tables with this name, possibly none. Returns none at all when the value is no table.
    pub(super) fn sections(&self) -> Option<Vec<Section<'a>>> {
        #[cfg(test)]
        self.asks(Wanted::Sections);
        let Some(value) = self.value else { return Some(Vec::new()) };
        let header = format!("[[{}]]", without_indices(&self.place.key));
        let remedy = format!("write the header of each as {header}");
        let table = |element: Self| element.table(&header, &remedy);
        match value.get_ref() {
            DeValue::Array(list) => {
                let elements = list.iter().enumerate().map(|(index, v)| self.element(index, v));
                Some(elements.filter_map(table).collect())
            }
            DeValue::Table(_) => {
                self.fault("there can be several, so each needs double brackets", remedy.clone());
                Some(table(self.element(0, value)).into_iter().collect())
            }
            other => {
                self.wrong_kind("sections", other, &remedy);
                None
            }
        }
    }

    fn table(self, header: &str, remedy: &str) -> Option<Section<'a>> {
        let value = self.value?.get_ref();
        let Some(table) = value.as_table() else {
            self.wrong_kind("a section", value, remedy);
            return None;
        };
        let (place, report, header) = (self.place, self.report, header.to_owned());
        Some(Section { place, header, table: Some(table), known: Vec::new(), report })
    }

    fn element(&self, index: usize, value: &'a Spanned<DeValue<'a>>) -> Self {
        let line = self.report.line(value.span().start);
        let place = SourceSpan { line, key: format!("{}[{index}]", self.place.key) };
        Self { place, value: Some(value), ..self.clone() }
    }

    fn parse_with<T, E: Display>(&self, parse: impl Fn(&str) -> Result<T, E>) -> Option<T> {
        let text = self.text()?;
        let fault = |err: E| {
            let (text, err) = (quoted(text), err.to_string());
            self.fault(format!("{text} cannot be read: {}", shortened(&err)), self.like());
        };
        parse(text).map_err(fault).ok()
    }

    fn expect<T>(&self, kind: &str, read: impl Fn(&'a DeValue<'a>) -> Option<T>) -> Option<T> {
        let value = self.value?.get_ref();
        let read = read(value);
        if read.is_none() {
            self.wrong_kind(kind, value, &self.like());
        }
        read
    }

    fn wrong_kind(&self, expected: &str, found: &DeValue<'_>, remedy: &str) {
        let found = match found {
            DeValue::String(_) => "a text",
            DeValue::Integer(_) => "a whole number",
            DeValue::Float(_) => "a number with a fraction",
            DeValue::Boolean(_) => "true or false",
            DeValue::Datetime(_) => "a date or time",
            DeValue::Array(_) => "a list",
            DeValue::Table(_) => "a section",
        };
        self.fault(format!("expected {expected}, found {found}"), remedy);
    }

    /// The port of the example, or P-NET's Secure port.
    pub(super) fn example_port(&self) -> u16 {
        let example = self.example.trim_matches('"').parse::<std::net::SocketAddr>();
        example.map_or(SECURE_PORT, |example| example.port())
    }

    /// A remedy: what to write instead.
    pub(super) fn like(&self) -> String {
        format!("write it like `{} = {}`", self.key, self.example)
    }
}

fn i64_of(integer: &DeInteger<'_>) -> Option<i64> {
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

/// `udp_range_net[1].password` → `udp_range_net.password`.
fn without_indices(key: &str) -> String {
    let parts = key.split('.').map(|part| part.split('[').next().unwrap_or(part));
    parts.collect::<Vec<_>>().join(".")
}
