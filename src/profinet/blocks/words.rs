//! Words and parts of the numbers in blocks (IEC 61158-6-10, 5.2).

use super::super::view::{Value, word};

pub(super) fn ar_type(number: u64) -> Value<'static> {
    word(
        number,
        &[
            (0x01, "IO controller AR"),
            (0x03, "IO controller AR, configuration in run"),
            (0x05, "IO controller AR, redundant"),
            (0x06, "IO supervisor AR"),
            (0x10, "IO controller AR, RT_CLASS_3"),
            (0x20, "IO controller AR, system redundancy"),
        ],
    )
}

pub(super) fn ar_properties(number: u64) -> Value<'static> {
    Value::Bits(
        number,
        &[
            ("state", 0, 3),
            ("supervisor_takeover_allowed", 3, 1),
            ("parameterization_server", 4, 1),
            ("device_access", 8, 1),
            ("companion_ar", 9, 2),
            ("acknowledge_companion_ar", 11, 1),
            ("time_aware_system", 28, 1),
            ("combined_object_container", 29, 1),
            ("startup_mode", 30, 1),
            ("pull_module_alarm_allowed", 31, 1),
        ],
    )
}

pub(super) fn iocr_type(number: u64) -> Value<'static> {
    word(
        number,
        &[(1, "input"), (2, "output"), (3, "multicast provider"), (4, "multicast consumer")],
    )
}

pub(super) fn iocr_properties(number: u64) -> Value<'static> {
    Value::Bits(
        number,
        &[
            ("rt_class", 0, 4),
            ("media_redundancy", 11, 1),
            ("fast_forwarding_mac_adr", 29, 1),
            ("distributed_subframe_watchdog", 30, 1),
            ("full_subframe_structure", 31, 1),
        ],
    )
}

pub(super) fn tag_header(number: u64) -> Value<'static> {
    Value::Bits(number, &[("vlan", 0, 12), ("priority", 13, 3)])
}

pub(super) fn alarm_cr_properties(number: u64) -> Value<'static> {
    Value::Bits(number, &[("priority", 0, 1), ("transport", 1, 1)])
}

pub(super) fn submodule_properties(number: u64) -> Value<'static> {
    Value::Bits(
        number,
        &[
            ("type", 0, 2),
            ("shared_input", 2, 1),
            ("reduce_input_submodule_data_length", 3, 1),
            ("reduce_output_submodule_data_length", 4, 1),
            ("discard_ioxs", 5, 1),
        ],
    )
}

pub(super) fn data_description(number: u64) -> Value<'static> {
    word(number, &[(1, "input"), (2, "output")])
}

pub(super) fn module_state(number: u64) -> Value<'static> {
    word(number, &[(0, "no module"), (1, "wrong module"), (2, "proper module"), (3, "substitute")])
}

/// Bit 15 says that the others are parts. Without it they are one number, as before version 2.
pub(super) fn submodule_state(number: u64) -> Value<'static> {
    if number & 0x8000 == 0 {
        return Value::Bits(number, &[("detail", 0, 15), ("format_indicator", 15, 1)]);
    }
    Value::Bits(
        number,
        &[
            ("add_info", 0, 3),
            ("advice", 3, 1),
            ("maintenance_required", 4, 1),
            ("maintenance_demanded", 5, 1),
            ("fault", 6, 1),
            ("ar_info", 7, 4),
            ("ident_info", 11, 4),
            ("format_indicator", 15, 1),
        ],
    )
}

pub(super) fn control_command(number: u64) -> Value<'static> {
    Value::Bits(
        number,
        &[
            ("prm_end", 0, 1),
            ("application_ready", 1, 1),
            ("release", 2, 1),
            ("done", 3, 1),
            ("ready_for_companion", 4, 1),
            ("ready_for_rt_class_3", 5, 1),
            ("prm_begin", 6, 1),
        ],
    )
}

pub(super) fn im_supported(number: u64) -> Value<'static> {
    Value::Bits(
        number,
        &[("im1", 1, 1), ("im2", 2, 1), ("im3", 3, 1), ("im4", 4, 1), ("im5", 5, 1)],
    )
}

pub(super) fn maintenance_status(number: u64) -> Value<'static> {
    Value::Bits(number, &[("required", 0, 1), ("demanded", 1, 1)])
}

pub(super) fn substitution_mode(number: u64) -> Value<'static> {
    word(number, &[(0, "zero"), (1, "last value"), (2, "replacement value")])
}

pub(super) fn ioxs(number: u64) -> Value<'static> {
    Value::Bits(number, &[("extension", 0, 1), ("instance", 5, 2), ("data_state", 7, 1)])
}

pub(super) fn multiple_interface_mode(number: u64) -> Value<'static> {
    Value::Bits(number, &[("name_of_device", 0, 1)])
}

