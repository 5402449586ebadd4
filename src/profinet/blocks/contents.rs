//! Which view reads which block.

use super::super::Malformed;
use super::super::diagnosis::DiagnosisData;
use super::super::view::{Show, Value, View};
use super::*;

/// Makes the enum and what chooses among its variants: number, lower part of the version.
macro_rules! contents {
    ($($view:ident $(<$life:lifetime>)?: $pattern:pat,)*) => {
        /// What a block holds.
        #[derive(Clone, Copy, Debug)]
        pub enum Contents<'a> {
            $(#[doc = concat!("See [`", stringify!($view), "`].")] $view($view $(<$life>)?),)*
            /// See [`DiagnosisData`].
            DiagnosisData(DiagnosisData<'a>),
            /// Octets of another block.
            Other(&'a [u8]),
        }

        impl<'a> Contents<'a> {
            pub(super) fn of(block: &Block<'a>) -> Result<Self, Malformed> {
                let mut octets = block.octets();
                Ok(match (block.block_type, block.version.1) {
                    $($pattern => Self::$view(View::read(&mut octets)?),)*
                    (0x0010, version) => {
                        Self::DiagnosisData(DiagnosisData::read(octets, version > 0)?)
                    }
                    _ => Self::Other(octets.rest()),
                })
            }
        }

        impl Show for Contents<'_> {
            fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
                match self {
                    $(Self::$view(view) => view.show(visit),)*
                    Self::DiagnosisData(data) => data.show(visit),
                    Self::Other(octets) => visit("octets", Value::Octets(octets)),
                }
            }
        }
    };
}

contents! {
    AlarmNotification<'a>: (0x0001 | 0x0002, _),
    AlarmAck: (0x8001 | 0x8002, _),
    IodWriteReqHeader: (0x0008, _),
    IodWriteResHeader: (0x8008, _),
    IodReadReqHeader: (0x0009, _),
    IodReadResHeader: (0x8009, _),
    RealIdentificationSlots<'a>: (0x0012 | 0x0013, 0),
    RealIdentificationData<'a>: (0x0012 | 0x0013, _),
    SubstituteValue<'a>: (0x0014, _),
    LogBookData<'a>: (0x0019, _),
    ApiData<'a>: (0x001A, _),
    Im0<'a>: (0x0020, _),
    Im1<'a>: (0x0021, _),
    Im2<'a>: (0x0022, _),
    Im3<'a>: (0x0023, _),
    Im4<'a>: (0x0024, _),
    Im5<'a>: (0x0025, _),
    FilterData<'a>: (0x0030..=0x0032, _),
    Im5Data<'a>: (0x0034, _),
    ArBlockReq<'a>: (0x0101, _),
    ArBlockRes: (0x8101, _),
    IoCrBlockReq<'a>: (0x0102, _),
    IoCrBlockRes: (0x8102, _),
    AlarmCrBlockReq: (0x0103, _),
    AlarmCrBlockRes: (0x8103, _),
    ExpectedSubmoduleBlockReq<'a>: (0x0104, _),
    ModuleDiffBlock<'a>: (0x8104, _),
    PrmServerBlock<'a>: (0x0105, _),
    McrBlockReq<'a>: (0x0106, _),
    ArServerBlock<'a>: (0x8106, _),
    ArRpcBlock: (0x0107 | 0x8107, _),
    ArVendorBlock<'a>: (0x0108 | 0x8108, _),
    ControlBlock: (0x0110..=0x0114 | 0x0116..=0x0118 | 0x8110..=0x8114 | 0x8116..=0x8118, _),
    SubmoduleListBlock<'a>: (0x0119, _),
    IrInfoBlock<'a>: (0x0109, _),
    SrInfoBlock: (0x010A, _),
    RsInfoBlock: (0x010C, _),
    FastStartUp<'a>: (0x010B | 0x0608 | 0x0609, _),
    FsHelloBlock: (0x0600, _),
    FsParameterBlock: (0x0601, _),
    MrpAdjust<'a>: (0x0211, 0),
    MrpCheck: (0x0213, 0),
    MrpInstances<'a>: (0x0211 | 0x0213, _),
    PortMrp: (0x0214 | 0x0215, 0),
    PortMrpInstance: (0x0214 | 0x0215, _),
    MrpManagerParams: (0x0216, _),
    MrpClientParams: (0x0217, _),
    MrpRingStateData: (0x0219, _),
    MrpInstanceAdjust<'a>: (0x0231, _),
    MrpInstanceCheck: (0x0233, _),
    PortBlocks<'a>: (0x0200 | 0x0202, _),
    CheckPeers<'a>: (0x020A, _),
    CheckMauType: (0x020C, _),
    AdjustMauType: (0x020E, _),
    PdPortDataReal<'a>: (0x020F, _),
    PdInterfaceDataReal<'a>: (0x0240, _),
    InterfaceAdjust: (0x0250, _),
    PdPortStatistic: (0x0251, _),
    MultipleBlock<'a>: (0x0400, _),
    MaintenanceItem: (0x0F00, _),
}
