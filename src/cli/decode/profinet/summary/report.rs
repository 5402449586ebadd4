//! The summary of PROFINET as it is printed: as text, and as JSON.
//!
//! JSON has sums for each AR too. Text has them row by row: the streams of an AR stand side by side.

use std::fmt::{self, Display};

use comfy_table::CellAlignment;
use serde::Serialize;

use super::super::Protocol;
use super::super::words::Shown;
use super::{MOST, ProfinetSummary, Row};
use crate::cli::output::{Hex, duration, table};
use crate::profinet::rt::FrameKind;
use crate::profinet::{MacAddress, Uuid};

/// A summary as it is printed.
#[derive(Debug, Serialize)]
pub(in crate::cli::decode) struct ProfinetReport {
    frames: Frames,
    malformed: u64,
    /// Those that have a stream.
    ars: Vec<ArReport>,
    /// Those of one AR are side by side, and those without one are the last.
    pub(super) streams: Vec<StreamReport>,
    pub(super) frames_of_other_streams: u64,
}

impl ProfinetReport {
    pub(super) fn of(summary: &ProfinetSummary) -> Self {
        let mut rows: Vec<_> = summary.rows.iter().collect();
        rows.sort_by_key(|row| (row.key.ar.is_none(), row.key));
        let of_one_ar = rows.chunk_by(|one, next| one.key.ar == next.key.ar);
        let of = |protocol: Protocol| summary.frames[protocol as usize];
        Self {
            frames: Frames {
                rt: of(Protocol::ProfinetRt),
                dcp: of(Protocol::ProfinetDcp),
                alarm: of(Protocol::ProfinetAlarm),
                rpc: of(Protocol::ProfinetRpc),
                ptcp: of(Protocol::Ptcp),
                lldp: of(Protocol::Lldp),
                mrp: of(Protocol::Mrp),
            },
            malformed: summary.malformed,
            ars: of_one_ar.filter_map(ArReport::of).collect(),
            streams: rows.iter().map(|row| StreamReport::of(row)).collect(),
            frames_of_other_streams: summary.others,
        }
    }
}

/// By protocol.
#[derive(Debug, Serialize)]
struct Frames {
    rt: u64,
    dcp: u64,
    alarm: u64,
    rpc: u64,
    ptcp: u64,
    lldp: u64,
    mrp: u64,
}

/// Sums of the streams of an AR.
#[derive(Debug, Serialize)]
struct ArReport {
    ar: Shown<Uuid>,
    streams: usize,
    frames: u64,
    /// Null where no stream has a step.
    gaps: Option<u64>,
    data_status_changes: u64,
    alarms: u64,
    aborts: u64,
    /// Of the stream whose jitter is the worst.
    jitter_p99_seconds: Option<f64>,
}

#[derive(Debug, Serialize)]
pub(super) struct StreamReport {
    /// Null where the Connect is not in the capture.
    ar: Option<Shown<Uuid>>,
    from: Shown<MacAddress>,
    to: Option<Shown<MacAddress>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    vlan_id: Option<u16>,
    frame_id: u16,
    frame_id_name: &'static str,
    frames: u64,
    /// Of cyclic data: by how much the cycle counter goes on, in units of 31.25 µs.
    usual_step: Option<u16>,
    /// Steps that differ from it.
    gaps: Option<u64>,
    usual_interval_seconds: Option<f64>,
    jitter_median_seconds: Option<f64>,
    jitter_p99_seconds: Option<f64>,
    data_status_changes: u64,
    /// Null of alarms; false where the Connect is not in the capture.
    has_submodules: Option<bool>,
    alarms: u64,
    aborts: u64,
}

impl ArReport {
    /// None for streams without an AR.
    fn of(rows: &[&Row]) -> Option<Self> {
        let ar = rows.first()?.key.ar?;
        let sum = |count: fn(&Row) -> u64| rows.iter().map(|row| count(row)).sum();
        let gaps = rows.iter().filter_map(|row| row.stream.steps()).map(|(_, gaps)| gaps);
        let jitters = rows.iter().filter_map(|row| row.stream.jitter());
        Some(Self {
            ar: Shown(ar),
            streams: rows.len(),
            frames: sum(|row| row.stream.frames),
            gaps: gaps.reduce(|one, other| one + other),
            data_status_changes: sum(|row| row.stream.status_changes),
            alarms: sum(|row| row.alarms),
            aborts: sum(|row| row.aborts),
            jitter_p99_seconds: jitters.map(|jitter| jitter.p99).reduce(f64::max),
        })
    }
}

