//! What one device is asked, and what its answers mean: the endpoint mapper, I&M0FilterData, I&M of each
//! submodule, the neighbours of each port. No I/O, no time. Invariant: nothing is ever written.
//!
//! Some devices serve records at a port that their endpoint mapper alone knows. Behind a NAT router that
//! port cannot be reached, so the port that the user named is tried first.

use std::net::SocketAddrV4;

use super::assembly::{Added, Assembly};
use super::device::{Device, Submodule, text};
use super::identification;
use crate::profinet::endpoint_mapper::{Handle, InterfaceId, Lookup, LookupAnswer};
use crate::profinet::records::{IM0, IM0_FILTER_DATA};
use crate::profinet::rpc::{Body, Interface, PacketType, ReadImplicit, Rpc};
use crate::profinet::{ByteOrder, ObjectUuid, Octets, Uuid, ndr};

/// Entries of an endpoint mapper that are asked for.
const MOST_ENTRIES: u32 = 16;
/// The last subslot of a port whose neighbours are asked for.
const LAST_PORT: u16 = 0x8020;
/// Octets of the longest record that is asked for.
const RECORD_LENGTH: u32 = 4096;

/// PDPortDataReal.
const PORT_DATA: u16 = 0x802A;
/// The subslot of the first port.
const FIRST_PORT: u16 = 0x8001;

/// What is asked now.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Question {
    Endpoints { handle: Handle },
    Record { api: u32, slot: u16, subslot: u16, index: u16 },
}

/// A device that is being asked.
pub(super) struct Conversation {
    target: SocketAddrV4,
    /// Where the next request goes.
    port: u16,
    /// The port that the endpoint mapper told, until it has been tried.
    mapped_port: Option<u16>,
    object: Uuid,
    /// The one in use comes last. Each begins with sequence number 0, which some devices look at.
    activities: Vec<Uuid>,
    sequence: u32,
    question: Question,
    /// What is asked later: the next one comes last.
    further: Vec<Question>,
    answer: Assembly,
    has_answered: bool,
    is_over: bool,
    device: Device,
}

/// What comes of a datagram.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Came {
    /// It is no answer to the question.
    Nothing,
    /// The answer is on its way. `wants_fack` if the device waits for an acknowledgement.
    MoreToCome { wants_fack: bool },
    /// The question has its answer; the next one can be asked, or the device is done.
    Answered { wants_fack: bool },
}

impl Conversation {
    /// Activities that a conversation may need.
    pub(super) const ACTIVITIES: usize = 3;

    pub(super) fn new(target: SocketAddrV4, activities: [Uuid; Self::ACTIVITIES]) -> Self {
        Self {
            target,
            port: target.port(),
            mapped_port: None,
            object: ObjectUuid { instance: 1, device: 0, vendor: 0 }.to_uuid(),
            activities: activities.into(),
            sequence: 0,
            question: Question::Endpoints { handle: Handle::default() },
            further: Vec::new(),
            answer: Assembly::default(),
            has_answered: false,
            is_over: false,
            device: Device {
                address: Some(*target.ip()),
                asked: Some(target),
                ..Device::default()
            },
        }
    }

    /// Where the request goes.
    pub(super) fn to(&self) -> SocketAddrV4 {
        SocketAddrV4::new(*self.target.ip(), self.port)
    }

    fn activity(&self) -> Uuid {
        self.activities.last().copied().unwrap_or_default()
    }

    /// Writes the request and returns the number of its octets.
    pub(super) fn emit(&self, buffer: &mut [u8]) -> usize {
        let (activity, sequence) = (self.activity(), self.sequence);
        let emitted = match self.question {
            // Some mappers know no other request than one with room for both UUIDs.
            Question::Endpoints { handle } => Lookup {
                object: Some(Uuid::NIL),
                interface: Some(InterfaceId { uuid: Uuid::NIL, major: 0, minor: 0 }),
                ..Lookup::next_of_all(handle)
            }
            .emit(ByteOrder::Little, activity, sequence, buffer),
            Question::Record { api, slot, subslot, index } => ReadImplicit {
                order: ByteOrder::Big,
                object: self.object,
                activity,
                sequence,
                api,
                slot,
                subslot,
                index,
                record_length: RECORD_LENGTH,
                target_ar: Uuid::NIL,
            }
            .emit(buffer),
        };
        emitted.expect("the buffer has room for a request")
    }

    /// Takes a datagram of the device, from any port of it (P-4).
    pub(super) fn receive(&mut self, from: SocketAddrV4, rpc: &Rpc<'_>) -> Came {
        let header = rpc.header();
        let is_answer = from.ip() == self.target.ip()
            && header.activity == self.activity()
            && header.sequence == self.sequence;
        if !is_answer {
            return Came::Nothing;
        }
        match (header.packet_type, rpc.body()) {
            (PacketType::Response, _) => {}
            (PacketType::Fault | PacketType::Reject, Body::Status(code)) => {
                self.has_come(from);
                let words = rpc.body().status_words();
                self.refused(words.map_or_else(|| format!("status {code:#010x}"), str::to_owned));
                return Came::Answered { wants_fack: false };
            }
            (PacketType::Working, _) => return Came::MoreToCome { wants_fack: false },
            _ => return Came::Nothing,
        }
        let wants_fack = header.flags1.is_fragment() && !header.flags1.is_no_fack();
        match self.answer.add(rpc) {
            Added::Ignored => Came::Nothing,
            Added::Known | Added::Waits => Came::MoreToCome { wants_fack },
            Added::Whole => {
                self.has_come(from);
                self.answered();
                Came::Answered { wants_fack }
            }
        }
    }

    fn has_come(&mut self, from: SocketAddrV4) {
        self.has_answered = true;
        self.device.answered_from = Some(from.port());
    }

