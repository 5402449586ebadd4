//! A faster datapath beside the core: which flows it may carry, when it has to let go of them, and that
//! nobody can tell afterwards which way a datagram went.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::fixture::*;
use crate::nat::*;

const SECOND_PASSWORD: &[u8; 8] = b"another!";

/// Lends memory of its own, and notes what is taken back.
#[derive(Debug, Default)]
struct Memory {
    places: [SharedFlow; 4],
    taken_back: Mutex<Vec<u32>>,
}

impl Lender<SharedFlow> for Memory {
    fn get(&self, place: u32) -> &SharedFlow {
        &self.places[place as usize]
    }

    fn take_back(&self, place: u32) {
        self.taken_back.lock().unwrap().push(place);
    }
}

/// Carries every flow that it is offered.
#[derive(Default)]
struct Datapath {
    memory: Arc<Memory>,
    offers: u32,
    /// By place, the password of each flow that it carries.
    carried: BTreeMap<u32, [u8; 8]>,
}

impl Effects for Datapath {
    fn open_upstream(&mut self, _: &Table, id: UpstreamId, _: NetId, _: SocketKind) -> Option<u16> {
        Some(50_000 + id.0 as u16)
    }

    fn close_upstream(&mut self, _: UpstreamId) {}

    fn offload(&mut self, table: &Table, offer: &Offer<'_>) -> Option<Lent<SharedFlow>> {
        assert_eq!(offer.public_port, table.mapping(offer.mapping).public_port);
        let place = self.offers;
        self.offers += 1;
        self.carried.insert(place, *offer.password.octets());
        Some(Lent::new(Arc::clone(&self.memory) as Arc<dyn Lender<SharedFlow>>, place))
    }

    fn recall(&mut self, place: u32) {
        assert!(self.carried.remove(&place).is_some(), "recalled twice");
    }
}

struct World {
    worker: Worker<Datapath>,
    now: Instant,
    asked: Option<ToServer>,
}

impl World {
    fn new(net: Net) -> Self {
        let (rules, now) = (rules(net), Instant::now());
        let worker = Worker::new(&rules, now, 0, Datapath::default());
        Self { worker, now, asked: None }
    }

    /// A request that is sent. Time passes after it.
    fn ask(&mut self, password: &[u8; 8]) {
        let arrival = arrival(CLIENT.parse::<SocketAddr>().unwrap());
        let to = self.worker.request(self.now, &arrival, &mut request(password)).unwrap();
        self.worker.core.request_sent(self.now, arrival.mapping, to.asks, 20);
        self.asked = Some(to);
        self.pass(Duration::from_millis(10));
    }

    fn answer(&mut self) {
        let ToServer { via, server, .. } = self.asked.unwrap();
        let to = self.worker.response(self.now, via, server, &mut response(PASSWORD)).unwrap();
        self.worker.core.response_sent(to.mapping, 20);
    }

    fn pass(&mut self, time: Duration) {
        self.now += time;
        self.worker.expire(self.now);
    }

    fn carried(&self) -> usize {
        self.worker.effects.carried.len()
    }

    /// The memory of the flow that was offered last.
    fn shared(&self) -> &SharedFlow {
        &self.worker.effects.memory.places[self.worker.effects.offers as usize - 1]
    }

    /// The time as the core has it.
    fn nanos(&self, since: Instant) -> u64 {
        u64::try_from((self.now - since).as_nanos()).unwrap() + 1
    }

    fn reload(&mut self, net: Net) {
        let next = self.worker.succession(&rules(net), &Default::default());
        self.worker.reload(self.now, next);
        while self.worker.go_over(self.now).is_none() {}
    }

    fn the_flow(&self) -> FlowRecord {
        self.worker.core.flows(self.now).next().unwrap()
    }
}

fn rules(net: Net) -> Rules {
    Rules::new(table(vec![net], vec![node_4()]), LIMITS)
}

#[test]
fn a_flow_is_offered_when_its_client_asks_again() {
    let mut world = World::new(net());
    world.ask(PASSWORD);
    assert_eq!(world.carried(), 0);
    world.ask(PASSWORD);
    assert_eq!(world.carried(), 1);
    world.ask(PASSWORD);
    assert_eq!((world.carried(), world.worker.effects.offers), (1, 1));
    world.worker.core.shut_down(world.now, &mut world.worker.effects);
    assert_eq!(world.carried(), 0);
    assert_eq!(*world.worker.effects.memory.taken_back.lock().unwrap(), [0]);
}

