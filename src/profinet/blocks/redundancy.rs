//! Blocks about the ways of frames and about fast starts: media redundancy (P-12), IR, system redundancy,
//! fast start-up.

use super::super::Uuid;
use super::super::view::{Align, List, Rest, Skip, Text, view};
use super::{Block, words};

view! {
    /// 0x0211, version 1.0: the ring that an interface is to be in.
    pub struct MrpAdjust<'a> {
        /// Padding.
        padding: Align,
        /// The ring.
        mrp_domain_uuid: Uuid,
        /// Client or manager.
        mrp_role: u16 => words::mrp_role,
        /// Padding.
        padding2: Align,
        /// The name of the ring.
        mrp_domain_name: Text<'a, 1>,
        /// Padding.
        padding3: Align,
        /// Parameters of client or manager.
        blocks: Rest<'a, Block<'a>>,
    }
}

view! {
    /// 0x0213, version 1.0: what is checked about the ring.
    pub struct MrpCheck {
        /// Padding.
        padding: Align,
        /// The ring.
        mrp_domain_uuid: Uuid,
        /// What is checked.
        mrp_check: u32 => words::mrp_check,
    }
}

view! {
    /// 0x0211, 0x0212 and 0x0213, version 1.1: the same for each of several rings.
    pub struct MrpInstances<'a> {
        /// Padding.
        padding: Skip<1>,
        /// How many rings.
        number_of_mrp_instances: u8,
        /// A block for each ring.
        blocks: Rest<'a, Block<'a>>,
    }
}

view! {
    /// 0x0231: one of the rings that an interface is to be in.
    pub struct MrpInstanceAdjust<'a> {
        /// Padding.
        padding: Skip<1>,
        /// Which ring, from 0.
        mrp_instance: u8,
        /// The ring.
        mrp_domain_uuid: Uuid,
        /// Client or manager.
        mrp_role: u16 => words::mrp_role,
        /// Padding.
        padding2: Align,
        /// The name of the ring.
        mrp_domain_name: Text<'a, 1>,
        /// Padding.
        padding3: Align,
        /// Parameters of client or manager.
        blocks: Rest<'a, Block<'a>>,
    }
}

view! {
    /// 0x0233: what is checked about one of the rings.
    pub struct MrpInstanceCheck {
        /// Padding.
        padding: Skip<1>,
        /// Which ring, from 0.
        mrp_instance: u8,
        /// The ring.
        mrp_domain_uuid: Uuid,
        /// What is checked.
        mrp_check: u32 => words::mrp_check,
    }
}

view! {
    /// 0x0214 and 0x0215, version 1.0: the ring that a port belongs to.
    pub struct PortMrp {
        /// Padding.
        padding: Align,
        /// The ring.
        mrp_domain_uuid: Uuid,
    }
}

view! {
    /// 0x0214 and 0x0215, version 1.1: one of the rings that a port belongs to.
    pub struct PortMrpInstance {
        /// Padding.
        padding: Skip<1>,
        /// Which ring, from 0.
        mrp_instance: u8,
        /// The ring.
        mrp_domain_uuid: Uuid,
    }
}

view! {
    /// 0x0216: how a manager watches the ring.
    pub struct MrpManagerParams {
        /// Which manager wins: the lowest number.
        mrp_prio: u16,
        /// From a change to its announcement, in units of 10 ms.
        mrp_topchgt: u16,
        /// How often a change is announced.
        mrp_topnrmax: u16,
        /// From test to test while a link has changed, in ms.
        mrp_tstshortt: u16,
        /// From test to test, in ms.
        mrp_tstdefaultt: u16,
        /// How many tests may be lost.
        mrp_tstnrmax: u16,
    }
}

view! {
    /// 0x0217: how a client tells of its links.
    pub struct MrpClientParams {
        /// From repetition to repetition when a link goes down, in ms.
        mrp_lnkdownt: u16,
        /// From repetition to repetition when a link comes up, in ms.
        mrp_lnkupt: u16,
        /// How often it is repeated.
        mrp_lnknrmax: u16,
    }
}

view! {
    /// 0x0219: whether the ring is closed.
    pub struct MrpRingStateData {
        /// 0: open, 1: closed.
        mrp_ring_state: u16 => words::mrp_ring_state,
    }
}

view! {
    /// 0x0109: which frames go which way at which time (RT_CLASS_3).
    pub struct IrInfoBlock<'a> {
        /// Padding.
        padding: Skip<2>,
        /// The plan.
        ir_data_uuid: Uuid,
        /// Padding.
        padding2: Skip<2>,
        /// CRs whose data share a frame.
        iocrs: List<'a, IrIocr>,
    }
}

view! {
    /// Where the data of a CR are in a frame that it shares.
    pub struct IrIocr {
        /// The CR's number in this AR.
        iocr_reference: u16,
        /// Octets from the beginning of the frame.
        subframe_offset: u16,
        /// Position and length.
        subframe_data: u32 => words::subframe_data,
    }
}

view! {
    /// 0x010A: system redundancy.
    pub struct SrInfoBlock {
        /// After how long without any AR the outputs are given up, in ms.
        redundancy_data_hold_factor: u16,
        /// How both ARs behave.
        sr_properties: u32 => words::sr_properties,
    }
}

view! {
    /// 0x010C: which events a device is to report.
    pub struct RsInfoBlock {
        /// Padding.
        padding: Skip<2>,
        /// How they are reported.
        rs_properties: u32,
    }
}

view! {
    /// 0x010B, 0x0608 and 0x0609: fast start-up.
    pub struct FastStartUp<'a> {
        /// Padding.
        padding: Align,
        /// One block for each setting.
        blocks: Rest<'a, Block<'a>>,
    }
}

view! {
    /// 0x0600: how a device says hello.
    pub struct FsHelloBlock {
        /// Padding.
        padding: Align,
        /// When.
        fs_hello_mode: u32 => words::fs_hello_mode,
        /// From hello to hello, in ms.
        fs_hello_interval: u32,
        /// How often it is repeated.
        fs_hello_retry: u32,
        /// Until the first one, in ms.
        fs_hello_delay: u32,
    }
}

view! {
    /// 0x0601: whether parameters are taken from the last start.
    pub struct FsParameterBlock {
        /// Padding.
        padding: Align,
        /// Whether they are.
        fs_parameter_mode: u32 => words::fs_parameter_mode,
        /// Which parameters.
        fs_parameter_uuid: Uuid,
    }
}
