//! Which nodes are silent, which nets are flooded and who is throttled; an event for each change.

use std::collections::HashMap;
use std::time::{Duration, SystemTime};

use crate::config::runs;
use crate::datapath::{ActiveConfig, Router, Throttling};
use crate::logging::audit;
use crate::nat::{NO_NODE, NetId, ThrottleScope};
use crate::observe::Journal;
use crate::observe::events::{Event, EventKind};
use crate::observe::totals::{Contact, Presence};

/// When so many nodes of a net change at once, or so many nets, each gets an event of its own. More
/// share one, so that a power cut does not push out everything else.
const FEW: usize = 4;
/// So many throttled senders get an event of their own in a minute. The others share one.
const THROTTLED_A_MINUTE: usize = 6;
const MINUTE: Duration = Duration::from_secs(60);

/// What was seen at the last look.
#[derive(Debug, Default)]
pub(super) struct Watch {
    /// By net and node address: since when the node is silent, counted from the relay's start.
    silent: HashMap<(String, u8), Duration>,
    floods: HashMap<String, Flood>,
    throttled: Throttled,
    /// Whether a node has not answered, and is not silent yet.
    waits: bool,
}

/// A flood of a net.
#[derive(Clone, Copy, Debug)]
struct Flood {
    /// When it was seen first, counted from the relay's start.
    since: Duration,
    /// What the kernel had refused before.
    refused: u64,
}

/// The throttled senders of a minute.
#[derive(Debug, Default)]
struct Throttled {
    minute_began: Duration,
    told: usize,
    more: u64,
}

/// The time of a look: counted from the relay's start, and by the clock.
#[derive(Clone, Copy, Debug)]
struct Now {
    since_start: Duration,
    time: SystemTime,
}

impl Watch {
    /// Looks, and notes an event for each change. `since_start` is the time since the relay's start.
    /// Returns whether time alone will bring no event.
    pub(super) fn look(
        &mut self,
        router: &Router,
        active: &ActiveConfig,
        since_start: Duration,
        time: SystemTime,
    ) -> bool {
        let (journal, now) = (router.journal(), Now { since_start, time });
        self.nodes(journal, active, now);
        self.floods(journal, active, now);
        let (told, more) = router.throttlings().take();
        self.throttled.note(journal, told, more, now);
        !self.waits && self.floods.is_empty() && self.throttled.more == 0
    }

    fn nodes(&mut self, journal: &Journal, active: &ActiveConfig, now: Now) {
        let table = &active.config.table;
        let mut silent = HashMap::new();
        self.waits = false;
        for net in table.net_ids() {
            let name = &table.net(net).name;
            let (mut fell_silent, mut answering) = (Vec::new(), Vec::new());
            for mapping in table.mappings_of(net) {
                let node = table.mapping(mapping).node_address;
                let contact = Contact::of_node(&active.counters, mapping);
                let key = (name.clone(), node);
                let before = self.silent.remove(&key);
                let waiting_since = contact.waiting_since();
                if contact.presence(now.since_start) == Presence::Silent {
                    let since = waiting_since.unwrap_or(now.since_start);
                    if before.is_none() {
                        fell_silent.push((node, since));
                    }
                    silent.insert(key, before.unwrap_or(since));
                    continue;
                }
                self.waits |= waiting_since.is_some();
                if let Some(since) = before {
                    answering.push((node, since));
                }
            }
            let event = |kind, time, nodes: &[(u8, Duration)], what: &str| {
                let (node, who) = subject(name, nodes);
                let text = format!("{who} {what}");
                Event { number: 0, time, kind, net: Some(name.clone()), node, text }
            };
            for nodes in shared(&fell_silent) {
                let since = nodes.iter().map(|(_, since)| *since).min().unwrap_or_default();
                let time = now.time - now.since_start.saturating_sub(since);
                let what = if nodes.len() > 1 { "are silent" } else { "is silent" };
                journal.note_event(event(EventKind::NodeSilent, time, nodes, what));
            }
            for nodes in shared(&answering) {
                let since = nodes.iter().map(|(_, since)| *since).min().unwrap_or_default();
                let verb = if nodes.len() > 1 { "answer" } else { "answers" };
                let silence = whole_seconds(now.since_start.saturating_sub(since));
                let what = format!("{verb} again after {silence}");
                journal.note_event(event(EventKind::NodeAnswers, now.time, nodes, &what));
            }
        }
        self.silent = silent;
    }

