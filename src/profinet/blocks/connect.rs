//! The blocks of Connect: what a controller wants of a device, and what it gets.

use super::super::view::{Each, List, Show, Text, Value, View, view};
use super::super::{MacAddress, Malformed, Octets, Uuid};
use super::words;

view! {
    /// 0x0101: the application relation (AR) that is to be made.
    pub struct ArBlockReq<'a> {
        /// Which kind of AR.
        ar_type: u16 => words::ar_type,
        /// The AR's own UUID.
        ar_uuid: Uuid,
        /// Counts the connections of an initiator.
        session_key: u16,
        /// The initiator's interface.
        cm_initiator_mac_add: MacAddress,
        /// The initiator's object UUID.
        cm_initiator_object_uuid: Uuid,
        /// How the AR is to behave.
        ar_properties: u32 => words::ar_properties,
        /// After how long a silent initiator is gone, in units of 100 ms.
        cm_initiator_activity_timeout_factor: u16,
        /// The initiator's UDP port for cyclic data over UDP.
        cm_initiator_udp_rt_port: u16,
        /// The initiator's station name.
        cm_initiator_station_name: Text<'a, 2>,
    }
}

view! {
    /// 0x8101: the AR that was made.
    pub struct ArBlockRes {
        /// Which kind of AR.
        ar_type: u16 => words::ar_type,
        /// The AR's own UUID.
        ar_uuid: Uuid,
        /// That of the request.
        session_key: u16,
        /// The responder's interface.
        cm_responder_mac_add: MacAddress,
        /// The responder's UDP port for cyclic data over UDP.
        cm_responder_udp_rt_port: u16,
    }
}

view! {
    /// 0x0102: one communication relation (CR) of cyclic data.
    pub struct IoCrBlockReq<'a> {
        /// In which direction the data go.
        iocr_type: u16 => words::iocr_type,
        /// The CR's number in this AR.
        iocr_reference: u16,
        /// The EtherType: 0x8892, or 0x0800 over UDP.
        lt: u16,
        /// Which class of real time.
        iocr_properties: u32 => words::iocr_properties,
        /// Octets of data and status in a frame.
        data_length: u16,
        /// The frame ID; 0xFFFF: the device chooses.
        frame_id: u16,
        /// The length of a clock, in units of 31.25 µs.
        send_clock_factor: u16,
        /// Clocks from frame to frame.
        reduction_ratio: u16,
        /// In which of these clocks, from 1.
        phase: u16,
        /// Place among the frames of a clock.
        sequence: u16,
        /// Place in the clock, in ns; 0xFFFFFFFF: as early as can be.
        frame_send_offset: u32,
        /// After how many cycles without data the consumer complains.
        watchdog_factor: u16,
        /// After how many cycles without data the AR ends.
        data_hold_factor: u16,
        /// VLAN tag of the frames.
        iocr_tag_header: u16 => words::tag_header,
        /// The address of a multicast CR.
        iocr_multicast_mac_add: MacAddress,
        /// What is in a frame, by application process.
        apis: List<'a, IoCrApi<'a>>,
    }
}

view! {
    /// What one application process has in a frame of cyclic data.
    pub struct IoCrApi<'a> {
        /// The application process.
        api: u32,
        /// Data of submodules, each followed by its provider status.
        io_data_objects: List<'a, IoDataObject>,
        /// Consumer status of submodules.
        iocs: List<'a, IoDataObject>,
    }
}

view! {
    /// Where data or status of a submodule are in a frame.
    pub struct IoDataObject {
        /// The slot.
        slot: u16,
        /// The subslot.
        subslot: u16,
        /// Octets from the beginning of the data.
        frame_offset: u16,
    }
}

view! {
    /// 0x8102: the CR of cyclic data that was made.
    pub struct IoCrBlockRes {
        /// In which direction the data go.
        iocr_type: u16 => words::iocr_type,
        /// That of the request.
        iocr_reference: u16,
        /// The frame ID that is used.
        frame_id: u16,
    }
}

view! {
    /// 0x0103: the CR of alarms.
    pub struct AlarmCrBlockReq {
        /// 1: alarms.
        alarmcr_type: u16,
        /// The EtherType: 0x8892, or 0x0800 over UDP.
        lt: u16,
        /// Priority and transport.
        alarmcr_properties: u32 => words::alarm_cr_properties,
        /// Until an alarm is repeated, in units of 100 ms.
        rta_timeout_factor: u16,
        /// How often an alarm is repeated.
        rta_retries: u16,
        /// The initiator's number of the alarm endpoint.
        local_alarm_reference: u16,
        /// The most octets of an alarm.
        max_alarm_data_length: u16,
        /// VLAN tag of alarms of high priority.
        alarmcr_tag_header_high: u16 => words::tag_header,
        /// VLAN tag of alarms of low priority.
        alarmcr_tag_header_low: u16 => words::tag_header,
    }
}

view! {
    /// 0x8103: the CR of alarms that was made.
    pub struct AlarmCrBlockRes {
        /// 1: alarms.
        alarmcr_type: u16,
        /// The responder's number of the alarm endpoint.
        local_alarm_reference: u16,
        /// The most octets of an alarm.
        max_alarm_data_length: u16,
    }
}