pub(super) fn link_state_port(number: u64) -> Value<'static> {
    word(
        number,
        &[
            (0, "unknown"),
            (1, "disabled or discarding"),
            (2, "blocking"),
            (3, "listening"),
            (4, "learning"),
            (5, "forwarding"),
            (6, "broken"),
        ],
    )
}

pub(super) fn link_state_link(number: u64) -> Value<'static> {
    word(
        number,
        &[
            (1, "up"),
            (2, "down"),
            (3, "testing"),
            (4, "unknown"),
            (5, "dormant"),
            (6, "not present"),
            (7, "lower layer down"),
        ],
    )
}

pub(super) fn media_type(number: u64) -> Value<'static> {
    word(number, &[(0, "unknown"), (1, "copper"), (2, "fiber"), (3, "radio")])
}

/// The numbers of RFC 4836 (dot3MauType) that the standard uses.
pub(super) fn mau_type(number: u64) -> Value<'static> {
    word(
        number,
        &[
            (0x00, "radio"),
            (0x05, "10BASE-T"),
            (0x0A, "10BASE-T half duplex"),
            (0x0B, "10BASE-T full duplex"),
            (0x0C, "10BASE-FL half duplex"),
            (0x0D, "10BASE-FL full duplex"),
            (0x0F, "100BASE-TX half duplex"),
            (0x10, "100BASE-TX full duplex"),
            (0x11, "100BASE-FX half duplex"),
            (0x12, "100BASE-FX full duplex"),
            (0x15, "1000BASE-X half duplex"),
            (0x16, "1000BASE-X full duplex"),
            (0x17, "1000BASE-LX half duplex"),
            (0x18, "1000BASE-LX full duplex"),
            (0x19, "1000BASE-SX half duplex"),
            (0x1A, "1000BASE-SX full duplex"),
            (0x1D, "1000BASE-T half duplex"),
            (0x1E, "1000BASE-T full duplex"),
            (0x1F, "10GBASE-FX"),
            (0x2E, "100BASE-LX10"),
            (0x36, "100BASE-PX full duplex"),
            (0x8D, "10BASE-T1L"),
        ],
    )
}

pub(super) fn alarm_type(number: u64) -> Value<'static> {
    word(
        number,
        &[
            (0x01, "diagnosis"),
            (0x02, "process"),
            (0x03, "pull"),
            (0x04, "plug"),
            (0x05, "status"),
            (0x06, "update"),
            (0x07, "redundancy"),
            (0x08, "controlled by supervisor"),
            (0x09, "released"),
            (0x0A, "plug wrong submodule"),
            (0x0B, "return of submodule"),
            (0x0C, "diagnosis disappears"),
            (0x0D, "multicast communication mismatch"),
            (0x0E, "port data change"),
            (0x0F, "sync data changed"),
            (0x10, "isochronous mode problem"),
            (0x11, "network component problem"),
            (0x12, "time data changed"),
            (0x13, "dynamic frame packing problem"),
            (0x14, "MRPD problem"),
            (0x15, "multiple interface mismatch"),
            (0x1E, "upload and retrieval"),
            (0x1F, "pull module"),
        ],
    )
}

pub(super) fn alarm_specifier(number: u64) -> Value<'static> {
    Value::Bits(
        number,
        &[
            ("sequence_number", 0, 11),
            ("channel_diagnosis", 11, 1),
            ("manufacturer_specific_diagnosis", 12, 1),
            ("submodule_diagnosis_state", 13, 1),
            ("ar_diagnosis_state", 15, 1),
        ],
    )
}

pub(super) fn mrp_role(number: u64) -> Value<'static> {
    word(number, &[(0, "no redundancy"), (1, "client"), (2, "manager"), (3, "manager or client")])
}

pub(super) fn mrp_check(number: u64) -> Value<'static> {
    Value::Bits(number, &[("mrm", 0, 1), ("domain_uuid", 1, 1)])
}

pub(super) fn mrp_ring_state(number: u64) -> Value<'static> {
    word(number, &[(0, "open"), (1, "closed")])
}

pub(super) fn subframe_data(number: u64) -> Value<'static> {
    Value::Bits(number, &[("position", 0, 7), ("length", 8, 8)])
}

pub(super) fn sr_properties(number: u64) -> Value<'static> {
    Value::Bits(number, &[("input_valid_on_backup_ar", 0, 1), ("mode", 2, 1)])
}

pub(super) fn fs_hello_mode(number: u64) -> Value<'static> {
    word(
        number,
        &[(0, "off"), (1, "when a link comes up"), (2, "when a link comes up, after a delay")],
    )
}

pub(super) fn fs_parameter_mode(number: u64) -> Value<'static> {
    word(number, &[(0, "off"), (1, "on")])
}
