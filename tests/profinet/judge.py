#!/usr/bin/env python3
"""Whether `pnet-nat decode` reads frames of PROFINET as tshark does, field by field.

    python3 tests/profinet/judge.py target/release/pnet-nat CAPTURE...

Every frame must have the same protocol in both. Every field of FIELDS must have the same values in both, in
the same order, unless EXPLAINED says why not. Prints how many fields were compared and each difference.
Exit code 1: a frame has another protocol, or a difference is not explained. 2: something failed."""

import collections
import json
import re
import subprocess
import sys

import judge_rpc


def number(text):
    """A number as tshark prints it, or a bit."""
    return {"True": 1, "False": 0}.get(text) if text in ("True", "False") else int(text, 0)


def text(value):
    return value


def octets(value):
    """Octets that tshark prints as digits, with or without colons."""
    return bytes.fromhex(value.replace(":", ""))


def unescaped(value):
    """The octets of text in which decode has written what cannot be printed as \\x00."""
    parts = re.split(r"\\x([0-9a-f]{2})", value)
    return b"".join(
        bytes.fromhex(part) if index % 2 else part.encode() for index, part in enumerate(parts)
    )


def mac(value):
    return value.lower()


def without_end(values):
    """TLVs without the one that ends them: decode does not list it."""
    return [value for value in values if value != 0]


def once(values):
    """tshark prints each type of MRP twice: of the TLV, and in its header."""
    return without_end(values)[::2]


class Field:
    """A row of the table: a protocol, tshark's field, where it is in the JSON, and how both are read."""

    def __init__(self, protocol, field, path, read=number, ours=None, theirs=list):
        self.protocol, self.field, self.path = protocol, field, path
        self.read, self.ours, self.theirs = read, ours or (lambda value: value), theirs


LAYER_2 = ("profinet-rt", "profinet-dcp", "profinet-alarm", "lldp", "mrp", "ptcp")
RT = ("profinet-rt", "profinet-dcp", "profinet-alarm", "ptcp")
DCP, ALARM, PTCP, LLDP, MRP = (("profinet-dcp",), ("profinet-alarm",), ("ptcp",), ("lldp",), ("mrp",))
CYCLIC = ("profinet-rt",)

