//! What strangers and operators may send, on every run of the tests: the corpus that fuzzing has
//! gathered, and random changes of it.
//!
//! What has to hold is written in `tests/rig/src/targets`. `cargo fuzz` looks for octets
//! that break it.

use std::fs;
use std::path::Path;

use pnet_nat_rig::targets::{codec, configuration, core, endpoints, ip_net_table, profinet_rpc};
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

fn corpus(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target);
    let files = fs::read_dir(folder).unwrap().map(|file| file.unwrap().path());
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
