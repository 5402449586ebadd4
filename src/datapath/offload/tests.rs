//! The programs on frames that a test makes. Needs the right to load programs.

use std::net::SocketAddrV4;
use std::sync::atomic::Ordering::Relaxed;

use super::trial::*;
use super::*;
use crate::nat::{Direction, MappingId, NetId, ResponseTimes};

/// Where programs may not be loaded, says so and returns `None`.
fn trial() -> Option<Trial> {
    let trial = Trial::new();
    if let Err(error) = &trial {
        assert!(std::env::var("PNET_NAT_TESTS").as_deref() != Ok("all"), "{error}");
        println!("left out: {error}");
    }
    trial.ok()
}

/// What fuzzing has gathered.
#[test]
fn the_corpus_of_fuzzing_is_judged_alike() {
    if trial().is_none() {
        return;
    }
    let corpus = std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/corpus/offload"));
    for file in corpus.unwrap() {
        holds(&std::fs::read(file.unwrap().path()).unwrap());
    }
}

/// A payload that is nearly right, or right.
fn payload(random: &mut fastrand::Rng, direction: Direction) -> Vec<u8> {
    let element = |random: &mut fastrand::Rng| match random.u8(..20) {
        0 => random.u8(124..128),
        _ => random.u8(..126),
    };
    let first = if random.u8(..20) == 0 { random.u8(..) } else { NODE };
    let mut route = vec![element(random), first];
    if direction == Direction::Response {
        route[1] = element(random);
    }
    if random.u8(..4) == 0 {
        route.extend([element(random) | 0x80, element(random) | 0x80]);
    } else {
        let sources = random.usize(1..6);
        let destinations = random.usize(..23);
        route.push((destinations + sources) as u8);
        route.extend((0..destinations).map(|_| element(random)));
        route.extend((0..sources).map(|_| element(random) | 0x80));
    }
    let data: Vec<u8> = (0..random.usize(..64)).map(|_| random.u8(..)).collect();
    let mut octets = datagram([&route, &[]], &data, PASSWORD);
    match random.u8(..8) {
        0 => {
            let place = random.usize(..octets.len());
            octets[place] ^= 1 << random.u8(..8);
        }
        1 => octets.truncate(random.usize(..octets.len())),
        2 => octets.extend((0..random.usize(1..9)).map(|_| random.u8(..))),
        3 => {
            let place = random.usize(4..octets.len().min(40));
            octets[place] = random.u8(..);
        }
        _ => {}
    }
    octets
}

/// Random payloads that are nearly right, in trial directions.
#[test]
fn the_program_passes_what_the_core_passes() {
    let Some(mut trial) = trial() else { return };
    let mut random = fastrand::Rng::with_seed(7);
    let mut passed = [0, 0];
    let mut octets = [0, 0];
    for number in 0..100_000 {
        let direction = Direction::ALL[number % 2];
        let payload = payload(&mut random, direction);
        if trial.judge(direction, &payload) {
            passed[direction as usize] += 1;
            octets[direction as usize] += payload.len() as u64;
        }
    }
    println!("{passed:?} passed");
    assert!(passed.iter().all(|&passed| passed > 15_000), "{passed:?}");
    let traffic = trial.shared.traffic();
    assert_eq!([traffic.requests, traffic.responses], passed);
    assert_eq!(traffic.octets, octets.iter().sum::<u64>());
    assert_eq!(trial.counters.accepted(NetId(0))[0].get(), passed[0]);
    for direction in Direction::ALL {
        let counters = trial.counters.node(MappingId(0)).direction(direction);
        let counted = [&counters.received, &counters.forwarded, &counters.forwarded_bytes];
        let (passed, octets) = (passed[direction as usize], octets[direction as usize]);
        assert_eq!(counted.map(Counter::get), [passed, passed, octets]);
    }
}

