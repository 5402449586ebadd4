//! What is wrong between router and node, found from the router itself, without a client.
//!
//! Here are the checks of one node, which `pnet-nat probe` and the admin server share: `node` asks it,
//! `neighbour` reads the ARP table, `counted` judges what the relay has seen of it. Each verdict is a
//! function of what was read. Invariant: a node gets one harmless request at a time.

mod counted;
mod neighbour;
mod node;

use serde::Serialize;

pub use counted::Counted;
pub use neighbour::Neighbour;
pub use node::{Asked, Outcome, Seen};

/// How a check came out, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// As it has to be.
    Good,
    /// It cannot be told from here.
    Unknown,
    /// It may be meant so, or be the cause of a fault.
    Doubtful,
    /// Nothing can work like this.
    Bad,
}

impl Verdict {
    /// The verdict in one word.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Unknown => "unknown",
            Self::Doubtful => "doubtful",
            Self::Bad => "bad",
        }
    }
}

/// One check with its verdict.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What is checked, in one word.
    pub check: &'static str,
    /// What it is checked of: "node 3 of section-1".
    pub subject: String,
    /// The verdict.
    pub verdict: Verdict,
    /// What was found.
    pub text: String,
    /// What to do about it.
    pub remedy: Option<String>,
}

impl Check {
    /// A check that came out well.
    pub fn good(check: &'static str, subject: &str, text: impl Into<String>) -> Self {
        Self::new(check, subject, Verdict::Good, text)
    }

    /// A check whose outcome cannot be told.
    pub fn unknown(check: &'static str, subject: &str, text: impl Into<String>) -> Self {
        Self::new(check, subject, Verdict::Unknown, text)
    }

    /// A check that found what may be a fault.
    pub fn doubtful(check: &'static str, subject: &str, text: impl Into<String>) -> Self {
        Self::new(check, subject, Verdict::Doubtful, text)
    }

    /// A check that found a fault.
    pub fn bad(check: &'static str, subject: &str, text: impl Into<String>) -> Self {
        Self::new(check, subject, Verdict::Bad, text)
    }

    fn new(check: &'static str, subject: &str, verdict: Verdict, text: impl Into<String>) -> Self {
        Self { check, subject: subject.to_owned(), verdict, text: text.into(), remedy: None }
    }

    /// The same check, with what to do.
    pub fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = Some(remedy.into());
        self
    }
}

/// All checks of a probe.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The checks, in their order.
    pub checks: Vec<Check>,
    /// The worst verdict of them.
    pub verdict: Verdict,
}

impl Report {
    /// The report of these checks.
    pub fn new(checks: Vec<Check>) -> Self {
        let verdict = checks.iter().map(|check| check.verdict).max().unwrap_or(Verdict::Unknown);
        Self { checks, verdict }
    }
}
