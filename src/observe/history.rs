//! The relay's figures of the last hour, every 10 s, and of the last day, every minute; and the
//! state of each node in every minute of the day.
//!
//! All memory is taken when a table comes into force: 65 KB, and 362 octets for each node. A step
//! has a number, counted from the relay's start by a clock that goes on while the machine sleeps. A
//! step in which nobody looked is a gap, but for a [rest](History::rest): then nothing happened.

use std::array;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use strum::VariantArray;

use crate::nat::{MappingId, NetId, Table};
use crate::observe::totals::{Presence, ResponseTotals};

/// The figures that are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, VariantArray)]
pub enum Series {
    /// Requests passed on, a second.
    Requests,
    /// Answers passed on, a second.
    Answers,
    /// Datagrams dropped by the relay or by the kernel, a second.
    Dropped,
    /// Wrong passwords, a second.
    WrongPasswords,
    /// Open flows at the end of the step.
    Flows,
    /// Answering nodes at the end of the step.
    AnsweringNodes,
    /// The median of the response times in the step, in seconds.
    MedianSeconds,
    /// Their 99th percentile.
    P99Seconds,
}

impl Series {
    /// The name in the API.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Requests => "requests",
            Self::Answers => "answers",
            Self::Dropped => "dropped",
            Self::WrongPasswords => "wrong_passwords",
            Self::Flows => "flows",
            Self::AnsweringNodes => "answering_nodes",
            Self::MedianSeconds => "median_seconds",
            Self::P99Seconds => "p99_seconds",
        }
    }
}

/// One figure for each [`Series`]; NaN where it is not known.
pub type Figures = [f32; Series::VARIANTS.len()];

const UNKNOWN: Figures = [f32::NAN; Series::VARIANTS.len()];

/// What happened in a step.
#[derive(Clone, Debug, Default)]
pub struct Step {
    /// The length of the step, which is never exactly [`History::STEP`].
    pub length: Duration,
    /// Requests passed on.
    pub requests: u64,
    /// Answers passed on.
    pub answers: u64,
    /// Datagrams dropped by the relay or by the kernel.
    pub dropped: u64,
    /// Wrong passwords.
    pub wrong_passwords: u64,
    /// Open flows at the end.
    pub flows: u64,
    /// Answering nodes at the end.
    pub answering_nodes: u64,
    /// How long the answers took.
    pub times: ResponseTotals,
}

impl Step {
    fn add(&mut self, next: &Self) {
        self.length += next.length;
        self.requests += next.requests;
        self.answers += next.answers;
        self.dropped += next.dropped;
        self.wrong_passwords += next.wrong_passwords;
        (self.flows, self.answering_nodes) = (next.flows, next.answering_nodes);
        self.times.add(&next.times);
    }

    /// All unknown when the step has no length.
    fn figures(&self) -> Figures {
        let seconds = self.length.as_secs_f64();
        if seconds <= 0.0 {
            return UNKNOWN;
        }
        let time = |share| self.times.quantile(share).map_or(f64::NAN, |time| time.as_secs_f64());
        let figure = |series| match series {
            Series::Requests => self.requests as f64 / seconds,
            Series::Answers => self.answers as f64 / seconds,
            Series::Dropped => self.dropped as f64 / seconds,
            Series::WrongPasswords => self.wrong_passwords as f64 / seconds,
            Series::Flows => self.flows as f64,
            Series::AnsweringNodes => self.answering_nodes as f64,
            Series::MedianSeconds => time(0.5),
            Series::P99Seconds => time(0.99),
        };
        array::from_fn(|series| figure(Series::VARIANTS[series]) as f32)
    }
}

/// The last figures of one length of step.
#[derive(Debug)]
struct Ring {
    figures: Box<[Figures]>,
    /// Where the next ones go.
    next: usize,
}

impl Ring {
    fn new(steps: usize) -> Self {
        Self { figures: vec![UNKNOWN; steps].into_boxed_slice(), next: 0 }
    }

    fn push(&mut self, figures: Figures) {
        self.figures[self.next] = figures;
        self.next = (self.next + 1) % self.figures.len();
    }

