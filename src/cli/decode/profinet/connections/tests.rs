use serde_json::json;

use super::super::submodules::Submodules;
use super::*;
use crate::profinet::Octets;

pub(in super::super) const CONTROLLER: MacAddress = MacAddress([2, 0, 0, 0, 1, 0]);
pub(in super::super) const DEVICE: MacAddress = MacAddress([2, 0, 0, 0, 0, 9]);
/// In the request: the device chooses.
const OPEN: u16 = 0xFFFF;

/// A block of version 1.0.
fn block(block_type: u16, contents: &[&[u8]]) -> Vec<u8> {
    let contents = contents.concat();
    let length = contents.len() as u16 + 2;
    [&block_type.to_be_bytes()[..], &length.to_be_bytes(), &[1, 0], &contents].concat()
}

fn ar_request(ar: u8) -> Vec<u8> {
    let front = [&[0, 1][..], &[ar; 16], &[0, 1], &CONTROLLER.0].concat();
    block(0x0101, &[&front, &[0; 16], &[0, 0, 0, 0x11], &[0, 100, 0x88, 0x92], &[0, 3], b"plc"])
}

/// A CR whose API 0 has these data objects and consumer status: slot, subslot, offset.
fn cr_request(kind: u8, frame_id: u16, data: &[[u8; 3]], iocs: &[[u8; 3]]) -> Vec<u8> {
    let objects = |objects: &[[u8; 3]]| {
        let words = objects.iter().flatten().flat_map(|&octet| [0, octet]);
        [0, objects.len() as u8].into_iter().chain(words).collect::<Vec<_>>()
    };
    let [high, low] = frame_id.to_be_bytes();
    let front = [0, kind, 0, kind, 0x88, 0x92, 0, 0, 0, 2, 0, 40, high, low];
    let timing = [0, 32, 0, 2, 0, 1, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF, 0, 3, 0, 3, 0xC0, 0];
    let api = [&[0, 0, 0, 0][..], &objects(data), &objects(iocs)].concat();
    block(0x0102, &[&front, &timing, &[0; 6], &[0, 1], &api])
}

/// Slot 0 subslot 1 without data; slot 1 subslot 1 with two octets in and three out.
fn expected() -> Vec<u8> {
    let module = |slot: u8, submodule: &[u8]| {
        let head = [0, 0, 0, 0, 0, slot, 0, 0, 0, 1, 0, 0, 0, 1];
        block(0x0104, &[&[0, 1], &head, submodule])
    };
    let nothing = [0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 1];
    let both = [0, 1, 0, 0, 0, 2, 0, 3, 0, 1, 0, 2, 1, 1, 0, 2, 0, 3, 1, 1];
    [module(0, &nothing), module(1, &both)].concat()
}

fn request(ar: u8) -> Vec<u8> {
    let input = cr_request(1, 0x8001, &[[0, 1, 0], [1, 1, 2]], &[[1, 1, 1]]);
    let output = cr_request(2, OPEN, &[[1, 1, 0]], &[[0, 1, 4], [1, 1, 5]]);
    [ar_request(ar), input, output, alarm_request(ar.into()), expected()].concat()
}

fn alarm_request(reference: u16) -> Vec<u8> {
    let front = [0, 1, 0x88, 0x92, 0, 0, 0, 0, 0, 1, 0, 3];
    block(0x0103, &[&front, &reference.to_be_bytes(), &[0, 200, 0xC0, 0, 0xA0, 0]])
}

fn answer(ar: u8) -> Vec<u8> {
    let front = [&[0, 1][..], &[ar; 16], &[0, 1], &DEVICE.0, &[0x88, 0x92]].concat();
    let cr = |kind: u8, frame_id: u16| {
        let [high, low] = frame_id.to_be_bytes();
        block(0x8102, &[&[0, kind, 0, kind, high, low]])
    };
    let alarms = block(0x8103, &[&[0, 1, 0, 5, 0, 200]]);
    [block(0x8101, &[&front]), cr(1, 0x8001), cr(2, 0x8005), alarms].concat()
}

/// Teaches an AR whose UUID is made of this octet: inputs $8001, outputs $8005, alarms between the end of this
/// number in the controller and end 5 in the device.
pub(in super::super) fn connect(connections: &mut Connections, ar: u8) {
    connections.request(blocks(&request(ar)));
    connections.answer(blocks(&answer(ar)));
}

fn blocks(octets: &[u8]) -> Blocks<'_> {
    Blocks::new(Octets::new(octets))
}

#[test]
fn a_connect_and_its_answer_tell_the_places_of_submodules() {
    let mut connections = Connections::default();
    connections.request(blocks(&request(7)));
    let input = |connections: &Connections| {
        connections.layout(DEVICE, Some(CONTROLLER), FrameId(0x8001)).cloned()
    };
    assert!(input(&connections).is_none());
    connections.answer(blocks(&answer(7)));
    let part = |slot, offset, data_length| Part { api: 0, slot, subslot: 1, offset, data_length };
    assert_eq!(
        input(&connections).unwrap().parts(),
        [part(0, 0, Some(0)), part(1, 1, None), part(1, 2, Some(2))]
    );
    // The device chose its frame ID, and only between these two.
    let output = |from, to, id| connections.layout(from, to, FrameId(id));
    let parts = output(CONTROLLER, Some(DEVICE), 0x8005).unwrap().parts();
    assert_eq!(parts, [part(1, 0, Some(3)), part(0, 4, None), part(1, 5, None)]);
    assert!(output(CONTROLLER, Some(DEVICE), OPEN).is_none());
    assert!(output(DEVICE, Some(CONTROLLER), 0x8005).is_none());
    assert!(output(CONTROLLER, None, 0x8005).is_none());
}

