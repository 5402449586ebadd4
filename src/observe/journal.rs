//! What the relay remembers: the last events, and the figures of a day. The observer and the reload
//! write it, the admin server reads it. The workers do not know of it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use nix::time::{ClockId, clock_gettime};

use crate::nat::Table;
use crate::observe::events::{Event, EventKind, Events};
use crate::observe::history::History;

/// The memory of a relay.
#[derive(Debug)]
pub struct Journal {
    events: Mutex<Events>,
    history: Mutex<History>,
    began: Duration,
}

impl Journal {
    /// An empty journal.
    pub fn new(table: &Arc<Table>) -> Self {
        let history = Mutex::new(History::new(table));
        Self { events: Mutex::default(), history, began: since_boot() }
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
        let mut history = lock(&self.history);
        history.catch_up(self.age());
        history
    }

    /// The time since the relay's start, by the clock of the history, which goes on while the machine sleeps.
    pub(super) fn age(&self) -> Duration {
        since_boot().saturating_sub(self.began)
    }
}

fn since_boot() -> Duration {
    // Every kernel that the relay runs on has this clock.
    clock_gettime(ClockId::CLOCK_BOOTTIME).map(Duration::from).unwrap_or_default()
}

/// Locks even after a panic: events and figures are only shown.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
