use super::*;
use crate::config::fixture::{config, large_table};
use Presence::{Answering, NeverAsked, Silent};

const STEP: u64 = History::STEP.as_secs();

fn history() -> History {
    History::new(&config().table)
}

/// A step of the usual length.
fn step(requests: u64) -> Step {
    Step { length: History::STEP, requests, flows: requests / 10, ..Step::default() }
}

fn after(steps: u64) -> Duration {
    Duration::from_secs(steps * STEP)
}

/// Notes a step with these states of the fixture's three nodes.
fn note(history: &mut History, steps: u64, requests: u64, presences: [Presence; 3]) {
    history.note(after(steps), &step(requests), presences.into_iter());
}

/// The last figures of a series.
fn last<const N: usize>(figures: &[Figures], series: Series) -> [f32; N] {
    *figures
        .iter()
        .map(|figures| figures[series as usize])
        .collect::<Vec<_>>()
        .last_chunk()
        .unwrap()
}

/// The last letters of the nodes of a net.
fn letters(history: &History, net: &str, minutes: usize) -> Vec<(u8, String)> {
    let nodes = history.view(Some(net)).nodes;
    let of_node = |strip: NodeStrip| {
        let all = strip.letters();
        assert_eq!(all.len(), 1440);
        all[1440 - minutes..].to_owned()
    };
    nodes.into_iter().map(|(node, strip)| (node, of_node(strip))).collect()
}

