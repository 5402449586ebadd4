//! What a capture says of devices: answers to others that read their records, and of endpoint mappers.
//! Nobody is asked. Invariant: what is kept has a limit, whatever the capture holds.

use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddr};

use super::assembly::{Added, Assembly};
use super::device::{Device, text};
use super::identification;
use crate::cli::decode::Seen;
use crate::profinet::endpoint_mapper::{LOOKUP, LookupAnswer};
use crate::profinet::rpc::{Header, Interface, PacketType, ReadImplicit, Rpc};
use crate::profinet::{ObjectUuid, Uuid, ndr};

/// Devices that are kept.
const MOST_DEVICES: usize = 4096;
/// Answers that wait for more of their fragments.
const MOST_ANSWERS: usize = 64;
/// Read, in a connection.
const READ: u16 = 2;

/// The devices so far.
#[derive(Default)]
pub(super) struct Passive {
    devices: Vec<Device>,
    /// The oldest first.
    answers: VecDeque<(Call, Assembly)>,
    /// Devices that were too many.
    pub(super) left_out: u64,
}

/// Which call an answer belongs to.
type Call = (Ipv4Addr, Uuid, u32);

impl Passive {
    /// Takes what stands in a capture.
    pub(super) fn note(&mut self, seen: &Seen<'_>) {
        match *seen {
            Seen::Udp { from: SocketAddr::V4(from), octets } => {
                if let Ok(rpc) = Rpc::parse(octets) {
                    self.answer(*from.ip(), &rpc);
                }
            }
            Seen::Udp { .. } => {}
        }
    }

    fn answer(&mut self, from: Ipv4Addr, rpc: &Rpc<'_>) {
        let header = rpc.header();
        let call = (Interface::of(header.interface), header.operation);
        let is_known = matches!(
            call,
            (Some(Interface::Device), READ | ReadImplicit::OPERATION)
                | (Some(Interface::EndpointMapper), LOOKUP)
        );
        if header.packet_type != PacketType::Response || !is_known {
            return;
        }
        let call = (from, header.activity, header.sequence);
        let open = self.answers.iter().position(|(other, _)| *other == call);
        let mut answer =
            open.and_then(|at| self.answers.remove(at)).map_or_else(Assembly::default, |it| it.1);
        match answer.add(rpc) {
            Added::Ignored if open.is_none() => {}
            Added::Ignored | Added::Known | Added::Waits => {
                if self.answers.len() == MOST_ANSWERS {
                    self.answers.pop_front();
                }
                self.answers.push_back((call, answer));
            }
            Added::Whole => self.whole(from, header, &answer),
        }
    }

    fn whole(&mut self, from: Ipv4Addr, header: &Header, answer: &Assembly) {
        if Interface::of(header.interface) == Some(Interface::EndpointMapper) {
            let Ok(answer) = LookupAnswer::read(answer.stub()) else { return };
            for entry in answer.entries() {
                let Some(device) = self.by_address(from) else { return };
                device.annotation = text(entry.annotation).or(device.annotation.take());
                numbers(device, entry.object);
            }
            return;
        }
        let Ok(response) = ndr::Response::read(answer.stub()) else { return };
        let Some(record) = identification::record(response.args) else { return };
        if !identification::is_of_interest(record.index) {
            return;
        }
        let Some(device) = self.by_address(from) else { return };
        identification::note(device, &record);
        numbers(device, header.object);
    }

    fn by_address(&mut self, address: Ipv4Addr) -> Option<&mut Device> {
        if let Some(at) = self.devices.iter().position(|device| device.address == Some(address)) {
            return self.devices.get_mut(at);
        }
        if self.devices.len() == MOST_DEVICES {
            self.left_out += 1;
            return None;
        }
        self.devices.push(Device { address: Some(address), ..Device::default() });
        self.devices.last_mut()
    }

    /// The devices, in any order.
    pub(super) fn into_devices(self) -> Vec<Device> {
        self.devices
    }
}

/// Vendor and device, as the object UUID says. Who does not know them asks with 0.
fn numbers(device: &mut Device, object: Uuid) {
    if let Some(node) = ObjectUuid::of(object).filter(|node| node.vendor != 0) {
        device.vendor_id.get_or_insert(node.vendor);
        device.device_id.get_or_insert(node.device);
    }
}
