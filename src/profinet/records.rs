//! Records: what an index means, and what slots and subslots are (P-9).
//!
//! Indexes up to 0x7FFF are the device's own. Above them the highest digits say for what a record is:
//! a subslot, a slot, an AR, an application process, or the device.

use super::view::Value;

/// I&M0: who made the device.
pub const IM0: u16 = 0xAFF0;
/// The application processes of a device.
pub const API_DATA: u16 = 0xF821;
/// Which modules are plugged, of one application process.
pub const REAL_IDENTIFICATION_DATA: u16 = 0xF000;
/// Which submodules have I&M of their own.
pub const IM0_FILTER_DATA: u16 = 0xF840;
/// Interface and ports as they are.
pub const PD_REAL_DATA: u16 = 0xF841;
/// What the device remembers.
pub const LOG_BOOK_DATA: u16 = 0xF830;
/// All diagnosis of the device.
pub const DEVICE_DIAGNOSIS: u16 = 0xF80C;

/// What a record is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// As the device's description says.
    User,
    /// One subslot.
    Subslot,
    /// One slot.
    Slot,
    /// One connection.
    Ar,
    /// One application process.
    Api,
    /// The whole device.
    Device,
}

impl Scope {
    /// What a record with this index is for.
    pub fn of(index: u16) -> Self {
        match index {
            0x0000..=0x7FFF => Self::User,
            0x8000..=0xBFFF => Self::Subslot,
            0xC000..=0xDFFF => Self::Slot,
            0xE000..=0xEFFF => Self::Ar,
            0xF000..=0xF7FF => Self::Api,
            0xF800.. => Self::Device,
        }
    }
}

/// The standard's name of the record with this index; none if it is not known.
pub fn record_name(index: u16) -> Option<&'static str> {
    let place = RECORDS.binary_search_by_key(&index, |(index, _)| *index).ok()?;
    Some(RECORDS[place].1)
}

/// An index and its name.
pub(super) fn word(index: u64) -> Value<'static> {
    Value::Word(index, u16::try_from(index).ok().and_then(record_name))
}

/// Whether a record is made of blocks. Others mean what the device or a profile says.
pub fn has_blocks(index: u16) -> bool {
    let is_of_profile = matches!(index, 0x80A0 | 0x80D0 | 0xB02E | 0xB02F);
    !is_of_profile && record_name(index).is_some()
}

/// What a subslot is; none if it is not one of interface and ports.
pub fn subslot_words(subslot: u16) -> Option<Subslot> {
    let interface = (subslot >> 8 & 0x0F) as u8 + 1;
    match (subslot, subslot as u8) {
        (0x8000..=0x8FFF, 0) => Some(Subslot::Interface(interface)),
        (0x8000..=0x8FFF, port) => Some(Subslot::Port { interface, port }),
        _ => None,
    }
}

/// A subslot of the module that is the device itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subslot {
    /// An interface, from 1.
    Interface(u8),
    /// A port of an interface, both from 1.
    Port {
        /// The interface.
        interface: u8,
        /// The port.
        port: u8,
    },
}

impl std::fmt::Display for Subslot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Interface(interface) => write!(f, "interface {interface}"),
            Self::Port { interface, port } => write!(f, "port {port} of interface {interface}"),
        }
    }
}