# A path goes through maps by name and through lists by []; [name=value] takes some items alone. Where a name
# is missing there is no value.
FIELDS = [
    Field(LAYER_2, "eth.src", "from", mac),
    Field(LAYER_2, "eth.dst", "to", mac),
    Field(LAYER_2, "vlan.id", "vlan.id"),
    Field(LAYER_2, "vlan.priority", "vlan.priority"),
    Field(LAYER_2, "vlan.dei", "vlan.drop_eligible"),
    Field(RT, "pn_rt.frame_id", "frame_id"),
    Field(CYCLIC, "pn_rt.cycle_counter", "cycle_counter"),
    Field(CYCLIC, "pn_rt.ds", "data_status.value"),
    Field(CYCLIC, "pn_rt.ds_primary", "data_status.primary"),
    Field(CYCLIC, "pn_rt.ds_redundancy", "data_status.redundancy"),
    Field(CYCLIC, "pn_rt.ds_valid", "data_status.data_valid"),
    Field(CYCLIC, "pn_rt.ds_operate", "data_status.provider_running"),
    Field(CYCLIC, "pn_rt.ds_ok", "data_status.station_ok"),
    Field(CYCLIC, "pn_rt.ds_ignore", "data_status.ignore"),
    Field(CYCLIC, "pn_rt.transfer_status", "transfer_status"),
    Field(CYCLIC, "pn_io.ioxs", "submodules[].status"),
    Field(CYCLIC, "pn_io.ioxs.datastate", "submodules[].good"),
    Field(ALARM, "pn_io.alarm_dst_endpoint", "destination_endpoint"),
    Field(ALARM, "pn_io.alarm_src_endpoint", "source_endpoint"),
    Field(ALARM, "pn_io.pdu_type.type", "pdu_type"),
    Field(ALARM, "pn_io.pdu_type.version", "version"),
    Field(ALARM, "pn_io.window_size", "window_size"),
    Field(ALARM, "pn_io.tack", "immediate_acknowledge"),
    Field(ALARM, "pn_io.send_seq_num", "send_sequence"),
    Field(ALARM, "pn_io.ack_seq_num", "acknowledge_sequence"),
    Field(ALARM, "pn_io.var_part_len", "contents_length"),
    Field(DCP, "pn_dcp.service_id", "service_id"),
    Field(DCP, "pn_dcp.service_type", "service_type"),
    Field(DCP, "pn_dcp.xid", "xid"),
    Field(DCP, "pn_dcp.response_delay", "response_delay"),
    Field(DCP, "pn_dcp.data_length", "data_length"),
    Field(DCP, "pn_dcp.block_length", "blocks[].length"),
    Field(DCP, "pn_dcp.block_qualifier", "blocks[qualifier][!reset].qualifier"),
    Field(DCP, "pn_dcp.block_qualifier_reset", "blocks[reset].qualifier"),
    Field(DCP, "pn_dcp.suboption_ip_block_info", "blocks[option=1][suboption=2].block_info"),
    Field(DCP, "pn_dcp.suboption_ip_mac_address", "blocks[].mac_address", mac),
    Field(DCP, "pn_dcp.suboption_ip_ip", "blocks[].ip_address", text),
    Field(DCP, "pn_dcp.suboption_ip_subnetmask", "blocks[].netmask", text),
    Field(DCP, "pn_dcp.suboption_ip_standard_gateway", "blocks[].gateway", text),
    Field(DCP, "pn_dcp.suboption_device_devicevendorvalue", "blocks[].type_of_station", text),
    Field(DCP, "pn_dcp.suboption_device_nameofstation", "blocks[].name_of_station", text),
    Field(DCP, "pn_dcp.suboption_device_aliasname", "blocks[].alias_name", text),
    Field(DCP, "pn_dcp.suboption_vendor_id", "blocks[suboption=3].vendor_id"),
    Field(DCP, "pn_dcp.suboption_device_id", "blocks[suboption=3].device_id"),
    Field(DCP, "pn_dcp.suboption_device_oem_ven_id", "blocks[suboption=8].vendor_id"),
    Field(DCP, "pn_dcp.suboption_device_oem_dev_id", "blocks[suboption=8].device_id"),
    Field(DCP, "pn_dcp.suboption_device_role", "blocks[].role"),
    Field(DCP, "pn_dcp.suboption_control_signal_value", "blocks[].signal"),
    Field(DCP, "pn_dcp.block_error", "blocks[].block_error"),
    Field(DCP, "pn_dcp.deviceinitiative_value", "blocks[].device_initiative"),
    Field(DCP, "pn_dcp.suboption_dhcp_option_code", "blocks[].dhcp_option"),
    Field(LLDP, "lldp.tlv.type", "tlvs[].type", theirs=without_end),
    Field(LLDP, "lldp.chassis.subtype", "tlvs[type=1].subtype"),
    Field(LLDP, "lldp.chassis.id", "tlvs[type=1][subtype=7].id", octets, unescaped),
    Field(LLDP, "lldp.chassis.id.mac", "tlvs[type=1][subtype=4].id", mac),
    Field(LLDP, "lldp.port.subtype", "tlvs[type=2].subtype"),
    Field(LLDP, "lldp.port.id", "tlvs[type=2][subtype=7].id", text),
    Field(LLDP, "lldp.port.id.mac", "tlvs[type=2][subtype=3].id", mac),
    Field(LLDP, "lldp.time_to_live", "ttl"),
    Field(LLDP, "lldp.port.desc", "tlvs[type=4].text", text),
    Field(LLDP, "lldp.tlv.system.name", "tlvs[type=5].text", text),
    Field(LLDP, "lldp.tlv.system.desc", "tlvs[type=6].text", text),
    Field(LLDP, "lldp.tlv.system_cap", "tlvs[type=7].supported"),
    Field(LLDP, "lldp.tlv.enable_system_cap", "tlvs[type=7].enabled"),
    Field(LLDP, "lldp.mgn.addr.ip4", "tlvs[type=8].address", text),
    Field(LLDP, "lldp.mgn.interface.subtype", "tlvs[type=8].interface_subtype"),
    Field(LLDP, "lldp.mgn.interface.number", "tlvs[type=8].interface_number"),
    Field(LLDP, "lldp.orgtlv.oui", "tlvs[type=127].oui", ours=lambda oui: int(oui.replace(":", ""), 16)),
    Field(LLDP, "lldp.profinet.subtype", "tlvs[oui=00:0e:cf].subtype"),
    Field(LLDP, "lldp.profinet.port_rx_delay_local", "tlvs[].receive_delay_local"),
    Field(LLDP, "lldp.profinet.port_rx_delay_remote", "tlvs[].receive_delay_remote"),
    Field(LLDP, "lldp.profinet.port_tx_delay_local", "tlvs[].transmit_delay_local"),
    Field(LLDP, "lldp.profinet.port_tx_delay_remote", "tlvs[].transmit_delay_remote"),
    Field(LLDP, "lldp.profinet.cable_delay_local", "tlvs[].cable_delay"),
    Field(LLDP, "lldp.profinet.rtc2_port_status", "tlvs[].class_2_status"),
    Field(LLDP, "lldp.profinet.rtc3_port_status", "tlvs[].class_3_status", ours=lambda bits: bits & 7),
    Field(LLDP, "lldp.profinet.mrp_domain_uuid", "tlvs[].domain_uuid", text),
    Field(LLDP, "lldp.profinet.mrrt_port_status", "tlvs[].mrrt_status"),
    Field(LLDP, "lldp.profinet.cm_mac_add", "tlvs[].chassis_mac", mac),
    Field(LLDP, "lldp.profinet.master_source_address", "tlvs[].master", mac),
    Field(LLDP, "lldp.profinet.subdomain_uuid", "tlvs[].subdomain_uuid", text),
    Field(LLDP, "lldp.profinet.ir_data_uuid", "tlvs[].ir_data_uuid", text),
    Field(LLDP, "lldp.profinet.length_of_period_valid", "tlvs[].length_of_period.valid"),
    Field(LLDP, "lldp.profinet.length_of_period_length", "tlvs[].length_of_period.nanoseconds"),
    Field(LLDP, "lldp.profinet.red_period_begin_valid", "tlvs[].red_period_begin.valid"),
    Field(LLDP, "lldp.profinet.red_period_begin_offset", "tlvs[].red_period_begin.nanoseconds"),
    Field(LLDP, "lldp.profinet.orange_period_begin_offset", "tlvs[].orange_period_begin.nanoseconds"),
    Field(LLDP, "lldp.profinet.green_period_begin_offset", "tlvs[].green_period_begin.nanoseconds"),
    Field(LLDP, "lldp.ieee.802_3.subtype", "tlvs[oui=00:12:0f].subtype"),
    Field(LLDP, "lldp.ieee.802_3.pmd_mau_type", "tlvs[].mau_type"),
    Field(LLDP, "lldp.ieee.802_3.max_frame_size", "tlvs[].maximum_frame_size"),
    Field(PTCP, "pn_ptcp.sequence_id", "sequence_id"),
    Field(PTCP, "pn_ptcp.delay10ns", "delay_10_ns"),
    Field(PTCP, "pn_ptcp.delay1ns_byte", "delay_1_ns_octet"),
    Field(PTCP, "pn_ptcp.delay1ns", "[frame_id_name!=PTCP follow-up].delay_ns"),
    Field(PTCP, "pn_ptcp.delay1ns_fup", "[frame_id_name=PTCP follow-up].delay_ns"),
    Field(PTCP, "pn_ptcp.tl_type", "tlvs[].type", theirs=without_end),
    Field(PTCP, "pn_ptcp.master_source_address", "tlvs[].master", mac),
    Field(PTCP, "pn_ptcp.subdomain_uuid", "tlvs[].subdomain_uuid", text),
    Field(PTCP, "pn_ptcp.epoch_number", "tlvs[].epoch"),
    Field(PTCP, "pn_ptcp.seconds", "tlvs[].seconds"),
    Field(PTCP, "pn_ptcp.nanoseconds", "tlvs[].nanoseconds"),
    Field(PTCP, "pn_ptcp.flags", "tlvs[].flags"),
    Field(PTCP, "pn_ptcp.currentutcoffset", "tlvs[].utc_offset"),
    Field(PTCP, "pn_ptcp.master_priority2", "tlvs[].priority_2"),
    Field(PTCP, "pn_ptcp.clock_class", "tlvs[].clock_class"),
    Field(PTCP, "pn_ptcp.clock_accuracy", "tlvs[].clock_accuracy"),
    Field(PTCP, "pn_ptcp.clockvariance", "tlvs[].clock_variance"),
    Field(PTCP, "pn_ptcp.t2portrxdelay", "tlvs[].receive_delay"),
    Field(PTCP, "pn_ptcp.t3porttxdelay", "tlvs[].transmit_delay"),
    Field(PTCP, "pn_ptcp.port_mac_address", "tlvs[].port", mac),
    Field(PTCP, "pn_ptcp.t2timestamp", "tlvs[].received"),
    Field(PTCP, "pn_ptcp.irdata_uuid", "tlvs[].ir_data_uuid", text),
    Field(MRP, "pn_mrp.version", "version"),
    Field(MRP, "pn_mrp.type", "tlvs[].type", theirs=once),
    Field(MRP, "pn_mrp.sequence_id", "tlvs[].sequence_id"),
    Field(MRP, "pn_mrp.domain_uuid", "tlvs[].domain_uuid", text),
    Field(MRP, "pn_mrp.prio", "tlvs[].priority"),
    Field(MRP, "pn_mrp.sa", "tlvs[].source", mac),
    Field(MRP, "pn_mrp.port_role", "tlvs[].port_role"),
    Field(MRP, "pn_mrp.ring_state", "tlvs[].ring_state"),
    Field(MRP, "pn_mrp.transition", "tlvs[].transitions"),
    Field(MRP, "pn_mrp.time_stamp", "tlvs[].timestamp"),
    Field(MRP, "pn_mrp.interval", "tlvs[].interval"),
    Field(MRP, "pn_mrp.blocked", "tlvs[].blocked"),
    Field(MRP, "pn_mrp.oui", "tlvs[].oui", ours=lambda oui: int(oui.replace(":", ""), 16)),
    Field(MRP, "pn_mrp.sub_type", "tlvs[].sub_type"),
    Field(MRP, "pn_mrp.other_mrm_prio", "tlvs[].other_priority"),
    Field(MRP, "pn_mrp.other_mrm_sa", "tlvs[].other_source", mac),
]

