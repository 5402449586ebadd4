//! Simulates a router that spreads a million clients over a thousand relays by ECMP, while relays die, are
//! drained and come back. It tells how many clients each change moves, how even the load is, how many flows
//! clients leave behind, and how many requests are lost. There are no sockets, and each run prints the same.
//!
//! Run it with `cargo bench --bench ecmp`. docs/scale.md has the result.

mod churn;
mod report;
mod spread;

use std::collections::VecDeque;
use std::ops::Range;

use churn::{Change, MINUTE, RELAYS, Random, SECOND, Why, mix};
use report::Figures;
use spread::{Modulo, Resilient, Spread, Threshold};

const CLIENTS: usize = 1_000_000;
/// Clients come from few addresses: each a company behind its own address translation.
const CLIENTS_AN_ADDRESS: u64 = 100;
/// Each client asks one node once in this time, at its own moment, and gives a request up after it.
const PERIOD: u64 = SECOND;
/// From the request's arrival at the relay to the answer's: a slow node.
const ANSWER: u64 = 50;
/// The relay's default: for so long a flow stays open that its client has left.
const IDLE_TIMEOUT: u64 = 5 * MINUTE;
/// Flows are counted after each 30th change, for it takes longer than all else.
const COUNT_EVERY: usize = 30;

/// How a relay goes: for how long after that it takes requests, and passes answers on, and when the
/// route is gone.
const WAYS: [Way; 4] = [
    // The last packet of BFD is up to one of three intervals of 100 ms old when the host dies.
    Way { name: "dies, BFD", why: Why::Died, takes: 0, answers: 0, noticed: 200..300 },
    // pnet-nat-route looks every half second, and waits for half a second.
    Way { name: "hangs, check", why: Why::Died, takes: 0, answers: 0, noticed: 500..1_000 },
    // From SIGTERM on a relay is not ready, which the next look finds. It goes on for `pre_drain` of
    // deploy/bgp, and then waits for answers for `drain`.
    Way { name: "drained", why: Why::Drained, takes: 5_000, answers: 10_000, noticed: 0..500 },
    Way { name: "no pre_drain", why: Why::Drained, takes: 0, answers: 5_000, noticed: 0..500 },
];

struct Way {
    name: &'static str,
    why: Why,
    takes: u64,
    answers: u64,
    noticed: Range<u64>,
}

impl Way {
    /// The requests to a relay that goes now, until the route is gone, that it does not take or not answer.
    fn lost(&self, now: u64, route_gone: u64, phases: &[u64]) -> usize {
        let (takes_until, answers_until) = (now + self.takes, now + self.answers);
        let is_lost = |&sent: &u64| sent >= takes_until || sent + ANSWER > answers_until;
        // A request that is older than a period is answered, or given up.
        let first = now.saturating_sub(PERIOD);
        let of_client = |&phase: &u64| {
            let sent = (first / PERIOD * PERIOD + phase..route_gone).step_by(PERIOD as usize);
            sent.filter(|&sent| sent > first).filter(is_lost).count()
        };
        phases.iter().map(of_client).sum()
    }
}

fn main() {
    check_three_relays();
    let random = &mut Random(1);
    // A client's address and port, hashed with the router's secret.
    let secret = random.next();
    let hash = |key: u64| (mix(secret ^ key) >> 33) as u32;
    let mut clients: Vec<_> = (0..CLIENTS as u64)
        .map(|client| hash((client / CLIENTS_AN_ADDRESS) << 16 | (client % CLIENTS_AN_ADDRESS)))
        .collect();
    clients.sort_unstable(); // neighbours go the same ways, so this machine's caches and guesses are right
    let phases: Vec<_> = clients.iter().map(|_| random.below(PERIOD)).collect();
    let world = World { clients, phases, changes: churn::changes(random) };

    let mut all = vec![
        ("hash-threshold", world.run(&mut Threshold::default())),
        ("modulo", world.run(&mut Modulo::default())),
    ];
    for (name, buckets, timer) in [
        ("resilient, 16,384 buckets", 16_384, None),
        ("resilient, 65,535 buckets", 65_535, None),
        ("resilient, 65,535, forced after 2 min", 65_535, Some(2 * MINUTE)),
    ] {
        let mut resilient = Resilient::new(buckets, timer, RELAYS, &world.clients);
        all.push((name, world.run(&mut resilient)));
    }
    report::print(&world, &all);

    // What a hash of addresses alone does, at rest.
    let mut loads = [0; RELAYS];
    let mut threshold = Threshold::default();
    threshold.change(0, &everyone());
    for address in 0..CLIENTS as u64 / CLIENTS_AN_ADDRESS {
        loads[usize::from(threshold.relay(hash(address << 16)))] += CLIENTS_AN_ADDRESS;
    }
    let largest = loads.iter().max().unwrap() * RELAYS as u64;
    println!("\nhash of addresses alone: largest load {:.2}", largest as f64 / CLIENTS as f64);
}

/// When one of three goes, the ranges of a hash-threshold say who moves: of the others, those between a third
/// and a half, or between a half and two thirds. None when it is the one in the middle.
fn check_three_relays() {
    for (left, moved) in [([1, 2], 1), ([0, 2], 0), ([0, 1], 1)] {
        let [mut before, mut after] = [Threshold::default(), Threshold::default()];
        before.change(0, &[0, 1, 2]);
        after.change(0, &left);
        let of_others = (0..1 << 31).step_by(1 << 20).filter(|&hash| {
            let relay = before.relay(hash);
            left.contains(&relay) && after.relay(hash) != relay
        });
        let sixths = of_others.count() as f64 / 2048.0 * 6.0;
        assert!((sixths - f64::from(moved)).abs() < 0.01, "{left:?}: {sixths}");
    }
}

