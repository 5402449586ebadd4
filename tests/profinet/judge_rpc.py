"""The judge's rows of RPC and of the blocks in calls and alarms: tshark's field, and where it is in the JSON.

`**` is every object inside, in the order in which they are printed."""

import datetime


def parts(version):
    return [int(part) for part in version.split(".")]


def byte_order(name):
    return int(name == "little-endian")


def characters(name):
    return int(name == "EBCDIC")


def padded(value):
    """Text without the spaces and zeros at its end."""
    return value.rstrip(" \0")


def uuid(value):
    return value.lower()


def seconds(value):
    """A time as seconds since 1970."""
    moment = datetime.datetime.strptime(value.split(".")[0], "%b %d, %Y %H:%M:%S")
    return int(moment.replace(tzinfo=datetime.UTC).timestamp())


def first(value):
    """A character as tshark prints it."""
    return value.strip("'")


# tshark's field, path, and where the values differ in form: how tshark's is read, how decode's is.
HEADER = [
    ("dcerpc.pkt_type", "packet_type"),
    ("dcerpc.dg_flags1", "flags1.value"),
    ("dcerpc.dg_flags1_last_frag", "flags1.last_fragment"),
    ("dcerpc.dg_flags1_frag", "flags1.fragment"),
    ("dcerpc.dg_flags1_nofack", "flags1.no_fack"),
    ("dcerpc.dg_flags1_maybe", "flags1.maybe"),
    ("dcerpc.dg_flags1_idempotent", "flags1.idempotent"),
    ("dcerpc.dg_flags1_broadcast", "flags1.broadcast"),
    ("dcerpc.dg_flags2", "flags2.value"),
    ("dcerpc.dg_flags2_cancel_pending", "flags2.cancel_pending"),
    ("dcerpc.drep.byteorder", "data_representation.byte_order", None, byte_order),
    ("dcerpc.drep.character", "data_representation.characters", None, characters),
    ("dcerpc.drep.fp", "data_representation.floating_point"),
    ("dcerpc.dg_serial_hi", "serial", None, lambda serial: serial >> 8),
    ("dcerpc.dg_serial_lo", "serial", None, lambda serial: serial & 255),
    ("dcerpc.obj_id", "object", uuid),
    ("dcerpc.dg_if_id", "interface", uuid),
    ("dcerpc.dg_act_id", "activity", uuid),
    ("dcerpc.dg_server_boot", "server_boot", seconds),
    ("dcerpc.dg_if_ver", "interface_version"),
    ("dcerpc.dg_seqnum", "sequence"),
    ("dcerpc.opnum", "opnum"),
    ("dcerpc.dg_ihint", "interface_hint"),
    ("dcerpc.dg_ahint", "activity_hint"),
    ("dcerpc.dg_frag_len", "length", None, lambda length: length - 80),
    ("dcerpc.dg_frag_num", "fragment"),
    ("dcerpc.dg_auth_proto", "auth_protocol"),
    ("dcerpc.fack_vers", "fack.version"),
    ("dcerpc.fack_window_size", "fack.window_size"),
    ("dcerpc.fack_max_tsdu", "fack.max_tsdu"),
    ("dcerpc.fack_max_frag_size", "fack.max_fragment_size"),
    ("dcerpc.fack_serial_num", "fack.serial"),
    ("dcerpc.fack_selack", "fack.masks[]"),
    ("dcerpc.dg_status", "nca_status"),
    ("dcerpc.dg_cancel_id", "cancel_id"),
    ("dcerpc.dg_cancel_vers", "cancel_version"),
    ("pn_io.args_max", "args_maximum"),
    ("pn_io.args_len", "args_length"),
    ("pn_io.array_act_count", "args_length"),
    ("epm.inq_type", "inquiry_type"),
    ("epm.ver_opt", "version_option"),
    ("epm.max_ents", "max_entries"),
    ("epm.annotation", "entries[].annotation", padded),
    ("epm.proto.udp_port", "entries[].tower[].udp_port"),
    ("epm.proto.ip", "entries[].tower[].ip_address", str),
    ("epm.rc", "mapper_status"),
]

