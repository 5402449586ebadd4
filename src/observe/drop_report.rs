//! The report of dropped datagrams. It stands in place of one log line for each datagram.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::time::{self, MissedTickBehavior};
use tracing::warn;

use crate::datapath::{ActiveConfig, Router};
use crate::nat::{Direction, DropReason, LastSender, MappingId, NetId, SourceSketch, Table};
use crate::observe::totals::NodeTotals;

/// Reports dropped datagrams. Each net and drop reason gets a line at the end of the first window
/// with drops. While the drops go on, it gets another line every ten minutes, with the sum since
/// the line before. The audit log uses the same windows.
#[derive(Debug)]
pub struct DropReport {
    router: Arc<Router>,
    /// Datagrams dropped up to the end of the last window, by mapping and reason.
    reported: Vec<[u64; DropReason::COUNT]>,
    /// The table that these mappings belong to.
    table: Arc<Table>,
    window_began: Instant,
    /// The drops that go on, by net and reason. The log has told of each of them before.
    going_on: HashMap<(String, usize), Told>,
}

/// The drops since the last line.
#[derive(Debug, Default)]
struct Told {
    count: u64,
    time: Duration,
}

impl DropReport {
    /// The length of a window.
    pub const WINDOW: Duration = Duration::from_secs(10);

    /// How often drops that go on get a line. After a pause of this length, they count as new.
    pub const INTERVAL: Duration = Duration::from_secs(600);

    /// Makes the report and starts its first window.
    pub fn new(router: Arc<Router>) -> Self {
        let active = router.active_config();
        let table = Arc::clone(&active.config.table);
        let reported = table.mapping_ids().map(|mapping| dropped(&active, mapping)).collect();
        Self { router, reported, table, window_began: Instant::now(), going_on: HashMap::new() }
    }

    /// Reports at the end of each window, for ever.
    pub async fn run(&mut self) -> ! {
        let mut window = time::interval(Self::WINDOW);
        window.set_missed_tick_behavior(MissedTickBehavior::Delay);
        window.tick().await;
        loop {
            window.tick().await;
            self.report(Self::WINDOW, false);
        }
    }

    /// Reports the window that has begun. It is the last one.
    pub fn report_rest(&mut self) {
        self.report(self.window_began.elapsed(), true);
    }

    /// Ends the window and writes the lines that are due. For the `last` window, it writes all
    /// lines.
    fn report(&mut self, window: Duration, last: bool) {
        self.window_began = Instant::now();
        let active = self.router.active_config();
        self.router.audit().end_window(active.config.log.audit_lines, window);
        let table = &active.config.table;
        if !Arc::ptr_eq(table, &self.table) {
            self.reported = carried_over(&self.reported, &self.table, table);
            self.table = Arc::clone(table);
        }
        let mut counts = vec![[0; DropReason::COUNT]; table.nets().len()];
        for (mapping, reported) in table.mapping_ids().zip(&mut self.reported) {
            let dropped = dropped(&active, mapping);
            let before = std::mem::replace(reported, dropped);
            let counts = &mut counts[usize::from(table.mapping(mapping).net.0)];
            for ((count, now), before) in counts.iter_mut().zip(dropped).zip(before) {
                // A smaller count means that the node was away and its counters began again.
                *count += now.checked_sub(before).unwrap_or(now);
            }
        }
        for (net, counts) in table.net_ids().zip(counts) {
            for reason in reasons() {
                let key = (table.net(net).name.clone(), reason as usize);
                let count = counts[reason as usize];
                if count == 0 && !self.going_on.contains_key(&key) {
                    continue;
                }
                let first = !self.going_on.contains_key(&key);
                let told = self.going_on.entry(key.clone()).or_default();
                (told.count, told.time) = (told.count + count, told.time + window);
                if !(first || last || told.time >= Self::INTERVAL) {
                    continue;
                }
                let Told { count, time } = std::mem::take(told);
                if count == 0 {
                    self.going_on.remove(&key);
                } else {
                    line(&active, net, reason, count, time);
                }
            }
        }
        let table = &self.table;
        self.going_on.retain(|(net, _), _| table.nets().iter().any(|it| it.name == *net));
    }
}

