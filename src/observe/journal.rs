//! What the relay remembers: the last events, and the figures of a day. The observer and the reload
//! write it, the admin server reads it. The workers do not know of it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

use crate::nat::Table;
use crate::observe::events::{Event, EventKind, Events};
use crate::observe::history::History;

/// The memory of a relay.
#[derive(Debug)]
pub struct Journal {
    events: Mutex<Events>,
    history: Mutex<History>,
}

impl Journal {
    /// An empty journal.
    pub fn new(table: &Arc<Table>) -> Self {
        Self { events: Mutex::default(), history: Mutex::new(History::new(table)) }
    }

    /// Notes an event that belongs to no net.
    pub fn note(&self, kind: EventKind, text: String) {
        let time = SystemTime::now();
        self.note_event(Event { number: 0, time, kind, net: None, node: None, text });
    }

    /// Notes an event, and gives it its number.
    pub(super) fn note_event(&self, event: Event) {
        lock(&self.events).note(event);
    }

    /// The events with a larger number, newest first.
    pub fn events_after(&self, number: u64) -> Vec<Arc<Event>> {
        lock(&self.events).after(number)
    }

    /// The figures of the last hour and day.
    pub fn history(&self) -> MutexGuard<'_, History> {
        lock(&self.history)
    }
}

/// Locks even after a panic: events and figures are only shown.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
