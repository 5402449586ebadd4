//! The log: events on stderr, one a line; and what bounds those that others cause: the audit log and
//! warnings.
//!
//! The relay goes on whatever happens to stderr. Lines wait until it can be written to; when too many
//! wait, further ones are lost, and [`lines_lost`] counts them.

pub(crate) mod audit;
mod faults;
mod json;
mod queue;
mod text;
pub(crate) mod warnings;

use std::borrow::Cow;
use std::error::Error;
use std::fmt::{self, Debug, Display, Formatter};
use std::io::{self, IsTerminal};
use std::panic::{self, PanicHookInfo};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use anstream::{AutoStream, ColorChoice};
use tracing::{Level, Metadata};
use tracing_subscriber::fmt::MakeWriter;

use crate::harmless::harmless_lines;
use crate::thread::ThreadError;

pub use faults::complain_of_faults;
pub(crate) use faults::log_faults;
use json::Json;
use queue::{LOG, Line, Pen};

/// How long the end of the process waits for lines to be written.
const LAST_LINES: Duration = Duration::from_secs(2);

/// How events are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum LogFormat {
    /// Text on a terminal, else JSON.
    #[default]
    Auto,
    /// Lines for people to read.
    Text,
    /// One JSON object a line.
    Json,
}

/// Which events are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum LogLevel {
    /// Failures.
    Error,
    /// Failures, and what somebody should look at.
    Warn,
    /// All of that, and the audit log.
    Info,
}

/// Whether [`complain`] writes JSON events instead of text.
static COMPLAINS_IN_JSON: AtomicBool = AtomicBool::new(false);

/// Starts logging to stderr, for the whole process and only once. Times are in UTC, as in RFC 3339.
/// The thread that logs a line also writes it. In a `service`, lines wait for the thread that
/// [`in_background`] starts, and complaints are JSON wherever events are.
pub fn init(format: LogFormat, level: LogLevel, service: bool) {
    let terminal = io::stderr().is_terminal();
    let json = match format {
        LogFormat::Auto => !terminal,
        LogFormat::Text => false,
        LogFormat::Json => true,
    };
    COMPLAINS_IN_JSON.store(json && (service || format == LogFormat::Json), Relaxed);
    if service {
        LOG.wait_for_a_thread();
        panic::set_hook(Box::new(tell_panic));
    }
    let level = match level {
        LogLevel::Error => Level::ERROR,
        LogLevel::Warn => Level::WARN,
        LogLevel::Info => Level::INFO,
    };
    let events = tracing_subscriber::fmt()
        .with_max_level(level)
        .log_internal_errors(false)
        .with_writer(Pens);
    if json {
        events.event_format(Json).init();
    } else {
        let colour = AutoStream::choice(&io::stderr()) != ColorChoice::Never;
        events.fmt_fields(text::fields()).with_target(false).with_ansi(colour).init();
    }
}

/// From now on, a thread of its own writes the lines, so that a stderr that nobody reads blocks no
/// other thread. The new thread has the privileges of the calling one.
pub fn in_background() -> Result<(), ThreadError> {
    LOG.start_thread()
}

/// Waits until all lines are written, for two seconds at most.
pub fn flush() {
    LOG.flush(LAST_LINES);
}

/// How many lines were lost so far, because stderr failed or was too slow.
pub fn lines_lost() -> u64 {
    LOG.lost()
}

/// Tells the user why a command fails.
pub fn complain(message: impl Display) {
    let message = message.to_string();
    if COMPLAINS_IN_JSON.load(Relaxed) {
        tracing::error!(error = message.trim_start_matches("pnet-nat: ").trim_end(), "failed");
    } else {
        LOG.push(Line::of(harmless_lines(&message) + "\n"));
    }
}

/// A list as the value of a field: an array in JSON, and the same array in text.
pub(crate) fn list<T: ToString>(items: impl IntoIterator<Item = T>) -> Box<dyn Error> {
    Box::new(List(items.into_iter().map(|item| item.to_string()).collect()))
}

/// A list in a field of an event. `tracing` has no fields for lists, but it hands on errors with their
/// type, so a list travels as an error.
struct List(Vec<String>);

