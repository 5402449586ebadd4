use std::net::SocketAddr;

use super::*;
use crate::config::Config;
use crate::config::fixture::{NODE_1, NODE_33, SECTION, config, large_table};
use crate::nat::{
    Direction, DropReason, Mapping, MappingId, NO_NODE, NetId, Table, ThrottleScope, Throttled,
    Writer,
};
use crate::observe::events::Event;
use crate::observe::history::Series;
use crate::pnet::wire::Header;

/// An observer that looks when the test says so.
struct Looks {
    observer: Observer,
    writer: Writer,
    seen: u64,
}

impl Looks {
    fn of(config: Config) -> Self {
        let observer = Observer::new(Router::idle(config, 1));
        let mut looks = Self { observer, writer: Writer::of_worker(), seen: 0 };
        assert_eq!(looks.new_events(), ["start: pnet-nat 0.1.0 relays"]);
        looks
    }

    /// Looks so many seconds after the start. Returns what the new events say, oldest first.
    async fn look(&mut self, seconds: u64) -> Vec<String> {
        let now = Duration::from_secs(seconds);
        self.observer.look(now, now).await;
        self.new_events()
    }

    /// Looks, and tells whether the observer may rest until a worker wakes up.
    async fn may_rest(&mut self, seconds: u64) -> bool {
        let now = Duration::from_secs(seconds);
        self.observer.look(now, now).await
    }

    fn new_events(&mut self) -> Vec<String> {
        let mut events = self.events();
        events.reverse();
        self.seen = events.last().map_or(self.seen, |event| event.number);
        let text = |event: &Arc<Event>| match event.text.split_once(':') {
            Some((start, _)) if event.kind == EventKind::Start => format!("start: {start}"),
            _ => format!("{}: {}", event.kind.label(), event.text),
        };
        events.iter().map(text).collect()
    }

    fn events(&self) -> Vec<Arc<Event>> {
        self.observer.router.journal().events_after(self.seen)
    }

    /// A client asks a node at this second, which answers or not.
    fn ask(&self, mapping: MappingId, second: u64, answers: bool) {
        let active = self.observer.router.active_config();
        let (node, nanos) = (active.counters[0].node(mapping), second * 1_000_000_000);
        node.last_request.set(&self.writer, nanos);
        node.direction(Direction::Request).forwarded.add(&self.writer, 1);
        if answers {
            node.last_response.set(&self.writer, nanos + 1);
            node.unanswered_since.set(&self.writer, 0);
            node.direction(Direction::Response).forwarded.add(&self.writer, 1);
            node.response_times.observe(&self.writer, Duration::from_millis(4));
        } else if node.unanswered_since.get() == 0 {
            node.unanswered_since.set(&self.writer, nanos);
        }
    }
}

const NOTHING: [&str; 0] = [];

#[tokio::test]
async fn a_node_that_falls_silent_and_answers_again_is_told_of_once_each() {
    let mut looks = Looks::of(config());
    looks.ask(NODE_1, 1, true);
    looks.ask(NODE_33, 1, true);
    assert_eq!(looks.look(5).await, NOTHING);
    for second in 6..20 {
        looks.ask(NODE_33, second, false);
    }
    assert_eq!(looks.look(10).await, NOTHING, "its answer may still come");
    looks.observer.look(Duration::from_secs(15), Duration::from_secs(15)).await;
    let silent = looks.events();
    assert_eq!((silent[0].net.as_deref(), silent[0].node), (Some("section-1"), Some(33)));
    let ago = SystemTime::now().duration_since(silent[0].time).unwrap();
    assert!((Duration::from_secs(9)..Duration::from_secs(60)).contains(&ago), "since second 6");
    assert_eq!(looks.new_events(), ["node_silent: node 33 of section-1 is silent"]);
    assert_eq!(looks.look(20).await, NOTHING);
    looks.ask(NODE_33, 71, true);
    let answers = ["node_answers: node 33 of section-1 answers again after 1m 9s"];
    assert_eq!(looks.look(75).await, answers);
    assert_eq!(looks.look(80).await, NOTHING);
}

#[tokio::test]
async fn a_power_cut_is_one_event() {
    let mut looks = Looks::of(Config { table: large_table(2), ..config() });
    for node in 0..250 {
        looks.ask(MappingId(node), 1, node == 4);
    }
    let silent = [
        "node_silent: 124 nodes (1-4, 6-125) of section-0 are silent",
        "node_silent: 125 nodes (1-125) of section-1 are silent",
    ];
    assert_eq!(looks.look(10).await, silent);
    for node in 0..3 {
        looks.ask(MappingId(node), 11, true);
    }
    assert_eq!(looks.look(15).await.len(), 3, "a few have an event each");
}