#[test]
fn what_needs_judgement_for_each_datagram_is_not_offered() {
    let limited = RequestRate::new(1000);
    let exchanged = credential("service", PASSWORD, Some(SECOND_PASSWORD));
    let nets = [
        Net { max_requests: Some(limited), ..net() },
        Net { max_flow_requests: Some(limited), ..net() },
        Net { credentials: vec![exchanged], ..net() },
    ];
    for net in nets {
        let mut world = World::new(net);
        (0..3).for_each(|_| world.ask(PASSWORD));
        assert_eq!(world.worker.effects.offers, 0);
    }
}

/// Answers may have either password then.
#[test]
fn a_client_with_two_passwords_is_recalled() {
    let two =
        vec![credential("service", PASSWORD, None), credential("second", SECOND_PASSWORD, None)];
    let mut world = World::new(Net { credentials: two, ..net() });
    world.ask(PASSWORD);
    world.ask(PASSWORD);
    assert_eq!(world.worker.effects.carried[&0], *PASSWORD);
    world.shared().requests.store(5, Relaxed);
    world.ask(SECOND_PASSWORD);
    assert_eq!(world.carried(), 0);
    world.ask(SECOND_PASSWORD);
    assert_eq!(world.worker.effects.offers, 1, "it stays here");
    assert_eq!(world.the_flow().traffic.requests, 4 + 5, "nothing is forgotten");
}

#[test]
fn a_reload_recalls_what_it_changes_and_nothing_else() {
    let same = Net { max_flows: 50, ..net() };
    let changes: [(&str, Net); 3] = [
        ("a limit", Net { max_requests: Some(RequestRate::new(1000)), ..net() }),
        ("another name", Net { credentials: vec![credential("new", PASSWORD, None)], ..net() }),
        (
            "another password",
            Net { credentials: vec![credential("service", SECOND_PASSWORD, None)], ..net() },
        ),
    ];
    for (what, change) in changes {
        let mut world = World::new(net());
        world.ask(PASSWORD);
        world.ask(PASSWORD);
        world.reload(same.clone());
        assert_eq!(world.carried(), 1, "reload swaps nothing that need not be");
        world.reload(change);
        assert_eq!(world.carried(), 0, "{what}");
    }
    let mut world = World::new(Net { max_requests: Some(RequestRate::new(1000)), ..net() });
    world.ask(PASSWORD);
    world.ask(PASSWORD);
    world.reload(net());
    world.ask(PASSWORD);
    assert_eq!(world.carried(), 1, "it is offered once the limit is gone");
}

/// It is not idle, and what has passed counts.
#[test]
fn what_passes_there_is_seen_here() {
    let idle_timeout = Duration::from_secs(300);
    let mut world = World::new(Net { idle_timeout, ..net() });
    let start = world.now;
    world.ask(PASSWORD);
    world.ask(PASSWORD);
    world.pass(Duration::from_secs(200));
    let shared = world.shared();
    shared.last_used.store(world.nanos(start), Relaxed);
    for (figure, count) in [(&shared.requests, 7), (&shared.responses, 6), (&shared.octets, 400)] {
        figure.store(count, Relaxed);
    }
    let before = world.the_flow();
    assert_eq!(before.idle, Duration::ZERO);
    let FlowTraffic { requests, responses, octets } = before.traffic;
    let own = 2 * request(PASSWORD).len() as u64;
    assert_eq!((requests, responses, octets), (9, 6, own + 400));
    world.pass(Duration::from_secs(299));
    assert_eq!(world.worker.flows(world.now), 1);
    world.pass(Duration::from_secs(1));
    assert_eq!(world.worker.flows(world.now), 0, "and then it is idle");
    assert_eq!(world.carried(), 0);
}

/// A request that went the one way, and its answer the other one.
#[test]
fn response_times_are_those_of_both_ways_together() {
    let mut world = World::new(net());
    let start = world.now;
    world.ask(PASSWORD);
    world.ask(PASSWORD);
    let times = || world.worker.counters.node(MappingId(0)).response_times.sum_nanos();
    assert_eq!(times(), 0);
    let asked = world.shared().unanswered.load(Relaxed);
    assert_eq!(asked, world.nanos(start) - 20_000_000, "that of the first request is still due");
    world.answer();
    let times = world.worker.counters.node(MappingId(0)).response_times.sum_nanos();
    assert_eq!(times, 20_000_000);
    assert_eq!(world.shared().unanswered.load(Relaxed), 0);

    // The datapath passes a request; the answer comes here.
    world.shared().requests.fetch_add(1, Relaxed);
    world.shared().unanswered.store(world.nanos(start), Relaxed);
    world.pass(Duration::from_millis(3));
    assert!(world.worker.core.awaits_answers(world.now));
    world.answer();
    let times = world.worker.counters.node(MappingId(0)).response_times.sum_nanos() - times;
    assert_eq!(times, 3_000_000);
    world.answer();
    assert!(!world.worker.core.awaits_answers(world.now), "three asked, three answered");
}
