//! What strangers and operators may send, on every run of the tests: the corpus that fuzzing has
//! gathered, and random changes of it.
//!
//! What has to hold is written in `tests/rig/src/targets`. `cargo fuzz` looks for octets
//! that break it.

use std::fs;
use std::path::{Path, PathBuf};

use pnet_nat_rig::targets::{
    codec, configuration, core, endpoints, ip_net_table, profinet, profinet_device, profinet_rpc,
};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::TestRunner;

#[test]
fn any_octets_are_read_or_refused_by_the_codec() {
    survives("codec", codec::holds);
}

#[test]
fn any_sequence_of_steps_leaves_the_core_in_order() {
    survives("core", core::holds);
}

#[test]
fn any_text_is_a_configuration_or_told_why_not() {
    survives("configuration", configuration::holds);
}

#[test]
fn any_text_or_octets_are_an_ip_net_table_or_told_why_not() {
    survives("ip_net_table", ip_net_table::holds);
}

#[test]
fn any_datagrams_are_answered_or_ignored_by_the_endpoints() {
    survives("endpoints", endpoints::holds);
}

#[test]
fn any_octets_are_read_or_refused_as_rpc_of_profinet() {
    survives("profinet_rpc", profinet_rpc::holds);
}

#[test]
fn any_octets_are_read_or_refused_by_the_views_of_profinet() {
    survives("profinet", profinet::holds);
}

/// Each parser has octets that it reads to their end, so the fuzzer begins behind its checks.
#[test]
fn the_corpus_of_profinet_has_sound_octets_for_each_parser() {
    let seeds = profinet::seeds::all();
    planted("profinet", &seeds);
    let unread = |(_, octets): &&(String, Vec<u8>)| !profinet::reads(octets);
    let unread: Vec<_> = seeds.iter().filter(unread).map(|(name, _)| name).collect();
    assert!(unread.is_empty(), "{unread:?}");
}

#[test]
fn any_sequence_of_steps_lets_nothing_but_reading_reach_a_profinet_device() {
    survives("profinet_device", profinet_device::holds);
}

/// Enough of it passes, in both directions, that the rules have something to hold for.
#[test]
fn the_corpus_of_profinet_device_has_calls_that_pass_and_their_answers() {
    let seeds = profinet_device::seeds::all();
    planted("profinet_device", &seeds);
    for (name, octets) in &seeds {
        let passed = profinet_device::passed(octets);
        let [asked, answered] = passed.map(|passed| passed > 0);
        let is_refused = ["operation", "damaged", "index-3", "index-4", "index-5", "index-7"];
        let is_refused = is_refused.iter().any(|it| name.contains(it));
        let is_answered = ["seed-port", "seed-fragments", "seed-everybody"];
        let is_answered = is_answered.iter().any(|it| name.starts_with(it));
        assert_eq!(asked, !is_refused, "{name}: {passed:?}");
        assert!(answered || !is_answered, "{name}: {passed:?}");
    }
}

/// The files of the corpus that we made are as we make them. With `PNET_NAT_SEEDS=write` they are
/// written.
fn planted(target: &str, seeds: &[(String, Vec<u8>)]) {
    let folder = folder(target);
    let writes = std::env::var_os("PNET_NAT_SEEDS").is_some_and(|it| it == "write");
    for (name, octets) in seeds {
        let path = folder.join(name);
        if writes {
            fs::create_dir_all(&folder).unwrap();
            fs::write(&path, octets).unwrap();
        }
        assert_eq!(fs::read(&path).ok().as_ref(), Some(octets), "{name}");
    }
}

/// Every file of a target's corpus, then changes of them.
fn survives(target: &str, holds: fn(&[u8])) {
    let corpus = corpus(target);
    assert!(corpus.len() >= 20, "the corpus is missing");
    for (name, octets) in &corpus {
        println!("{name}"); // shown when it fails
        holds(octets);
    }
    let octets: Vec<_> = corpus.into_iter().map(|(_, octets)| octets).collect();
    let config = ProptestConfig { cases: 10_000, failure_persistence: None, ..Default::default() };
    let changed = TestRunner::new(config).run(&changed(octets), |octets| {
        holds(&octets);
        Ok(())
    });
    if let Err(error) = changed {
        panic!("{error}");
    }
}

fn folder(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target)
}

fn corpus(target: &str) -> Vec<(String, Vec<u8>)> {
    let files = fs::read_dir(folder(target)).unwrap().map(|file| file.unwrap().path());
    files.map(|path| (path.display().to_string(), fs::read(path).unwrap())).collect()
}

/// The front of one file and the back of another, with a few octets replaced by others.
fn changed(corpus: Vec<Vec<u8>>) -> impl Strategy<Value = Vec<u8>> {
    let cut = |octets: Vec<u8>, at: Index| octets[..at.index(octets.len() + 1)].to_vec();
    let front =
        (select(corpus.clone()), any::<Index>()).prop_map(move |(octets, at)| cut(octets, at));
    let back = (select(corpus), any::<Index>())
        .prop_map(|(octets, at)| octets[at.index(octets.len() + 1)..].to_vec());
    let changes = vec((any::<Index>(), 0..3_usize, vec(any::<u8>(), 0..4)), 0..6);
    (front, back, changes).prop_map(|(front, back, changes)| {
        let mut octets = [front, back].concat();
        for (at, removed, put) in changes {
            let at = at.index(octets.len() + 1);
            let end = octets.len().min(at + removed);
            octets.splice(at..end, put);
        }
        octets
    })
}
