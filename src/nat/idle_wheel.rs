//! A timing wheel: when to look at which flow, because it may have been idle for too long by then.
//!
//! Each flow is in the list of the half second in which it has to be looked at. A datagram does not
//! move its flow to another list. Only when a flow is looked at and was used meanwhile, it is filed
//! again for later. So each flow costs one or two looks in its time-out, and the flows that are due
//! are found without a search through the others.

use super::ids::FlowId;
use super::time::Nanos;

/// The number of lists. Each stands for a half second (2²⁹ ns); after the last, the first comes
/// again. A flow that has to be looked at even later is looked at in the last list, and filed
/// again.
const LISTS: u64 = 1024;

/// The list of flows that were looked at and are due later in the same half second.
const WAITING: u32 = LISTS as u32;

/// Flows, each of them in one list or in none.
#[derive(Debug)]
pub(super) struct Wheel {
    /// First the head of each list, then each flow. The lists are rings, so that a flow can be
    /// taken out without knowing its list.
    links: Vec<Link>,
    /// The half second whose list comes next.
    tick: u64,
}

/// Neighbours in a ring. A link that is alone is its own neighbour.
#[derive(Clone, Copy, Debug)]
struct Link {
    before: u32,
    after: u32,
}

impl Wheel {
    /// No flows, and memory for this many.
    pub(super) fn new(capacity: usize) -> Self {
        let mut links = Vec::with_capacity(WAITING as usize + 1 + capacity);
        links.extend((0..=WAITING).map(Link::alone));
        Self { links, tick: 0 }
    }

    /// Files a flow to be looked at when this time has come.
    pub(super) fn file(&mut self, id: FlowId, at: Nanos) {
        let tick = tick(at).clamp(self.tick, self.tick + LISTS - 1);
        self.put(id, head(tick));
    }

    /// As [`file`](Self::file), for a flow that [`next`](Self::next) has just returned.
    pub(super) fn put_back(&mut self, id: FlowId, at: Nanos) {
        if tick(at) <= self.tick { self.put(id, WAITING) } else { self.file(id, at) }
    }

    /// Takes a flow out, if it is in.
    pub(super) fn remove(&mut self, id: FlowId) {
        let place = place(id);
        let Some(&Link { before, after }) = self.links.get(place as usize) else { return };
        self.links[before as usize].after = after;
        self.links[after as usize].before = before;
        self.links[place as usize] = Link::alone(place);
    }

    /// Takes out a flow that may be due; none when there is no other flow to look at now. Until it
    /// returns none, it returns each flow once, or twice if a half second ends meanwhile.
    pub(super) fn next(&mut self, now: Nanos) -> Option<FlowId> {
        let end = tick(now);
        // One round visits every list.
        self.tick = self.tick.max(end.saturating_sub(LISTS));
        loop {
            let head = head(self.tick);
            let first = self.links[head as usize].after;
            if first != head {
                let id = FlowId(first - WAITING - 1);
                self.remove(id);
                return Some(id);
            }
            let waited = self.rename(WAITING, head);
            if self.tick >= end {
                return None;
            }
            if !waited {
                self.tick += 1;
            }
        }
    }

    fn put(&mut self, id: FlowId, head: u32) {
        self.remove(id);
        let place = place(id);
        let next = self.links.len() as u32;
        self.links.extend((next..=place).map(Link::alone));
        let before = self.links[head as usize].before;
        self.links[place as usize] = Link { before, after: head };
        self.links[before as usize].after = place;
        self.links[head as usize].before = place;
    }

    /// Moves all flows of one list to another, which is empty. True if there were any.
    fn rename(&mut self, from: u32, to: u32) -> bool {
        let Link { before, after } = self.links[from as usize];
        if after == from {
            return false;
        }
        self.links[to as usize] = Link { before, after };
        self.links[before as usize].after = to;
        self.links[after as usize].before = to;
        self.links[from as usize] = Link::alone(from);
        true
    }
}

impl Link {
    fn alone(place: u32) -> Self {
        Self { before: place, after: place }
    }
}

fn tick(at: Nanos) -> u64 {
    at >> 29
}

fn head(tick: u64) -> u32 {
    (tick % LISTS) as u32
}

/// The index of a flow in the links.
fn place(id: FlowId) -> u32 {
    id.0 + WAITING + 1
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    #[derive(Clone, Copy, Debug)]
    enum Step {
        File(u32, Nanos),
        Remove(u32),
        /// Time passes, and flows that are due are taken out, this many at a time.
        Look(Nanos, usize),
    }

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let times = || prop_oneof![0..1_000_000_000_u64, 0..900_000_000_000_u64];
        let step = prop_oneof![
            4 => (0..20_u32, times()).prop_map(|(id, in_so_long)| Step::File(id, in_so_long)),
            1 => (0..20_u32).prop_map(Step::Remove),
            3 => (times(), 1..8_usize).prop_map(|(pause, most)| Step::Look(pause, most)),
        ];
        prop::collection::vec(step, 0..80)
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..Default::default() })]
        /// The wheel agrees with a list of times.
        #[test]
        fn a_flow_is_found_when_it_is_due_and_not_before(steps in steps()) {
            let (mut wheel, mut times, mut now) = (Wheel::new(4), BTreeMap::new(), 1);
            for step in steps {
                match step {
                    Step::File(id, in_so_long) => {
                        wheel.file(FlowId(id), now + in_so_long);
                        times.insert(id, now + in_so_long);
                    }
                    Step::Remove(id) => {
                        wheel.remove(FlowId(id));
                        times.remove(&id);
                    }
                    Step::Look(pause, most) => {
                        now += pause;
                        let (begun, mut looks) = (now, 0);
                        while let Some(id) = wheel.next(now) {
                            let at = times[&id.0];
                            if at <= now {
                                times.remove(&id.0);
                            } else {
                                wheel.put_back(id, at);
                            }
                            looks += 1;
                            prop_assert!(looks <= 100, "each is looked at a few times at most");
                            if looks % most == 0 {
                                now += 1_000_000; // others have their turns meanwhile
                            }
                        }
                        let left = times.values().filter(|&&at| at <= begun).count();
                        prop_assert_eq!(left, 0, "{:?} at {}", times, begun);
                    }
                }
            }
            while wheel.next(u64::MAX).is_some_and(|id| times.remove(&id.0).is_some()) {}
            prop_assert!(times.is_empty(), "lost: {times:?}");
        }
    }
}
