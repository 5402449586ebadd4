//! Faults and warnings: where in which file, what is wrong, what to do.
//!
//! Reading never stops at a fault; it is noted in a [`Report`], which decides at the end whether a
//! configuration may be used. No message ever holds an octet of a password.

use std::cell::RefCell;
use std::fmt;
use std::path::{Path, PathBuf};

/// Something in the configuration that keeps the router from starting.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The configuration file.
    pub file: PathBuf,
    /// Line in it, from 1; none when the file could not be read at all.
    pub line: Option<usize>,
    /// Path of the key, like `udp_range_net[1].password[0].file`; empty when the fault belongs to
    /// no key.
    pub key: String,
    /// What is wrong.
    pub problem: String,
    /// What to do about it.
    pub remedy: String,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:", self.file.display())?;
        if let Some(line) = self.line {
            write!(f, "{line}:")?;
        }
        if !self.key.is_empty() {
            write!(f, " {}:", self.key)?;
        }
        write!(f, " {}; {}", self.problem, self.remedy)
    }
}

/// Every fault of a configuration, in the order of their lines; printed one a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Faults(pub Vec<Fault>);

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, fault) in self.0.iter().enumerate() {
            let separator = if number == 0 { "" } else { "\n" };
            write!(f, "{separator}{fault}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Faults {}

/// Something that the router can run with, but that is probably not meant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning(pub Fault);

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// A place in the configuration file.
#[derive(Clone, Debug)]
pub(super) struct Place {
    /// Line, from 1.
    pub(super) line: usize,
    /// Path of the key.
    pub(super) key: String,
}

/// What was found while one file was read.
#[derive(Debug)]
pub(super) struct Report<'a> {
    /// The configuration file.
    pub(super) file: &'a Path,
    text: &'a str,
    /// The password and token files that were read.
    pub(super) secrets: RefCell<Vec<PathBuf>>,
    faults: RefCell<Vec<Fault>>,
    warnings: RefCell<Vec<Warning>>,
}

impl<'a> Report<'a> {
    pub(super) fn new(file: &'a Path, text: &'a str) -> Self {
        let (faults, warnings) = (RefCell::default(), RefCell::default());
        Self { file, text, secrets: RefCell::default(), faults, warnings }
    }

    /// The line of an offset into the text.
    pub(super) fn line(&self, offset: usize) -> usize {
        line_of(self.text.as_bytes(), offset)
    }

    pub(super) fn fault(&self, place: &Place, problem: String, remedy: String) {
        self.faults.borrow_mut().push(self.found(place, problem, remedy));
    }

    pub(super) fn warn(&self, place: &Place, problem: String, remedy: String) {
        self.warnings.borrow_mut().push(Warning(self.found(place, problem, remedy)));
    }

    pub(super) fn is_sound(&self) -> bool {
        self.faults.borrow().is_empty()
    }

    /// What was read, with the warnings, when no fault was noted; else the faults.
    pub(super) fn verdict<T>(self, read: Option<T>) -> Result<(T, Vec<Warning>), Faults> {
        let (mut faults, mut warnings) = (self.faults.into_inner(), self.warnings.into_inner());
        faults.sort_by_key(|fault| fault.line);
        warnings.sort_by_key(|warning| warning.0.line);
        match read {
            Some(read) if faults.is_empty() => Ok((read, warnings)),
            _ => Err(Faults(faults)),
        }
    }

    fn found(&self, place: &Place, problem: String, remedy: String) -> Fault {
        let (line, key) = (Some(place.line), place.key.clone());
        Fault { file: self.file.to_owned(), line, key, problem, remedy }
    }
}

/// The line, from 1, of an offset into a text.
pub(super) fn line_of(text: &[u8], offset: usize) -> usize {
    let before = &text[..offset.min(text.len())];
    1 + before.iter().filter(|&&octet| octet == b'\n').count()
}
