//! `docs/requirements.md`: every rule has a test, and each test is there.

use std::fs;

const PAGE: &str = include_str!("../../docs/requirements.md");

/// The number of a rule, and its tests: file and name.
fn rows() -> impl Iterator<Item = (&'static str, Vec<(&'static str, &'static str)>)> {
    let is_row = |line: &&str| ["| R-", "| N-", "| P-"].iter().any(|kind| line.starts_with(kind));
    let rows = PAGE.lines().filter(is_row);
    rows.map(|row| {
        let columns: Vec<_> = row.trim_matches('|').split('|').map(str::trim).collect();
        let &[number, _, _, tests] = columns.as_slice() else { panic!("four columns: {row}") };
        let test = |test: &'static str| {
            let (name, file) = test.split_once("` in ").unwrap_or_else(|| panic!("{test}"));
            (file, name.trim_start_matches('`'))
        };
        (number, tests.split("<br>").map(test).collect())
    })
}

#[test]
fn every_rule_has_a_row() {
    let numbers: Vec<_> = rows().map(|(number, _)| number.to_owned()).collect();
    let rules = (1..=44).map(|n| format!("R-{n}"));
    let rules = rules.chain((1..=11).map(|n| format!("N-{n}")));
    let expected: Vec<_> = rules.chain((1..=12).map(|n| format!("P-{n}"))).collect();
    assert_eq!(numbers, expected);
}

#[test]
fn every_test_is_there() {
    for (number, tests) in rows() {
        for (file, name) in tests {
            let text = fs::read_to_string(file).unwrap_or_else(|error| panic!("{file}: {error}"));
            let (before, _) = text
                .split_once(&format!("fn {name}("))
                .unwrap_or_else(|| panic!("{number}: {file} has no {name}"));
            let mut above = before.rsplit('\n').skip(1).take_while(|line| !line.is_empty());
            assert!(
                above.any(|line| line.contains("test]")),
                "{number}: {name} in {file} is no test"
            );
        }
    }
}
