//! Which AR a frame belongs to, and which submodules cyclic data is of. The Connect that made an AR tells it,
//! so it has to be in the capture, with its answer: request for the places, answer for the frame IDs and the
//! device. Alarms are known by the references that both sides gave their ends.
//!
//! Invariant: memory has a bound, whatever the capture holds: [`WAITING`] requests wait for their answer,
//! [`STREAMS`] streams and [`ALARMS`] alarm connections are known, and a stream has at most [`PARTS`] parts.

use std::collections::{HashMap, VecDeque};

use foldhash::fast::RandomState;

use crate::profinet::blocks::{
    Blocks, Contents, DataDescription, ExpectedSubmoduleBlockReq, IoCrApi, IoCrBlockReq,
    IoDataObject,
};
use crate::profinet::rt::FrameId;
use crate::profinet::{MacAddress, Uuid};

/// Requests without an answer so far.
const WAITING: usize = 64;
/// Streams whose submodules are known.
const STREAMS: usize = 1024;
/// Alarm connections whose AR is known.
const ALARMS: usize = 1024;
/// Streams of one connection.
const OF_CONNECTION: usize = 16;
/// Parts of a frame: it has no room for more.
const PARTS: usize = 1440;

/// The directions of data, by the numbers of CR and of data descriptions.
const INPUT: u16 = 1;
const OUTPUT: u16 = 2;

/// The connections of a capture.
#[derive(Debug, Default)]
pub(in crate::cli::decode) struct Connections {
    /// The one that has waited longest first.
    asked: VecDeque<Asked>,
    layouts: HashMap<(MacAddress, MacAddress, FrameId), Layout, RandomState>,
    /// By both ends, the lower one first.
    alarms: HashMap<[End; 2], Uuid, RandomState>,
}

/// An end of an alarm connection, and the reference that it gave itself.
pub(super) type End = (MacAddress, u16);

/// A Connect request.
#[derive(Debug)]
struct Asked {
    ar_uuid: Uuid,
    controller: MacAddress,
    streams: Vec<AskedStream>,
    alarm_reference: Option<u16>,
}

#[derive(Debug)]
struct AskedStream {
    direction: u16,
    reference: u16,
    frame_id: FrameId,
    layout: Layout,
}

/// The AR of cyclic data, and the parts of a frame in the order of their offsets.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub(super) ar: Uuid,
    parts: Vec<Part>,
}

/// Data of a submodule with the provider's status, or a consumer's status alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Part {
    pub(super) api: u32,
    pub(super) slot: u16,
    pub(super) subslot: u16,
    pub(super) offset: usize,
    /// Octets of data; none for a consumer's status.
    pub(super) data_length: Option<usize>,
}

impl Layout {
    pub(super) fn parts(&self) -> &[Part] {
        &self.parts
    }
}

impl Connections {
    /// Learns from the blocks of a Connect request.
    pub(super) fn request(&mut self, blocks: Blocks<'_>) {
        let contents = || blocks.flatten().filter_map(|block| block.contents().ok());
        let ar = contents()
            .find_map(|it| if let Contents::ArBlockReq(ar) = it { Some(ar) } else { None });
        let Some(ar) = ar else { return };
        let mut expected = Expected::default();
        contents().for_each(|it| {
            if let Contents::ExpectedSubmoduleBlockReq(block) = it {
                expected.add(&block);
            }
        });
        expected.0.sort_unstable_by_key(|(place, _)| *place);
        let streams = contents().filter_map(|it| match it {
            Contents::IoCrBlockReq(cr) => Some(AskedStream::of(ar.ar_uuid, &cr, &expected)),
            _ => None,
        });
        let streams = streams.take(OF_CONNECTION).collect();
        let alarm_reference = contents().find_map(|it| match it {
            Contents::AlarmCrBlockReq(cr) => Some(cr.local_alarm_reference),
            _ => None,
        });
        self.asked.retain(|asked| asked.ar_uuid != ar.ar_uuid);
        if self.asked.len() == WAITING {
            self.asked.pop_front();
        }
        let controller = ar.cm_initiator_mac_add;
        self.asked.push_back(Asked { ar_uuid: ar.ar_uuid, controller, streams, alarm_reference });
    }

