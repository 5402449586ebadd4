//! The blocks of alarms: what happened at a submodule, and that somebody has seen it.

use super::super::diagnosis::{self, DiagnosisEntry};
use super::super::view::{Rest, Show, Value, View, view};
use super::super::{Malformed, Octets, PnioStatus};
use super::{Block, words};

view! {
    /// 0x0001 (high priority) and 0x0002 (low): what happened at a submodule.
    pub struct AlarmNotification<'a> {
        /// What happened.
        alarm_type: u16 => words::alarm_type,
        /// The application process.
        api: u32,
        /// The slot.
        slot: u16,
        /// The subslot.
        subslot: u16,
        /// The module that is plugged.
        module_ident_number: u32,
        /// The submodule that is plugged.
        submodule_ident_number: u32,
        /// Which alarm it is, and what diagnosis is left.
        alarm_specifier: u16 => words::alarm_specifier,
        /// More about it.
        items: Rest<'a, AlarmItem<'a>>,
    }
}

view! {
    /// 0x8001 (high priority) and 0x8002 (low): the alarm has been seen.
    pub struct AlarmAck {
        /// What happened.
        alarm_type: u16 => words::alarm_type,
        /// The application process.
        api: u32,
        /// The slot.
        slot: u16,
        /// The subslot.
        subslot: u16,
        /// Which alarm it is.
        alarm_specifier: u16 => words::alarm_specifier,
        /// Whether it was accepted.
        status: PnioStatus,
    }
}

/// One item of an alarm: a structure, by its identifier (USI).
#[derive(Clone, Copy, Debug)]
pub struct AlarmItem<'a> {
    /// How the octets behind it are to be read (P-10).
    pub user_structure_identifier: u16,
    /// What they say.
    pub contents: AlarmItemContents<'a>,
}

/// What an item of an alarm says.
#[derive(Clone, Copy, Debug)]
pub enum AlarmItemContents<'a> {
    /// One diagnosis of a channel.
    Diagnosis(DiagnosisEntry),
    /// A block: maintenance, upload, parameters.
    Block(Block<'a>),
    /// What the manufacturer or a profile says, up to the end of the alarm.
    Octets(Octets<'a>),
}

impl<'a> View<'a> for AlarmItem<'a> {
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        let user_structure_identifier = octets.u16()?;
        let contents = match DiagnosisEntry::read(user_structure_identifier, octets)? {
            Some(entry) => AlarmItemContents::Diagnosis(entry),
            None if matches!(user_structure_identifier, 0x8100 | 0x8200 | 0x8201) => {
                AlarmItemContents::Block(Block::read(octets)?)
            }
            None => AlarmItemContents::Octets(octets.part(octets.len())?),
        };
        Ok(Self { user_structure_identifier, contents })
    }

    fn value(&self) -> Value<'_> {
        Value::Fields(self)
    }
}

impl Show for AlarmItem<'_> {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        visit(
            "user_structure_identifier",
            diagnosis::user_structure_identifier(self.user_structure_identifier.into()),
        );
        match &self.contents {
            AlarmItemContents::Diagnosis(entry) => entry.show(visit),
            AlarmItemContents::Block(block) => visit("block", Value::Fields(block)),
            AlarmItemContents::Octets(octets) => visit("data", Value::Octets(octets.rest())),
        }
    }
}
