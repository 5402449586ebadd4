//! Prints the checks: a line each, and the remedy below it where there is one.

use std::fmt::Write;

use crate::cli::output::Paint;
use crate::harmless::harmless;
use crate::probe::{Check, Report, Verdict};

/// The report as text for people.
pub(super) fn text(report: &Report, paint: Paint) -> String {
    let width = |of: fn(&Check) -> usize| report.checks.iter().map(of).max().unwrap_or(0);
    let names = width(|check| check.check.chars().count());
    let subjects = width(|check| check.subject.chars().count());
    // "doubtful" is the longest.
    let indent = " ".repeat("doubtful".len() + names + subjects + 6);
    let mut text = String::new();
    for (index, of) in report.checks.iter().enumerate() {
        let Check { check, subject, verdict, text: found, remedy } = of;
        // A process may have any name.
        let found = harmless(found);
        let verdict = paint.verdict(*verdict, &format!("{:8}", verdict.label()));
        let _ = writeln!(text, "{verdict}  {check:names$}  {subject:subjects$}  {found}");
        // One remedy for several lines stands below the last of them.
        let below = report.checks.get(index + 1).and_then(|next| next.remedy.as_ref());
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
            text(&report, Paint { colour: false }),
            "good      route   section-1            by \\u{1b}[1m\n\
             bad       answer  node 2 of section-1  closed\n\
             bad       answer  node 3 of section-1  closed\n\
             \u{20}                                      → open it\n\
             \n2 bad, 0 doubtful, 0 unknown, 1 good\n"
        );
        let coloured = text(&report, Paint { colour: true });
        assert!(coloured.contains("\u{1b}[31mbad     \u{1b}[0m"), "{coloured:?}");
    }
}