RPC = ("profinet-rpc",)


def row(protocols, field, path, read=None, ours=None):
    return Field(protocols, field, path, read or number, ours)


FIELDS += [row(RPC, *columns) for columns in judge_rpc.HEADER] + [row(RPC + ALARM, *columns) for columns in judge_rpc.BLOCKS]

# What differs, and why it may: tshark's field, a test of (object, ours, theirs), and the reason.
EXPLAINED = []


def explain(fields, may_differ, reason):
    EXPLAINED.extend((field, may_differ, reason) for field in fields)


def servers(*places):
    """The name servers of a full IP suite behind the address that they are printed with."""

    def may_differ(shown, here, there):
        found = [value for block in shown["blocks"] if "dns" in block for value in block["dns"]]
        return len(found) == 4 and there == here + [found[place] for place in places]

    return may_differ


def behind_a_gap(shown, here, there):
    """The parts that tshark has not are behind octets that belong to none."""
    parts = shown["submodules"] or []
    if here[: len(there)] != there or not 0 < len(there) < len(parts):
        return False
    last, first = parts[len(there) - 1], parts[len(there)]
    return last["offset"] + len(last.get("data", "")) // 2 + 1 < first["offset"]


explain(
    ["pn_io.ioxs", "pn_io.ioxs.datastate"],
    behind_a_gap,
    "tshark cuts cyclic data up to the first gap between two parts",
)
explain(
    ["pn_io.ioxs", "pn_io.ioxs.datastate"],
    lambda shown, here, there: not there,
    "tshark forgets a connection with the alarm frame that ends it; data may still come for a while",
)