BLOCKS = [
    ("pn_io.block_type", "**[version][name].type"),
    ("pn_io.block_length", "**[version][type].length"),
    ("pn_io.block_version_high", "**[length].version", None, lambda version: parts(version)[0]),
    ("pn_io.block_version_low", "**[length].version", None, lambda version: parts(version)[1]),
    ("pn_io.error_code", "**.status.code"),
    ("pn_io.error_decode", "**.status.decode"),
    ("pn_io.error_code1", "**.status.code1"),
    ("pn_io.error_code2", "**.status.code2"),
    ("pn_io.ar_type", "**[type=33025].ar_type"),
    ("pn_io.ar_uuid", "**.ar_uuid", uuid),
    ("pn_io.target_ar_uuid", "**[ar_uuid=00000000-0000-0000-0000-000000000000].target_ar_uuid", uuid),
    ("pn_io.session_key", "**.session_key"),
    ("pn_io.cminitiator_mac_add", "**.cm_initiator_mac_add", uuid),
    ("pn_io.cminitiator_uuid", "**.cm_initiator_object_uuid", uuid),
    ("pn_io.ar_properties", "**.ar_properties.value"),
    ("pn_io.ar_properties.state", "**.ar_properties.state"),
    ("pn_io.ar_properties.supervisor_takeover_allowed", "**.ar_properties.supervisor_takeover_allowed"),
    ("pn_io.ar_properties.parameterization_server", "**.ar_properties.parameterization_server"),
    ("pn_io.ar_properties.device_access", "**.ar_properties.device_access"),
    ("pn_io.ar_properties.companion_ar", "**.ar_properties.companion_ar"),
    ("pn_io.ar_properties.acknowledge_companion_ar", "**.ar_properties.acknowledge_companion_ar"),
    ("pn_io.ar_properties.time_aware_system", "**.ar_properties.time_aware_system"),
    ("pn_io.ar_properties.combined_object_container", "**.ar_properties.combined_object_container"),
    ("pn_io.ar_properties.StartupMode", "**.ar_properties.startup_mode"),
    ("pn_io.ar_properties.pull_module_alarm_allowed", "**.ar_properties.pull_module_alarm_allowed"),
    ("pn_io.cminitiator_activitytimeoutfactor", "**[type=257].cm_initiator_activity_timeout_factor"),
    ("pn_io.cminitiator_udprtport", "**.cm_initiator_udp_rt_port"),
    ("pn_io.cminitiator_station_name", "**.cm_initiator_station_name", padded),
    ("pn_io.cmresponder_macadd", "**.cm_responder_mac_add", uuid),
    ("pn_io.cmresponder_udprtport", "**.cm_responder_udp_rt_port"),
    ("pn_io.iocr_type", "**.iocr_type"),
    ("pn_io.iocr_reference", "**.iocr_reference"),
    ("pn_io.lt", "**.lt"),
    ("pn_io.iocr_properties", "**.iocr_properties.value"),
    ("pn_io.iocr_properties.rtclass", "**.iocr_properties.rt_class"),
    ("pn_io.iocr_properties.media_redundancy", "**.iocr_properties.media_redundancy"),
    ("pn_io.iocr_properties.fast_forwarding_mac_adr", "**.iocr_properties.fast_forwarding_mac_adr"),
    ("pn_io.iocr_properties.distributed_subframe_watchdog", "**.iocr_properties.distributed_subframe_watchdog"),
    ("pn_io.iocr_properties.full_subframe_structure", "**.iocr_properties.full_subframe_structure"),
    ("pn_io.data_length", "**[iocr_reference].data_length"),
    ("pn_io.send_clock_factor", "**.send_clock_factor"),
    ("pn_io.reduction_ratio", "**.reduction_ratio"),
    ("pn_io.phase", "**.phase"),
    ("pn_io.sequence", "**[phase].sequence"),
    ("pn_io.frame_send_offset", "**.frame_send_offset"),
    ("pn_io.watchdog_factor", "**.watchdog_factor"),
    ("pn_io.data_hold_factor", "**.data_hold_factor"),
    ("pn_io.iocr_tag_header", "**.iocr_tag_header.value"),
    ("pn_io.iocr_multicast_mac_add", "**.iocr_multicast_mac_add", uuid),
    ("pn_io.io_data_object.frame_offset", "**.io_data_objects[].frame_offset"),
    ("pn_io.iocs_frame_offset", "**.iocs[].frame_offset"),
    ("pn_io.alarmcr_type", "**.alarmcr_type"),
    ("pn_io.alarmcr_properties", "**.alarmcr_properties.value"),
    ("pn_io.alarmcr_properties.priority", "**.alarmcr_properties.priority"),
    ("pn_io.alarmcr_properties.transport", "**.alarmcr_properties.transport"),
    ("pn_io.rta_timeoutfactor", "**.rta_timeout_factor"),
    ("pn_io.rta_retries", "**.rta_retries"),
    ("pn_io.localalarmref", "**.local_alarm_reference"),
    ("pn_io.maxalarmdatalength", "**.max_alarm_data_length"),
    ("pn_io.alarmcr_tagheaderhigh", "**.alarmcr_tag_header_high.value"),
    ("pn_io.alarmcr_tagheaderlow", "**.alarmcr_tag_header_low.value"),
    ("pn_io.api", "**.api"),
    ("pn_io.slot_nr", "**.slot"),
    ("pn_io.subslot_nr", "**.subslot"),
    ("pn_io.module_ident_number", "**.module_ident_number"),
    ("pn_io.module_properties", "**.module_properties"),
    ("pn_io.module_state", "**.module_state"),
    ("pn_io.submodule_ident_number", "**.submodule_ident_number"),
    ("pn_io.submodule_properties", "**.submodule_properties.value"),
    ("pn_io.submodule_properties.type", "**.submodule_properties.type"),
    ("pn_io.submodule_properties.shared_input", "**.submodule_properties.shared_input"),
    ("pn_io.submodule_properties.discard_ioxs", "**.submodule_properties.discard_ioxs"),
    ("pn_io.submodule_state", "**.submodule_state.value"),
    ("pn_io.submodule_state.add_info", "**.submodule_state.add_info"),
    ("pn_io.submodule_state.advice", "**.submodule_state.advice"),
    ("pn_io.submodule_state.maintenance_required", "**.submodule_state.maintenance_required"),
    ("pn_io.submodule_state.maintenance_demanded", "**.submodule_state.maintenance_demanded"),
    ("pn_io.submodule_state.fault", "**.submodule_state.fault"),
    ("pn_io.submodule_state.ar_info", "**.submodule_state.ar_info"),
    ("pn_io.submodule_state.ident_info", "**.submodule_state.ident_info"),
    ("pn_io.data_description", "**.data_description"),
    ("pn_io.submodule_data_length", "**.submodule_data_length"),
    ("pn_io.length_iocs", "**.length_iocs"),
    ("pn_io.length_iops", "**.length_iops"),
    ("pn_io.control_command", "**.control_command.value"),
    ("pn_io.control_command.prmend", "**.control_command.prm_end"),
    ("pn_io.control_command.applready", "**.control_command.application_ready"),
    ("pn_io.control_command.release", "**.control_command.release"),
    ("pn_io.control_command.done", "**.control_command.done"),
    ("pn_io.control_command.ready_for_companion", "**.control_command.ready_for_companion"),
    ("pn_io.control_command.ready_for_rt_class3", "**.control_command.ready_for_rt_class_3"),
    ("pn_io.control_command.prmbegin", "**.control_command.prm_begin"),
    ("pn_io.control_block_properties", "**[type!=274][type!=280].control_block_properties"),
    ("pn_io.seq_number", "**[index].sequence"),
    ("pn_io.index", "**.index"),
    ("pn_io.record_data_length", "**.record_data_length"),
    ("pn_io.add_val1", "**.additional_value1"),
    ("pn_io.add_val2", "**.additional_value2"),
    ("pn_io.alarm_type", "**.alarm_type"),
    ("pn_io.alarm_specifier.sequence", "**.alarm_specifier.sequence_number"),
    ("pn_io.alarm_specifier.channel", "**.alarm_specifier.channel_diagnosis"),
    ("pn_io.alarm_specifier.manufacturer", "**.alarm_specifier.manufacturer_specific_diagnosis"),
    ("pn_io.alarm_specifier.submodule", "**.alarm_specifier.submodule_diagnosis_state"),
    ("pn_io.alarm_specifier.ardiagnosis", "**.alarm_specifier.ar_diagnosis_state"),
    ("pn_io.user_structure_identifier", "**.user_structure_identifier"),
    ("pn_io.user_structure_identifier_manf", "**[data][channel_number].user_structure_identifier"),
    ("pn_io.channel_number", "**.channel_number"),
    ("pn_io.channel_properties", "**.channel_properties.value"),
    ("pn_io.channel_properties.type", "**.channel_properties.type"),
    ("pn_io.channel_properties.accumulative", "**.channel_properties.accumulative"),
    ("pn_io.channel_properties.maintenance", "**.channel_properties.maintenance"),
    ("pn_io.channel_properties.specifier", "**.channel_properties.specifier"),
    ("pn_io.channel_properties.direction", "**.channel_properties.direction"),
    ("pn_io.channel_error_type", "**.channel_error_type"),
    ("pn_io.ext_channel_add_value", "**.ext_channel_error_add_value"),
    ("pn_io.qualified_channel_qualifier", "**.qualified_channel_qualifier"),
    ("pn_io.maintenance_status", "**.maintenance_status.value"),
    ("pn_io.vendor_id_high", "**[im_version_major].vendor_id", None, lambda vendor: vendor >> 8),
    ("pn_io.vendor_id_low", "**[im_version_major].vendor_id", None, lambda vendor: vendor & 255),
    ("pn_io.order_id", "**.order_id", padded),
    ("pn_io.im_serial_number", "**.im_serial_number", padded),
    ("pn_io.im_hardware_revision", "**.im_hardware_revision"),
    ("pn_io.im_revision_prefix", "**.im_revision_prefix", first),
    ("pn_io.im_sw_revision_functional_enhancement", "**.im_sw_revision_functional_enhancement"),
    ("pn_io.im_revision_bugfix", "**.im_revision_bugfix"),
    ("pn_io.im_sw_revision_internal_change", "**.im_sw_revision_internal_change"),
    ("pn_io.im_revision_counter", "**.im_revision_counter"),
    ("pn_io.im_profile_id", "**.im_profile_id"),
    ("pn_io.im_profile_specific_type", "**.im_profile_specific_type"),
    ("pn_io.im_version_major", "**.im_version_major"),
    ("pn_io.im_version_minor", "**.im_version_minor"),
    ("pn_io.im_supported", "**.im_supported.value"),
    ("pn_io.im_tag_function", "**.im_tag_function", padded),
    ("pn_io.im_tag_location", "**.im_tag_location", padded),
    ("pn_io.im_date", "**.im_date", padded),
    ("pn_io.im_descriptor", "**.im_descriptor", padded),
    ("pn_io.own_port_id", "**.own_port_id", padded),
    ("pn_io.peer_port_id", "**.peer_port_id", padded),
    ("pn_io.peer_chassis_id", "**.peer_chassis_id", padded),
    ("pn_io.line_delay", "**.line_delay"),
    ("pn_io.peer_macadd", "**.peer_mac_address", uuid),
    ("pn_io.mau_type", "**.mau_type"),
    ("pn_io.domain_boundary", "**.domain_boundary"),
    ("pn_io.multicast_boundary", "**.multicast_boundary"),
    ("pn_io.link_state_port", "**.link_state_port"),
    ("pn_io.link_state_link", "**.link_state_link"),
    ("pn_io.media_type", "**.media_type"),
    ("pn_io.own_chassis_id", "**.own_chassis_id", padded),
    ("pn_io.macadd", "**[own_chassis_id].mac_address", uuid),
    ("pn_io.ip_address", "**[own_chassis_id].ip_address", str),
    ("pn_io.subnetmask", "**.subnetmask", str),
    ("pn_io.standard_gateway", "**.standard_gateway", str),
    ("pn_io.ifInOctets", "**.if_in_octets"),
    ("pn_io.ifOutOctets", "**.if_out_octets"),
    ("pn_io.ifInDiscards", "**.if_in_discards"),
    ("pn_io.ifOutDiscards", "**.if_out_discards"),
    ("pn_io.ifInErrors", "**.if_in_errors"),
    ("pn_io.ifOutErrors", "**.if_out_errors"),
    ("pn_io.MultipleInterfaceMode_NameOfDevice", "**.multiple_interface_mode.name_of_device"),
    ("pn_io.substitutionmode", "**.substitution_mode"),
    ("pn_io.control_block_properties.appl_ready", "**[type=274].control_block_properties"),
    ("pn_io.IRData_uuid", "**.ir_data_uuid", uuid),
    ("pn_io.subframe_offset", "**.subframe_offset"),
    ("pn_io.RedundancyDataHoldFactor", "**.redundancy_data_hold_factor"),
    ("pn_io.sr_properties", "**.sr_properties.value"),
    ("pn_io.sr_properties.InputValidOnBackupAR", "**.sr_properties.input_valid_on_backup_ar"),
    ("pn_io.sr_properties.Mode", "**.sr_properties.mode"),
    ("pn_io.fs_hello_mode", "**.fs_hello_mode"),
    ("pn_io.fs_hello_interval", "**.fs_hello_interval"),
    ("pn_io.fs_hello_retry", "**.fs_hello_retry"),
    ("pn_io.fs_hello_delay", "**.fs_hello_delay"),
    ("pn_io.fs_parameter_mode", "**.fs_parameter_mode"),
    ("pn_io.fs_parameter_uuid", "**.fs_parameter_uuid", uuid),
    ("pn_io.mrp_domain_uuid", "**.mrp_domain_uuid", uuid),
    ("pn_io.mrp_domain_name", "**.mrp_domain_name", padded),
    ("pn_io.mrp_role", "**.mrp_role"),
    ("pn_io.mrp_check", "**.mrp_check.value"),
    ("pn_io.mrp_MrpInstance", "**.mrp_instance"),
    ("pn_io.mrp_prio", "**.mrp_prio"),
    ("pn_io.mrp_topchgt", "**.mrp_topchgt"),
    ("pn_io.mrp_topnrmax", "**.mrp_topnrmax"),
    ("pn_io.mrp_tstshortt", "**.mrp_tstshortt"),
    ("pn_io.mrp_tstdefaultt", "**.mrp_tstdefaultt"),
    ("pn_io.mrp_tstnrmax", "**.mrp_tstnrmax"),
    ("pn_io.mrp_lnkdownt", "**.mrp_lnkdownt"),
    ("pn_io.mrp_lnkupt", "**.mrp_lnkupt"),
    ("pn_io.mrp_lnknrmax", "**.mrp_lnknrmax"),
    ("pn_io.mrp_ring_state", "**.mrp_ring_state"),
]