    fn floods(&mut self, journal: &Journal, active: &ActiveConfig, now: Now) {
        let table = &active.config.table;
        let (mut began, mut flooded) = (Vec::new(), HashMap::new());
        for (net, _) in table.net_ids().zip(active.floods()).filter(|(_, flooded)| *flooded) {
            let name = table.net(net).name.clone();
            let refused = active.kernel_drops_seen(net).prefilter;
            let before = self.floods.remove(&name);
            if before.is_none() {
                began.push((name.clone(), "the kernel refuses it".to_owned()));
            }
            flooded.insert(name, before.unwrap_or(Flood { since: now.since_start, refused }));
        }
        let refused_now = |name: &str| {
            let is_it = |id: &NetId| table.net(*id).name == name;
            let id = table.net_ids().find(is_it);
            id.map_or(0, |id| active.kernel_drops_seen(id).prefilter)
        };
        let mut ended: Vec<_> = std::mem::replace(&mut self.floods, flooded)
            .into_iter()
            .map(|(name, flood)| {
                let time = whole_seconds(now.since_start.saturating_sub(flood.since));
                let refused = refused_now(&name).saturating_sub(flood.refused);
                let what = format!("the kernel refused {refused} datagrams in {time}");
                (name, what)
            })
            .collect();
        ended.sort();
        for (kind, nets, what) in [
            (EventKind::FloodBegan, began, "flood"),
            (EventKind::FloodEnded, ended, "end of the flood"),
        ] {
            for nets in shared(&nets) {
                let (net, text) = match nets {
                    [(net, how)] => (Some(net.clone()), format!("{what} of {net}: {how}")),
                    nets => {
                        let names: Vec<_> = nets.iter().map(|(net, _)| net.as_str()).collect();
                        (None, format!("{what} of {} nets: {}", nets.len(), names.join(", ")))
                    }
                };
                journal.note_event(Event {
                    number: 0,
                    time: now.time,
                    kind,
                    net,
                    node: None,
                    text,
                });
            }
        }
    }
}

impl Throttled {
    fn note(&mut self, journal: &Journal, told: Vec<Throttling>, more: u64, now: Now) {
        if now.since_start >= self.minute_began + MINUTE {
            if self.more > 0 {
                let text = format!("{} more senders are refused, as those before", self.more);
                journal.note(EventKind::Throttled, text);
            }
            *self = Self { minute_began: now.since_start, ..Self::default() };
        }
        self.more += more;
        for Throttling { throttled, net, node } in told {
            if self.told == THROTTLED_A_MINUTE {
                self.more += 1;
                continue;
            }
            self.told += 1;
            let sender = match throttled.scope {
                ThrottleScope::Sender => throttled.sender.to_string(),
                ThrottleScope::Address => audit::address(&throttled),
            };
            let text = format!(
                "{sender} is refused after too many wrong passwords for node {node} of {net}"
            );
            let (kind, time) = (EventKind::Throttled, now.time);
            let (net, node) = (Some(net), Some(node));
            journal.note_event(Event { number: 0, time, kind, net, node, text });
        }
    }
}

/// One by one while they are few, else all at once.
fn shared<T>(all: &[T]) -> impl Iterator<Item = &[T]> {
    all.chunks(if all.len() > FEW { all.len() } else { 1 })
}

/// The node, if there is only one, and "node 3 of section-1" or "5 nodes (1-4, 33) of section-1". A
/// PROFINET device is a net by itself.
fn subject(net: &str, nodes: &[(u8, Duration)]) -> (Option<u8>, String) {
    match nodes {
        [(NO_NODE, _)] => (Some(NO_NODE), net.to_owned()),
        [(node, _)] => (Some(*node), format!("node {node} of {net}")),
        nodes => {
            let mut addresses: Vec<_> = nodes.iter().map(|(node, _)| u16::from(*node)).collect();
            addresses.sort_unstable();
            (None, format!("{} nodes ({}) of {net}", nodes.len(), runs(&addresses)))
        }
    }
}

fn whole_seconds(time: Duration) -> humantime::FormattedDuration {
    humantime::format_duration(Duration::from_secs(time.as_secs()))
}
