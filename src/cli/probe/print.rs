//! Prints the checks: a line each, and the remedy below it where there is one.

use std::fmt::Write;

use crate::cli::output::Paint;
use crate::harmless::harmless;
use crate::probe::{Check, Report, Verdict};

/// As many nodes that answer, one after the other, have a line each.
const MOST_ANSWERS: usize = 8;

/// The report as text for people.
pub(super) fn text(report: &Report, full: bool, paint: Paint) -> String {
    let checks = if full { report.checks.clone() } else { folded(&report.checks) };
    let width = |of: fn(&Check) -> usize| checks.iter().map(of).max().unwrap_or(0);
    let names = width(|check| check.check.chars().count());
    let subjects = width(|check| check.subject.chars().count());
    // "doubtful" is the longest.
    let indent = " ".repeat("doubtful".len() + names + subjects + 6);
    let mut text = String::new();
    for (index, of) in checks.iter().enumerate() {
        let Check { check, subject, verdict, text: found, remedy } = of;
        // A process may have any name.
        let found = harmless(found);
        let verdict = paint.verdict(*verdict, &format!("{:8}", verdict.label()));
        let _ = writeln!(text, "{verdict}  {check:names$}  {subject:subjects$}  {found}");
        // One remedy for several lines stands below the last of them.
        let below = checks.get(index + 1).and_then(|next| next.remedy.as_ref());
        if let Some(remedy) = remedy.as_ref().filter(|remedy| below != Some(remedy)) {
            let _ = writeln!(text, "{indent}→ {remedy}");
        }
    }
    let count = |verdict| report.checks.iter().filter(|check| check.verdict == verdict).count();
    let counts = [Verdict::Bad, Verdict::Doubtful, Verdict::Unknown, Verdict::Good]
        .map(|verdict| format!("{} {}", count(verdict), verdict.label()));
    let _ = writeln!(text, "\n{}", counts.join(", "));
    text
}

/// The checks, with one in place of many nodes that answer.
fn folded(checks: &[Check]) -> Vec<Check> {
    let answers = |check: &Check| check.check == "answer" && check.verdict == Verdict::Good;
    let runs = checks.chunk_by(|check, next| answers(check) && answers(next));
    let fold = |run: &[Check]| match run {
        [first, .., last] if run.len() > MOST_ANSWERS => {
            let text = format!("all answer, from {} to {}", first.subject, last.subject);
            vec![Check::good(first.check, &format!("{} nodes", run.len()), text)]
        }
        run => run.to_vec(),
    };
    runs.flat_map(fold).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_a_check_with_its_remedy_below() {
        let report = Report::new(vec![
            Check::good("route", "section-1", "by \u{1b}[1m"),
            Check::bad("answer", "node 2 of section-1", "closed").remedy("open it"),
            Check::bad("answer", "node 3 of section-1", "closed").remedy("open it"),
        ]);
        assert_eq!(report.verdict, Verdict::Bad);
        assert_eq!(
            text(&report, false, Paint { colour: false }),
            "good      route   section-1            by \\u{1b}[1m\n\
             bad       answer  node 2 of section-1  closed\n\
             bad       answer  node 3 of section-1  closed\n\
             \u{20}                                      → open it\n\
             \n2 bad, 0 doubtful, 0 unknown, 1 good\n"
        );
        let coloured = text(&report, false, Paint { colour: true });
        assert!(coloured.contains("\u{1b}[31mbad     \u{1b}[0m"), "{coloured:?}");
    }

    #[test]
    fn many_nodes_that_answer_are_one_line() {
        let node =
            |number: u8| Check::good("answer", &format!("node {number}"), "answers in 1.2 ms");
        let off = Check::bad("answer", "node 10", "no answer");
        let checks: Vec<_> =
            (1..10).map(node).chain([off.clone()]).chain((11..13).map(node)).collect();
        let all = Check::good("answer", "9 nodes", "all answer, from node 1 to node 9");
        assert_eq!(folded(&checks), [all, off, node(11), node(12)]);
        let report = Report::new(checks);
        let lines = |full| text(&report, full, Paint { colour: false }).lines().count();
        assert_eq!((lines(false), lines(true)), (6, 14));
    }
}
