//! NAT conformance: one list of checks, run against the relay and against the kernel's own NAT.
//!
//! Each check says what it expects of either, so that what one of them does not do is known and
//! stays known. docs/nat-conformance.md shows the list, and has to show it as it is.

mod checks;
mod systems;

use std::fmt::{self, Write};
use std::thread;

use checks::CHECKS;
use systems::{Settings, System, Tested};

use crate::harness::{Network, has_nft, nightly};

/// One thing that a NAT router has to do.
struct Check {
    /// What it is part of; the sources stand in docs/nat-conformance.md.
    requirement: &'static str,
    passes_when: &'static str,
    settings: Settings,
    /// Whether it passes.
    run: fn(&Tested<'_>) -> bool,
    relay: Expected,
    kernel: Expected,
    /// It takes minutes.
    nightly: bool,
}

/// What comes of a check.
#[derive(Clone, Copy)]
enum Expected {
    Passes,
    /// And why.
    Fails(&'static str),
}

impl Check {
    fn expected(&self, system: System) -> Expected {
        match system {
            System::Relay => self.relay,
            System::Kernel => self.kernel,
        }
    }

    /// Runs it in networks of its own, and says what is not as expected.
    fn surprise(&self, system: System) -> Option<String> {
        let network = Network::build()?;
        let expected = matches!(self.expected(system), Expected::Passes);
        let passed = network.edge.enter(|| {
            let tested = Tested::start(system, &network, &self.settings, expected);
            let passed = (self.run)(&tested);
            tested.end();
            passed
        });
        let Self { requirement, passes_when, .. } = self;
        (passed != expected)
            .then(|| format!("{system:?}, {requirement}: {passes_when}: passed is {passed}"))
    }
}

impl fmt::Display for Expected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Passes => f.write_str("yes"),
            Self::Fails(why) => write!(f, "no: {why}"),
        }
    }
}

/// Runs the checks side by side.
fn run(systems: &[System], nightly: bool) {
    if Network::build().is_none() {
        return; // that has said so
    }
    if systems.contains(&System::Kernel) && !has_nft() {
        return;
    }
    let wanted = || CHECKS.iter().filter(|check| check.nightly == nightly);
    let surprises: Vec<_> = thread::scope(|scope| {
        let pairs = systems.iter().flat_map(|&system| wanted().map(move |check| (system, check)));
        let running = pairs.map(|(system, check)| {
            (check.requirement, scope.spawn(move || check.surprise(system)))
        });
        let running: Vec<_> = running.collect();
        let outcome = |(requirement, check): (&str, thread::ScopedJoinHandle<'_, _>)| {
            check.join().unwrap_or_else(|_| Some(format!("{requirement} panicked")))
        };
        running.into_iter().filter_map(outcome).collect()
    });
    assert!(surprises.is_empty(), "not as docs/nat-conformance.md says:\n{}", surprises.join("\n"));
}

#[test]
fn the_relay_conforms() {
    run(&[System::Relay], false);
}

#[test]
fn the_kernel_does_what_the_table_says_of_it() {
    run(&[System::Kernel], false);
}

#[test]
fn what_takes_minutes() {
    if nightly() {
        run(&[System::Relay, System::Kernel], true);
    }
}

#[test]
fn the_page_has_the_table() {
    let mut table = "| | passes when | pnet-nat | kernel |\n|---|---|---|---|\n".to_owned();
    for Check { requirement, passes_when, relay, kernel, .. } in &CHECKS {
        writeln!(table, "| {requirement} | {passes_when} | {relay} | {kernel} |").unwrap();
    }
    assert!(
        include_str!("../../../docs/nat-conformance.md").contains(&format!("\n\n{table}\n")),
        "the table of docs/nat-conformance.md has to be:\n\n{table}"
    );
}
