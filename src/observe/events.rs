//! What happened: the last events of each kind, in memory of fixed size.
//!
//! Each kind has places of its own, so that no number of events of one kind pushes out those of
//! another. Where a kind has no place left, the node or net with the most events of this kind loses
//! its oldest one. So a node that comes and goes all night does not push out the others.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::SystemTime;

use strum::VariantArray;

/// The kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, VariantArray)]
pub enum EventKind {
    /// The relay began to relay.
    Start,
    /// A node answers nobody any more.
    NodeSilent,
    /// A node that was silent answers.
    NodeAnswers,
    /// A configuration came into force.
    Reload,
    /// A configuration did not come into force, or not all of it.
    ReloadFailed,
    /// A sender is refused for a while, after too many wrong passwords.
    Throttled,
    /// The kernel refuses a flood.
    FloodBegan,
    /// The flood is over.
    FloodEnded,
}

impl EventKind {
    /// The name of this kind in the API.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::NodeSilent => "node_silent",
            Self::NodeAnswers => "node_answers",
            Self::Reload => "reload",
            Self::ReloadFailed => "reload_failed",
            Self::Throttled => "throttled",
            Self::FloodBegan => "flood_began",
            Self::FloodEnded => "flood_ended",
        }
    }

    /// How many events of this kind are kept.
    const fn places(self) -> usize {
        match self {
            Self::Start => 1,
            Self::NodeSilent | Self::NodeAnswers => 256,
            Self::Throttled => 128,
            Self::Reload | Self::ReloadFailed | Self::FloodBegan | Self::FloodEnded => 64,
        }
    }
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Event {
    /// Counts the events since the start, from 1.
    pub number: u64,
    /// When it happened.
    pub time: SystemTime,
    /// What kind of event it is.
    pub kind: EventKind,
    /// The net it happened to. `None`: several nets, or none.
    pub net: Option<String>,
    /// The node address of the node it happened to. `None`: several nodes, or none.
    pub node: Option<u8>,
    /// What happened, in one line.
    pub text: String,
}

/// The last events of each kind.
#[derive(Debug)]
pub struct Events {
    /// Oldest first.
    of_kind: [VecDeque<Arc<Event>>; EventKind::VARIANTS.len()],
    last_number: u64,
}

impl Default for Events {
    fn default() -> Self {
        // One place more, for the event that comes before another one goes.
        let ring = |kind: usize| VecDeque::with_capacity(EventKind::VARIANTS[kind].places() + 1);
        Self { of_kind: std::array::from_fn(ring), last_number: 0 }
    }
}

impl Events {
    /// The longest text of an event, in octets.
    pub const MOST_TEXT: usize = 400;

    /// Notes an event. Its number is given here, and a text that is too long is cut.
    pub fn note(&mut self, mut event: Event) {
        self.last_number += 1;
        event.number = self.last_number;
        if event.text.len() > Self::MOST_TEXT {
            let is_boundary = |end: &usize| event.text.is_char_boundary(*end);
            let end = (0..=Self::MOST_TEXT - 3).rev().find(is_boundary).unwrap_or(0);
            event.text.truncate(end);
            event.text.push('…');
        }
        let kind = event.kind;
        let events = &mut self.of_kind[kind as usize];
        events.push_back(Arc::new(event));
        if events.len() > kind.places() {
            make_room(events);
        }
    }

    /// The events with a larger number, newest first.
    pub fn after(&self, number: u64) -> Vec<Arc<Event>> {
        let later = self.of_kind.iter().flatten().filter(|event| event.number > number);
        let mut later: Vec<_> = later.cloned().collect();
        later.sort_unstable_by_key(|event| std::cmp::Reverse(event.number));
        later
    }
}

/// Removes the oldest event of the node or net that has the most.
fn make_room(events: &mut VecDeque<Arc<Event>>) {
    let mut counts: HashMap<_, usize> = HashMap::new();
    for event in &*events {
        *counts.entry((&event.net, event.node)).or_default() += 1;
    }
    let most = counts.values().copied().max().unwrap_or(0);
    let has_most = |event: &Arc<Event>| counts[&(&event.net, event.node)] == most;
    let oldest = events.iter().position(has_most).unwrap_or(0);
    events.remove(oldest);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(kind: EventKind, net: &str, node: u8) -> Event {
        Event {
            number: 0,
            time: SystemTime::UNIX_EPOCH,
            kind,
            net: Some(net.to_owned()),
            node: Some(node),
            text: format!("node {node} of {net}"),
        }
    }

    #[test]
    fn newest_first_and_only_those_after_a_number() {
        let mut events = Events::default();
        for node in 1..=3 {
            events.note(event(EventKind::NodeSilent, "section-1", node));
            events.note(event(EventKind::NodeAnswers, "section-1", node));
        }
        let numbers =
            |after| -> Vec<_> { events.after(after).iter().map(|it| it.number).collect() };
        assert_eq!(numbers(0), [6, 5, 4, 3, 2, 1]);
        assert_eq!(numbers(4), [6, 5]);
        assert_eq!(numbers(6), [0; 0]);
    }

    #[test]
    fn many_events_take_no_more_memory_and_push_out_nothing_of_another_kind() {
        let mut events = Events::default();
        events.note(event(EventKind::NodeSilent, "section-1", 3));
        events.note(event(EventKind::ReloadFailed, "section-1", 3));
        let capacity =
            |events: &Events| -> usize { events.of_kind.iter().map(VecDeque::capacity).sum() };
        let before = capacity(&events);
        for n in 0..10_000_u32 {
            let mut throttled = event(EventKind::Throttled, "section-1", (n % 125) as u8);
            throttled.text = "x".repeat(1000);
            events.note(throttled);
        }
        let kept = events.after(0);
        assert_eq!(kept.len(), 2 + EventKind::Throttled.places());
        assert_eq!(kept.last().unwrap().number, 1);
        assert!(kept.iter().all(|event| event.text.len() <= Events::MOST_TEXT));
        assert_eq!(capacity(&events), before);
    }

    #[test]
    fn a_node_that_comes_and_goes_does_not_push_out_the_others() {
        let mut events = Events::default();
        events.note(event(EventKind::NodeSilent, "section-1", 33));
        for _ in 0..1000 {
            events.note(event(EventKind::NodeSilent, "section-1", 4));
        }
        let kept = events.after(0);
        assert_eq!(kept.last().unwrap().node, Some(33));
        assert_eq!(kept[0].number, 1001);
    }

    #[test]
    fn a_long_text_is_cut_between_two_characters() {
        let mut events = Events::default();
        let mut long = event(EventKind::Reload, "section-1", 1);
        long.text = "ä".repeat(300);
        events.note(long);
        let text = &events.after(0)[0].text;
        assert!(text.len() <= Events::MOST_TEXT && text.ends_with("ä…"), "{text}");
    }
}