IP_SUITE = "tshark prints the name servers of a full IP suite as address, mask and gateways"
explain(["pn_dcp.suboption_ip_ip"], servers(0), IP_SUITE)
explain(["pn_dcp.suboption_ip_subnetmask"], servers(1), IP_SUITE)
explain(["pn_dcp.suboption_ip_standard_gateway"], servers(2, 3), IP_SUITE)
explain(
    ["pn_mrp.sa", "pn_mrp.port_role", "pn_mrp.ring_state", "pn_mrp.transition", "pn_mrp.time_stamp", "pn_mrp.interval"],
    lambda shown, here, there: not there and any(6 <= tlv["type"] <= 10 for tlv in shown["tlvs"]),
    "tshark 4.0 knows the TLVs of an interconnection by their type alone",
)

for rows in judge_rpc.EXPLAINED:
    explain(*rows)

SEPARATOR, MORE = "\x1e", "\x1f"


def protocol_of(protocols, frame_id):
    """What tshark takes a frame for, in decode's words; None for what decode does not show."""
    layers = protocols.split(":")
    for layer, name in (("lldp", "lldp"), ("pn_mrp", "mrp"), ("pn_dcp", "profinet-dcp")):
        if layer in layers:
            return name
    if "pn_ptcp" in layers:
        return "ptcp"
    if {"udp", "dcerpc"} <= set(layers):
        return "profinet-rpc"
    if "pn_rt" in layers:
        return "profinet-alarm" if frame_id in (0xFC01, 0xFE01) else "profinet-rt"
    return None


