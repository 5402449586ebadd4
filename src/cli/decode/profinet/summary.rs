//! What a capture has shown of PROFINET, stream by stream. A stream is what one station sends to another
//! with one frame ID. Invariant: at most [`MOST`] have a row of their own.

use std::collections::HashMap;
use std::fmt::{self, Display};
use std::hash::{Hash, Hasher};
use std::time::SystemTime;

use comfy_table::CellAlignment;
use foldhash::fast::RandomState;
use serde::Serialize;

use super::ethernet::{Ethernet, Vlan};
use super::streams::Stream;
use super::words::Shown;
use super::{Fields, Protocol, RpcFields};
use crate::cli::output::{duration, table};
use crate::profinet::MacAddress;
use crate::profinet::alarm::PduType;
use crate::profinet::rt::{FrameId, FrameKind};

/// Streams with a row of their own; the others share one.
const MOST: usize = 1024;

/// Whose frames they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Key {
    from: MacAddress,
    to: Option<MacAddress>,
    frame_id: FrameId,
    /// With planned duplication, the same frame goes both ways round the ring on two VLANs.
    vlan_id: Option<u16>,
}

impl Hash for Key {
    /// In two numbers, since this is done for each frame. Both kinds of absence are numbers that are free.
    fn hash<H: Hasher>(&self, state: &mut H) {
        let number = |MacAddress([a, b, c, d, e, f]), high: u16| {
            let [g, h] = high.to_be_bytes();
            u64::from_be_bytes([g, h, a, b, c, d, e, f])
        };
        let to = self.to.unwrap_or(MacAddress([0; MacAddress::LEN]));
        state.write_u64(number(self.from, self.frame_id.0));
        state.write_u64(number(to, self.vlan_id.unwrap_or(u16::MAX)));
    }
}

/// Counts of a capture.
#[derive(Debug, Default)]
pub(in crate::cli::decode) struct ProfinetSummary {
    /// By the number of the protocol.
    frames: [u64; Protocol::ALL.len()],
    malformed: u64,
    rows: Vec<Row>,
    /// The place of a stream's row.
    places: HashMap<Key, usize, RandomState>,
    /// Frames of streams without a row.
    others: u64,
}

#[derive(Debug)]
struct Row {
    key: Key,
    stream: Stream,
    /// Whether its Connect is known.
    has_submodules: bool,
    /// DATA frames of an alarm connection.
    alarms: u64,
    /// ERR frames of an alarm connection.
    aborts: u64,
}

impl Row {
    fn new(key: Key) -> Self {
        Self { key, stream: Stream::default(), has_submodules: false, alarms: 0, aborts: 0 }
    }
}

impl ProfinetSummary {
    /// Counts a frame.
    pub(in crate::cli::decode) fn frame(
        &mut self,
        frame: &Ethernet<'_>,
        (protocol, fields): (Protocol, &Fields<'_>),
        time: Option<SystemTime>,
    ) {
        self.frames[protocol as usize] += 1;
        self.malformed += u64::from(fields.fault().is_some());
        let vlan_id = frame.vlan.as_ref().map(Vlan::id);
        let key = |frame_id| Key { from: frame.from, to: frame.to, frame_id, vlan_id };
        if let Some((frame_id, status)) = fields.stream()
            && let Some(row) = self.row(key(frame_id))
        {
            row.stream.frame(status, time);
            row.has_submodules |= fields.has_submodules();
        }
        if let Some((frame_id, kind)) = fields.alarm()
            && let Some(row) = self.row(key(frame_id))
        {
            row.stream.frames += 1;
            row.alarms += u64::from(kind == PduType::Data);
            row.aborts += u64::from(kind == PduType::Error);
        }
    }

    /// Counts a datagram of RPC.
    pub(in crate::cli::decode) fn rpc(&mut self, fields: &RpcFields<'_>) {
        self.frames[Protocol::ProfinetRpc as usize] += 1;
        self.malformed += u64::from(fields.fault().is_some());
    }

    /// None, and counted, for a stream that has no room.
    fn row(&mut self, key: Key) -> Option<&mut Row> {
        let next = self.rows.len();
        let place = match self.places.get(&key) {
            Some(&place) => place,
            None if next < MOST => {
                self.places.insert(key, next);
                self.rows.push(Row::new(key));
                next
            }
            None => {
                self.others += 1;
                return None;
            }
        };
        self.rows.get_mut(place)
    }

    /// Whether there was a frame.
    pub(in crate::cli::decode) fn is_empty(&self) -> bool {
        self.frames.iter().all(|&count| count == 0)
    }

    /// As it is printed.
    pub(in crate::cli::decode) fn report(&self) -> ProfinetReport {
        let mut rows: Vec<_> = self.rows.iter().collect();
        rows.sort_by_key(|row| row.key);
        let of = |protocol: Protocol| self.frames[protocol as usize];
        ProfinetReport {
            frames: Frames {
                rt: of(Protocol::ProfinetRt),
                dcp: of(Protocol::ProfinetDcp),
                alarm: of(Protocol::ProfinetAlarm),
                rpc: of(Protocol::ProfinetRpc),
                ptcp: of(Protocol::Ptcp),
                lldp: of(Protocol::Lldp),
                mrp: of(Protocol::Mrp),
            },
            malformed: self.malformed,
            streams: rows.into_iter().map(StreamReport::of).collect(),
            frames_of_other_streams: self.others,
        }
    }
}

/// A summary as it is printed.
#[derive(Debug, Serialize)]
pub(in crate::cli::decode) struct ProfinetReport {
    frames: Frames,
    malformed: u64,
    streams: Vec<StreamReport>,
    frames_of_other_streams: u64,
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

#[derive(Debug, Serialize)]
struct StreamReport {
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

impl StreamReport {
    fn of(row: &Row) -> Self {
        let Row { key, stream, has_submodules, alarms, aborts } = row;
        let is_cyclic = matches!(key.frame_id.kind(), FrameKind::Cyclic(_));
        let (steps, jitter) = (stream.steps(), stream.jitter());
        Self {
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
            // Addresses begin with a figure, and are none.
            for column in [0, 1] {
                if let Some(addresses) = table.column_mut(column) {
                    addresses.set_cell_alignment(CellAlignment::Left);
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

#[cfg(test)]
mod tests;