#[test]
fn rates_are_a_second_and_minutes_sum_up() {
    let mut history = history();
    for n in 1..=6 {
        let mut step = step(100 * n);
        let millis = if n == 6 { 90 } else { n };
        (0..100).for_each(|_| step.times.observe(Duration::from_millis(millis)));
        history.note(after(n), &step, [].into_iter());
    }
    let view = history.view(None);
    assert_eq!((view.hour.len(), view.day.len(), view.nodes.len()), (360, 1440, 0));
    assert_eq!(last(&view.hour, Series::Requests), [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
    assert_eq!(last(&view.hour, Series::MedianSeconds), [0.005, 0.09]);
    assert_eq!(last(&view.day, Series::Requests), [35.0]);
    assert_eq!(last(&view.day, Series::Flows), [60.0], "at its end");
    assert_eq!(last(&view.day, Series::MedianSeconds), [0.003]);
    assert_eq!(last(&view.day, Series::P99Seconds), [0.09]);
    let [before, _] = last(&view.day, Series::Requests);
    assert!(before.is_nan(), "nothing was known before the start");
    let [nobody] = last(&history_of_nobody().hour, Series::MedianSeconds);
    assert!(nobody.is_nan(), "a time without answers is not known");
}

fn history_of_nobody() -> HistoryView {
    let mut history = history();
    note(&mut history, 1, 0, [NeverAsked; 3]);
    history.view(None)
}

/// A tick that comes late is not a gap, and one that comes early makes no step of its own.
#[test]
fn ticks_are_not_exact() {
    let mut history = history();
    for (millis, requests) in [(10_004, 10), (20_900, 20), (29_400, 30), (40_001, 40)] {
        history.note(Duration::from_millis(millis), &step(requests), [].into_iter());
    }
    assert_eq!(last(&history.view(None).hour, Series::Requests), [1.0, 2.0, 3.0, 4.0]);
}

#[test]
fn while_the_machine_sleeps_there_is_a_gap() {
    let mut history = history();
    for n in 1..=12 {
        note(&mut history, n, 10, [Answering; 3]);
    }
    note(&mut history, 12 + 18, 70, [Answering, Silent, NeverAsked]);
    let view = history.view(None);
    let hour: [f32; 19] = last(&view.hour, Series::Requests);
    assert_eq!((hour[0], hour[18]), (1.0, 7.0));
    assert!(hour[1..18].iter().all(|figure| figure.is_nan()));
    assert_eq!(letters(&history, "section-1", 6), [(1, "-aa--a".into()), (33, "-aa--n".into())]);
    assert_eq!(letters(&history, "press", 6), [(7, "-aa--s".into())]);

    // A month later nothing of it is left.
    let month = 30 * History::STEPS_OF_DAY + 6;
    note(&mut history, month, 10, [Silent; 3]);
    let view = history.view(None);
    let known = |figures: &[Figures]| figures.iter().filter(|it| !it[0].is_nan()).count();
    assert_eq!((known(&view.hour), known(&view.day)), (1, 1));
    assert_eq!(letters(&history, "press", 3), [(7, "--s".into())]);
}

/// A rest is no gap: whoever looks during it, or after it, sees that nothing happened.
#[test]
fn while_the_relay_rests_its_figures_go_on() {
    let mut history = history();
    for n in 1..=6 {
        note(&mut history, n, 10, [Answering, Silent, NeverAsked]);
    }
    history.rest();
    history.catch_up(after(9) + Duration::from_secs(9));
    assert_eq!(last(&history.view(None).hour, Series::Requests), [1.0, 0.0, 0.0, 0.0]);
    history.end_rest(after(18) - Duration::from_secs(4));
    history.catch_up(after(30));
    note(&mut history, 19, 20, [Answering; 3]);
    let view = history.view(None);
    let hour: [f32; 14] = last(&view.hour, Series::Requests);
    assert_eq!((hour[0], hour[13]), (1.0, 2.0));
    assert_eq!(hour[1..13], [0.0; 12]);
    assert_eq!(last(&view.day, Series::Requests), [1.0, 0.0, 0.0]);
    assert_eq!(last(&view.day, Series::Flows), [1.0; 3]);
    assert_eq!(letters(&history, "section-1", 4), [(1, "-aaa".into()), (33, "-nnn".into())]);

    // A month later nothing else is left.
    history.rest();
    history.end_rest(after(30 * History::STEPS_OF_DAY));
    let view = history.view(None);
    let rests = |figures: &[Figures]| figures.iter().all(|it| it[Series::Requests as usize] == 0.0);
    assert!(rests(&view.hour) && rests(&view.day));
    assert_eq!(letters(&history, "press", 1440), [(7, "a".repeat(1440))]);
}

#[test]
fn a_minute_has_its_worst_state() {
    let mut history = history();
    for n in 1..=6 {
        let third = if n == 2 { Silent } else { Answering };
        note(&mut history, n, 0, [NeverAsked, Answering, third]);
    }
    assert_eq!(letters(&history, "section-1", 2), [(1, "-n".into()), (33, "-s".into())]);
    assert!(history.view(Some("nobody")).nodes.is_empty());
}

/// Nodes are known by name, whatever places they have. New ones were not running before.
#[test]
fn it_goes_on_over_a_reload() {
    let mut history = history();
    (1..=6).for_each(|n| note(&mut history, n, 60, [Answering, Silent, NeverAsked]));
    let table = config().table;
    let mut mappings = table.mappings().to_vec();
    mappings.reverse();
    mappings[0].node_address = 34;
    let reversed = Arc::new(Table::new(table.header, table.nets().to_vec(), mappings));
    history.follow(&reversed);
    (7..=12).for_each(|n| note(&mut history, n, 60, [Silent, Silent, Answering]));
    let mut of_section = letters(&history, "section-1", 3);
    of_section.sort();
    assert_eq!(of_section, [(1, "-aa".into()), (34, "--s".into())]);
    assert_eq!(letters(&history, "press", 3), [(7, "-ss".into())]);
    assert_eq!(last(&history.view(None).day, Series::Requests), [6.0, 6.0]);
}

/// The octets of all memory that a history holds.
fn octets(history: &History) -> usize {
    size_of_val(history)
        + size_of_val(&*history.hour.figures)
        + size_of_val(&*history.day.figures)
        + history.strips.capacity() * size_of::<Strip>()
        + history.states.capacity()
        + history.latest.capacity()
}

/// Documented in `docs/monitoring.md`.
#[test]
fn a_full_day_takes_no_more_memory_than_an_empty_one() {
    let table = large_table(8);
    let nodes = table.mappings().len();
    let mut history = History::new(&table);
    let before = (octets(&history), history.hour.figures.as_ptr(), history.strips.as_ptr());
    for n in 1..=2 * History::STEPS_OF_DAY {
        history.note(after(n), &step(n), std::iter::repeat_n(Answering, nodes));
    }
    let (full, hour, strips) =
        (octets(&history), history.hour.figures.as_ptr(), history.strips.as_ptr());
    assert_eq!(before, (full, hour, strips), "allocated once");
    assert_eq!(nodes, 1000);
    assert!((400_000..450_000).contains(&full), "{full} octets at 1,000 ports");
    let view = history.view(Some("section-7"));
    assert!(view.hour.iter().chain(&view.day).all(|figures| figures[0] > 0.0), "it is full");
    let [.., newest] = last::<2>(&view.hour, Series::Requests);
    assert_eq!(newest, 2.0 * History::STEPS_OF_DAY as f32 / 10.0);
    assert!(view.nodes.iter().all(|(_, strip)| strip.letters() == "a".repeat(1440)));
}
