//! The blocks of Control and Release: parameters are complete, the application is ready, the AR ends.

use super::super::Uuid;
use super::super::view::{List, Skip, view};
use super::words;

view! {
    /// 0x0110 to 0x0118 and their answers: one step of a connection.
    pub struct ControlBlock {
        /// Reserved.
        reserved: Skip<2>,
        /// The AR.
        ar_uuid: Uuid,
        /// The session key of the AR.
        session_key: u16,
        /// The alarm that the step belongs to, after a module was plugged.
        alarm_sequence_number: u16,
        /// Which step.
        control_command: u16 => words::control_command,
        /// More about the step.
        control_block_properties: u16,
    }
}

view! {
    /// 0x0119: the submodules that a step is for.
    pub struct SubmoduleListBlock<'a> {
        /// The submodules.
        entries: List<'a, SubmoduleListEntry>,
    }
}

view! {
    /// One submodule of a list.
    pub struct SubmoduleListEntry {
        /// The application process.
        api: u32,
        /// The slot.
        slot: u16,
        /// The subslot.
        subslot: u16,
    }
}