/// What only the kernel can check, and what it can do alone: all of these go up to it untouched.
#[test]
fn packets_that_are_not_plain_take_the_long_way() {
    let Some(trial) = trial() else { return };
    let payload = datagram([&[2, NODE], &[2, 0xB3, 0xFD]], &[1, 2, 3], PASSWORD);
    let good = coming(Direction::Request, &payload);
    assert!(trial.program(&good).is_some());
    let with = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut frame = good.clone();
        change(&mut frame);
        let sum = !sum(&[&frame[14..24], &[0, 0], &frame[26..34]].concat());
        frame[24..26].copy_from_slice(&sum.to_be_bytes());
        frame
    };
    let wrong_sum = {
        let mut frame = good.clone();
        frame[25] ^= 1;
        frame
    };
    let frames: [(&str, Vec<u8>); 14] = [
        ("to another station", [&[2, 0, 0, 0, 0, 9], &good[6..]].concat()),
        ("to all stations", [&[0xFF; 6], &good[6..]].concat()),
        ("IPv6", with(&|frame| frame[12..14].copy_from_slice(&[0x86, 0xDD]))),
        ("IP options", with(&|frame| frame[14] = 0x46)),
        ("more fragments", with(&|frame| frame[20] = 0x20)),
        ("a later fragment", with(&|frame| frame[21] = 1)),
        ("the last hop", with(&|frame| frame[22] = 1)),
        ("TCP", with(&|frame| frame[23] = 6)),
        ("no UDP checksum", with(&|frame| frame[40..42].fill(0))),
        ("a UDP length that is too short", with(&|frame| frame[39] -= 1)),
        ("a total length that is too long", with(&|frame| frame[17] += 1)),
        ("octets behind the packet", with(&|frame| frame.push(0))),
        ("a wrong sum of the IP header", wrong_sum),
        ("another client", with(&|frame| frame[29] ^= 1)),
    ];
    for (what, frame) in frames {
        assert_eq!(trial.program(&frame), None, "{what}");
    }
    trial.lend_way(u64::MAX, LOOPBACK + 1);
    assert_eq!(trial.program(&good), None, "it comes by another interface");
    trial.lend_way(1, LOOPBACK);
    assert_eq!(trial.program(&good), None, "the lease is over");
    trial.lend_way(u64::MAX, LOOPBACK);
    assert!(trial.program(&good).is_some());
    for entry in &trial.entries {
        bpf::delete(trial.offload.entries.as_fd(), &entry.comes.to_octets()).unwrap();
    }
    assert_eq!(trial.program(&good), None, "the flow is not in the kernel any more");
    assert_eq!(trial.shared.traffic().requests, 2);
}

/// The kernel has other buckets for nothing: those of the core, found in another way.
#[test]
fn response_times_fall_into_the_buckets_of_the_core() {
    let Some(trial) = trial() else { return };
    let times = &trial.counters.node(MappingId(0)).response_times;
    let response = datagram([&[0x31, 1], &[3, 0x7D, 0xB3, 0x82]], &[], PASSWORD);
    let response = coming(Direction::Response, &response);
    let mut before: Vec<u64> = times.buckets().collect();
    let mut elapsed = 1;
    while elapsed < 30_000_000_000 {
        let asked = u64::try_from(trial.now.elapsed().as_nanos()).unwrap() + 1;
        trial.shared.unanswered.store(asked.wrapping_sub(elapsed), Relaxed);
        let sum = times.sum_nanos();
        assert!(trial.program(&response).is_some());
        let took = times.sum_nanos() - sum;
        assert!((elapsed..elapsed + 1_000_000_000).contains(&took), "{took} of {elapsed}");
        let after: Vec<u64> = times.buckets().collect();
        let bucket = before.iter().zip(&after).position(|(before, after)| before != after);
        assert_eq!(bucket, Some(ResponseTimes::bucket(took)), "{took}");
        before = after;
        elapsed = elapsed * 51 / 50 + 1;
    }
}

/// A datagram of the relay's own shows how those of its direction leave.
#[test]
fn the_way_out_is_learned_from_what_the_relay_sends() {
    let Some(trial) = trial() else { return };
    trial.lend_way(0, 0);
    let flow = &trial.offload.flows.all()[trial.shared.place() as usize];
    let payload = datagram([&[2, NODE], &[2, 0xB3, 0xFD]], &[1, 2, 3], PASSWORD);
    let learn = |frame: &[u8]| {
        let (result, after) = bpf::test_run(trial.offload.learning.as_fd(), frame).unwrap();
        assert_eq!((result, after), (-1, frame.to_vec()), "it never changes anything");
        flow.ways.each_ref().map(|way| way.lease.load(Relaxed))
    };
    let to_another = SocketAddrV4::new(*SERVER.ip(), SERVER.port() + 1);
    assert_eq!(learn(&frame(HARDWARE, UPSTREAM, to_another, &payload)), [0, 0]);
    let to_all = [[0xFF; 6], [2, 0, 0, 0, 0, 1]].concat().try_into().unwrap();
    assert_eq!(learn(&frame(to_all, UPSTREAM, SERVER, &payload)), [0, 0]);

    let before = u64::try_from(trial.now.elapsed().as_nanos()).unwrap();
    let [request, response] = learn(&frame(HARDWARE, UPSTREAM, SERVER, &payload));
    let lease = request - before;
    assert!((1_500_000_000..4_000_000_000).contains(&lease), "{lease}");
    assert_eq!(response, 0);
    let way = &flow.ways[Direction::Request as usize];
    let hardware = way.hardware.each_ref().map(|word| word.load(Relaxed).to_ne_bytes());
    assert_eq!(hardware.as_flattened(), HARDWARE);
    assert_eq!(way.interface.load(Relaxed), LOOPBACK);
    let [_, response] = learn(&frame(HARDWARE, PUBLIC, CLIENT, &payload));
    assert!(response > 0);
    assert!(trial.program(&coming(Direction::Request, &payload)).is_some(), "trial are known");
}