impl StreamReport {
    fn of(row: &Row) -> Self {
        let Row { key, stream, has_submodules, alarms, aborts } = row;
        let is_cyclic = matches!(key.frame_id.kind(), FrameKind::Cyclic(_));
        let (steps, jitter) = (stream.steps(), stream.jitter());
        Self {
            ar: key.ar.map(Shown),
            from: Shown(key.from),
            to: key.to.map(Shown),
            vlan_id: key.vlan_id,
            frame_id: key.frame_id.0,
            frame_id_name: key.frame_id.name(),
            frames: stream.frames,
            usual_step: steps.map(|(usual, _)| usual),
            gaps: steps.map(|(_, gaps)| gaps),
            usual_interval_seconds: jitter.map(|it| it.usual_interval),
            jitter_median_seconds: jitter.map(|it| it.median),
            jitter_p99_seconds: jitter.map(|it| it.p99),
            data_status_changes: stream.status_changes,
            has_submodules: is_cyclic.then_some(*has_submodules),
            alarms: *alarms,
            aborts: *aborts,
        }
    }

    fn cells(&self) -> Vec<String> {
        fn or_dash(value: Option<impl Display>) -> String {
            value.map_or("–".to_owned(), |value| value.to_string())
        }
        vec![
            or_dash(self.ar.map(|Shown(ar)| short(ar))),
            self.from.to_string(),
            or_dash(self.to),
            format!("${:04X}", self.frame_id),
            self.frame_id_name.to_owned(),
            self.frames.to_string(),
            or_dash(self.usual_step),
            or_dash(self.gaps),
            duration(self.usual_interval_seconds),
            duration(self.jitter_median_seconds),
            duration(self.jitter_p99_seconds),
            self.data_status_changes.to_string(),
            self.alarms.to_string(),
            self.aborts.to_string(),
        ]
    }
}

impl Display for ProfinetReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Frames { rt, dcp, alarm, rpc, ptcp, lldp, mrp } = self.frames;
        writeln!(
            f,
            "\nPROFINET frames: RT {rt}, DCP {dcp}, alarms {alarm}, RPC {rpc}, PTCP {ptcp}, LLDP \
             {lldp}, MRP {mrp}; malformed: {}.",
            self.malformed
        )?;
        if !self.streams.is_empty() {
            let rows: Vec<_> = self.streams.iter().map(StreamReport::cells).collect();
            let mut table = table(
                [
                    "AR",
                    "From",
                    "To",
                    "Frame ID",
                    "Kind",
                    "Frames",
                    "Step",
                    "Gaps",
                    "Interval",
                    "Jitter",
                    "99 %",
                    "Status changes",
                    "Alarms",
                    "Aborts",
                ],
                &rows,
            );
            // UUIDs and addresses may begin with a figure, and are none.
            for column in [0, 1, 2] {
                if let Some(names) = table.column_mut(column) {
                    names.set_cell_alignment(CellAlignment::Left);
                }
            }
            writeln!(f, "\n{table}")?;
        }
        let uncut = self.streams.iter().filter(|stream| stream.has_submodules == Some(false));
        let mut notes = Vec::new();
        match uncut.count() {
            0 => {}
            uncut => notes.push(format!(
                "Streams that are not cut into submodules, since the capture has no Connect of \
                 them: {uncut}."
            )),
        }
        match self.frames_of_other_streams {
            0 => {}
            others => {
                notes.push(format!("Frames of more than {MOST} streams, without a row: {others}."));
            }
        }
        if !notes.is_empty() {
            writeln!(f)?;
        }
        notes.iter().try_for_each(|note| writeln!(f, "{note}"))
    }
}

/// The first eight digits are enough for people.
fn short(ar: Uuid) -> String {
    let [a, b, c, d, ..] = ar.octets();
    Hex(&[a, b, c, d]).to_string()
}
