//! The drops of one net and reason: who has lines of its own, and when a line is due.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::mem;
use std::net::IpAddr;
use std::time::Duration;

use super::DropReport;
use super::line::{Line, Who};
use super::senders::Sender;

/// How many senders of one net and reason have lines of their own at once.
const NAMED: usize = 8;

/// The drops of one net and reason.
#[derive(Debug, Default)]
pub(super) struct Group {
    /// Senders with lines of their own, and the nodes of what is untold.
    named: BTreeMap<IpAddr, (Untold, BTreeSet<u16>)>,
    /// All others; none: they sent nothing lately.
    others: Option<Untold>,
    /// Drops of named senders in the last window that the count of all did not have yet.
    ahead: u64,
}

/// The end of a window.
#[derive(Debug)]
pub(super) struct Window {
    /// How long it was.
    pub(super) time: Duration,
    /// Whether all that is untold is due.
    pub(super) is_last: bool,
    /// How many more senders of all groups may have lines of their own.
    pub(super) places: usize,
}

/// Drops that the log has not told of.
#[derive(Debug, Default)]
struct Untold {
    count: u64,
    time: Duration,
    /// Whether there was a line before.
    is_known: bool,
}

/// What a window brings.
enum Due {
    Nothing,
    /// A line with this count and time.
    Line(u64, Duration),
    /// Nothing was dropped for so long that it is over.
    Over,
}

impl Group {
    /// The number of senders with lines of their own.
    pub(super) fn named(&self) -> usize {
        self.named.len()
    }

    pub(super) fn has_others(&self) -> bool {
        self.others.is_some()
    }

    /// Whether nothing goes on.
    pub(super) fn is_over(&self) -> bool {
        self.named.is_empty() && self.others.is_none()
    }

    /// Adds the drops of a window, in which all senders together sent `count`, and returns the lines
    /// that are due.
    pub(super) fn end_window(
        &mut self,
        count: u64,
        senders: &BTreeMap<IpAddr, Sender>,
        window: &mut Window,
    ) -> Vec<Line> {
        self.name(senders, window);
        let (mut lines, mut of_named) = (Vec::new(), 0);
        self.named.retain(|address, (untold, nodes)| {
            let sender = senders.get(address);
            let count = sender.map_or(0, |sender| sender.count);
            nodes.extend(sender.into_iter().flat_map(|sender| &sender.nodes));
            of_named += count;
            match untold.add(count, window) {
                Due::Line(count, time) => {
                    let nodes = mem::take(nodes).into_iter().collect();
                    lines.push(Line { who: Who::One(*address, nodes), count, time });
                    true
                }
                Due::Nothing => true,
                Due::Over => false,
            }
        });
        let of_others = (count + self.ahead).saturating_sub(of_named);
        self.ahead = of_named.saturating_sub(count);
        if of_others > 0 || self.others.is_some() {
            match self.others.get_or_insert_default().add(of_others, window) {
                Due::Line(count, time) => {
                    lines.push(Line { who: self.others(senders), count, time });
                }
                Due::Nothing => {}
                Due::Over => self.others = None,
            }
        }
        lines
    }

    /// Chooses the senders that have lines of their own from now on. Where there is no room for all,
    /// it is for those that sent most, and for none that sent once.
    fn name(&mut self, senders: &BTreeMap<IpAddr, Sender>, window: &mut Window) {
        let is_new = |(address, _): &(&IpAddr, &Sender)| !self.named.contains_key(*address);
        let mut new: Vec<_> = senders.iter().filter(is_new).collect();
        let room = NAMED.saturating_sub(self.named.len()).min(window.places);
        if new.len() > room {
            new.retain(|(_, sender)| sender.count > 1);
            new.sort_by_key(|(_, sender)| Reverse(sender.count));
            new.truncate(room);
        }
        window.places -= new.len();
        self.named.extend(new.into_iter().map(|(address, _)| (*address, Default::default())));
    }

    fn others(&self, senders: &BTreeMap<IpAddr, Sender>) -> Who {
        let others = senders.iter().filter(|(address, _)| !self.named.contains_key(address));
        let newest = others.max_by_key(|(_, sender)| sender.last).map(|(address, _)| *address);
        Who::Others { named: self.named.keys().copied().collect(), newest }
    }
}

impl Untold {
    fn add(&mut self, count: u64, window: &Window) -> Due {
        self.count += count;
        self.time += window.time;
        if self.is_known && !window.is_last && self.time < DropReport::INTERVAL {
            return Due::Nothing;
        }
        let Self { count, time, .. } =
            mem::replace(self, Self { is_known: true, ..Self::default() });
        if count > 0 { Due::Line(count, time) } else { Due::Over }
    }
}