    /// Oldest first.
    fn to_vec(&self) -> Vec<Figures> {
        let (newer, older) = self.figures.split_at(self.next);
        [older, newer].concat()
    }
}

/// The states of a node in the minutes of a day, two bits each.
type Strip = [u8; History::MINUTES / 4];

/// The state of a node in a minute, worst last.
const NOT_RUNNING: u8 = 0;
const NEVER_ASKED: u8 = 1;
const ANSWERING: u8 = 2;
const SILENT: u8 = 3;

/// The letters of the states in the API.
const LETTERS: [char; 4] = ['-', 'n', 'a', 's'];

/// The figures of the last hour and day.
#[derive(Debug)]
pub struct History {
    hour: Ring,
    day: Ring,
    /// For each mapping of the table.
    strips: Vec<Strip>,
    /// For each mapping, its worst state in the minute that has begun.
    states: Vec<u8>,
    /// For each mapping, its state at the end of the last step.
    latest: Vec<u8>,
    /// The sum of the minute that has begun.
    minute: Step,
    /// What each step of a rest is like.
    idle: Step,
    rests: bool,
    /// The number of steps that are over.
    steps: u64,
    table: Arc<Table>,
}

/// A copy of a history, to be shown.
#[derive(Clone, Debug)]
pub struct HistoryView {
    /// Each [`STEP`](History::STEP) of the last hour, oldest first.
    pub hour: Vec<Figures>,
    /// Each [`MINUTE`](History::MINUTE) of the last day, oldest first.
    pub day: Vec<Figures>,
    /// The nodes of the net that was asked for, by node address.
    pub nodes: Vec<(u8, NodeStrip)>,
}

/// The states of a node in the minutes of a day.
#[derive(Clone, Debug)]
pub struct NodeStrip {
    strip: Strip,
    oldest: usize,
}

impl NodeStrip {
    /// One letter a minute, oldest first: `a` answering, `s` silent, `n` never asked, `-` not
    /// running.
    pub fn letters(&self) -> String {
        let minutes = (self.oldest..History::MINUTES).chain(0..self.oldest);
        minutes.map(|minute| LETTERS[usize::from(state(&self.strip, minute))]).collect()
    }
}

fn state(strip: &Strip, minute: usize) -> u8 {
    strip[minute / 4] >> (2 * (minute % 4)) & 3
}

/// The number of the step that ends at about this time after the start.
fn number_at(at: Duration) -> u64 {
    (at.as_secs_f64() / History::STEP.as_secs_f64()).round() as u64
}

impl History {
    /// The length of a step.
    pub const STEP: Duration = Duration::from_secs(10);
    /// The length of a step of the day.
    pub const MINUTE: Duration = Duration::from_secs(60);
    /// Steps of an hour.
    const STEPS: usize = 360;
    const STEPS_OF_MINUTE: u64 = 6;
    /// Minutes of a day.
    const MINUTES: usize = 24 * 60;
    const STEPS_OF_DAY: u64 = Self::STEPS_OF_MINUTE * Self::MINUTES as u64;

    /// An empty history.
    pub fn new(table: &Arc<Table>) -> Self {
        let nodes = table.mappings().len();
        Self {
            hour: Ring::new(Self::STEPS),
            day: Ring::new(Self::MINUTES),
            strips: vec![[0; Self::MINUTES / 4]; nodes],
            states: vec![NOT_RUNNING; nodes],
            latest: vec![NOT_RUNNING; nodes],
            minute: Step::default(),
            idle: Step::default(),
            rests: false,
            steps: 0,
            table: Arc::clone(table),
        }
    }

    /// Goes over to another table. A node is found by its net and node address.
    pub fn follow(&mut self, table: &Arc<Table>) {
        if Arc::ptr_eq(table, &self.table) {
            return;
        }
        let known: HashMap<_, _> = self.table.node_names().zip(self.table.mapping_ids()).collect();
        let old = |name| known.get(&name).map(|id: &MappingId| id.0 as usize);
        let strip = |name| old(name).map_or([0; Self::MINUTES / 4], |id| self.strips[id]);
        let strips = table.node_names().map(strip).collect();
        let of = |states: &[u8]| {
            table.node_names().map(|name| old(name).map_or(NOT_RUNNING, |id| states[id])).collect()
        };
        (self.states, self.latest) = (of(&self.states), of(&self.latest));
        self.strips = strips;
        self.table = Arc::clone(table);
    }

