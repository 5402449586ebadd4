use std::collections::HashMap;
use std::thread;

use super::*;

const SECOND: Nanos = 1_000_000_000;
const REASON: DropReason = DropReason::SourceNotAllowed;

/// A worker's table, and how many refusals it noted.
struct World {
    refusals: Refusals,
    writer: Writer,
    hash: FixedState,
    noted: u64,
}

impl World {
    fn new() -> Self {
        let (refusals, hash) = (Refusals::default(), FixedState::with_seed(62412));
        Self { refusals, writer: Writer::of_worker(), hash, noted: 0 }
    }

    fn note(&mut self, now: Nanos, refused: Refused) {
        self.refusals.note(&self.writer, now, &refused, &self.hash);
        self.noted += 1;
    }

    /// Count, first and last.
    fn of(&self, refused: Refused) -> Option<(u64, Nanos, Nanos)> {
        let its = self.refusals.list().filter(|refusal| refusal.refused == refused);
        let mut its = its.map(|it| (it.count, it.first, it.last));
        let found = its.next();
        assert_eq!(its.next(), None, "listed twice");
        found
    }

    #[track_caller]
    fn check(&self) {
        let listed: u64 = self.refusals.list().map(|refusal| refusal.count).sum();
        assert_eq!(listed + self.refusals.not_listed.get(), self.noted, "each counts once");
    }
}

fn of(number: u32) -> Refused {
    Refused {
        sender: IpAddr::from((0x0a00_0000 + number).to_be_bytes()),
        net: net_key("section-1"),
        node: 3,
        direction: Direction::Request,
        reason: REASON,
    }
}

#[test]
fn each_sender_net_node_and_reason_is_counted_by_itself() {
    let mut world = World::new();
    let one = of(1);
    let others = [
        Refused { sender: "2001:db8::7".parse().unwrap(), ..one },
        Refused { sender: "2001:db8::8".parse().unwrap(), ..one },
        Refused { net: net_key("press"), ..one },
        Refused { node: 4, ..one },
        Refused { reason: DropReason::PasswordWrong, ..one },
        Refused { reason: DropReason::BadHeader, direction: Direction::Response, ..one },
    ];
    world.note(5, one);
    others.into_iter().for_each(|other| world.note(6, other));
    world.note(9, one);
    assert_eq!(world.of(one), Some((2, 5, 9)));
    for other in others {
        assert_eq!(world.of(other), Some((1, 6, 6)), "{other:?}");
    }
    assert_eq!(world.refusals.not_listed.get(), 0);
    let mapped = Refused { sender: "::ffff:10.0.0.1".parse().unwrap(), ..one };
    world.note(10, mapped);
    assert_eq!(world.of(one), Some((3, 5, 10)), "IPv4 is IPv4");
}

/// A million forged senders in ten seconds, as clients and as noise, beside clients that are refused
/// ten times a second. One was there before, and is counted from its first datagram on; one comes
/// in the middle, and is counted once it is in.
#[test]
fn a_million_forged_senders_push_nobody_out_and_keep_nobody_out() {
    let mut world = World::new();
    let (before, meanwhile) = (of(0x00ff_ffff), of(0x00ff_fffe));
    let (start, end) = (10 * SECOND, 20 * SECOND);
    for now in (0..start).step_by(100_000_000) {
        world.note(now, before);
    }
    for (number, now) in (0..1_000_000).zip((start..end).step_by(10_000)) {
        world.note(now, of(number));
        world.note(now, Refused { reason: DropReason::BadHeader, ..of(number) });
        if number % 10_000 == 0 {
            world.note(now, before);
        }
        if number % 10_000 == 5_000 && number > 500_000 {
            world.note(now, meanwhile);
        }
    }
    assert_eq!(world.of(before), Some((200, 0, end - 100_000_000)));
    let (count, first, last) = world.of(meanwhile).expect("it got in");
    assert_eq!(last, end - 50_000_000);
    assert_eq!(count, (last - first) / 100_000_000 + 1, "right since the first that counts");
    assert!(first < start + 8 * SECOND, "it took {} s", (first - start) / SECOND);
    world.check();
}

