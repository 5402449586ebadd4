use std::iter;
use std::time::{Duration, UNIX_EPOCH};

use pcap_parser::Linktype;
use serde_json::{Value, json};

use super::super::Connections;
use super::super::connections::tests::{CONTROLLER, DEVICE, connect};
use super::super::ethernet::frame;
use super::super::rpc::tests::read_api_data;
use super::*;
use crate::cli::decode::capture::Captured;
use crate::profinet::ByteOrder;

/// Counts a frame of this station, behind its Ethertype, after so many microseconds.
fn count(summary: &mut ProfinetSummary, station: u16, micros: u64, behind: &[u8]) {
    let [high, low] = station.to_be_bytes();
    let (from, to) = ([2, 0, 0, 0, high, low], [1, 0x0E, 0xCF, 0, 0, 0]);
    let addresses = [from, to].map(MacAddress);
    count_between(summary, &Connections::default(), addresses, micros, behind);
}

fn count_between(
    summary: &mut ProfinetSummary,
    connections: &Connections,
    [from, to]: [MacAddress; 2],
    micros: u64,
    behind: &[u8],
) {
    let octets = [&to.0, &from.0, behind].concat();
    let time = Some(UNIX_EPOCH + Duration::from_micros(micros));
    let (link, length) = (Linktype::ETHERNET, octets.len());
    let captured = Captured { number: 1, time, link, octets: &octets, length };
    let frame = frame(&captured).unwrap();
    let (protocol, fields) = Fields::of(&frame, connections);
    summary.frame(&frame, (protocol, &fields), time);
}

fn cyclic(frame_id: u16, cycle_counter: u16, data_status: u8) -> Vec<u8> {
    let [id, counter] = [frame_id, cycle_counter].map(u16::to_be_bytes);
    [&[0x88, 0x92][..], &id, &[0; 40], &counter, &[data_status, 0]].concat()
}

/// A frame from this end of an alarm connection to that one.
fn alarm([from, to]: [u8; 2], kind: u8) -> Vec<u8> {
    let contents: &[u8] = if kind == 0x14 { &[0xCF, 0x81, 0xFD, 5] } else { &[] };
    let header = [0, to, 0, from, kind, 0x11, 0, 5, 0xFF, 0xFE, 0, contents.len() as u8];
    [&[0x88, 0x92, 0xFE, 0x01][..], &header, contents].concat()
}

#[test]
fn streams_have_a_row_each() {
    let mut summary = ProfinetSummary::default();
    assert!(summary.is_empty());
    for cycle in 0..100_u16 {
        // Cycle 50 is missing, and a problem shows in cycle 60.
        if cycle != 50 {
            let status = if cycle == 60 { 0x15 } else { 0x35 };
            let micros = u64::from(cycle) * 2000;
            count(&mut summary, 9, micros, &cyclic(0x8001, cycle * 64, status));
        }
        let micros = u64::from(cycle) * 1000;
        count(&mut summary, 8, micros, &cyclic(0x8000, cycle * 32, 0x35));
    }
    for kind in [0x11, 0x11, 0x13, 0x14] {
        count(&mut summary, 9, 0, &alarm([2, 1], kind));
    }
    count(&mut summary, 9, 0, &[0x88, 0xCC, 0x06, 2, 0]);
    let call = read_api_data(ByteOrder::Little);
    for octets in [&call, &call[..163]] {
        summary.rpc(&RpcFields::of(octets, [34964; 2]).unwrap());
    }
    let report = summary.report();
    assert_eq!(
        report.to_string(),
        "
PROFINET frames: RT 199, DCP 0, alarms 4, RPC 2, PTCP 0, LLDP 1, MRP 0; malformed: 2.

| AR | From              | To                | Frame ID | Kind       | Frames | Step | Gaps | Interval |   Jitter |     99 % | Status changes | Alarms | Aborts |
|----|-------------------|-------------------|----------|------------|--------|------|------|----------|----------|----------|----------------|--------|--------|
| –  | 02:00:00:00:00:08 | 01:0e:cf:00:00:00 | $8000    | RT class 1 |    100 |   32 |    0 |   1.0 ms | 0.000 ms | 0.000 ms |              0 |      0 |      0 |
| –  | 02:00:00:00:00:09 | 01:0e:cf:00:00:00 | $8001    | RT class 1 |     99 |   64 |    1 |   2.0 ms | 0.000 ms |   2.0 ms |              2 |      0 |      0 |
| –  | 02:00:00:00:00:09 | 01:0e:cf:00:00:00 | $FE01    | alarm low  |      4 |    – |    – |        – |        – |        – |              0 |      2 |      1 |

Streams that are not cut into submodules, since the capture has no Connect of them: 2.
"
    );
    let json: Value = serde_json::to_value(&report).unwrap();
    assert_eq!((&json["frames"]["lldp"], &json["frames"]["rpc"]), (&json!(1), &json!(2)));
    let stream = &json["streams"][1];
    assert_eq!((&stream["usual_step"], &stream["gaps"]), (&json!(64), &json!(1)));
    assert_eq!(stream["usual_interval_seconds"], 0.002);
    assert_eq!(json["streams"][2]["usual_step"], Value::Null);
}