impl Error for List {}

impl Debug for List {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        Display::fmt(self, f)
    }
}

impl Display for List {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(&serde_json::to_string(&self.0).map_err(|_| fmt::Error)?)
    }
}

/// Writes a panic as one line of the log, the last one.
fn tell_panic(panic: &PanicHookInfo<'_>) {
    let thread = thread::current();
    let thread = thread.name().unwrap_or("unnamed");
    let payload = panic.payload();
    let why = payload.downcast_ref::<&str>().map(|why| Cow::Borrowed(*why));
    let why =
        why.or_else(|| payload.downcast_ref::<String>().map(|why| Cow::Borrowed(why.as_str())));
    let place = panic.location().map(tracing::field::display);
    tracing::error!(thread, place, why = why.as_deref(), "panicked");
    flush();
}

/// Makes a [`Pen`] for each event.
struct Pens;

impl<'a> MakeWriter<'a> for Pens {
    type Writer = Pen;

    fn make_writer(&'a self) -> Pen {
        Pen { is_report: false }
    }

    fn make_writer_for(&'a self, event: &Metadata<'_>) -> Pen {
        Pen { is_report: event.target() == queue::LOST }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::sync::{Arc, Mutex};

    use serde_json::{Value, json};
    use tracing::Subscriber;
    use tracing::level_filters::LevelFilter;
    use tracing_subscriber::fmt::SubscriberBuilder;
    use tracing_subscriber::fmt::format::{DefaultFields, Format};

    use super::*;

    type Events<W> = SubscriberBuilder<DefaultFields, Format, LevelFilter, W>;

    /// What `log` writes to the subscriber that `build` makes.
    pub(super) fn written<S>(
        build: impl FnOnce(Events<Box<dyn Fn() -> Written + Send + Sync>>) -> S,
        log: impl FnOnce(),
    ) -> String
    where
        S: Subscriber + Send + Sync + 'static,
    {
        let written = Arc::new(Mutex::new(Vec::new()));
        let writer = written.clone();
        let writer = Box::new(move || Written(writer.clone())) as Box<dyn Fn() -> _ + Send + Sync>;
        let events = build(tracing_subscriber::fmt().with_writer(writer));
        tracing::subscriber::with_default(events, log);
        String::from_utf8(written.lock().unwrap().clone()).unwrap()
    }

    /// What `log` logs, as JSON without its times.
    pub(crate) fn logged(log: impl FnOnce()) -> Vec<Value> {
        let line = |line| {
            let mut line: Value = serde_json::from_str(line).unwrap();
            let time = line.as_object_mut().unwrap().remove("timestamp").unwrap();
            let time = time.as_str().unwrap();
            assert!(time.starts_with("20") && time.ends_with('Z') && time.len() == 27, "{time}");
            line.as_object_mut().unwrap().remove("target").unwrap();
            line
        };
        written(|events| events.event_format(Json).finish(), log).lines().map(line).collect()
    }

    pub(super) struct Written(Arc<Mutex<Vec<u8>>>);

    impl io::Write for Written {
        fn write(&mut self, octets: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().write(octets)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn every_kind_of_field_is_what_it_is_in_json() {
        let none: Option<u64> = None;
        let lines = logged(|| {
            tracing::warn!(
                text = "a \"b\"\n\u{1b}[1m",
                shown = %"[\"no list\"]",
                debug = ?Some(1),
                number = 7_u64,
                negative = -7_i64,
                float = 0.5,
                truth = true,
                none,
                addresses = list(["192.0.2.1", "2001:db8::1"]),
                nothing = list([0; 0]),
                error = %io::Error::other("so"),
                "what {}", "happened"
            );
        });
        assert_eq!(
            lines,
            [json!({
                "level": "WARN", "message": "what happened", "text": "a \"b\"\n\u{1b}[1m",
                "shown": "[\"no list\"]", "debug": "Some(1)", "number": 7, "negative": -7,
                "float": 0.5, "truth": true, "addresses": ["192.0.2.1", "2001:db8::1"],
                "nothing": [], "error": "so",
            })]
        );
    }
}
