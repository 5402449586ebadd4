//! What the simulation prints.

use crate::churn::{HOUR, RELAYS, TIME, Why};
use crate::{CLIENTS, Outcome, WAYS, World};

/// The mean and the largest of some values.
#[derive(Default)]
pub(crate) struct Figures {
    count: u32,
    sum: f64,
    largest: f64,
}

impl Figures {
    pub(crate) fn add(&mut self, value: f64) {
        self.count += 1;
        self.sum += value;
        self.largest = self.largest.max(value);
    }

    fn mean(&self) -> f64 {
        self.sum / f64::from(self.count.max(1))
    }
}

/// Three tables. docs/scale.md has them.
pub(crate) fn print(world: &World, all: &[(&str, Outcome)]) {
    let count = |why| world.changes.iter().filter(|change| change.why == why).count();
    println!(
        "{CLIENTS} clients, {RELAYS} relays, {} hours: {} die, {} are drained, {} come back\n",
        TIME / HOUR,
        count(Why::Died),
        count(Why::Drained),
        count(Why::Back)
    );
    let head = |title: &str, columns: &[&str]| {
        print!("{title:<38}");
        columns.iter().for_each(|column| print!("{column:>20}"));
        println!();
    };
    let row = |name: &str, cells: &[String]| {
        print!("{name:<38}");
        cells.iter().for_each(|cell| print!("{cell:>20}"));
        println!();
    };
    head("clients that move: mean, most", &["a relay goes", "comes back", "by the timer"]);
    for (name, outcome) in all {
        let share = |moved: &Figures| match moved.count {
            0 => "-".to_owned(),
            _ => format!("{:.2} %, {:.2} %", 100.0 * moved.mean(), 100.0 * moved.largest),
        };
        row(name, &outcome.moved.each_ref().map(share));
    }
    head("\nmean, most", &["largest load", "relays unused", "flows a client", "flows at a relay"]);
    for (name, outcome) in all {
        let Outcome { load, unused, flows, flows_at_relay, .. } = outcome;
        let cell = |figures: &Figures, digits| {
            format!("{:.digits$}, {:.digits$}", figures.mean(), figures.largest)
        };
        let cells = [cell(load, 2), cell(unused, 0), cell(flows, 2), cell(flows_at_relay, 0)];
        row(name, &cells);
    }
    head("\nrequests lost: mean, most", &WAYS.map(|way| way.name));
    for (name, outcome) in all {
        let cell = |lost: &Figures| format!("{:.0}, {:.0}", lost.mean(), lost.largest);
        row(name, &outcome.lost.each_ref().map(cell));
    }
}