fn line(active: &ActiveConfig, net: NetId, reason: DropReason, count: u64, window: Duration) {
    let sketches = active.counters.iter().map(|worker| worker.net(net).sources(reason));
    let estimate = SourceSketch::take_estimate(sketches);
    // The sketch only estimates. The true number lies between one source and `count`.
    let sources = u64::from(estimate).clamp(1, count);
    let senders = active.counters.iter().map(|worker| worker.net(net).last_sender(reason));
    let last_sender = LastSender::latest(senders);
    let from = match (sources, last_sender) {
        (1, Some(sender)) => sender.to_string(),
        (1, None) => "1 source".to_owned(),
        _ if estimate == SourceSketch::MOST => format!("{sources} sources or more"),
        _ => format!("{sources} sources"),
    };
    let last = last_sender.filter(|_| sources > 1);
    let last = last.map(|sender| format!(", the last one {sender}")).unwrap_or_default();
    let net = &active.config.table.net(net).name;
    let (what, seconds) = (reason.counted(count), window.as_secs_f64().ceil());
    warn!(
        %net, reason = %reason.label(), count, sources,
        last_sender = last_sender.map(tracing::field::display),
        "{what} from {from} in {seconds} s{last}"
    );
}

/// Every drop reason once.
fn reasons() -> impl Iterator<Item = DropReason> {
    let [request, response] = Direction::ALL.map(Direction::drop_reasons);
    let of_both = |reason: &DropReason| Direction::Request.drop_reasons().any(|it| it == *reason);
    request.chain(response.filter(move |reason| !of_both(reason)))
}

/// The datagrams dropped so far on the way to and from a node, by reason.
fn dropped(active: &ActiveConfig, mapping: MappingId) -> [u64; DropReason::COUNT] {
    let totals = NodeTotals::of_node(&active.counters, mapping);
    let mut dropped = [0; DropReason::COUNT];
    for direction in Direction::ALL {
        for reason in direction.drop_reasons() {
            dropped[reason as usize] += totals.direction(direction).dropped(reason);
        }
    }
    dropped
}