/// A PROFINET device has no node address that anybody could look for.
#[tokio::test]
async fn a_device_is_told_by_its_name() {
    let mut nets = config().table.nets()[1..].to_vec();
    nets[0].name = "drive-7".into();
    let device = Mapping { net: NetId(0), node_address: NO_NODE, ..config().table.mappings()[1] };
    let table = Arc::new(Table::new(Header::default(), nets, vec![device]));
    let mut looks = Looks::of(Config { table, ..config() });
    looks.ask(MappingId(0), 1, false);
    assert_eq!(looks.look(10).await, ["node_silent: drive-7 is silent"]);
    looks.ask(MappingId(0), 31, true);
    assert_eq!(looks.look(35).await, ["node_answers: drive-7 answers again after 34s"]);
}

/// A million forged sources that are all throttled make a few events, which say how many there were.
#[tokio::test]
async fn strangers_cannot_fill_the_events() {
    let mut looks = Looks::of(config());
    looks.ask(NODE_1, 1, false);
    let mut told = looks.look(10).await;
    let router = Arc::clone(&looks.observer.router);
    let table = router.active_config().config.table.clone();
    for n in 0..1_000_000_u32 {
        let sender = SocketAddr::from((n.to_be_bytes(), 4000));
        let scope = if n == 1 { ThrottleScope::Address } else { ThrottleScope::Sender };
        let throttled = Throttled { scope, sender, age: Duration::ZERO, refused: 1 };
        router.throttlings().note(&table, &throttled, NODE_33);
        if n % 50_000 == 0 {
            told.extend(looks.look(10 + u64::from(n) / 10_000).await);
        }
    }
    told.extend(looks.look(200).await);
    told.extend(looks.look(260).await);
    assert_eq!(told[0], "node_silent: node 1 of section-1 is silent");
    let words = "is refused after too many wrong passwords for node 33 of section-1";
    assert_eq!(told[1], format!("throttled: 0.0.0.0:4000 {words}"));
    assert_eq!(told[2], format!("throttled: 0.0.0.1 {words}"));
    let mut sum = 0;
    for event in &told[1..] {
        let more = event.split_once(" more senders").map(|(count, _)| count.rsplit(' ').next());
        sum += more.flatten().map_or(1, |count| count.parse::<u64>().unwrap());
    }
    assert_eq!(sum, 1_000_000, "none is forgotten");
    assert!(told.len() < 30, "{told:#?}");
    let all = looks.observer.router.journal().events_after(0);
    assert_eq!(all.len(), told.len() + 1, "all are kept");
}

/// It sleeps while the workers do, and not before all is told.
#[tokio::test]
async fn it_rests_when_nothing_is_to_come() {
    let mut looks = Looks::of(config());
    assert!(!looks.may_rest(5).await, "a worker may have been awake");
    assert!(looks.may_rest(10).await);
    assert!(!looks.may_rest(15).await, "a step has begun");
    looks.observer.router.activity().note();
    assert!(!looks.may_rest(20).await, "a worker was awake");
    assert!(looks.may_rest(30).await);

    looks.ask(NODE_33, 38, false);
    assert!(!looks.may_rest(40).await, "its answer may still come");
    assert!(looks.may_rest(50).await, "it is silent");
    assert_eq!(looks.new_events(), ["node_silent: node 33 of section-1 is silent"]);

    let mut filtered = config();
    filtered.datapath.prefilter = Prefilter::Always;
    let mut looks = Looks::of(filtered);
    assert!(!looks.may_rest(10).await && !looks.may_rest(20).await, "the kernel drops by itself");
}

#[tokio::test]
async fn the_history_grows_by_a_step_every_10_s() {
    let mut looks = Looks::of(config());
    for n in 1..=12 {
        (0..10).for_each(|_| looks.ask(NODE_1, 5 * n, true));
        let active = looks.observer.router.active_config();
        let node = active.counters[0].node(NODE_33).direction(Direction::Request);
        node.dropped(DropReason::PasswordWrong).add(&looks.writer, 5);
        active.counters[0]
            .stray
            .direction(Direction::Response)
            .dropped(DropReason::UnknownFlow)
            .add(&looks.writer, 1);
        active.counters[0].net(SECTION).flows.set(&looks.writer, 7);
        looks.look(5 * n).await;
    }
    let view = looks.observer.router.journal().history().view(Some("section-1"));
    let known = view.hour.iter().filter(|figures| !figures[0].is_nan());
    assert_eq!(known.count(), 6);
    let newest = view.hour.last().unwrap();
    for (series, expected) in [
        (Series::Requests, 2.0),
        (Series::Answers, 2.0),
        (Series::Dropped, 1.2),
        (Series::WrongPasswords, 1.0),
        (Series::Flows, 7.0),
        (Series::AnsweringNodes, 1.0),
        (Series::MedianSeconds, 0.004),
        (Series::P99Seconds, 0.004),
    ] {
        assert_eq!(newest[series as usize], expected, "{series:?}");
        assert_eq!(view.day.last().unwrap()[series as usize], expected, "{series:?}");
    }
    let letters: Vec<_> = view.nodes.iter().map(|(node, strip)| (*node, strip.letters())).collect();
    assert!(letters[0].1.ends_with("-a") && letters[1].1.ends_with("-n"), "{letters:?}");
}
