//! Blocks about a device in service: maintenance, its log, and the values that replace missing data.

use super::super::view::{Align, List, view};
use super::super::{PnioStatus, Uuid};
use super::words;

view! {
    /// 0x0F00: whether somebody should come, in an alarm.
    pub struct MaintenanceItem {
        /// Padding.
        padding: Align,
        /// How soon.
        maintenance_status: u32 => words::maintenance_status,
    }
}

view! {
    /// 0x0019: what the device remembers.
    pub struct LogBookData<'a> {
        /// The device's clock now, in its own units.
        actual_local_time_stamp: u64,
        /// Its entries.
        entries: List<'a, LogEntry>,
    }
}

view! {
    /// One entry of a log.
    pub struct LogEntry {
        /// The device's clock then, in its own units.
        local_time_stamp: u64,
        /// The connection that it was about.
        ar_uuid: Uuid,
        /// What happened.
        status: PnioStatus,
        /// More about it, as the vendor says.
        entry_detail: u32,
    }
}

view! {
    /// 0x0014: the value of an output that gets no data.
    pub struct SubstituteValue<'a> {
        /// Where it comes from.
        substitution_mode: u16 => words::substitution_mode,
        /// Consumer status.
        iocs: u8 => words::ioxs,
        /// The value and its provider status.
        data: &'a [u8],
    }
}
