//! Advice for a text that is not TOML: values without quotes, blocks in the wrong order, invisible
//! characters.
//!
//! The parser reports where it stopped. A remedy shows a line only after trying that it can be read.

use std::collections::HashSet;

use toml::de::DeTable;

use super::excerpt::Lines;
use super::report::{Advice, MOST_TOLD, Report, shortened};
use crate::harmless::is_harmful;

/// Keys whose value is a list.
const LISTS: [&str; 3] = ["listen", "nodes", "allow"];
/// Quotation marks of keyboards and word processors.
const QUOTES: [char; 10] = ['"', '\'', '“', '”', '„', '‟', '‘', '’', '`', '´'];

/// Notes each place where the text is not TOML, with advice where there is some.
pub(super) fn note_faults(report: &Report<'_>, errors: &[toml::de::Error]) {
    if errors.is_empty() {
        return;
    }
    let syntax = Syntax::of(&report.lines);
    let mut advised = HashSet::new();
    for (number, error) in errors.iter().enumerate() {
        let offset = error.span().map_or(0, |span| span.start);
        let line = report.line(offset);
        // What the parser reports of the rest of such a line does not help.
        if syntax.follows(line, &advised) {
            continue;
        }
        let own = || syntax.advice(offset, error.message());
        let own = (number < MOST_TOLD).then(own).flatten();
        if own.is_some() {
            advised.insert(line);
        }
        let as_parsed = || Advice {
            key: String::new(),
            problem: error.message().replace('\n', ", "),
            remedy: "correct the TOML; keys are checked once it can be read".into(),
        };
        report.syntax_fault(offset, own.unwrap_or_else(as_parsed));
    }
}

/// The lines of a text and the headers among them.
#[derive(Debug)]
pub(super) struct Syntax<'a> {
    lines: &'a Lines<'a>,
    headers: Vec<Header<'a>>,
}

/// `[public]` or `[[server.password]]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Header<'a> {
    line: usize,
    text: &'a str,
    name: &'a str,
    is_repeated: bool,
}

impl<'a> Syntax<'a> {
    pub(super) fn of(lines: &'a Lines<'a>) -> Self {
        let headers = (1..=lines.count()).filter_map(|line| Header::read(line, lines.text(line)));
        Self { lines, headers: headers.collect() }
    }

    /// Advice from the place and the parser's message, if there is any.
    pub(super) fn advice(&self, offset: usize, message: &str) -> Option<Advice> {
        let line = self.lines.line(offset);
        let is_twice = message.contains("duplicate key");
        let unseen = || self.unseen(line);
        match self.headers.iter().find(|header| header.line == line) {
            Some(header) if is_twice => self.header_advice(*header),
            Some(_) => unseen(),
            None if is_twice => self.key_advice(line),
            None => unseen().or_else(|| self.value_advice(line)),
        }
    }

    /// Whether a fault only follows from one that was reported for its line or for the header above.
    pub(super) fn follows(&self, line: usize, advised: &HashSet<usize>) -> bool {
        let block = || self.headers.iter().rfind(|header| header.line <= line);
        let is_below = || block().is_some_and(|header| advised.contains(&header.line));
        !advised.is_empty() && (advised.contains(&line) || is_below())
    }

    /// An invisible character outside of quotes.
    fn unseen(&self, line: usize) -> Option<Advice> {
        let mut is_quoted = false;
        let is_outside = |&(_, c): &(usize, char)| {
            is_quoted ^= matches!(c, '"' | '\'');
            !is_quoted
        };
        let text = self.lines.text(line).chars().take_while(|&c| c != '#').enumerate();
        let (index, sign) = text.filter(is_outside).find(|&(_, c)| is_unseen(c))?;
        let (place, code) = (index + 1, u32::from(sign));
        Some(Advice {
            key: String::new(),
            problem: format!("character {place} of the line is invisible (U+{code:04X})"),
            remedy: "delete it, or replace it with a plain space".into(),
        })
    }

