//! What views show of a frame, and what has to hold for all of them.

use std::cell::Cell;

use pnet_nat::profinet::Malformed;
use pnet_nat::profinet::view::{Show, Value, bits};

/// The octets that are read.
pub(super) struct Frame<'a> {
    pub octets: &'a [u8],
    has_fault: Cell<bool>,
}

impl<'a> Frame<'a> {
    pub(super) fn new(octets: &'a [u8]) -> Self {
        Self { octets, has_fault: Cell::new(false) }
    }

    /// Whether something of it is malformed.
    pub(super) fn has_fault(&self) -> bool {
        self.has_fault.get()
    }

    /// These octets are some of the frame's.
    #[track_caller]
    pub(super) fn has(&self, shown: &[u8]) {
        let (all, part) = (self.octets.as_ptr_range(), shown.as_ptr_range());
        assert!(shown.is_empty() || all.start <= part.start && part.end <= all.end);
    }

    /// What was read, or none where it is malformed. The place of an error is an octet of the frame, or
    /// the first one behind it.
    #[track_caller]
    pub(super) fn read<T>(&self, read: Result<T, Malformed>) -> Option<T> {
        if read.is_err() {
            self.has_fault.set(true);
        }
        self.attempt(read)
    }

    /// The same where the octets may well be something else.
    #[track_caller]
    pub(super) fn attempt<T>(&self, read: Result<T, Malformed>) -> Option<T> {
        match read {
            Ok(read) => Some(read),
            Err(Malformed { offset, what }) => {
                assert!(offset <= self.octets.len(), "{what} at octet {offset}");
                assert!(!what.is_empty());
                None
            }
        }
    }

    /// All parts of the frame. They end, and an error is the last of them.
    #[track_caller]
    pub(super) fn all<T>(&self, parts: impl Iterator<Item = Result<T, Malformed>>) -> Vec<T> {
        let parts: Vec<_> = parts.take(self.octets.len() + 2).collect();
        assert!(parts.len() <= self.octets.len() + 1, "parts without octets");
        let errors = parts.iter().position(Result::is_err);
        assert!(errors.is_none_or(|at| at + 1 == parts.len()), "parts behind an error");
        parts.into_iter().filter_map(|part| self.read(part)).collect()
    }

    /// Walks through all that a view shows. There is not more of it than the octets can hold.
    #[track_caller]
    pub(super) fn show(&self, show: &dyn Show) {
        let mut walk = Walk { frame: self, left: 100 + 16 * self.octets.len() };
        show.show(&mut |name, value| {
            assert!(!name.is_empty());
            walk.value(value);
        });
    }
}

struct Walk<'f> {
    frame: &'f Frame<'f>,
    /// How many more values there may be.
    left: usize,
}

impl Walk<'_> {
    fn value(&mut self, value: Value<'_>) {
        self.left = self.left.checked_sub(1).expect("more values than octets can hold");
        match value {
            Value::Nothing | Value::Number(_) => {}
            Value::Word(_, word) => assert!(word.is_none_or(|word| !word.is_empty())),
            Value::Bits(number, parts) => {
                for (name, lowest, count) in parts {
                    assert!(!name.is_empty() && bits(number, *lowest, *count) <= number);
                }
            }
            Value::Text(shown) | Value::Octets(shown) => self.frame.has(shown),
            Value::Display(text) => assert!(!text.to_string().is_empty()),
            Value::Fields(show) => show.show(&mut |_, value| self.value(value)),
            Value::List(each) => each.each(&mut |value| self.value(value)),
            Value::Fault(fault) => drop(self.frame.read(Err::<(), _>(fault))),
        }
    }
}