/// At the speed at which a worker has nothing else to do. What counts is how often the client comes:
/// here a hundred times a second.
#[test]
fn a_million_forged_senders_a_second_keep_nobody_out_for_long() {
    const APART: Nanos = SECOND / 100;
    let mut world = World::new();
    let client = of(0x00ff_ffff);
    let mut flood = (0..0x00ff_0000).cycle();
    let mut times = (SECOND..).step_by(APART as usize).take(1_000);
    let is_in = times.any(|now| {
        for now in (now..now + APART).step_by(1_000) {
            world.note(now, of(flood.next().unwrap()));
        }
        world.note(now + APART, client);
        world.of(client).is_some_and(|(count, ..)| count > 1)
    });
    assert!(is_in, "not after a thousand datagrams");
    world.check();
}

/// Ten thousand that come again and again: who was there before stays.
#[test]
fn a_flood_of_senders_that_come_back_pushes_nobody_out() {
    let mut world = World::new();
    let client = of(0x00ff_ffff);
    (0..10).for_each(|n| world.note(n * SECOND, client));
    for (number, now) in (0..1_000_000).zip((10 * SECOND..).step_by(10_000)) {
        world.note(now, of(number % 10_000));
        if number % 100_000 == 0 {
            world.note(now, client);
        }
    }
    assert_eq!(world.of(client), Some((20, 0, 19 * SECOND)));
    world.check();
}

/// One engineer who polls all nodes of two nets is in the table with each of them, and does not
/// fill it.
#[test]
#[cfg_attr(
    not(all(target_pointer_width = "64", target_endian = "little")),
    ignore = "foldhash has other values there, and by chance one of the sets may be full"
)]
fn all_nodes_of_nets_have_room() {
    let mut world = World::new();
    for now in 0..2 {
        for net in ["section-1", "section-2"].map(net_key) {
            (1..=125).for_each(|node| world.note(now, Refused { net, node, ..of(1) }));
        }
    }
    assert_eq!((world.refusals.list().count(), world.refusals.not_listed.get()), (250, 0));
    world.note(3, of(2));
    assert_eq!(world.of(of(2)), Some((1, 3, 3)));
}

#[test]
fn who_is_over_gives_way_at_once() {
    let mut world = World::new();
    let numbers = 0..10_000;
    for now in [SECOND, 2 * SECOND] {
        numbers.clone().for_each(|number| world.note(now, of(number)));
    }
    let full = world.refusals.list().count();
    assert_eq!(full, 32 * WAYS);
    let newcomer = of(20_000);
    world.note(OVER, newcomer);
    assert_eq!(world.of(newcomer), None, "those go on, as far as one knows");
    let mut now = 2 * SECOND + OVER;
    world.note(now, newcomer);
    assert_eq!(world.of(newcomer), Some((1, now, now)));
    for number in numbers.map(|number| number + 30_000) {
        now += SECOND / 10;
        world.note(now, of(number));
    }
    let old = |refusal: &Refusal| refusal.first < OVER;
    assert_eq!(world.refusals.list().filter(old).count(), 0);
    world.check();
}

#[test]
fn one_that_is_given_away_meanwhile_is_left_out() {
    let mut world = World::new();
    world.note(5, of(1));
    let entries = world.refusals.sets.iter().flat_map(|set| &set.entries);
    let mut entries = entries.filter(|entry| entry.get().is_some());
    entries.next().unwrap().0.version.store(3, Relaxed);
    assert_eq!(world.refusals.list().count(), 0);
}

/// The parts of an entry always belong to the same sender.
#[test]
fn nothing_is_read_of_two() {
    let refusals = Refusals::default();
    thread::scope(|scope| {
        let writing = scope.spawn(|| {
            let (writer, hash) = (Writer::of_worker(), FixedState::with_seed(7));
            let mut written = HashMap::new();
            for (number, now) in (0..).zip((0..).step_by(OVER as usize).take(30_000)) {
                let refused = Refused { node: number as u8, ..of(number) };
                (0..=number % 3).for_each(|_| refusals.note(&writer, now, &refused, &hash));
                written.insert(now, refused);
            }
            written
        });
        let mut read = Vec::new();
        while !writing.is_finished() {
            read.truncate(1_000_000);
            read.extend(refusals.list());
        }
        let written = writing.join().unwrap();
        for refusal in read {
            assert_eq!(refusal.refused, written[&refusal.first]);
            assert!(refusal.count <= 3 && refusal.last == refusal.first, "{refusal:?}");
        }
    });
}

#[test]
fn its_memory_is_what_the_documentation_says() {
    let refusals = Refusals::default();
    let octets = size_of_val(&*refusals.sets) + (16 + 1) * 1024 * size_of::<AtomicU32>();
    assert_eq!(size_of::<Set>(), (1 + WAYS) * 64);
    assert!(octets < 1_000_000, "{octets}");
}
