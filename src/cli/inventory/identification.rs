//! What the blocks of an answer say about a device: I&M, filter data, real identification, neighbours.

use super::device::{Device, MOST_PARTS, Neighbour, Part, Product, Submodule, text};
use crate::cli::output::Hex;
use crate::profinet::Octets;
use crate::profinet::blocks::{
    Block, Blocks, Contents, IdentifiedSubslot, Im0, Im5Data, PdPortDataReal, Record,
};

/// RealIdentificationData; 0x0012 looks the same, and says what is expected.
const REAL_IDENTIFICATION: u16 = 0x0013;

/// A record that was read: where it is from, and its blocks.
pub(super) struct ReadRecord<'a> {
    pub(super) slot: u16,
    pub(super) subslot: u16,
    pub(super) index: u16,
    pub(super) blocks: Blocks<'a>,
}

/// The record in the arguments of a successful answer; none if there is no record of blocks.
pub(super) fn record(args: Octets<'_>) -> Option<ReadRecord<'_>> {
    let header = Blocks::new(args).next()?.ok()?;
    let Contents::IodReadResHeader(place) = header.contents().ok()? else { return None };
    let Some(Record::Blocks(blocks)) = header.record() else { return None };
    Some(ReadRecord { slot: place.slot, subslot: place.subslot, index: place.index, blocks })
}

/// Whether a record may say something that stands in an inventory: I&M, filter data, real identification
/// and the ports, of one submodule or of all.
pub(super) fn is_of_interest(index: u16) -> bool {
    matches!(index, 0xAFF0..=0xAFF5 | 0xF840 | 0xF000 | 0xE001 | 0x802A | 0xF841)
}

/// Notes all that the blocks of a record say.
pub(super) fn note(device: &mut Device, record: &ReadRecord<'_>) {
    for block in record.blocks.filter_map(Result::ok) {
        note_block(device, (record.slot, record.subslot), &block);
    }
}

/// Which further I&M a submodule has: bit 1 for I&M1, and so on.
pub(super) fn supported(record: &ReadRecord<'_>) -> u16 {
    let supported = record.blocks.filter_map(Result::ok).find_map(|block| match block.contents() {
        Ok(Contents::Im0(im0)) => Some(im0.im_supported),
        _ => None,
    });
    supported.unwrap_or_default()
}

fn note_block(device: &mut Device, place: (u16, u16), block: &Block<'_>) {
    match block.contents() {
        Ok(Contents::FilterData(data)) => {
            for api in data.apis.iter() {
                for module in api.modules.iter() {
                    let ident = module.module_ident_number;
                    plugged(device, (api.api, module.slot, ident), module.submodules.iter());
                }
            }
        }
        Ok(Contents::RealIdentificationData(data)) if block.block_type == REAL_IDENTIFICATION => {
            for api in data.apis.iter() {
                for slot in api.slots.iter() {
                    let ident = slot.module_ident_number;
                    plugged(device, (api.api, slot.slot, ident), slot.subslots.iter());
                }
            }
        }
        Ok(Contents::RealIdentificationSlots(data)) if block.block_type == REAL_IDENTIFICATION => {
            for slot in data.slots.iter() {
                plugged(device, (0, slot.slot, slot.module_ident_number), slot.subslots.iter());
            }
        }
        Ok(Contents::PdPortDataReal(port)) => neighbours(device, &port),
        // Blocks inside blocks: only ports are looked for there.
        Ok(Contents::MultipleBlock(several)) => {
            for block in several.blocks.iter() {
                if let Ok(Contents::PdPortDataReal(port)) = block.contents() {
                    neighbours(device, &port);
                }
            }
        }
        Ok(contents) if (0x0020..=0x0025).contains(&block.block_type) => {
            if let Some(submodule) = device.submodule(place.0, place.1) {
                im(submodule, &contents);
            }
        }
        _ => {}
    }
}

/// A module (application process, slot, number) and its submodules.
fn plugged(
    device: &mut Device,
    (api, slot, module): (u32, u16, u32),
    submodules: impl Iterator<Item = IdentifiedSubslot>,
) {
    for IdentifiedSubslot { subslot, submodule_ident_number } in submodules {
        if let Some(submodule) = device.submodule(slot, subslot) {
            submodule.api = api;
            submodule.module_ident = Some(module);
            submodule.submodule_ident = Some(submodule_ident_number);
        }
    }
}

/// What LLDP told the device about the other end of the cable.
fn neighbours(device: &mut Device, port: &PdPortDataReal<'_>) {
    for peer in port.peers.iter() {
        let neighbour = Neighbour {
            port: text(port.own_port_id.0),
            station_name: text(peer.peer_chassis_id.0),
            their_port: text(peer.peer_port_id.0),
        };
        device.neighbour(neighbour);
    }
}

/// I&M0 to I&M5.
fn im(submodule: &mut Submodule, contents: &Contents<'_>) {
    match contents {
        Contents::Im0(im0) => submodule.product = product(im0),
        Contents::Im1(im1) => {
            submodule.function = text(im1.im_tag_function.0);
            submodule.location = text(im1.im_tag_location.0);
        }
        Contents::Im2(im2) => submodule.installed = text(im2.im_date.0),
        Contents::Im3(im3) => submodule.descriptor = text(im3.im_descriptor.0),
        Contents::Im4(im4) => {
            let is_set = im4.im_signature.iter().any(|octet| *octet != 0);
            submodule.signature = is_set.then(|| Hex(im4.im_signature).to_string());
        }
        Contents::Im5(im5) => {
            let parts = im5.entries.iter().filter_map(|block| match block.contents() {
                Ok(Contents::Im5Data(part)) => Some(self::part(&part)),
                _ => None,
            });
            submodule.parts = parts.take(MOST_PARTS).collect();
        }
        _ => {}
    }
}

fn product(im0: &Im0<'_>) -> Product {
    let parts = (
        im0.im_sw_revision_functional_enhancement,
        im0.im_revision_bugfix,
        im0.im_sw_revision_internal_change,
    );
    Product {
        vendor_id: Some(im0.vendor_id),
        order_id: text(im0.order_id.0),
        serial_number: text(im0.im_serial_number.0),
        hardware_revision: Some(im0.im_hardware_revision),
        software_revision: software_revision(im0.im_revision_prefix.0, parts),
    }
}

fn part(part: &Im5Data<'_>) -> Part {
    let parts = (
        part.im_sw_revision_functional_enhancement,
        part.im_revision_bugfix,
        part.im_sw_revision_internal_change,
    );
    let product = Product {
        vendor_id: Some(part.vendor_id),
        order_id: text(part.im_order_id.0),
        serial_number: text(part.im_serial_number.0),
        hardware_revision: Some(part.im_hardware_revision),
        software_revision: software_revision(part.im_revision_prefix.0, parts),
    };
    Part { annotation: text(part.im_annotation.0), product }
}

/// `V1.20.3`.
fn software_revision(prefix: &[u8], (major, minor, internal): (u8, u8, u8)) -> Option<String> {
    Some(format!("{}{major}.{minor}.{internal}", text(prefix).unwrap_or_default()))
}