struct World {
    /// The hash of each client.
    clients: Vec<u32>,
    /// When each client asks, within its period.
    phases: Vec<u64>,
    changes: Vec<Change>,
}

#[derive(Default)]
struct Outcome {
    /// The share of clients that move when a relay goes, when one comes back, and by the router's timer.
    moved: [Figures; 3],
    /// Clients of the largest relay, of the mean of all.
    load: Figures,
    /// Relays that have the route and no client.
    unused: Figures,
    /// Flows that are open, of all clients.
    flows: Figures,
    /// Flows that are open at the relay with the most.
    flows_at_relay: Figures,
    /// Requests that are lost, by `WAYS`.
    lost: [Figures; WAYS.len()],
}

impl World {
    fn run(&self, spread: &mut impl Spread) -> Outcome {
        let mut outcome = Outcome::default();
        let random = &mut Random(2);
        let mut live = [true; RELAYS];
        spread.change(0, &everyone());
        let mut relays: Vec<_> = self.clients.iter().map(|&hash| spread.relay(hash)).collect();
        let mut past = Past { left: VecDeque::new(), gone: [None; RELAYS] };
        for (number, &change) in self.changes.iter().enumerate() {
            if let Some(due) = spread.due().filter(|&due| due < change.at) {
                spread.force();
                outcome.moved[2].add(self.go_over(due, spread, &mut relays, &mut past));
            }
            let Change { at, relay, why } = change;
            // When those ask whose relay it is.
            let of_relay = self.phases.iter().zip(&relays).filter(|(_, of)| **of == relay);
            let phases: Vec<_> = of_relay.map(|(&phase, _)| phase).collect();
            for (way, lost) in WAYS.iter().zip(&mut outcome.lost) {
                let noticed = way.noticed.start + random.below(way.noticed.end - way.noticed.start);
                if way.why == why {
                    lost.add(way.lost(at, at + noticed, &phases) as f64);
                }
            }
            live[usize::from(relay)] = why == Why::Back;
            if why != Why::Back {
                past.gone[usize::from(relay)] = Some(at);
            }
            spread.change(at, &all(&live));
            let moved = &mut outcome.moved[usize::from(why == Why::Back)];
            moved.add(self.go_over(at, spread, &mut relays, &mut past));
            let loads = loads(&relays, &live);
            let mean = CLIENTS as f64 / all(&live).len() as f64;
            outcome.load.add(f64::from(*loads.iter().max().unwrap()) / mean);
            let unused = loads.iter().zip(live).filter(|&(&load, live)| live && load == 0).count();
            outcome.unused.add(unused as f64);
            if number % COUNT_EVERY == 0 && at > IDLE_TIMEOUT {
                let flows = past.flows(at, &relays);
                let together: u32 = flows.iter().sum();
                outcome.flows.add(f64::from(together) / CLIENTS as f64);
                outcome.flows_at_relay.add(f64::from(*flows.iter().max().unwrap()));
            }
        }
        outcome
    }

    /// Clients come to where the router sends them now. The share of those who move.
    fn go_over(
        &self,
        now: u64,
        spread: &impl Spread,
        relays: &mut Vec<u16>,
        past: &mut Past,
    ) -> f64 {
        let next: Vec<_> = self.clients.iter().map(|&hash| spread.relay(hash)).collect();
        let moved = next.iter().zip(&*relays).filter(|(next, last)| next != last).count();
        past.left.push_front((now, std::mem::replace(relays, next)));
        past.left.retain(|&(left, _)| left + IDLE_TIMEOUT > now);
        moved as f64 / CLIENTS as f64
    }
}

/// What was, for as long as flows remember it.
struct Past {
    /// Until when the clients were at these relays, the last first.
    left: VecDeque<(u64, Vec<u16>)>,
    /// When each relay went last. Its flows went with it.
    gone: [Option<u64>; RELAYS],
}

impl Past {
    /// The open flows of each relay.
    fn flows(&self, now: u64, relays: &[u16]) -> Vec<u32> {
        let mut flows = vec![0; RELAYS];
        let mut seen = Vec::new();
        for (client, &relay) in relays.iter().enumerate() {
            seen.clear();
            seen.push(relay);
            for (left, relays) in self.left.iter().filter(|(left, _)| left + IDLE_TIMEOUT > now) {
                let relay = relays[client];
                let is_open = self.gone[usize::from(relay)].is_none_or(|gone| gone < *left);
                if is_open && !seen.contains(&relay) {
                    seen.push(relay);
                }
            }
            seen.iter().for_each(|&relay| flows[usize::from(relay)] += 1);
        }
        flows
    }
}

/// The clients of each relay. Each client is at one that has the route.
fn loads(relays: &[u16], live: &[bool]) -> Vec<u32> {
    let mut loads = vec![0; RELAYS];
    relays.iter().for_each(|&relay| loads[usize::from(relay)] += 1);
    assert!(loads.iter().zip(live).all(|(&load, &live)| live || load == 0));
    loads
}

fn everyone() -> Vec<u16> {
    all(&[true; RELAYS])
}

fn all(live: &[bool]) -> Vec<u16> {
    (0..RELAYS as u16).filter(|&relay| live[usize::from(relay)]).collect()
}
