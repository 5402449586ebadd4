//! Fragments in any order, twice, too many, and never.

use serde_json::{Value as Json, json};

use super::super::rpc::tests::{emit, read_api_data};
use super::*;
use crate::profinet::ByteOrder;
use crate::profinet::rpc::{Flags1, Header, Interface, PORT};

/// A fragment of the call with this sequence number.
fn fragment(sequence: u32, number: u16, is_last: bool, octets: &[u8]) -> Vec<u8> {
    let mut header = Header::request(ByteOrder::Big, Interface::Device.uuid(), 5);
    let last = if is_last { Flags1::LAST_FRAGMENT } else { 0 };
    header.flags1 = Flags1(Flags1::FRAGMENT | last);
    (header.sequence, header.fragment_number) = (sequence, number);
    emit(&header, octets)
}

fn add(fragments: &mut RpcFragments, datagram: &[u8]) -> Option<Vec<u8>> {
    fragments.add(&RpcFields::of(datagram, [PORT; 2]).unwrap())
}

#[test]
fn p_8_fragments_are_put_together_in_any_order() {
    let stub = &read_api_data(ByteOrder::Big)[80..];
    let parts = [&stub[..30], &stub[30..31], &stub[31..]];
    for order in [[0, 1, 2], [2, 1, 0], [1, 2, 0]] {
        let mut fragments = RpcFragments::default();
        let mut datagrams =
            order.map(|part| fragment(1, part, part == 2, parts[usize::from(part)])).to_vec();
        // One of them is sent again.
        datagrams.insert(1, datagrams[0].clone());
        let (last, others) = datagrams.split_last().unwrap();
        assert!(others.iter().all(|datagram| add(&mut fragments, datagram).is_none()));
        let whole = add(&mut fragments, last).unwrap();
        assert_eq!(whole, stub);
        let fields = RpcFields::of(last, [PORT; 2]).unwrap().with_call(&whole);
        let json: Json = serde_json::to_value(&fields).unwrap();
        assert_eq!(json["blocks"][0]["index_name"], "APIData");
        assert_eq!(json["reassembled_length"], json!(stub.len()));
        assert!(fields.to_string().ends_with("octets; IODReadReqHeader APIData"), "{fields}");
        assert!(fragments.calls.is_empty());
    }
}

#[test]
fn p_8_an_error_in_a_call_that_was_put_together_counts_through_the_fragments() {
    let stub = &read_api_data(ByteOrder::Big)[80..];
    let mut wrong = stub.to_vec();
    wrong[23] = 0xFF; // the block's length
    let mut fragments = RpcFragments::default();
    assert!(add(&mut fragments, &fragment(1, 0, false, &wrong[..40])).is_none());
    let last = fragment(1, 1, true, &wrong[40..]);
    let whole = add(&mut fragments, &last).unwrap();
    let fields = RpcFields::of(&last, [PORT; 2]).unwrap().with_call(&whole);
    assert_eq!(fields.fault().unwrap().offset, 164);
}

#[test]
fn p_8_calls_do_not_mix_and_whole_ones_are_left_alone() {
    let mut fragments = RpcFragments::default();
    assert!(add(&mut fragments, &fragment(1, 0, false, &[1])).is_none());
    assert!(add(&mut fragments, &fragment(2, 1, true, &[9])).is_none());
    assert_eq!(add(&mut fragments, &fragment(1, 1, true, &[2])), Some(vec![1, 2]));
    assert!(add(&mut fragments, &read_api_data(ByteOrder::Big)).is_none());
    assert_eq!(fragments.calls.len(), 1);
}

#[test]
fn memory_has_a_bound() {
    let mut fragments = RpcFragments::default();
    for sequence in 0..100 {
        add(&mut fragments, &fragment(sequence, 0, false, &[0]));
    }
    assert_eq!(fragments.calls.len(), CALLS);
    // The one that has waited longest is gone.
    assert_eq!(fragments.calls[0].key.sequence, 100 - CALLS as u32);

    let mut fragments = RpcFragments::default();
    for number in 0..200 {
        add(&mut fragments, &fragment(1, number, false, &[0; 1400]));
        assert!(fragments.calls.iter().all(|call| call.octets <= OCTETS));
    }
    // A fragment with a number beyond all bounds takes its call along.
    assert!(add(&mut fragments, &fragment(2, 0, false, &[0])).is_none());
    assert!(add(&mut fragments, &fragment(2, FRAGMENTS, true, &[0])).is_none());
    assert!(fragments.calls.iter().all(|call| call.key.sequence == 1));
}

#[test]
fn a_fragment_behind_the_last_one_makes_nothing_whole() {
    let mut fragments = RpcFragments::default();
    add(&mut fragments, &fragment(1, 5, false, &[5]));
    assert!(add(&mut fragments, &fragment(1, 0, true, &[0])).is_none());
}