    /// A response is whole.
    fn answered(&mut self) {
        let answer = std::mem::take(&mut self.answer);
        match self.question {
            Question::Endpoints { .. } => match LookupAnswer::read(answer.stub()) {
                Ok(answer) => self.endpoints(&answer),
                Err(_) => self.begin_reading(),
            },
            Question::Record { .. } => {
                if let Err(why) = self.record(answer.stub()) {
                    self.refused(why);
                }
            }
        }
    }

    fn endpoints(&mut self, answer: &LookupAnswer<'_>) {
        let is_device = |tower: Option<Uuid>| tower == Some(Interface::Device.uuid());
        for entry in answer.entries() {
            self.device.annotation = self.device.annotation.take().or(text(entry.annotation));
            let Some(tower) = entry.tower.filter(|tower| is_device(tower.interface())) else {
                continue;
            };
            if let Some(node) = ObjectUuid::of(entry.object) {
                self.object = entry.object;
                self.device.vendor_id = Some(node.vendor);
                self.device.device_id = Some(node.device);
            }
            self.mapped_port =
                tower.udp_port().filter(|port| ![0, self.target.port()].contains(port));
        }
        let is_last = answer.status != 0 || answer.handle == Handle::default();
        if is_last || self.sequence + 1 >= MOST_ENTRIES {
            return self.begin_reading();
        }
        self.question = Question::Endpoints { handle: answer.handle };
        self.sequence += 1;
    }

    fn begin_reading(&mut self) {
        self.begin_activity();
        self.question = Question::Record { api: 0, slot: 0, subslot: 1, index: IM0_FILTER_DATA };
    }

    /// The next activity. The last one is kept.
    fn begin_activity(&mut self) {
        if self.activities.len() > 1 {
            self.activities.pop();
        }
        self.sequence = 0;
        self.answer = Assembly::default();
    }

    /// The answer to a read. Otherwise says why it is none.
    fn record(&mut self, stub: Octets<'_>) -> Result<(), String> {
        let Question::Record { api, slot, subslot, index } = self.question else { return Ok(()) };
        let response =
            ndr::Response::read(stub).map_err(|error| format!("malformed answer: {error}"))?;
        if !response.status.is_ok() {
            return Err(response.status.to_string());
        }
        let record = identification::record(response.args).filter(|record| record.index == index);
        let record = record.ok_or("the answer has no such record")?;
        let is_same_place = (record.slot, record.subslot) == (slot, subslot);
        if !is_same_place && index != IM0_FILTER_DATA {
            return Err("the answer is from another slot".to_owned());
        }
        identification::note(&mut self.device, &record);
        match index {
            IM0_FILTER_DATA => self.ask_each_submodule(),
            IM0 => {
                let supported = identification::supported(&record);
                let further = (1..=5).rev().filter(|number| supported & 1 << number != 0);
                let further = further.map(|number| Question::Record {
                    api,
                    slot,
                    subslot,
                    index: IM0 + number,
                });
                self.further.extend(further);
            }
            PORT_DATA if subslot < LAST_PORT => {
                self.further.push(Question::Record { api, slot, subslot: subslot + 1, index });
            }
            _ => {}
        }
        self.next_question();
        Ok(())
    }

    /// Plans I&M0 of each submodule that the filter data name, and the neighbours behind that.
    fn ask_each_submodule(&mut self) {
        let index = PORT_DATA;
        self.further.push(Question::Record { api: 0, slot: 0, subslot: FIRST_PORT, index });
        if self.device.submodules.is_empty() {
            self.further.push(Question::Record { api: 0, slot: 0, subslot: 1, index: IM0 });
        }
        let questions = self.device.submodules.iter().rev().map(|submodule| {
            let Submodule { api, slot, subslot, .. } = *submodule;
            Question::Record { api, slot, subslot, index: IM0 }
        });
        self.further.extend(questions);
    }

    /// The device answered, but not what was asked.
    fn refused(&mut self, why: String) {
        let question = self.question;
        match question {
            Question::Endpoints { .. } => self.begin_reading(),
            Question::Record { index: IM0_FILTER_DATA, .. } if self.try_mapped_port() => {}
            Question::Record { index: IM0_FILTER_DATA, .. } => {
                self.ask_each_submodule();
                self.next_question();
            }
            Question::Record { index, .. } => {
                if index == IM0 {
                    self.device.error.get_or_insert(why);
                }
                self.next_question();
            }
        }
    }

    /// Nobody answered the question, however often it was asked.
    pub(super) fn silent(&mut self) {
        let question = self.question;
        match question {
            Question::Endpoints { .. } => self.begin_reading(),
            Question::Record { index: IM0_FILTER_DATA, .. } if self.try_mapped_port() => {}
            // What is silent now would be silent for each further question, too.
            Question::Record { .. } => {
                if self.has_answered {
                    self.device.error.get_or_insert_with(|| "no answer any more".to_owned());
                }
                self.further.clear();
                self.next_question();
            }
        }
    }

    /// Asks again at the port that the endpoint mapper told, if that is another one.
    fn try_mapped_port(&mut self) -> bool {
        let Some(port) = self.mapped_port.take() else { return false };
        self.port = port;
        self.begin_activity();
        true
    }

    fn next_question(&mut self) {
        self.answer = Assembly::default();
        self.sequence += 1;
        match self.further.pop() {
            Some(question) => self.question = question,
            None => self.is_over = true,
        }
    }

    /// Whether there is nothing more to ask.
    pub(super) fn is_over(&self) -> bool {
        self.is_over
    }

    /// What is known of the device; none if nothing answered.
    pub(super) fn into_device(self) -> Option<Device> {
        self.has_answered.then_some(self.device)
    }
}