    /// Notes a step that ends at this time after the start, and the state of each node of the table
    /// at its end. The steps in between are gaps.
    pub fn note(&mut self, at: Duration, step: &Step, presences: impl Iterator<Item = Presence>) {
        let number = number_at(at);
        if number.saturating_sub(self.steps) > Self::STEPS_OF_DAY {
            // All that is known is older than a day.
            self.steps = (number - Self::STEPS_OF_DAY).next_multiple_of(Self::STEPS_OF_MINUTE);
            *self = Self { steps: self.steps, ..Self::new(&self.table) };
        }
        while self.steps + 1 < number {
            self.end_step(UNKNOWN);
        }
        for (latest, presence) in self.latest.iter_mut().zip(presences) {
            *latest = match presence {
                Presence::NeverAsked => NEVER_ASKED,
                Presence::Answering => ANSWERING,
                Presence::Silent => SILENT,
            };
        }
        self.idle = Step {
            length: Self::STEP,
            flows: step.flows,
            answering_nodes: step.answering_nodes,
            ..Step::default()
        };
        self.add(step);
        if self.steps < number {
            self.end_step(step.figures());
        }
    }

    /// From the end of the last step on, nobody looks and nothing happens.
    pub fn rest(&mut self) {
        self.rests = true;
    }

    /// The rest ends at this time after the start.
    pub fn end_rest(&mut self, at: Duration) {
        if self.rests {
            self.idle_until(number_at(at));
            self.rests = false;
        }
    }

    /// Notes the steps of a rest that are over at this time after the start.
    pub fn catch_up(&mut self, at: Duration) {
        if self.rests {
            self.idle_until(at.as_secs() / Self::STEP.as_secs());
        }
    }

    fn idle_until(&mut self, number: u64) {
        // Nothing is left of what is older than a day.
        let kept = Self::STEPS_OF_DAY + Self::STEPS_OF_MINUTE;
        if number.saturating_sub(self.steps) > kept {
            self.steps = (number - kept).next_multiple_of(Self::STEPS_OF_MINUTE);
        }
        let idle = self.idle.clone();
        while self.steps < number {
            self.add(&idle);
            self.end_step(idle.figures());
        }
    }

    fn add(&mut self, step: &Step) {
        for (worst, latest) in self.states.iter_mut().zip(&self.latest) {
            *worst = (*worst).max(*latest);
        }
        self.minute.add(step);
    }

    fn end_step(&mut self, figures: Figures) {
        self.steps += 1;
        self.hour.push(figures);
        if !self.steps.is_multiple_of(Self::STEPS_OF_MINUTE) {
            return;
        }
        let (minute, shift) = (self.day.next, 2 * (self.day.next % 4));
        for (strip, state) in self.strips.iter_mut().zip(&mut self.states) {
            let octet = &mut strip[minute / 4];
            *octet = *octet & !(3 << shift) | std::mem::replace(state, NOT_RUNNING) << shift;
        }
        self.day.push(std::mem::take(&mut self.minute).figures());
    }

    /// All figures, and the states of the nodes of one net.
    pub fn view(&self, net: Option<&str>) -> HistoryView {
        let is_it = |id: &NetId| net.is_some_and(|name| self.table.net(*id).name == name);
        let mappings = self.table.net_ids().filter(is_it).flat_map(|id| self.table.mappings_of(id));
        let node = |id: MappingId| {
            let strip = NodeStrip { strip: self.strips[id.0 as usize], oldest: self.day.next };
            (self.table.mapping(id).node_address, strip)
        };
        HistoryView {
            hour: self.hour.to_vec(),
            day: self.day.to_vec(),
            nodes: mappings.map(node).collect(),
        }
    }
}

#[cfg(test)]
mod tests;
