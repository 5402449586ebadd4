//! What a capture says of devices: answers to others that read their records, of endpoint mappers and of
//! DCP, and what LLDP tells of a port. Nobody is asked. Invariant: what is kept has a limit, whatever the
//! capture holds.

use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddr};

use super::assembly::{Added, Assembly};
use super::device::{Device, text};
use super::identification;
use crate::cli::decode::Seen;
use crate::profinet::dcp::{Dcp, DcpValue, ServiceId, ServiceType};
use crate::profinet::endpoint_mapper::{LOOKUP, LookupAnswer};
use crate::profinet::lldp::{self, Address, Lldp, LldpValue, Names, OrganisationValue};
use crate::profinet::rpc::{Header, Interface, PacketType, ReadImplicit, Rpc};
use crate::profinet::rt::{self, FrameId, FrameKind};
use crate::profinet::{MacAddress, ObjectUuid, Octets, Uuid, ndr};

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
            Seen::Frame { from, ether_type: rt::ETHER_TYPE, octets } => self.rt(from, octets),
            Seen::Frame { from, ether_type: lldp::ETHER_TYPE, octets } => self.lldp(from, octets),
            Seen::Udp { .. } | Seen::Frame { .. } => {}
        }
    }

    /// Answers of DCP, and what a device says when it starts.
    fn rt(&mut self, from: MacAddress, octets: &[u8]) {
        let mut octets = Octets::new(octets);
        let Ok(FrameKind::Dcp(_)) = octets.u16().map(|id| FrameId(id).kind()) else { return };
        let Ok(dcp) = Dcp::parse(octets) else { return };
        let tells = match (dcp.service_id, dcp.service_type) {
            (ServiceId::Hello, _) => true,
            (ServiceId::Identify | ServiceId::Get, service_type) => {
                service_type == ServiceType::Success
            }
            _ => false,
        };
        if !tells {
            return;
        }
        let mut told = Device { mac: Some(from), ..Device::default() };
        for block in dcp.blocks().filter_map(Result::ok) {
            match (block.option, block.suboption, block.value) {
                (1, 2, DcpValue::Ip(ip)) | (1, 3, DcpValue::IpSuite(ip, _)) => {
                    told.address = Some(ip.address).filter(|address| !address.is_unspecified());
                }
                (2, 1, DcpValue::Text(kind)) => told.annotation = text(kind),
                (2, 2, DcpValue::Text(name)) => told.station_name = text(name),
                (2, 3, DcpValue::DeviceId { vendor_id, device_id }) => {
                    (told.vendor_id, told.device_id) = (Some(vendor_id), Some(device_id));
                }
                _ => {}
            }
        }
        self.join(told);
    }

    /// What a port says of itself. The frame comes from the port, which has an address of its own.
    fn lldp(&mut self, from: MacAddress, octets: &[u8]) {
        let (mut chassis, mut port, mut mac) = (None, None, None);
        for tlv in Lldp::new(octets).tlvs().filter_map(Result::ok) {
            match tlv.value {
                LldpValue::ChassisId(id) => match id.value {
                    Address::Text(name) => chassis = Some(name),
                    Address::Mac(address) => mac = mac.or(Some(address)),
                    _ => {}
                },
                LldpValue::PortId(id) => {
                    if let Address::Text(name) = id.value {
                        port = Some(name);
                    }
                }
                LldpValue::Organisation {
                    value: OrganisationValue::ChassisMac(address), ..
                } => {
                    mac = Some(address);
                }
                _ => {}
            }
        }
        let Some(names) = port.and_then(|port| Names::of(chassis.unwrap_or_default(), port)) else {
            return; // not of PROFINET
        };
        self.join(Device {
            mac: mac.or(Some(from)),
            station_name: text(names.station.as_bytes()),
            ports: text(names.port.as_bytes()).into_iter().collect(),
            ..Device::default()
        });
    }

    /// Adds what is told to the device with this MAC address, and to the one that was known by its address
    /// alone.
    fn join(&mut self, mut told: Device) {
        let is_its_address = |device: &Device| {
            device.mac.is_none() && device.address.is_some() && device.address == told.address
        };
        if let Some(at) = self.devices.iter().position(is_its_address) {
            let mut known = self.devices.swap_remove(at);
            known.absorb(told);
            told = known;
        }
        let is_full = self.devices.len() == MOST_DEVICES;
        match self.devices.iter_mut().find(|device| device.mac == told.mac) {
            Some(device) => device.absorb(told),
            None if is_full => self.left_out += 1,
            None => self.devices.push(told),
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
