//! Makes text from outside harmless before a terminal shows it. An answer of another server, a name
//! or an error may contain escape sequences, line breaks, or marks that reverse the order of
//! letters.

use std::fmt::Write;

#[cfg(feature = "cli")]
use serde_json::Value;

/// Whether a character controls a terminal or changes how other characters are read.
pub(crate) fn is_harmful(c: char) -> bool {
    c.is_control()
        || matches!(
            c,
            '\u{ad}'
                | '\u{61c}'
                | '\u{180e}'
                | '\u{200b}'..='\u{200f}'
                | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}'
                | '\u{feff}'
                | '\u{fff9}'..='\u{fffb}'
                | '\u{e0000}'..='\u{e007f}'
        )
}

/// The text with each harmful character escaped, as in `\u{1b}`.
pub(crate) fn harmless(text: &str) -> String {
    let mut harmless = String::with_capacity(text.len());
    for c in text.chars() {
        if is_harmful(c) {
            harmless.extend(c.escape_unicode());
        } else {
            harmless.push(c);
        }
    }
    harmless
}

/// The same for a text of several lines. The line breaks stay.
pub(crate) fn harmless_lines(text: &str) -> String {
    text.split('\n').map(harmless).collect::<Vec<_>>().join("\n")
}

/// The same for all names and texts in a JSON value.
#[cfg(feature = "cli")]
pub(crate) fn harmless_value(value: Value) -> Value {
    match value {
        Value::String(text) => harmless(&text).into(),
        Value::Array(list) => list.into_iter().map(harmless_value).collect(),
        Value::Object(map) => {
            map.into_iter().map(|(name, value)| (harmless(&name), harmless_value(value))).collect()
        }
        value => value,
    }
}

/// JSON with the same meaning, in which harmful characters are escaped as JSON does it.
pub(crate) fn harmless_json(json: &str) -> String {
    let mut harmless = String::with_capacity(json.len());
    for c in json.chars() {
        if is_harmful(c) {
            for unit in c.encode_utf16(&mut [0; 2]) {
                let _ = write!(harmless, "\\u{unit:04x}");
            }
        } else {
            harmless.push(c);
        }
    }
    harmless
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn nothing_harmful_is_left_and_the_rest_stays() {
        for harmful in [
            "\x1b[2J",
            "\u{9b}2J",
            "\r",
            "\n",
            "\x07",
            "\x7f",
            "\u{202e}",
            "\u{2066}",
            "\u{200f}",
            "\u{feff}",
            "\u{e0041}",
        ] {
            let text = format!("a{harmful}é 中");
            let shown = harmless(&text);
            assert!(!shown.chars().any(is_harmful), "{shown:?}");
            assert!(shown.starts_with("a\\u{") && shown.ends_with("é 中"), "{shown:?}");
            let value = json!({ &text: [&text, 7, null] });
            let json = harmless_json(&value.to_string());
            assert!(!json.chars().any(is_harmful), "{json:?}");
            assert_eq!(serde_json::from_str::<Value>(&json).unwrap(), value);
            assert_eq!(harmless_value(value), json!({ &shown: [&shown, 7, null] }));
        }
        assert_eq!(harmless_lines("one\ntwo\x1b[m\n"), "one\ntwo\\u{1b}[m\n");
    }
}
