//! The fields of header and body by name.

use super::super::ByteOrder;
use super::super::status::nca_words;
use super::super::uuid::ObjectUuid;
use super::super::view::{Each, Show, Value};
use super::{
    Body, CancelAck, Fack, Flags1, Flags2, Header, Interface, Quit, Representation, operation_name,
};

impl Show for Header {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        let packet_type = self.packet_type;
        visit("packet_type", Value::Word(packet_type as u64, Some(packet_type.name())));
        visit("flags1", Value::Bits(self.flags1.0.into(), Flags1::PARTS));
        visit("flags2", Value::Bits(self.flags2.0.into(), Flags2::PARTS));
        visit("data_representation", Value::Fields(&self.representation));
        visit("serial", Value::Number(self.serial.into()));
        visit("object", Value::Display(&self.object));
        if let Some(node) = ObjectUuid::of(self.object) {
            visit("object_node", Value::Fields(&node));
        }
        visit("interface", Value::Display(&self.interface));
        let interface = Interface::of(self.interface);
        if let Some(interface) = interface {
            visit("interface_name", Value::Display(&interface.name()));
        }
        visit("activity", Value::Display(&self.activity));
        visit("server_boot", Value::Number(self.server_boot.into()));
        visit("interface_version", Value::Number(self.interface_version.into()));
        visit("sequence", Value::Number(self.sequence.into()));
        let operation = interface.and_then(|interface| operation_name(interface, self.operation));
        visit("opnum", Value::Word(self.operation.into(), operation));
        visit("interface_hint", Value::Number(self.interface_hint.into()));
        visit("activity_hint", Value::Number(self.activity_hint.into()));
        visit("fragment", Value::Number(self.fragment_number.into()));
        visit("auth_protocol", Value::Number(self.auth_protocol.into()));
    }
}

impl Flags1 {
    const PARTS: &[(&str, u32, u32)] = &[
        ("last_fragment", 1, 1),
        ("fragment", 2, 1),
        ("no_fack", 3, 1),
        ("maybe", 4, 1),
        ("idempotent", 5, 1),
        ("broadcast", 6, 1),
    ];
}

impl Flags2 {
    const PARTS: &[(&str, u32, u32)] = &[("cancel_pending", 1, 1)];
}

impl Show for Representation {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        let is_little = self.order == ByteOrder::Little;
        let order = if is_little { "little-endian" } else { "big-endian" };
        visit("byte_order", Value::Display(&order));
        visit("characters", Value::Display(if self.ebcdic { &"EBCDIC" } else { &"ASCII" }));
        let float = ["IEEE", "VAX", "Cray", "IBM"].get(usize::from(self.floating_point));
        visit("floating_point", Value::Word(self.floating_point.into(), float.copied()));
    }
}

impl Show for ObjectUuid {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        visit("instance", Value::Number(self.instance.into()));
        visit("device_id", Value::Number(self.device.into()));
        visit("vendor_id", Value::Number(self.vendor.into()));
    }
}

/// Stub data are left out: what they are depends on the interface, and on other fragments.
impl Show for Body<'_> {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        match self {
            Self::Stub(_) | Self::Empty | Self::Fack(None) | Self::CancelAck(None) => {}
            Self::Fack(Some(fack)) => visit("fack", Value::Fields(fack)),
            Self::Status(status) => {
                visit("nca_status", Value::Word((*status).into(), nca_words(*status)));
            }
            Self::Quit(Quit { version, cancel_id }) => {
                visit("cancel_version", Value::Number((*version).into()));
                visit("cancel_id", Value::Number((*cancel_id).into()));
            }
            Self::CancelAck(Some(CancelAck { version, cancel_id, is_accepting })) => {
                visit("cancel_version", Value::Number((*version).into()));
                visit("cancel_id", Value::Number((*cancel_id).into()));
                visit("cancel_is_accepting", Value::Number((*is_accepting).into()));
            }
        }
    }
}

impl Show for Fack<'_> {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        visit("version", Value::Number(self.version.into()));
        visit("window_size", Value::Number(self.window_size.into()));
        visit("max_tsdu", Value::Number(self.max_tsdu.into()));
        visit("max_fragment_size", Value::Number(self.max_fragment_size.into()));
        visit("serial", Value::Number(self.serial.into()));
        visit("masks", Value::List(self));
    }
}

impl Each for Fack<'_> {
    fn each(&self, visit: &mut dyn FnMut(Value<'_>)) {
        self.masks().for_each(|mask| visit(Value::Number(mask.into())));
    }
}
