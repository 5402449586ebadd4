use std::time::{Duration, UNIX_EPOCH};

use pcap_parser::Linktype;
use serde_json::{Value, json};

use super::super::Connections;
use super::super::ethernet::frame;
use super::super::rpc::tests::read_api_data;
use super::*;
use crate::cli::decode::capture::Captured;
use crate::profinet::ByteOrder;

/// Counts a frame of this station, behind its Ethertype, after so many microseconds.
fn count(summary: &mut ProfinetSummary, station: u16, micros: u64, behind: &[u8]) {
    let [high, low] = station.to_be_bytes();
    let octets = [&[1, 0x0E, 0xCF, 0, 0, 0, 2, 0, 0, 0, high, low][..], behind].concat();
    let time = Some(UNIX_EPOCH + Duration::from_micros(micros));
    let (link, length) = (Linktype::ETHERNET, octets.len());
    let captured = Captured { number: 1, time, link, octets: &octets, length };
    let frame = frame(&captured).unwrap();
    let connections = Connections::default();
    let (protocol, fields) = Fields::of(&frame, &connections);
    summary.frame(&frame, (protocol, &fields), time);
}

fn cyclic(frame_id: u16, cycle_counter: u16, data_status: u8) -> Vec<u8> {
    let [id, counter] = [frame_id, cycle_counter].map(u16::to_be_bytes);
    [&[0x88, 0x92][..], &id, &[0; 40], &counter, &[data_status, 0]].concat()
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
    let alarm = |kind: u8| {
        let contents: &[u8] = if kind == 0x14 { &[0xCF, 0x81, 0xFD, 5] } else { &[] };
        let header = [0, 1, 0, 2, kind, 0x11, 0, 5, 0xFF, 0xFE, 0, contents.len() as u8];
        [&[0x88, 0x92, 0xFE, 0x01][..], &header, contents].concat()
    };
    for kind in [0x11, 0x11, 0x13, 0x14] {
        count(&mut summary, 9, 0, &alarm(kind));
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

| From              | To                | Frame ID | Kind       | Frames | Step | Gaps | Interval |   Jitter |     99 % | Status changes | Alarms | Aborts |
|-------------------|-------------------|----------|------------|--------|------|------|----------|----------|----------|----------------|--------|--------|
| 02:00:00:00:00:08 | 01:0e:cf:00:00:00 | $8000    | RT class 1 |    100 |   32 |    0 |   1.0 ms | 0.000 ms | 0.000 ms |              0 |      0 |      0 |
| 02:00:00:00:00:09 | 01:0e:cf:00:00:00 | $8001    | RT class 1 |     99 |   64 |    1 |   2.0 ms | 0.000 ms |   2.0 ms |              2 |      0 |      0 |
| 02:00:00:00:00:09 | 01:0e:cf:00:00:00 | $FE01    | alarm low  |      4 |    – |    – |        – |        – |        – |              0 |      2 |      1 |

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
