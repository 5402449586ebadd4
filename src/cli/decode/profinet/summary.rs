//! What a capture has shown of PROFINET, stream by stream. A stream is what one station sends to another
//! with one frame ID, in one AR. `report` prints it. Invariant: at most [`MOST`] have a row of their own, so
//! there are no more ARs than that.

mod report;

use std::collections::HashMap;
use std::hash::{Hash, Hasher};
use std::time::SystemTime;

use foldhash::fast::RandomState;

use super::ethernet::{Ethernet, Vlan};
use super::streams::Stream;
use super::{Fields, Protocol, RpcFields};
use crate::profinet::alarm::PduType;
use crate::profinet::rt::FrameId;
use crate::profinet::{MacAddress, Uuid};

pub(in crate::cli::decode) use report::ProfinetReport;

/// Streams with a row of their own; the others share one.
const MOST: usize = 1024;

/// Whose frames they are. Its order has the streams of an AR side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Key {
    /// None where the Connect is not known.
    ar: Option<Uuid>,
    from: MacAddress,
    to: Option<MacAddress>,
    frame_id: FrameId,
    /// With planned duplication, the same frame goes both ways round the ring on two VLANs.
    vlan_id: Option<u16>,
}

impl Hash for Key {
    /// In three numbers, since this is done for each frame. An absence is a number that is free, or at least
    /// rare.
    fn hash<H: Hasher>(&self, state: &mut H) {
        let number = |MacAddress([a, b, c, d, e, f]), high: u16| {
            let [g, h] = high.to_be_bytes();
            u64::from_be_bytes([g, h, a, b, c, d, e, f])
        };
        let to = self.to.unwrap_or(MacAddress([0; MacAddress::LEN]));
        state.write_u64(number(self.from, self.frame_id.0));
        state.write_u64(number(to, self.vlan_id.unwrap_or(u16::MAX)));
        state.write_u128(u128::from_be_bytes(self.ar.unwrap_or(Uuid::NIL).octets()));
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
    /// Whether it was cut into submodules.
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
        let ar = fields.ar();
        let key = |frame_id| Key { ar, from: frame.from, to: frame.to, frame_id, vlan_id };
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
        ProfinetReport::of(self)
    }
}

#[cfg(test)]
mod tests;