    /// Learns from the blocks of the answer. A refusal has none.
    pub(super) fn answer(&mut self, blocks: Blocks<'_>) {
        let contents = || blocks.flatten().filter_map(|block| block.contents().ok());
        let ar = contents()
            .find_map(|it| if let Contents::ArBlockRes(ar) = it { Some(ar) } else { None });
        let Some(ar) = ar else { return };
        let place = self.asked.iter().position(|asked| asked.ar_uuid == ar.ar_uuid);
        let Some(asked) = place.and_then(|place| self.asked.remove(place)) else { return };
        let device = ar.cm_responder_mac_add;
        let reference = contents().find_map(|it| match it {
            Contents::AlarmCrBlockRes(cr) => Some(cr.local_alarm_reference),
            _ => None,
        });
        if let Some((of_controller, of_device)) = asked.alarm_reference.zip(reference) {
            let ends = sorted([(asked.controller, of_controller), (device, of_device)]);
            if self.alarms.len() < ALARMS || self.alarms.contains_key(&ends) {
                self.alarms.insert(ends, asked.ar_uuid);
            }
        }
        for stream in asked.streams {
            let given = contents().find_map(|it| match it {
                Contents::IoCrBlockRes(cr) if cr.iocr_reference == stream.reference => {
                    Some(FrameId(cr.frame_id))
                }
                _ => None,
            });
            let (from, to) = match stream.direction {
                INPUT => (device, asked.controller),
                OUTPUT => (asked.controller, device),
                _ => continue,
            };
            let key = (from, to, given.unwrap_or(stream.frame_id));
            if self.layouts.len() < STREAMS || self.layouts.contains_key(&key) {
                self.layouts.insert(key, stream.layout);
            }
        }
    }

    /// The layout of frames between these two; none where their Connect is not known.
    pub(super) fn layout(
        &self,
        from: MacAddress,
        to: Option<MacAddress>,
        frame_id: FrameId,
    ) -> Option<&Layout> {
        if self.layouts.is_empty() {
            return None;
        }
        self.layouts.get(&(from, to?, frame_id))
    }

    /// The AR of an alarm connection between these ends.
    pub(super) fn ar_of_alarms(&self, ends: [End; 2]) -> Option<Uuid> {
        self.alarms.get(&sorted(ends)).copied()
    }
}

fn sorted(mut ends: [End; 2]) -> [End; 2] {
    ends.sort_unstable();
    ends
}

/// API, slot and subslot.
type Place = (u32, u16, u16);

/// The submodules that the controller expects, in the order of their places.
#[derive(Debug, Default)]
struct Expected(Vec<(Place, DataDescription)>);

impl Expected {
    fn add(&mut self, block: &ExpectedSubmoduleBlockReq<'_>) {
        for api in block.apis.iter() {
            for submodule in api.submodules.iter() {
                let place = (api.api, api.slot, submodule.fields.subslot);
                let room = (2 * PARTS).saturating_sub(self.0.len());
                self.0.extend(submodule.descriptions().map(|it| (place, it)).take(room));
            }
        }
    }

    /// How long the data of a submodule is in this direction.
    fn data_length(&self, place: Place, direction: u16) -> Option<usize> {
        let first = self.0.partition_point(|(known, _)| *known < place);
        let of_place = self.0[first..].iter().take_while(|(known, _)| *known == place);
        of_place
            .map(|(_, description)| description)
            .find(|description| description.data_description == direction)
            .map(|description| description.submodule_data_length.into())
    }
}

impl AskedStream {
    fn of(ar: Uuid, cr: &IoCrBlockReq<'_>, expected: &Expected) -> Self {
        let direction = cr.iocr_type;
        let mut parts = Vec::new();
        for api in cr.apis.iter() {
            let IoCrApi { api, io_data_objects, iocs } = api;
            let part = |object: IoDataObject, data_length| Part {
                api,
                slot: object.slot,
                subslot: object.subslot,
                offset: object.frame_offset.into(),
                data_length,
            };
            let data = io_data_objects.iter().filter_map(|object| {
                let place = (api, object.slot, object.subslot);
                let length = expected.data_length(place, direction)?;
                Some(part(object, Some(length)))
            });
            let all = data.chain(iocs.iter().map(|object| part(object, None)));
            let room = PARTS.saturating_sub(parts.len());
            parts.extend(all.take(room));
        }
        parts.sort_by_key(|part| part.offset);
        let frame_id = FrameId(cr.frame_id);
        Self { direction, reference: cr.iocr_reference, frame_id, layout: Layout { ar, parts } }
    }
}

#[cfg(test)]
pub(super) mod tests;
