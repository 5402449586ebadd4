//! The fields of an event as text. Their values may come from outside, so control characters in them are
//! escaped: an event stays one line, and a terminal executes nothing.

use tracing_subscriber::field::MakeExt;
use tracing_subscriber::fmt::FormatFields;
use tracing_subscriber::fmt::format::debug_fn;

use crate::harmless::harmless;

/// Writes the message, then `name=value` for each field, separated by spaces.
pub(super) fn fields() -> impl for<'a> FormatFields<'a> + Send + Sync + 'static {
    debug_fn(|line, field, value| {
        let value = harmless(&format!("{value:?}"));
        match (field.name(), line.has_ansi_escapes()) {
            ("message", _) => write!(line, "{value}"),
            (name, false) => write!(line, "{name}={value}"),
            (name, true) => write!(line, "\x1b[3m{name}\x1b[0m\x1b[2m=\x1b[0m{value}"),
        }
    })
    .delimited(" ")
}

#[cfg(test)]
mod tests {
    use std::io;

    use crate::logging::list;
    use crate::logging::tests::written;

    /// What is logged, without time and level.
    fn logged(colour: bool, log: impl FnOnce()) -> String {
        let text = written(
            |events| {
                events
                    .fmt_fields(super::fields())
                    .with_target(false)
                    .without_time()
                    .with_level(false)
                    .with_ansi(colour)
                    .finish()
            },
            log,
        );
        text.trim_start().to_owned()
    }

    #[test]
    fn names_and_values_stand_side_by_side() {
        let log = || {
            let error = io::Error::other("so");
            let addresses = list(["192.0.2.1"]);
            tracing::warn!(net = %"section-1", n = 7, quoted = "a b", addresses, %error, "it {}", "is");
        };
        let right = "it is net=section-1 n=7 quoted=\"a b\" addresses=[\"192.0.2.1\"] error=so\n";
        assert_eq!(logged(false, log), right);
        assert!(logged(true, log).contains("\x1b[3mnet\x1b[0m\x1b[2m=\x1b[0msection-1 "));
    }

    #[test]
    fn what_comes_from_outside_does_nothing_to_a_terminal() {
        for harmful in ["\x1b]0;x\x07", "\n", "\r", "\u{9b}2J", "\u{202e}", "\x7f", "\u{200b}"] {
            let (text, error) = (format!("a{harmful}b"), io::Error::other(format!("c{harmful}d")));
            let shown = logged(false, || {
                tracing::warn!(display = %text, debug = ?text, text, %error, "message {text}");
            });
            let line = shown.strip_suffix('\n').unwrap();
            assert!(!line.chars().any(crate::harmless::is_harmful), "{shown:?}");
            assert_eq!(line.matches("a\\").count(), 4, "{shown:?}");
        }
    }
}
