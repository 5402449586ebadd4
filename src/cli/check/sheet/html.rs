//! The sheet as one page: no script, nothing from elsewhere, and fit for paper.

use std::fmt::{self, Display, Write};

use super::{COLUMNS, Line, NOTES};

const HEAD: &str = r#"<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<title>Set up a P-NET client</title>
<style>
:root { color-scheme: light dark }
body { font: 1rem/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem }
section { break-inside: avoid; border-top: 1px solid; margin-top: 2rem }
th { text-align: left; padding-right: 2rem; font-weight: normal; vertical-align: top }
td { font-weight: bold; overflow-wrap: anywhere }
code { font: 1em ui-monospace, monospace; overflow-wrap: anywhere }
@media print { :root { color-scheme: light } body { margin: 0; max-width: none } }
</style>
</head>
<body>
<main>
<h1>Set up a P-NET client</h1>
"#;

/// A section for each net, with a line for each field, and the notes.
pub(super) fn page(lines: &[Line]) -> String {
    let mut page = HEAD.to_owned();
    for line in lines {
        let [name, cells @ .., command] = line;
        let [_, columns @ .., test] = COLUMNS;
        // A String takes all that is written to it.
        let _ = write!(page, "<section>\n<h2>{}</h2>\n<table>\n", Escaped(name));
        for (column, cell) in columns.iter().zip(cells) {
            let (column, cell) = (Escaped(column), Escaped(cell));
            let _ = writeln!(page, "<tr><th scope=\"row\">{column}</th><td>{cell}</td></tr>");
        }
        let (test, command) = (Escaped(test), Escaped(command));
        let _ = write!(page, "</table>\n<p>{test}: <code>{command}</code></p>\n</section>\n");
    }
    page += "<section>\n<h2>What it means</h2>\n<ul>\n";
    for note in NOTES {
        let _ = writeln!(page, "<li>{}</li>", Escaped(note));
    }
    page + "</ul>\n</section>\n</main>\n</body>\n</html>\n"
}

/// Text that is nothing but text in HTML.
struct Escaped<'a>(&'a str);

impl Display for Escaped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.chars().try_for_each(|c| match c {
            '&' => f.write_str("&amp;"),
            '<' => f.write_str("&lt;"),
            '>' => f.write_str("&gt;"),
            '"' => f.write_str("&quot;"),
            '\'' => f.write_str("&#39;"),
            c => f.write_char(c),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_stands_in_a_cell_is_text() {
        let hostile = "<img src=x onerror='alert(\"&\")'>";
        let line: Line = std::array::from_fn(|_| hostile.to_owned());
        let page = page(&[line]);
        assert!(!page.contains("<img") && !page.contains("alert(\""), "{page}");
        let escaped = "&lt;img src=x onerror=&#39;alert(&quot;&amp;&quot;)&#39;&gt;";
        assert_eq!(page.matches(escaped).count(), COLUMNS.len());
    }

    #[test]
    fn the_page_needs_nothing_else() {
        let page = page(&[]);
        for other in ["http://", "https://", "<script", "<link", "<img", "url("] {
            assert!(!page.contains(other), "{other}");
        }
    }
}