#[test]
fn the_last_connect_says_whose_streams_and_alarms_they_are() {
    let uuid = |octet| Some(Uuid::from_octets([octet; 16]));
    let mut connections = Connections::default();
    connect(&mut connections, 7);
    connect(&mut connections, 8);
    for (from, to, frame_id) in [(DEVICE, CONTROLLER, 0x8001), (CONTROLLER, DEVICE, 0x8005)] {
        let layout = connections.layout(from, Some(to), FrameId(frame_id));
        assert_eq!(layout.map(|layout| layout.ar), uuid(8));
    }
    // Two ARs between the same stations have alarms of their own, in both directions.
    let alarms = |one, other| connections.ar_of_alarms([one, other]);
    for ar in [7, 8] {
        let (controller, device) = ((CONTROLLER, ar), (DEVICE, 5));
        assert_eq!(alarms(controller, device), uuid(ar as u8));
        assert_eq!(alarms(device, controller), uuid(ar as u8));
    }
    assert_eq!(alarms((CONTROLLER, 5), (DEVICE, 7)), None);
    assert_eq!(alarms((CONTROLLER, 9), (DEVICE, 5)), None);
    // One without a CR of alarms has none.
    let without = |octets: Vec<u8>, block: &[u8]| {
        let place = octets.windows(block.len()).position(|found| found == block).unwrap();
        [&octets[..place], &octets[place + block.len()..]].concat()
    };
    connections.request(blocks(&without(request(9), &alarm_request(9))));
    connections.answer(blocks(&answer(9)));
    assert_eq!(connections.alarms.len(), 2);
}

#[test]
fn data_is_cut_and_what_is_missing_is_null() {
    let mut connections = Connections::default();
    connect(&mut connections, 7);
    let layout = connections.layout(DEVICE, Some(CONTROLLER), FrameId(0x8001)).unwrap();
    let data = [0x80, 0x20, 0xAA, 0xBB, 0x80, 0, 0];
    let submodules = Submodules::new(layout, &data);
    assert_eq!((submodules.count(), submodules.bad()), (3, 1));
    let consumer = json!({
        "kind": "consumer status", "api": 0, "slot": 1, "subslot": 1, "offset": 1,
        "status": 0x20, "good": false, "bad_by": "slot",
    });
    assert_eq!(
        serde_json::to_value(submodules).unwrap(),
        json!([
            {
                "kind": "data", "api": 0, "slot": 0, "subslot": 1, "offset": 0, "data": "",
                "status": 0x80, "good": true,
            },
            consumer,
            {
                "kind": "data", "api": 0, "slot": 1, "subslot": 1, "offset": 2, "data": "aabb",
                "status": 0x80, "good": true,
            },
        ])
    );
    let short = serde_json::to_value(Submodules::new(layout, &data[..3])).unwrap();
    assert_eq!(
        short[2],
        json!({
            "kind": "data", "api": 0, "slot": 1, "subslot": 1, "offset": 2,
            "status": null, "good": null,
        })
    );
}

#[test]
fn a_refusal_or_another_answer_teaches_nothing() {
    let mut connections = Connections::default();
    connections.answer(blocks(&answer(7)));
    connections.request(blocks(&request(7)));
    connections.answer(blocks(&answer(8)));
    connections.answer(blocks(&[]));
    assert!(connections.layouts.is_empty() && connections.alarms.is_empty());
    connections.answer(blocks(&answer(7)));
    assert_eq!((connections.layouts.len(), connections.asked.len()), (2, 0));
}

#[test]
fn requests_and_streams_without_end_need_no_more_room() {
    let mut connections = Connections::default();
    for ar in 0..=255 {
        connections.request(blocks(&request(ar)));
    }
    assert_eq!(connections.asked.len(), WAITING);
    // More CRs than a connection has, and more parts than a frame.
    let many = cr_request(1, 0x8001, &[[1, 1, 2]; 200], &[[1, 1, 1]; 200]).repeat(40);
    connections.request(blocks(&[ar_request(1), many, expected().repeat(2000)].concat()));
    let last = connections.asked.back().unwrap();
    assert_eq!(last.streams.len(), OF_CONNECTION);
    assert!(last.streams.iter().all(|stream| stream.layout.parts.len() <= PARTS));
    for frame_id in 0..2 * STREAMS as u16 {
        let input = cr_request(1, 0x8000 + frame_id, &[[1, 1, 2]], &[]);
        connections.request(blocks(&[ar_request(3), input, expected()].concat()));
        let front = [&[0, 1][..], &[3; 16], &[0, 1], &DEVICE.0, &[0x88, 0x92]].concat();
        connections.answer(blocks(&block(0x8101, &[&front])));
    }
    assert_eq!(connections.layouts.len(), STREAMS);
    for reference in 0..2 * ALARMS as u16 {
        connections.request(blocks(&[ar_request(3), alarm_request(reference)].concat()));
        connections.answer(blocks(&answer(3)));
    }
    assert_eq!(connections.alarms.len(), ALARMS);
}