    /// A header whose name is already taken above.
    fn header_advice(&self, header: Header<'_>) -> Option<Advice> {
        let above = || self.headers.iter().filter(|above| above.line < header.line);
        let Header { text, name, .. } = header;
        let (problem, remedy) = if let Some(same) = above().find(|above| above.name == name) {
            let (line, other) = (same.line, same.text);
            match (same.is_repeated, header.is_repeated) {
                (false, false) => (
                    format!("{text} is already in line {line}"),
                    format!("move its keys to line {line}, below the first {text}"),
                ),
                _ => (
                    format!("{other} in line {line} is written differently"),
                    format!("write both as [[{name}]]"),
                ),
            }
        } else {
            let is_inside = |above: &&Header<'_>| {
                above.name.strip_prefix(name).is_some_and(|rest| rest.starts_with('.'))
            };
            let inside = above().find(is_inside)?;
            let (line, inside) = (inside.line, inside.text);
            (
                format!("{inside} in line {line} stands before the {text} that it belongs to"),
                format!(
                    "{text} and its keys must come first: move {inside} with its keys below them"
                ),
            )
        };
        Some(Advice { key: name.to_owned(), problem, remedy })
    }

    /// A key that is there twice.
    fn key_advice(&self, line: usize) -> Option<Advice> {
        let (key, _) = key_and_value(self.lines.text(line))?;
        let first = self
            .headers
            .iter()
            .rfind(|header| header.line < line)
            .map_or(1, |header| header.line + 1);
        let is_same = |&above: &usize| {
            key_and_value(self.lines.text(above)).is_some_and(|(other, _)| other == key)
        };
        let other = (first..line).find(is_same)?;
        Some(Advice {
            key: self.path(line, key),
            problem: format!("is already in line {other}"),
            remedy: "keep one of the two lines".into(),
        })
    }

    /// A value without quotes, or with quotes that TOML does not know.
    fn value_advice(&self, line: usize) -> Option<Advice> {
        let text = self.lines.text(line);
        let Some((key, value)) = key_and_value(text) else { return self.element_advice(line) };
        let open = value.strip_prefix('[').is_some_and(|rest| !rest.contains(']'));
        let value = match value.strip_prefix('[') {
            _ if open => return self.element_advice(line),
            Some(rest) => format!("[{}]", elements(rest.trim_end_matches([']', ' ', ',', ';']))?),
            None if LISTS.contains(&key) => {
                format!("[{}]", elements(value.trim_end_matches([',', ';']))?)
            }
            None => element(value.trim_end_matches([',', ';']))?,
        };
        let better = format!("{key} = {value}");
        if better == text.trim() || !is_toml(&better) {
            return None;
        }
        Some(Advice {
            key: self.path(line, key),
            problem: "the value cannot be read".into(),
            remedy: format!("{}: {}", how(&value), shortened(&better)),
        })
    }

    /// The same in a list of several lines.
    fn element_advice(&self, line: usize) -> Option<Advice> {
        let first = (1..=line).rev().take(200).find_map(|above| {
            let (key, value) = key_and_value(self.lines.text(above))?;
            value.starts_with('[').then_some((key, above))
        });
        let (key, first) = first?;
        let text = without_comment(self.lines.text(line));
        let text = if first == line { text.split_once('[')?.1 } else { text };
        let text = text.trim().trim_end_matches([',', ']', ' ']);
        let better = elements(text)?;
        let is_better = better != text && is_toml(&format!("{key} = [{better}]"));
        is_better.then(|| Advice {
            key: self.path(line, key),
            problem: "the value cannot be read".into(),
            remedy: format!("{}: {}", how(&better), shortened(&better)),
        })
    }

    /// The path of a key in a line, such as `udp_range_net[1].password[0].file`.
    fn path(&self, line: usize, key: &str) -> String {
        let above = &self.headers[..self.headers.partition_point(|header| header.line < line)];
        let Some(header) = above.last() else { return key.to_owned() };
        let mut path = String::new();
        let mut from = 0;
        let ends = header.name.match_indices('.').map(|(at, _)| at).chain([header.name.len()]);
        for end in ends {
            let prefix = &header.name[..end];
            let is_it = |header: &Header<'_>| header.name == prefix && header.is_repeated;
            path += prefix.rsplit('.').next().unwrap_or(prefix);
            if let Some(last) = above[from..].iter().rposition(is_it) {
                let index =
                    above[from..=from + last].iter().filter(|header| is_it(header)).count() - 1;
                path += &format!("[{index}]");
                from += last;
            }
            path.push('.');
        }
        path + key
    }
}

impl<'a> Header<'a> {
    fn read(line: usize, text: &'a str) -> Option<Self> {
        let text = without_comment(text).trim_start_matches('\u{feff}');
        let one = text.strip_prefix('[')?.strip_suffix(']')?;
        let several = one.strip_prefix('[').and_then(|name| name.strip_suffix(']'));
        let name = several.unwrap_or(one).trim();
        let is_bare = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
        let is_name =
            name.chars().all(is_bare) && name.starts_with(|c: char| c.is_ascii_alphabetic());
        is_name.then_some(Self { line, text, name, is_repeated: several.is_some() })
    }
}

fn is_unseen(c: char) -> bool {
    let is_no_blank = c.is_whitespace() && c != ' ' && c != '\t';
    is_no_blank || matches!(c, '\u{feff}' | '\u{200b}'..='\u{200f}' | '\u{2060}')
}

fn without_comment(text: &str) -> &str {
    text.split('#').next().unwrap_or(text).trim()
}

/// Key and value of a line, also when a colon stands in place of `=`.
fn key_and_value(text: &str) -> Option<(&str, &str)> {
    let text = without_comment(text);
    let (key, value) = text.split_once('=').or_else(|| text.split_once(':'))?;
    let (key, value) = (key.trim(), value.trim());
    let is_bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-' || c == '.';
    (key.starts_with(|c: char| c.is_ascii_alphabetic()) && key.chars().all(is_bare))
        .then_some((key, value))
}

fn elements(list: &str) -> Option<String> {
    let elements: Option<Vec<_>> = list.split(',').map(element).collect();
    Some(elements?.join(", "))
}

/// The value, corrected; none when there is no correction.
fn element(value: &str) -> Option<String> {
    let value = value.trim();
    if is_toml(&format!("x = {value}")) {
        // A message shows some characters escaped, so that it could not be copied from there.
        return (!value.contains(is_harmful)).then(|| value.to_owned());
    }
    let plain = value.trim_matches(QUOTES).trim();
    match plain.to_ascii_lowercase().as_str() {
        "true" | "yes" | "on" => return Some("true".into()),
        "false" | "no" | "off" => return Some("false".into()),
        _ => {}
    }
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "._-/:%+*".contains(c);
    (!plain.is_empty() && plain.chars().all(is_plain)).then(|| format!("\"{plain}\""))
}

fn how(better: &str) -> &'static str {
    if better.contains('"') { "write it in quotes" } else { "write it like this" }
}

fn is_toml(text: &str) -> bool {
    DeTable::parse(text).is_ok()
}