/// In the order of the indexes.
const RECORDS: [(u16, &str); 129] = [
    (0x8000, "ExpectedIdentificationData"),
    (0x8001, "RealIdentificationData"),
    (0x800A, "DiagnosisData (channels)"),
    (0x800B, "DiagnosisData (all)"),
    (0x800C, "DiagnosisData (with maintenance, qualified, status)"),
    (0x8010, "maintenance required (channels)"),
    (0x8011, "maintenance demanded (channels)"),
    (0x8012, "maintenance required (all)"),
    (0x8013, "maintenance demanded (all)"),
    (0x801E, "SubstituteValue"),
    (0x8020, "PDIRSubframeData"),
    (0x8027, "PDPortDataRealExtended"),
    (0x8028, "RecordInputDataObjectElement"),
    (0x8029, "RecordOutputDataObjectElement"),
    (0x802A, "PDPortDataReal"),
    (0x802B, "PDPortDataCheck"),
    (0x802C, "PDIRData"),
    (0x802D, "PDSyncData"),
    (0x802F, "PDPortDataAdjust"),
    (0x8030, "IsochronousModeData"),
    (0x8031, "PDTimeData"),
    (0x8050, "PDInterfaceMrpDataReal"),
    (0x8051, "PDInterfaceMrpDataCheck"),
    (0x8052, "PDInterfaceMrpDataAdjust"),
    (0x8053, "PDPortMrpDataAdjust"),
    (0x8054, "PDPortMrpDataReal"),
    (0x8055, "PDPortMrpIcDataAdjust"),
    (0x8056, "PDPortMrpIcDataCheck"),
    (0x8057, "PDPortMrpIcDataReal"),
    (0x8060, "PDPortFODataReal"),
    (0x8061, "PDPortFODataCheck"),
    (0x8062, "PDPortFODataAdjust"),
    (0x8063, "PDPortSFPDataCheck"),
    (0x8070, "PDNCDataCheck"),
    (0x8071, "PDInterfaceAdjust"),
    (0x8072, "PDPortStatistic"),
    (0x8080, "PDInterfaceDataReal"),
    (0x8090, "PDInterfaceFSUDataAdjust"),
    (0x80A0, "energy saving"),
    (0x80AF, "PE_EntityStatusData"),
    (0x80B0, "CombinedObjectContainer"),
    (0x80CF, "RS_AdjustObserver"),
    (0x80D0, "condition monitoring"),
    (0x80F0, "TSNNetworkControlDataReal"),
    (0x80F1, "TSNStreamPathData"),
    (0x80F2, "TSNSyncTreeData"),
    (0x80F3, "TSNUploadNetworkAttributes"),
    (0x80F4, "TSNExpectedNetworkAttributes"),
    (0x80F5, "TSNNetworkControlDataAdjust"),
    (0xAFF0, "I&M0"),
    (0xAFF1, "I&M1"),
    (0xAFF2, "I&M2"),
    (0xAFF3, "I&M3"),
    (0xAFF4, "I&M4"),
    (0xAFF5, "I&M5"),
    (0xAFF6, "I&M6"),
    (0xAFF7, "I&M7"),
    (0xAFF8, "I&M8"),
    (0xAFF9, "I&M9"),
    (0xAFFA, "I&M10"),
    (0xAFFB, "I&M11"),
    (0xAFFC, "I&M12"),
    (0xAFFD, "I&M13"),
    (0xAFFE, "I&M14"),
    (0xAFFF, "I&M15"),
    (0xB02E, "PROFIdrive parameters (local)"),
    (0xB02F, "PROFIdrive parameters (global)"),
    (0xC000, "ExpectedIdentificationData"),
    (0xC001, "RealIdentificationData"),
    (0xC00A, "DiagnosisData (channels)"),
    (0xC00B, "DiagnosisData (all)"),
    (0xC00C, "DiagnosisData (with maintenance, qualified, status)"),
    (0xC010, "maintenance required (channels)"),
    (0xC011, "maintenance demanded (channels)"),
    (0xC012, "maintenance required (all)"),
    (0xC013, "maintenance demanded (all)"),
    (0xE000, "ExpectedIdentificationData"),
    (0xE001, "RealIdentificationData"),
    (0xE002, "ModuleDiffBlock"),
    (0xE00A, "DiagnosisData (channels)"),
    (0xE00B, "DiagnosisData (all)"),
    (0xE00C, "DiagnosisData (with maintenance, qualified, status)"),
    (0xE010, "maintenance required (channels)"),
    (0xE011, "maintenance demanded (channels)"),
    (0xE012, "maintenance required (all)"),
    (0xE013, "maintenance demanded (all)"),
    (0xE030, "PE_EntityFilterData"),
    (0xE031, "PE_EntityStatusData"),
    (0xE040, "MultipleWrite"),
    (0xE041, "ApplicationReadyBlock"),
    (0xE050, "ARFSUDataAdjust"),
    (0xE060, "RS_GetEvent"),
    (0xE061, "RS_AckEvent"),
    (0xF000, "RealIdentificationData"),
    (0xF00A, "DiagnosisData (channels)"),
    (0xF00B, "DiagnosisData (all)"),
    (0xF00C, "DiagnosisData (with maintenance, qualified, status)"),
    (0xF010, "maintenance required (channels)"),
    (0xF011, "maintenance demanded (channels)"),
    (0xF012, "maintenance required (all)"),
    (0xF013, "maintenance demanded (all)"),
    (0xF020, "ARData"),
    (0xF80C, "DiagnosisData (with maintenance, qualified, status)"),
    (0xF820, "ARData"),
    (0xF821, "APIData"),
    (0xF830, "LogBookData"),
    (0xF831, "PDevData"),
    (0xF840, "I&M0FilterData"),
    (0xF841, "PDRealData"),
    (0xF842, "PDExpectedData"),
    (0xF850, "AutoConfiguration"),
    (0xF860, "GSD upload"),
    (0xF870, "PE_EntityFilterData"),
    (0xF871, "PE_EntityStatusData"),
    (0xF880, "AssetManagementData"),
    (0xF881, "AssetManagementData"),
    (0xF882, "AssetManagementData"),
    (0xF883, "AssetManagementData"),
    (0xF884, "AssetManagementData"),
    (0xF885, "AssetManagementData"),
    (0xF886, "AssetManagementData"),
    (0xF887, "AssetManagementData"),
    (0xF888, "AssetManagementData"),
    (0xF889, "AssetManagementData"),
    (0xF8F0, "stream add"),
    (0xF8F1, "PDRsiInstances"),
    (0xF8F2, "stream remove"),
    (0xF8F3, "stream renew"),
    (0xFBFF, "RPC connection monitoring"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn p_9_indexes_have_names_and_a_scope() {
        assert!(RECORDS.is_sorted_by(|(one, _), (other, _)| one < other));
        for (index, name, scope) in [
            (0x802B, "PDPortDataCheck", Scope::Subslot),
            (0xAFF0, "I&M0", Scope::Subslot),
            (0xAFF3, "I&M3", Scope::Subslot),
            (0xC001, "RealIdentificationData", Scope::Slot),
            (0xE040, "MultipleWrite", Scope::Ar),
            (0xF000, "RealIdentificationData", Scope::Api),
            (0xF821, "APIData", Scope::Device),
            (0xF830, "LogBookData", Scope::Device),
            (0xF840, "I&M0FilterData", Scope::Device),
            (0xF841, "PDRealData", Scope::Device),
        ] {
            assert_eq!((record_name(index), Scope::of(index)), (Some(name), scope), "{index:#06x}");
            assert!(has_blocks(index));
        }
        assert_eq!((record_name(0x1234), Scope::of(0x1234)), (None, Scope::User));
        assert!([0x1234, 0x9000, 0xB02E, 0xFFFF].iter().all(|index| !has_blocks(*index)));
    }

    #[test]
    fn p_9_subslots_of_interfaces_and_ports_have_words() {
        let words = |subslot| subslot_words(subslot).map(|words| words.to_string());
        assert_eq!(words(0x8000).unwrap(), "interface 1");
        assert_eq!(words(0x8002).unwrap(), "port 2 of interface 1");
        assert_eq!(words(0x8100).unwrap(), "interface 2");
        assert_eq!(words(0x8101).unwrap(), "port 1 of interface 2");
        assert_eq!((words(1), words(0x9000)), (None, None));
    }
}