view! {
    /// 0x0104: the modules that the controller believes are plugged.
    pub struct ExpectedSubmoduleBlockReq<'a> {
        /// By application process and slot.
        apis: List<'a, ExpectedApi<'a>>,
    }
}

view! {
    /// A module that is expected in a slot.
    pub struct ExpectedApi<'a> {
        /// The application process.
        api: u32,
        /// The slot.
        slot: u16,
        /// Which module.
        module_ident_number: u32,
        /// Reserved.
        module_properties: u16,
        /// Its submodules.
        submodules: List<'a, ExpectedSubmodule>,
    }
}

/// A submodule that is expected in a subslot.
#[derive(Clone, Copy, Debug)]
pub struct ExpectedSubmodule {
    /// Subslot, submodule and its kind.
    pub fields: ExpectedFields,
    descriptions: [Option<DataDescription>; 2],
}

view! {
    /// What an expected submodule has before its data descriptions.
    pub struct ExpectedFields {
        /// The subslot.
        subslot: u16,
        /// Which submodule.
        submodule_ident_number: u32,
        /// Whether it has inputs, outputs, or both.
        submodule_properties: u16 => words::submodule_properties,
    }
}

view! {
    /// How long the cyclic data of a submodule are.
    pub struct DataDescription {
        /// 1: input, 2: output.
        data_description: u16 => words::data_description,
        /// Octets of data.
        submodule_data_length: u16,
        /// Octets of consumer status.
        length_iocs: u8,
        /// Octets of provider status.
        length_iops: u8,
    }
}

impl ExpectedSubmodule {
    /// Its data descriptions: inputs, outputs, or both of them.
    pub fn descriptions(&self) -> impl Iterator<Item = DataDescription> + use<> {
        self.descriptions.into_iter().flatten()
    }
}

impl<'a> View<'a> for ExpectedSubmodule {
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        let fields = ExpectedFields::read(octets)?;
        let first = Some(DataDescription::read(octets)?);
        let has_both = fields.submodule_properties & 3 == 3;
        let second = if has_both { Some(DataDescription::read(octets)?) } else { None };
        Ok(Self { fields, descriptions: [first, second] })
    }

    fn value(&self) -> Value<'_> {
        Value::Fields(self)
    }
}

impl Show for ExpectedSubmodule {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        self.fields.show(visit);
        visit("data_descriptions", Value::List(self));
    }
}

impl Each for ExpectedSubmodule {
    fn each(&self, visit: &mut dyn FnMut(Value<'_>)) {
        self.descriptions().for_each(|description| visit(description.value()));
    }
}

view! {
    /// 0x8104: where the plugged modules differ from the expected ones.
    pub struct ModuleDiffBlock<'a> {
        /// By application process.
        apis: List<'a, DiffApi<'a>>,
    }
}

view! {
    /// Differences in one application process.
    pub struct DiffApi<'a> {
        /// The application process.
        api: u32,
        /// Modules that differ, or that have a submodule that differs.
        modules: List<'a, DiffModule<'a>>,
    }
}

view! {
    /// A slot with a difference.
    pub struct DiffModule<'a> {
        /// The slot.
        slot: u16,
        /// The module that is plugged.
        module_ident_number: u32,
        /// How it differs.
        module_state: u16 => words::module_state,
        /// Submodules that differ.
        submodules: List<'a, DiffSubmodule>,
    }
}

view! {
    /// A subslot with a difference.
    pub struct DiffSubmodule {
        /// The subslot.
        subslot: u16,
        /// The submodule that is plugged.
        submodule_ident_number: u32,
        /// How it differs.
        submodule_state: u16 => words::submodule_state,
    }
}

view! {
    /// 0x0105: who parameterises the device instead of the controller.
    pub struct PrmServerBlock<'a> {
        /// The parameter server's object UUID.
        parameter_server_object_uuid: Uuid,
        /// Reserved.
        parameter_server_properties: u32,
        /// After how long a silent server is gone, in units of 100 ms.
        cm_initiator_activity_timeout_factor: u16,
        /// The parameter server's station name.
        parameter_server_station_name: Text<'a, 2>,
    }
}

view! {
    /// 0x0106: whose multicast data a CR takes.
    pub struct McrBlockReq<'a> {
        /// The CR's number in this AR.
        iocr_reference: u16,
        /// How the provider is found.
        address_resolution_properties: u32,
        /// After how long a silent provider is gone, in units of 100 ms.
        mci_timeout_factor: u16,
        /// The provider's station name.
        provider_station_name: Text<'a, 2>,
    }
}

view! {
    /// 0x0107 and 0x8107: where calls to this end should go.
    pub struct ArRpcBlock {
        /// A UDP port.
        rpc_server_port: u16,
    }
}

view! {
    /// 0x8106: the device's name.
    pub struct ArServerBlock<'a> {
        /// Its station name.
        cm_responder_station_name: Text<'a, 2>,
        /// Padding.
        padding: &'a [u8],
    }
}

view! {
    /// 0x0108 and 0x8108: what a vendor adds to Connect.
    pub struct ArVendorBlock<'a> {
        /// Whose structure the data have.
        ap_structure_identifier: u16,
        /// The application process.
        api: u32,
        /// The data.
        data: &'a [u8],
    }
}
