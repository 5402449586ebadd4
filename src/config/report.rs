//! Faults and warnings: file and line, what is wrong, and what to do.
//!
//! Reading never stops at a fault. A [`Report`] collects them and decides at the end whether the
//! configuration can be used. Of very many faults the first are kept and the others counted. No message
//! contains an octet of a password.

use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use super::excerpt::Lines;
use crate::harmless::harmless;

/// How many faults are shown, and how many warnings: enough to correct at a time.
pub(super) const MOST_TOLD: usize = 100;
/// The problem of a required key that is left out.
pub(super) const MISSING: &str = "missing";
/// How many characters of a text in the file are shown.
const MOST_SHOWN: usize = 100;

/// Something in the configuration that keeps the relay from starting.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The configuration file, or the environment variable in its place.
    pub file: PathBuf,
    /// Line in it, from 1; none when the file could not be read at all, and for a variable.
    pub line: Option<usize>,
    /// Path of the key, like `udp_range_net[1].password[0].file`; empty when the fault belongs to
    /// no key.
    pub key: String,
    /// What is wrong.
    pub problem: String,
    /// What to do about it.
    pub remedy: String,
    /// The line itself, and below it a `^` that points at the place; only where the text is not TOML.
    pub excerpt: Option<String>,
    /// It may go away without an edit, for example when an interface comes up.
    pub passes: bool,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:", harmless(&self.file.display().to_string()))?;
        if let Some(line) = self.line {
            write!(f, "{line}:")?;
        }
        if !self.key.is_empty() {
            write!(f, " {}:", harmless(&self.key))?;
        }
        write!(f, " {}; {}", self.problem, self.remedy)
    }
}

/// The faults of a configuration, in the order of their lines. Printed one a line, each followed by its
/// excerpt if it has one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Faults(pub Vec<Fault>);

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, fault) in self.0.iter().enumerate() {
            let separator = if number == 0 { "" } else { "\n" };
            write!(f, "{separator}{fault}")?;
            for line in fault.excerpt.iter().flat_map(|excerpt| excerpt.lines()) {
                write!(f, "\n    {line}")?;
            }
        }
        Ok(())
    }
}

impl std::error::Error for Faults {}

impl Faults {
    /// Whether all of them may go away without an edit.
    pub fn pass(&self) -> bool {
        self.0.iter().all(|fault| fault.passes)
    }
}

/// Something that the relay can run with, but that is probably not intended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning(pub Fault);

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// A text as a message shows it: cut when it is longer than a line.
pub(super) fn shortened(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(MOST_SHOWN) {
        Some((end, _)) => format!("{}…", &text[..end]).into(),
        None => text.into(),
    }
}

/// The same, escaped and in quotes.
pub(super) fn quoted(text: &str) -> String {
    format!("{:?}", shortened(text))
}

/// What is wrong at a place, and what to do.
#[derive(Debug)]
pub(super) struct Advice {
    /// Path of the key, if it stands on the line.
    pub(super) key: String,
    pub(super) problem: String,
    pub(super) remedy: String,
}

/// A place in the configuration file.
#[derive(Clone, Debug)]
pub(super) struct SourceSpan {
    /// Line, from 1.
    pub(super) line: usize,
    /// Path of the key.
    pub(super) key: String,
}

/// What was found while a file was read.
#[derive(Debug)]
pub(super) struct Report<'a> {
    /// The configuration file.
    pub(super) file: &'a Path,
    pub(super) lines: Lines<'a>,
    /// The password and token files that were read.
    pub(super) secrets: RefCell<Vec<PathBuf>>,
    /// The keys of each section that was read, by its header.
    known: RefCell<BTreeMap<String, Vec<&'static str>>>,
    faults: RefCell<Noted>,
    warnings: RefCell<Noted>,
    #[cfg(test)]
    pub(super) asked: super::asked::Asked,
}

impl<'a> Report<'a> {
    pub(super) fn new(file: &'a Path, text: &'a str) -> Self {
        Self {
            file,
            lines: Lines::of(text),
            secrets: RefCell::default(),
            known: RefCell::default(),
            faults: RefCell::default(),
            warnings: RefCell::default(),
            #[cfg(test)]
            asked: super::asked::Asked::default(),
        }
    }

    /// The line of an offset into the text.
    pub(super) fn line(&self, offset: usize) -> usize {
        self.lines.line(offset)
    }

    pub(super) fn fault(&self, place: &SourceSpan, problem: String, remedy: String) {
        self.faults.borrow_mut().note(self.found(place, problem, remedy), None);
    }

    pub(super) fn fault_that_passes(&self, place: &SourceSpan, problem: String, remedy: String) {
        let fault = Fault { passes: true, ..self.found(place, problem, remedy) };
        self.faults.borrow_mut().note(fault, None);
    }

    /// A key that the section does not have. Where it belongs is known once all sections are read.
    pub(super) fn unknown_key(&self, place: &SourceSpan, unknown: Unknown, remedy: String) {
        let fault = self.found(place, "unknown key".into(), remedy);
        self.faults.borrow_mut().note(fault, Some(unknown));
    }

    /// A text that is not TOML: the fault shows the line of this offset.
    pub(super) fn syntax_fault(&self, offset: usize, advice: Advice) {
        let Advice { key, problem, remedy } = advice;
        let place = SourceSpan { line: self.line(offset), key };
        let excerpt = Some(self.lines.excerpt(offset));
        let fault = Fault { excerpt, ..self.found(&place, problem, remedy) };
        self.faults.borrow_mut().note(fault, None);
    }

