//! The lines of the configuration's text: their numbers, and how one is shown below a fault.
//!
//! The beginnings of all lines are found once. So the line of each key takes a binary search and not a
//! walk through the text.

use crate::harmless::is_harmful;

/// How many characters of a line are shown on each side of the fault.
const MOST_BESIDE: usize = 60;

/// A text and where its lines begin.
#[derive(Debug)]
pub(super) struct Lines<'a> {
    text: &'a str,
    beginnings: Vec<usize>,
}

impl<'a> Lines<'a> {
    pub(super) fn of(text: &'a str) -> Self {
        let after_breaks = text.match_indices('\n').map(|(at, _)| at + 1);
        Self { text, beginnings: std::iter::once(0).chain(after_breaks).collect() }
    }

    /// The line, from 1, of an offset.
    pub(super) fn line(&self, offset: usize) -> usize {
        self.beginnings.partition_point(|&beginning| beginning <= offset.min(self.text.len()))
    }

    /// How many lines there are.
    pub(super) fn count(&self) -> usize {
        self.beginnings.len()
    }

    /// The text of a line, from 1, without its end.
    pub(super) fn text(&self, line: usize) -> &'a str {
        let (from, to) = (self.beginnings[line - 1], self.beginnings.get(line));
        self.text[from..to.copied().unwrap_or(self.text.len())].trim_end_matches(['\n', '\r'])
    }

    /// How many octets of its line stand before the offset.
    fn column(&self, offset: usize) -> usize {
        let line = self.line(offset);
        let (beginning, text) = (self.beginnings[line - 1], self.text(line));
        let column = offset.saturating_sub(beginning).min(text.len());
        (0..=column).rev().find(|&at| text.is_char_boundary(at)).unwrap_or(0)
    }

    /// The line of an offset, and below it a `^` that points at the offset.
    pub(super) fn excerpt(&self, offset: usize) -> String {
        let (before, after) = self.text(self.line(offset)).split_at(self.column(offset));
        // A character that would move the cursor is replaced, so that each one takes one column.
        let shown = |c: char| match c {
            '\t' => ' ',
            c if is_harmful(c) => '\u{fffd}',
            c => c,
        };
        let left_out = before.chars().count().saturating_sub(MOST_BESIDE);
        let mark = |is_cut| if is_cut { "…" } else { "" };
        let before: String = before.chars().skip(left_out).map(shown).collect();
        let rest = after.chars().nth(MOST_BESIDE).is_some();
        let after: String = after.chars().take(MOST_BESIDE).map(shown).collect();
        let indent = " ".repeat(before.chars().count() + usize::from(left_out > 0));
        format!("{}{before}{after}{}\n{indent}^", mark(left_out > 0), mark(rest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_offset_has_its_line() {
        let text = "a\n\nbc\r\nd";
        let lines = Lines::of(text);
        for offset in 0..=text.len() {
            let breaks = text[..offset].matches('\n').count();
            assert_eq!(lines.line(offset), 1 + breaks, "{offset}");
        }
        assert_eq!(lines.line(usize::MAX), 4);
        assert_eq!([1, 2, 3, 4].map(|line| lines.text(line)), ["a", "", "bc", "d"]);
    }

    #[test]
    fn an_excerpt_points_at_the_place() {
        let excerpt = |text: &str, offset| Lines::of(text).excerpt(offset);
        assert_eq!(excerpt("a = 1\nbö = x\n", 12), "bö = x\n     ^");
        assert_eq!(excerpt("a\t=\u{7}1", 4), "a =\u{fffd}1\n    ^");
        assert_eq!(excerpt("", 0), "\n^");
        assert_eq!(excerpt("a\r\n", 3), "\n^");
        let long = excerpt(&"x".repeat(1000), 500);
        assert_eq!(long.lines().map(|line| line.chars().count()).collect::<Vec<_>>(), [122, 62]);
    }
}