def at(values, path, inside):
    """The values at a path of an object, which has these objects inside."""
    for step in re.findall(r"\[[^\]]*\]|[^.\[\]]+", path):
        if step == "**":
            values = inside
        elif step == "[]":
            values = [item for value in values for item in value]
        elif step.startswith("["):
            if values and isinstance(values[0], list):
                values = [item for value in values for item in value]
            values = [value for value in values if matches(value, step[1:-1])]
        else:
            values = [value[step] for value in values if isinstance(value, dict) and value.get(step) is not None]
    return values


def objects(value):
    """An object, and every object inside, in the order in which they are printed."""
    if isinstance(value, dict):
        return [value, *(found for item in value.values() for found in objects(item))]
    return [found for item in value for found in objects(item)] if isinstance(value, list) else []


def matches(item, condition):
    """Whether an item of a list has a name, does not have it, or has a value there."""
    if condition.startswith("!"):
        return condition[1:] not in item
    name, operator, value = re.fullmatch(r"(\w+)(!?=|)(.*)", condition).groups()
    if name not in item:
        return False
    return not operator or (str(item[name]) == value) == (operator == "=")


def run(command):
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode != 0:
        sys.exit(f"{command}: exit code {result.returncode}\n{result.stderr}")
    return result.stdout


def decoded(program, capture):
    """decode's objects, by the number of the frame."""
    frames = {}
    for line in run([program, "decode", "--format", "json", capture]).splitlines():
        shown = json.loads(line)
        if shown.get("protocol", "p-net") != "p-net":
            frames[shown["frame"]] = shown
    return frames


def dissected(capture):
    """tshark's protocol and fields, by the number of the frame."""
    names = ["frame.number", "frame.protocols", "pn_rt.frame_id"]
    names += dict.fromkeys(field.field for field in FIELDS if field.field not in names)
    command = ["tshark", "-n", "-r", capture, "-T", "fields"]
    command += ["-E", f"separator={SEPARATOR}", "-E", "occurrence=a", "-E", f"aggregator={MORE}"]
    for name in names:
        command += ["-e", name]
    frames = {}
    for line in run(command).split("\n"):
        if line:
            values = dict(zip(names, line.split(SEPARATOR)))
            frame_id = number(values["pn_rt.frame_id"].split(MORE)[0]) if values["pn_rt.frame_id"] else None
            frames[int(values["frame.number"])] = (protocol_of(values["frame.protocols"], frame_id), values)
    return frames


def judge(program, capture):
    """Compares one capture. Returns (compared, equal, explained, problems)."""
    ours, theirs = decoded(program, capture), dissected(capture)
    counts, problems = collections.Counter(), []
    for frame, (protocol, values) in theirs.items():
        shown = ours.get(frame)
        name = shown and shown["protocol"]
        if name != protocol:
            problems.append(f"frame {frame}: decode has {name}, tshark has {protocol}")
            continue
        if shown is None:
            continue
        counts["frames"] += 1
        inside = objects(shown)
        for field in FIELDS:
            if protocol in field.protocol:
                compare(frame, field, shown, inside, values[field.field], counts, problems)
    return counts, problems


def compare(frame, field, shown, inside, printed, counts, problems):
    here = [field.ours(value) for value in at([shown], field.path, inside)]
    there = field.theirs([field.read(value) for value in printed.split(MORE)] if printed else [])
    if not here and not there:
        return
    counts["compared"] += max(len(here), len(there))
    if here == there:
        counts["equal"] += len(here)
        return
    for name, may_differ, _ in EXPLAINED:
        if name == field.field and may_differ(shown, here, there):
            counts["explained"] += max(len(here), len(there))
            return
    problems.append(f"frame {frame}: {field.field}: decode has {here}, tshark has {there}")


def main():
    if len(sys.argv) < 3:
        print(__doc__, file=sys.stderr)
        return 2
    is_sound = True
    for capture in sys.argv[2:]:
        counts, problems = judge(sys.argv[1], capture)
        print(
            f"{capture}: {counts['frames']} frames in both, {counts['compared']} values compared, "
            f"{counts['equal']} equal, {counts['explained']} explained, {len(problems)} problems"
        )
        for problem in problems:
            print(f"  {problem}")
            is_sound = False
    return 0 if is_sound else 1


if __name__ == "__main__":
    sys.exit(main())