#[test]
fn more_streams_than_there_is_room_for_are_counted_together() {
    let mut summary = ProfinetSummary::default();
    for station in 0..MOST as u16 + 10 {
        for cycle in 0..3 {
            count(&mut summary, station, 0, &cyclic(0x8001, cycle, 0x35));
        }
    }
    let report = summary.report();
    assert_eq!((report.streams.len(), report.frames_of_other_streams), (MOST, 30));
    let end = "\nFrames of more than 1024 streams, without a row: 30.\n";
    assert!(report.to_string().ends_with(end));
}

#[test]
fn streams_of_an_ar_stand_together() {
    let (mut summary, mut connections) = (ProfinetSummary::default(), Connections::default());
    let (input, output) = ([DEVICE, CONTROLLER], [CONTROLLER, DEVICE]);
    // Before any Connect in the capture, then in an AR that breaks, and in the next one.
    for (ar, cycles) in [(None, 2), (Some(8), 10), (Some(7), 20)] {
        if let Some(ar) = ar {
            connect(&mut connections, ar);
        }
        for cycle in 0..cycles {
            let micros = u64::from(cycle) * 1000;
            // The inputs miss one and tell of a problem; some outputs come late.
            if cycle != 4 {
                let inputs = cyclic(0x8001, cycle * 32, if cycle == 6 { 0x15 } else { 0x35 });
                count_between(&mut summary, &connections, input, micros, &inputs);
            }
            let late = if cycle == 7 { 3000 } else { 0 };
            let outputs = cyclic(0x8005, cycle * 32 + u16::from(cycle == 5), 0x35);
            count_between(&mut summary, &connections, output, micros + late, &outputs);
        }
    }
    for (ends, kind) in [([5, 8], 0x11), ([5, 8], 0x14), ([5, 7], 0x11), ([5, 9], 0x11)] {
        count_between(&mut summary, &connections, input, 0, &alarm(ends, kind));
    }
    count_between(&mut summary, &connections, output, 0, &alarm([8, 5], 0x13));

    let report = summary.report();
    let text = report.to_string();
    let row = |line: &str| {
        let cells: Vec<_> = line.split('|').map(str::trim).collect();
        let &[_, ar, from, _, frame_id, _, frames, ..] = &cells[..] else { return None };
        from.starts_with("02:").then(|| [ar, from, frame_id, frames].join(" "))
    };
    assert_eq!(
        text.lines().filter_map(row).collect::<Vec<_>>(),
        [
            "07070707 02:00:00:00:00:09 $8001 19",
            "07070707 02:00:00:00:00:09 $FE01 1",
            "07070707 02:00:00:00:01:00 $8005 20",
            "08080808 02:00:00:00:00:09 $8001 9",
            "08080808 02:00:00:00:00:09 $FE01 2",
            "08080808 02:00:00:00:01:00 $8005 10",
            "08080808 02:00:00:00:01:00 $FE01 1",
            "– 02:00:00:00:00:09 $8001 2",
            "– 02:00:00:00:00:09 $FE01 1",
            "– 02:00:00:00:01:00 $8005 2",
        ]
    );
    let json: Value = serde_json::to_value(&report).unwrap();
    let ars = json["streams"].as_array().unwrap().iter().map(|stream| stream["ar"].clone());
    let [seven, eight] =
        ["07070707-0707-0707-0707-070707070707", "08080808-0808-0808-0808-080808080808"];
    let right = [(json!(seven), 3), (json!(eight), 4), (Value::Null, 3)];
    assert!(ars.eq(right.into_iter().flat_map(|(ar, streams)| iter::repeat_n(ar, streams))));
    let worst = |places: [usize; 2]| {
        let [better, worse] = places.map(|at| json["streams"][at]["jitter_p99_seconds"].as_f64());
        assert!(better < worse, "{better:?} {worse:?}");
        worse
    };
    assert_eq!(
        json["ars"],
        json!([
            {
                "ar": seven, "streams": 3, "frames": 40, "gaps": 3, "data_status_changes": 2,
                "alarms": 1, "aborts": 0, "jitter_p99_seconds": worst([0, 2]),
            },
            {
                "ar": eight, "streams": 4, "frames": 22, "gaps": 3, "data_status_changes": 2,
                "alarms": 1, "aborts": 1, "jitter_p99_seconds": worst([3, 5]),
            },
        ])
    );
}

#[test]
fn ars_without_end_need_no_more_room() {
    let mut summary = ProfinetSummary::default();
    for ar in 0..2 * MOST as u16 {
        let key = Key {
            ar: Some(Uuid::new(ar.into())),
            from: DEVICE,
            to: Some(CONTROLLER),
            frame_id: FrameId(0x8001),
            vlan_id: None,
        };
        assert_eq!(summary.row(key).is_some(), usize::from(ar) < MOST);
    }
    let report = serde_json::to_value(summary.report()).unwrap();
    assert_eq!(report["ars"].as_array().unwrap().len(), MOST);
    assert_eq!(report["frames_of_other_streams"], MOST);
}