    pub(super) fn warn(&self, place: &SourceSpan, problem: String, remedy: String) {
        self.warnings.borrow_mut().note(self.found(place, problem, remedy), None);
    }

    /// Remembers the keys that a section with this header may have.
    pub(super) fn learn(&self, header: String, keys: Vec<&'static str>) {
        self.known.borrow_mut().entry(header).or_insert(keys);
    }

    pub(super) fn is_sound(&self) -> bool {
        self.faults.borrow().kept.is_empty()
    }

    /// What was read and the warnings if there is no fault; otherwise the faults.
    pub(super) fn verdict<T>(self, read: Option<T>) -> Result<(T, Vec<Warning>), Faults> {
        let known = self.known.into_inner();
        let faults = self.faults.into_inner().told("faults", &known);
        let warnings = self.warnings.into_inner().told("warnings", &known);
        match read {
            Some(read) if faults.is_empty() => {
                Ok((read, warnings.into_iter().map(Warning).collect()))
            }
            _ => Err(Faults(faults)),
        }
    }

    fn found(&self, place: &SourceSpan, problem: String, remedy: String) -> Fault {
        let (line, key) = (Some(place.line), place.key.clone());
        Fault {
            file: self.file.to_owned(),
            line,
            key,
            // Both may show what stands in the file.
            problem: harmless(&problem),
            remedy: harmless(&remedy),
            excerpt: None,
            passes: false,
        }
    }
}

/// The header of what stands above all sections.
const WHOLE_FILE: &str = "";

/// A key that its section does not have.
#[derive(Debug)]
pub(super) struct Unknown {
    pub(super) name: String,
    /// The header of the section, and the line that it begins in.
    pub(super) header: String,
    pub(super) line: usize,
    /// The section has a key with nearly the same name.
    pub(super) is_close: bool,
}

impl Unknown {
    /// The path of the key in the section above, if it belongs there.
    fn home(&self, path: &str, known: &BTreeMap<String, Vec<&'static str>>) -> Option<String> {
        let (section, _) = path.rsplit_once('.')?;
        let Some((above, _)) = section.rsplit_once('.') else {
            let keys = known.get(WHOLE_FILE)?;
            return keys.contains(&self.name.as_str()).then(|| self.name.clone());
        };
        let header = self.header.trim_matches(['[', ']']).rsplit_once('.')?.0;
        let keys = known.get(&format!("[[{header}]]"))?;
        keys.contains(&self.name.as_str()).then(|| format!("{above}.{}", self.name))
    }

    /// What to do if another section has the key.
    fn remedy(&self, known: &BTreeMap<String, Vec<&'static str>>) -> Option<String> {
        let Self { name, header, line, is_close } = self;
        let has_it = |(_, keys): &(_, &Vec<_>)| keys.contains(&name.as_str());
        let homes: Vec<_> = known.iter().filter(has_it).map(|(home, _)| home.as_str()).collect();
        let above =
            |home: &&&str| header.trim_matches('[').starts_with(home.trim_matches(['[', ']']));
        match homes.iter().find(above) {
            Some(&WHOLE_FILE) => Some(format!(
                "it belongs to the whole file, not to {header}: move it above the first section"
            )),
            Some(above) => Some(format!(
                "it is a key of {above}: move it above line {line}, where {header} begins"
            )),
            None if homes.is_empty() || *is_close => None,
            None => Some(format!("it is a key of {}: move it there", homes.join(" or of "))),
        }
    }
}

/// The first faults by line, and how many further ones there are.
#[derive(Debug, Default)]
struct Noted {
    kept: Vec<(Fault, Option<Unknown>)>,
    more: usize,
    /// The line of the first of the further ones.
    from: Option<usize>,
}

impl Noted {
    fn note(&mut self, fault: Fault, unknown: Option<Unknown>) {
        self.kept.push((fault, unknown));
        if self.kept.len() == 2 * MOST_TOLD {
            self.keep_the_first();
        }
    }

    fn keep_the_first(&mut self) {
        self.kept.sort_by_key(|(fault, _)| fault.line);
        for (left_out, _) in self.kept.drain(MOST_TOLD.min(self.kept.len())..) {
            self.more += 1;
            self.from = self.from.into_iter().chain(left_out.line).min();
        }
    }

    fn told(mut self, kind: &str, known: &BTreeMap<String, Vec<&'static str>>) -> Vec<Fault> {
        self.keep_the_first();
        // A key that stands in the wrong section is not missing: adding it would make two of it.
        let misplaced: Vec<_> = self
            .kept
            .iter()
            .filter_map(|(fault, unknown)| unknown.as_ref()?.home(&fault.key, known))
            .collect();
        self.kept.retain(|(fault, _)| fault.problem != MISSING || !misplaced.contains(&fault.key));
        let placed = |(fault, unknown): (Fault, Option<Unknown>)| match unknown
            .and_then(|unknown| unknown.remedy(known))
        {
            Some(remedy) => Fault { remedy, ..fault },
            None => fault,
        };
        let mut told: Vec<_> = self.kept.into_iter().map(placed).collect();
        if let (Some(last), more @ 1..) = (told.last(), self.more) {
            told.push(Fault {
                line: self.from,
                key: String::new(),
                problem: format!("{more} more {kind} from this line on are not shown"),
                remedy: "correct those above, and check again".into(),
                excerpt: None,
                ..last.clone()
            });
        }
        told
    }
}