def behind(count):
    """So many values behind those of the frame itself."""

    def may_differ(shown, here, there):
        return len(there) == len(here) + count and there[: len(here)] == here

    return may_differ


def api_data(shown, here, there):
    """The numbers of a block APIData, which has only those."""
    lists = [block["apis"] for block in found(shown) if block.get("name") == "APIData"]
    return there == here + [api for apis in lists for api in apis]


def manufacturers(shown, here, there):
    """A manufacturer's diagnosis in a block, which is compared by another field."""
    return not there and all(identifier < 0x8000 for identifier in here)


def found(value):
    if isinstance(value, dict):
        yield value
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, list) else []:
        yield from found(item)


REMEMBERED = "tshark adds what it remembers of the Connect to every frame of the AR"

# tshark's fields, a test of (object, ours, theirs), and why they may differ.
EXPLAINED = [
    (
        (
            "pn_io.ar_uuid",
            "pn_io.cminitiator_mac_add",
            "pn_io.cminitiator_station_name",
            "pn_io.cmresponder_macadd",
        ),
        behind(1),
        REMEMBERED,
    ),
    (("pn_io.localalarmref",), behind(2), REMEMBERED),
    (("pn_io.api",), api_data, "decode lists the numbers of APIData without a name for each"),
    (
        ("pn_io.user_structure_identifier",),
        manufacturers,
        "tshark has another field for a manufacturer's identifier in DiagnosisData",
    ),
]
