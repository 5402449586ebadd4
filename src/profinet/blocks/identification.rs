//! Blocks that say what a device is and what is plugged into it: I&M, filter data, identification, APIs.

use super::super::view::{Fixed, List, view};
use super::words;

view! {
    /// 0x0020: who made the device or module, and which one it is (I&M0).
    pub struct Im0<'a> {
        /// The vendor number.
        vendor_id: u16,
        /// What the vendor calls it in orders.
        order_id: Fixed<'a, 20>,
        /// The serial number.
        im_serial_number: Fixed<'a, 16>,
        /// The revision of the hardware.
        im_hardware_revision: u16,
        /// Which kind of software revision: V, R, P, U or T.
        im_revision_prefix: Fixed<'a, 1>,
        /// The revision of the software: functional enhancement.
        im_sw_revision_functional_enhancement: u8,
        /// The revision of the software: bug fix.
        im_revision_bugfix: u8,
        /// The revision of the software: internal change.
        im_sw_revision_internal_change: u8,
        /// Counts changes of the configuration.
        im_revision_counter: u16,
        /// The profile.
        im_profile_id: u16,
        /// The kind of device in the profile.
        im_profile_specific_type: u16,
        /// The version of I&M, major.
        im_version_major: u8,
        /// The version of I&M, minor.
        im_version_minor: u8,
        /// Which other I&M records there are: bit 1 is I&M1, and so on.
        im_supported: u16 => words::im_supported,
    }
}

view! {
    /// 0x0021: what the plant calls the device (I&M1).
    pub struct Im1<'a> {
        /// What it is for.
        im_tag_function: Fixed<'a, 32>,
        /// Where it is.
        im_tag_location: Fixed<'a, 22>,
    }
}

view! {
    /// 0x0022: when the device was installed (I&M2).
    pub struct Im2<'a> {
        /// `YYYY-MM-DD HH:MM`.
        im_date: Fixed<'a, 16>,
    }
}

view! {
    /// 0x0023: what the plant says about the device (I&M3).
    pub struct Im3<'a> {
        /// Any text.
        im_descriptor: Fixed<'a, 54>,
    }
}

view! {
    /// 0x0024: the signature of a safe device (I&M4).
    pub struct Im4<'a> {
        /// Its octets.
        im_signature: &'a [u8],
    }
}

view! {
    /// 0x0025: what parts of others are inside (I&M5).
    pub struct Im5<'a> {
        /// Blocks 0x0034, one for each part.
        entries: List<'a, super::Block<'a>>,
    }
}

view! {
    /// 0x0034: one part of I&M5.
    pub struct Im5Data<'a> {
        /// What it is.
        im_annotation: Fixed<'a, 64>,
        /// What its vendor calls it in orders.
        im_order_id: Fixed<'a, 64>,
        /// Its vendor's number.
        vendor_id: u16,
        /// Its serial number.
        im_serial_number: Fixed<'a, 16>,
        /// The revision of its hardware.
        im_hardware_revision: u16,
        /// Which kind of software revision.
        im_revision_prefix: Fixed<'a, 1>,
        /// The revision of its software: functional enhancement.
        im_sw_revision_functional_enhancement: u8,
        /// The revision of its software: bug fix.
        im_revision_bugfix: u8,
        /// The revision of its software: internal change.
        im_sw_revision_internal_change: u8,
    }
}

view! {
    /// 0x0030 to 0x0032: which submodules, modules or devices have I&M of their own.
    pub struct FilterData<'a> {
        /// By application process.
        apis: List<'a, FilterApi<'a>>,
    }
}

view! {
    /// What of one application process has I&M.
    pub struct FilterApi<'a> {
        /// The application process.
        api: u32,
        /// Its modules.
        modules: List<'a, IdentifiedModule<'a>>,
    }
}

view! {
    /// A module that has I&M, or whose submodules have.
    pub struct IdentifiedModule<'a> {
        /// The slot.
        slot: u16,
        /// Which module.
        module_ident_number: u32,
        /// Its submodules.
        submodules: List<'a, IdentifiedSubslot>,
    }
}

view! {
    /// 0x0012 and 0x0013, version 1.0: which modules are expected or plugged.
    pub struct RealIdentificationSlots<'a> {
        /// The slots of all application processes.
        slots: List<'a, IdentifiedSlot<'a>>,
    }
}

view! {
    /// 0x0012 and 0x0013, version 1.1: which modules are expected or plugged.
    pub struct RealIdentificationData<'a> {
        /// By application process.
        apis: List<'a, RealApi<'a>>,
    }
}

view! {
    /// The slots of one application process.
    pub struct RealApi<'a> {
        /// The application process.
        api: u32,
        /// Its slots.
        slots: List<'a, IdentifiedSlot<'a>>,
    }
}

view! {
    /// A slot and its module.
    pub struct IdentifiedSlot<'a> {
        /// The slot.
        slot: u16,
        /// Which module.
        module_ident_number: u32,
        /// Its subslots.
        subslots: List<'a, IdentifiedSubslot>,
    }
}

view! {
    /// A subslot and its submodule.
    pub struct IdentifiedSubslot {
        /// The subslot.
        subslot: u16,
        /// Which submodule.
        submodule_ident_number: u32,
    }
}

view! {
    /// 0x001A: the application processes of a device.
    pub struct ApiData<'a> {
        /// Their numbers.
        apis: List<'a, u32>,
    }
}