/// Carries figures from the mappings of one table over to those of another. A node is found by its
/// net and node address.
fn carried_over<T: Copy + Default>(figures: &[T], old: &Table, new: &Table) -> Vec<T> {
    fn nodes(table: &Table) -> impl Iterator<Item = (&str, u8)> {
        let mappings = table.mappings().iter();
        mappings.map(|mapping| (table.net(mapping.net).name.as_str(), mapping.node_address))
    }
    let figures: HashMap<_, _> = nodes(old).zip(figures).collect();
    nodes(new).map(|node| figures.get(&node).copied().copied().unwrap_or_default()).collect()
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use serde_json::{Value, json};

    use super::*;
    use crate::config::fixture::{NODE_1, NODE_33, SECTION, config};
    use crate::logging::tests::logged;
    use crate::nat::Writer;

    /// Writes one report and returns its lines.
    fn report(drops: &mut DropReport) -> Vec<Value> {
        logged(|| drops.report(DropReport::WINDOW, false))
    }

    fn drop_some(router: &Router, reason: DropReason, sources: impl Iterator<Item = u64>) {
        let (active, writer) = (router.active_config(), Writer::of_worker());
        for ((source, worker), now) in sources.zip(active.counters.iter().cycle()).zip(1..) {
            let sender = Ipv4Addr::from([198, 51, 100, source as u8]).into();
            let node = worker.node(if source % 2 == 0 { NODE_1 } else { NODE_33 });
            node.direction(Direction::Request).dropped(reason).add(&writer, 1);
            worker.net(SECTION).note_source(&writer, reason, now, sender, source);
        }
    }

    #[test]
    fn a_window_says_how_many_of_what_from_how_many() {
        let router = Router::idle(config(), 2);
        drop_some(&router, DropReason::BadHeader, 0..100);
        let mut drops = DropReport::new(router.clone());
        assert_eq!(report(&mut drops), Vec::<Value>::new(), "what was before is not reported");

        drop_some(&router, DropReason::PasswordWrong, (0..37).map(|n| n % 5));
        drop_some(&router, DropReason::TooShort, std::iter::once(1000));
        assert_eq!(
            report(&mut drops),
            [
                json!({
                    "level": "WARN", "net": "section-1", "reason": "too_short", "count": 1,
                    "sources": 1, "last_sender": "198.51.100.232",
                    "message": "1 datagram too short from 198.51.100.232 in 10 s",
                }),
                json!({
                    "level": "WARN", "net": "section-1", "reason": "password_wrong", "count": 37,
                    "sources": 5, "last_sender": "198.51.100.1",
                    "message":
                        "37 wrong passwords from 5 sources in 10 s, the last one 198.51.100.1",
                }),
            ]
        );
        assert_eq!(report(&mut drops), Vec::<Value>::new(), "a quiet window says nothing");
    }

    #[test]
    fn what_goes_on_is_told_of_every_ten_minutes() {
        let router = Router::idle(config(), 1);
        let mut drops = DropReport::new(router.clone());
        let mut lines = Vec::new();
        for _ in 0..14 * 6 {
            drop_some(&router, DropReason::PasswordWrong, std::iter::once(7));
            lines.extend(report(&mut drops));
        }
        lines.extend(logged(|| drops.report(Duration::ZERO, true)));
        let counts: Vec<_> = lines.iter().map(|line| line["count"].as_u64().unwrap()).collect();
        assert_eq!(counts, [1, 60, 23], "{lines:?}");
        assert_eq!(lines[1]["message"], "60 wrong passwords from 198.51.100.7 in 600 s");

        for _ in 0..60 {
            assert_eq!(report(&mut drops), Vec::<Value>::new(), "a pause");
        }
        drop_some(&router, DropReason::PasswordWrong, std::iter::once(7));
        assert_eq!(report(&mut drops)[0]["count"], 1, "it is new again");
    }

    /// In the meantime, nets and nodes may have come, gone or changed places.
    #[test]
    fn a_window_goes_on_over_a_reload() {
        let router = Router::idle(config(), 1);
        drop_some(&router, DropReason::BadHeader, 0..100);
        let mut drops = DropReport::new(router.clone());
        drop_some(&router, DropReason::BadHeader, 0..5);
        let turned = Router::idle(turned(), 1);
        let carried = (NODE_1.0, 50 + 3);
        let of_turned = turned.active_config();
        for (mapping, count) in [carried, (NODE_33.0, 7)] {
            let node = of_turned.counters[0].node(MappingId(mapping));
            node.direction(Direction::Request)
                .dropped(DropReason::BadHeader)
                .add(&Writer::of_worker(), count);
        }
        drops.router = turned;
        let lines = report(&mut drops);
        assert_eq!(lines.len(), 1);
        assert_eq!(lines[0]["count"], 3 + 7, "{}", lines[0]);
    }

    /// Node 33 is gone. A node that was not there before has its place.
    fn turned() -> crate::config::Config {
        let mut turned = config();
        let mut mappings = turned.table.mappings().to_vec();
        mappings[NODE_33.0 as usize].node_address = 34;
        let nets = turned.table.nets().to_vec();
        turned.table = Arc::new(crate::nat::Table::new(turned.table.header, nets, mappings));
        turned
    }

    #[test]
    fn a_flood_says_that_there_may_be_more() {
        let router = Router::idle(config(), 2);
        let mut drops = DropReport::new(router.clone());
        drop_some(&router, DropReason::BadHeader, 0..20_000);
        let lines = report(&mut drops);
        assert_eq!(lines.len(), 1);
        let expected =
            "20000 wrong headers from 7098 sources or more in 10 s, the last one 198.51.100.31";
        assert_eq!(lines[0]["message"], expected);
    }

    #[test]
    fn every_reason_can_be_reported() {
        assert_eq!(reasons().count(), DropReason::COUNT);
    }
}
