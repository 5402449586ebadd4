#!/usr/bin/env python3
"""Both ends of PROFINET's DCE/RPC for what profinet-py and pnio do not know: little-endian, fragments
with their acknowledgements, cancel, the endpoint mapper. Scapy makes and reads the octets; plain UDP
sockets carry them.

    scapy_peer.py read   ADDRESS:PORT [--little] [--any-port | --follow] [--record INDEX] [--fragments N]
    scapy_peer.py cancel ADDRESS:PORT [--little] [--any-port | --follow]
    scapy_peer.py lookup ADDRESS:PORT [--little] [--any-port | --follow] [--from-sequence N]
    scapy_peer.py serve  ADDRESS --answer-from PORT [--little] [--mapper] [--fragment OCTETS]

A client prints one JSON object and exits 0 if all was well: each answer has to come from where it was
asked, with the request's Activity UUID and sequence number. It may take answers from any port of the
device, and may go on at the port that answered. The server prints a line of JSON for each datagram that
it receives. Its endpoint mapper answers from the port that was asked.
"""

import argparse
import errno
import json
import logging
import select
import socket
import sys
import time
import uuid

logging.getLogger("scapy").setLevel(logging.ERROR)
from scapy.contrib import pnio_rpc  # noqa: E402
from scapy.layers.dcerpc import DceRpc4, NDRContextHandle, NDRPointer  # noqa: E402
from scapy.layers.msrpce import ept  # noqa: E402
from scapy.layers.msrpce.raw import ept as raw  # noqa: E402
from scapy.packet import Raw  # noqa: E402

PNIO_PORT = 34964
HEADER = 80
LAST, FRAGMENT, NO_FACK, IDEMPOTENT = 0x02, 0x04, 0x08, 0x20
KINDS = ["request", "ping", "response", "fault", "working", "nocall", "reject", "ack", "cl_cancel", "fack", "cancel_ack"]
DEVICE = uuid.UUID("dea00001-6c97-11d1-8271-00a02442df7d")
MAPPER = uuid.UUID("e1af8308-5d1f-11c9-91a4-08002b14a0fa")
OBJECT = uuid.UUID("dea00000-6c97-11d1-8271-000100421f2e")
READ_IMPLICIT, LOOKUP, FREE = 5, 2, 4
UNKNOWN_INTERFACE, CANCELLED, NO_MORE_ENTRIES = 0x1C010003, 0x1C00000D, 0x16C9A0D6
# A record that the server of this script never finishes.
ENDLESS = 0xF830
MODULES = [(slot, 1, 0x100 + slot, 0x200 + slot) for slot in range(40)]


def order(little):
    return "little" if little else "big"


def number(value, size, little):
    return value.to_bytes(size, order(little))


def datagram(kind, body, little, **fields):
    return bytes(DceRpc4(endian=int(little), ptype=KINDS.index(kind), len=len(body), **fields) / Raw(body))


def ndr(first, blocks, room, little):
    """The five values in front of the blocks (PROFINET: args maximum or status, and an array)."""
    values = (first, len(blocks), room, 0, len(blocks))
    return b"".join(number(value, 4, little) for value in values) + blocks


def fack(little, serial):
    """The body of a fragment acknowledgement: window 1, no selective ones (C706, 12.5.3.4)."""
    parts = [(0, 1), (0, 1), (1, 2), (1464, 4), (1464, 4), (serial, 2), (0, 2)]
    return b"".join(number(value, size, little) for value, size in parts)


def pieces(body, size):
    return [body[at : at + size] for at in range(0, len(body), size)]


def fragments(kind, body, size, little, **fields):
    """The datagrams of a body that goes out in pieces of this size."""
    parts = pieces(body, size) if size else [body]
    if len(parts) == 1:
        return [datagram(kind, body, little, flags1=IDEMPOTENT | NO_FACK, **fields)]
    flags = [IDEMPOTENT | FRAGMENT] * (len(parts) - 1) + [IDEMPOTENT | FRAGMENT | LAST]
    return [
        datagram(kind, part, little, flags1=flag, fragnum=index, serial_lo=index, **fields)
        for index, (part, flag) in enumerate(zip(parts, flags))
    ]


class Header:
    """The fields that both ends look at."""

    def __init__(self, octets):
        packet = DceRpc4(octets[:HEADER])
        self.kind = KINDS[packet.ptype] if packet.ptype < len(KINDS) else "unknown"
        self.little = packet.endian == 1
        self.flags = int(packet.flags1)
        self.activity, self.interface, self.sequence = packet.act_id, packet.if_id, packet.seqnum
        self.opnum, self.fragment, self.serial = packet.opnum, packet.fragnum, packet.serial_lo
        self.object = packet.object
        self.body = octets[HEADER : HEADER + packet.len]

    @property
    def wants_fack(self):
        return self.flags & FRAGMENT and not self.flags & NO_FACK


# --- Client


class Client:
    """One activity."""

    def __init__(self, arguments):
        address, port = arguments.device.rsplit(":", 1)
        self.peer = (address, int(port))
        self.little, self.follow = arguments.little, arguments.follow
        self.compared = 1 if arguments.any_port or arguments.follow else 2
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(arguments.timeout)
        self.activity, self.sequence = uuid.uuid4(), 0
        self.kinds, self.found, self.problems = [], {}, []

    def send(self, octets):
        self.socket.sendto(octets, self.peer)

    def fields(self, interface, opnum):
        return {
            "object": OBJECT, "if_id": interface, "act_id": self.activity, "seqnum": self.sequence,
            "opnum": opnum, "if_vers": 3 if interface == MAPPER else 1,
        }  # fmt: skip

    def receive(self):
        octets, source = self.socket.recvfrom(4096)
        header = Header(octets)
        self.kinds.append(header.kind)
        checks = {
            "source": source[: self.compared] == self.peer[: self.compared],
            "activity": header.activity == self.activity,
            "sequence": header.sequence == self.sequence,
        }
        self.problems += ["the %s of an answer is wrong" % name for name, good in checks.items() if not good]
        self.found["answered_from"] = "%s:%d" % source
        self.found["answer_is"] = order(header.little)
        if self.follow and checks["source"]:
            self.peer = source
        return header

    def call(self, interface, opnum, body, parts=1):
        """Sends a request and returns the whole body of its answer, and the answer's byte order."""
        size = -(-len(body) // parts)
        fields = self.fields(interface, opnum)
        for octets in fragments("request", body, size, self.little, **fields):
            self.send(octets)
            if parts > 1 and not Header(octets).flags & LAST:
                answer = self.receive()
                if answer.kind != "fack":
                    self.problems.append("%s, where a fack was due" % answer.kind)
        whole = {}
        while True:
            answer = self.receive()
            if answer.kind == "fack":
                continue
            if answer.kind != "response":
                status = int.from_bytes(answer.body[:4], order(answer.little))
                self.problems.append("%s 0x%08x" % (answer.kind, status))
                return None, answer.little
            whole[answer.fragment] = answer
            if answer.wants_fack:
                body = fack(self.little, answer.serial)
                self.send(datagram("fack", body, self.little, fragnum=answer.fragment, **fields))
            if not answer.flags & FRAGMENT or self.is_whole(whole):
                self.sequence += 1
                self.found["fragments"] = len(whole)
                return b"".join(whole[index].body for index in sorted(whole)), answer.little

    @staticmethod
    def is_whole(fragments):
        last = [index for index, header in fragments.items() if header.flags & LAST]
        return bool(last) and len(fragments) == last[0] + 1


def read_request(record, little):
    block = pnio_rpc.IODReadReq(
        ARUUID=uuid.UUID(int=0), slotNumber=0, subslotNumber=1, index=record, recordDataLength=4096
    )
    return ndr(4160, bytes(block), 4160, little)


def read(client, arguments):
    body, little = client.call(DEVICE, READ_IMPLICIT, read_request(arguments.record, client.little), arguments.fragments)
    if body is None:
        return
    status, length, _, _, count = (int.from_bytes(body[at : at + 4], order(little)) for at in range(0, 20, 4))
    client.found["status"] = status
    if status:
        client.problems.append("status 0x%08x" % status)
        return
    if (length, count) != (len(body) - 20,) * 2:
        client.problems.append("the lengths of the answer do not agree")
    response = pnio_rpc.IODReadRes(body[20:84])
    record = body[84:]
    client.found["record_octets"] = len(record)
    if response.recordDataLength != len(record):
        client.problems.append("the record has not the length that is told")
    if arguments.record == 0xAFF0:
        identification = pnio_rpc.IM0Block(record)
        client.found["order_id"] = identification.OrderID.decode().rstrip()
        client.found["serial_number"] = identification.IMSerialNumber.decode().rstrip()


def cancel(client, _arguments):
    """A request that takes for ever: ping says so, cancel ends it."""
    fields = client.fields(DEVICE, READ_IMPLICIT)
    client.send(datagram("request", read_request(ENDLESS, client.little), client.little, flags1=IDEMPOTENT, **fields))
    client.send(datagram("ping", b"", client.little, **fields))
    client.receive()
    client.send(datagram("cl_cancel", bytes(4) + number(1, 4, client.little), client.little, **fields))
    client.receive()
    client.receive()
    if client.kinds != ["working", "cancel_ack", "fault"]:
        client.problems.append("the answers are others")


def lookup(client, arguments):
    """All entries of the endpoint mapper, one at a time."""
    client.sequence = arguments.from_sequence
    endian = {"ndr64": False, "ndrendian": order(client.little)}
    nothing = raw.UUID(Data4=bytes(8), **endian)
    handle, client.found["endpoints"] = (0, bytes(16)), []
    while True:
        request = raw.ept_lookup_Request(
            object=NDRPointer(referent_id=1, value=nothing, **endian), vers_option=1, max_ents=1,
            Ifid=NDRPointer(referent_id=2, value=raw.RPC_IF_ID(Uuid=nothing, **endian), **endian),
            entry_handle=NDRContextHandle(attributes=handle[0], uuid=handle[1], **endian), **endian,
        )  # fmt: skip
        body, little = client.call(MAPPER, LOOKUP, bytes(request))
        if body is None:
            return
        status = int.from_bytes(body[-4:], order(little))
        if status == NO_MORE_ENTRIES:
            return
        answer = raw.ept_lookup_Response(body, ndr64=False, ndrendian=order(little))
        handle = (answer.entry_handle.attributes, answer.entry_handle.uuid)
        for entry in answer.entries.value[0].value:
            tower = ept.protocol_tower_t(entry.tower.value.tower_octet_string)
            client.found["endpoints"].append({
                "interface": str(tower.floors[0].uuid),
                "port": tower.floors[3].rhs,
                "annotation": entry.annotation.value.decode().rstrip("\0"),
            })  # fmt: skip


# --- Server


class Server:
    """A device with an endpoint mapper, which sends what is long in fragments."""

    def __init__(self, arguments):
        self.little, self.size, self.has_mapper = arguments.little, arguments.fragment, arguments.mapper
        self.port = arguments.answer_from
        self.known = self.bind(arguments.device, PNIO_PORT)
        own = self.port != PNIO_PORT
        self.answers = self.bind(arguments.device, self.port) if own else self.known
        self.sockets = [self.known, self.answers] if own else [self.known]
        # By activity: fragments of its request, datagrams that wait for a fack, the mapper's next sequence.
        self.requests, self.waiting, self.sequences = {}, {}, {}

    @staticmethod
    def bind(address, port):
        bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        for left in reversed(range(200)):
            try:
                bound.bind((address, port))
                return bound
            except OSError as error:
                # A process that is just being started may have a copy of an earlier device's socket.
                if error.errno != errno.EADDRINUSE or left == 0:
                    raise
                time.sleep(0.05)

    def run(self):
        print(json.dumps({"kind": "ready"}), flush=True)
        while True:
            for ready in select.select(self.sockets, [], [])[0]:
                octets, source = ready.recvfrom(4096)
                if len(octets) < HEADER or octets[0] != 4:
                    print(json.dumps({"kind": "no DCE/RPC", "octets": len(octets)}), flush=True)
                    continue
                header = Header(octets)
                line = {
                    "kind": header.kind, "from": "%s:%d" % source, "port": ready.getsockname()[1],
                    "octets": len(octets), "little_endian": header.little, "opnum": header.opnum,
                    "activity": str(header.activity), "sequence": header.sequence, "fragment": header.fragment,
                }  # fmt: skip
                print(json.dumps(line), flush=True)
                answers = ready if header.interface == MAPPER else self.answers
                for answer in self.answer(header, ready):
                    answers.sendto(answer, source)

    def answer(self, header, came_to):
        if header.kind == "fack":
            waiting = self.waiting.get(header.activity, [])
            sent = [octets for octets in waiting if Header(octets).fragment <= header.fragment]
            del waiting[: len(sent)]
            return waiting[:1]
        if header.kind == "ping":
            return [self.reply(header, "working", b"")]
        if header.kind == "cl_cancel":
            accepted = bytes(4) + header.body[4:8] + number(1, 4, self.little)
            return [
                self.reply(header, "cancel_ack", accepted),
                self.reply(header, "fault", number(CANCELLED, 4, self.little)),
            ]
        if header.kind != "request":
            return []
        if header.interface == MAPPER and self.has_mapper:
            return self.look_up(header)
        is_elsewhere = self.has_mapper and self.port != PNIO_PORT and came_to is self.known
        if header.interface != DEVICE or is_elsewhere:
            return [self.reply(header, "reject", number(UNKNOWN_INTERFACE, 4, self.little))]
        return self.request(header)

    def reply(self, header, kind, body, **more):
        return datagram(kind, body, self.little, **{**self.fields(header), **more})

    def fields(self, header):
        return {
            "object": header.object, "if_id": header.interface, "act_id": header.activity,
            "seqnum": header.sequence, "opnum": header.opnum, "server_boot": 1,
        }  # fmt: skip

    def request(self, header):
        """Puts a request together, and answers it when it is whole."""
        parts = self.requests.setdefault((header.activity, header.sequence), {})
        parts[header.fragment] = header
        if header.flags & FRAGMENT and not Client.is_whole(parts):
            body = fack(self.little, header.serial)
            return [self.reply(header, "fack", body, fragnum=header.fragment)]
        del self.requests[header.activity, header.sequence]
        body = b"".join(parts[index].body for index in sorted(parts))
        request = pnio_rpc.IODReadReq(body[20:84])
        if request.index == ENDLESS:
            return []
        room = int.from_bytes(body[:4], order(header.little))
        record = self.record(request) if header.opnum == READ_IMPLICIT else None
        if record is None:
            answer = ndr(0xDE80B000, b"", room, self.little)  # PNIORW, invalid index
        else:
            response = request.get_response()
            response.recordDataLength = len(record)
            answer = ndr(0, bytes(response) + record, room, self.little)
        all_fragments = fragments("response", answer, self.size, self.little, **self.fields(header))
        self.waiting[header.activity] = all_fragments
        return all_fragments[:1]

    def record(self, request):
        place = (request.slotNumber, request.subslotNumber)
        submodule = next((module for module in MODULES if module[:2] == place), None)
        if request.index == 0xF840:  # I&M0FilterData: which submodules have data of their own
            return filter_data(0x30, MODULES[:3]) + filter_data(0x32, MODULES[:1])
        if request.index == 0xF000:  # RealIdentificationData for one API
            return filter_data(0x13, MODULES)
        if request.index == 0x802A and place == (0, 0x8001):
            return port_data(*place)
        if submodule is None:
            return None
        if request.index == 0xAFF0:
            return bytes(pnio_rpc.IM0Block(
                VendorIDHigh=0x1F, VendorIDLow=0x2E, OrderID=b"VALVE-%-14d" % submodule[0],
                IMSerialNumber=b"SN %-13d" % (100 + submodule[0]), IMHardwareRevision=1,
                IMSWRevisionFunctionalEnhancement=2, IMSupported=0x0002,
            ))  # fmt: skip
        if request.index == 0xAFF1 and submodule[0] == 0:
            return bytes(pnio_rpc.IM1Block(IMTagFunction=b"Steam".ljust(32), IMTagLocation=b"Cellar".ljust(22)))
        return None

    def look_up(self, header):
        """Some mappers look at the sequence number: an activity begins with 0 and counts up."""
        if header.sequence != self.sequences.get(header.activity, 0):
            return []
        self.sequences[header.activity] = header.sequence + 1
        if header.opnum == FREE:
            return fragments("response", bytes(24), 0, self.little, **self.fields(header))
        request = raw.ept_lookup_Request(header.body, ndr64=False, ndrendian=order(header.little))
        endian = {"ndr64": False, "ndrendian": order(self.little)}
        endpoints = [(MAPPER, 3, PNIO_PORT), (DEVICE, 1, self.port)]
        at = request.entry_handle.uuid[0]
        if at < len(endpoints):
            handle = NDRContextHandle(attributes=0, uuid=bytes([at + 1]) * 16, **endian)
            entries = [self.entry(endpoints[at], endian)]
            body = bytes(raw.ept_lookup_Response(entry_handle=handle, entries=entries, status=0, **endian))
        else:
            nothing = [0, request.max_ents, 0, 0, NO_MORE_ENTRIES]
            body = bytes(20) + b"".join(number(value, 4, self.little) for value in nothing)
        return fragments("response", body, 0, self.little, **self.fields(header))

    @staticmethod
    def entry(endpoint, endian):
        interface, version, port = endpoint
        floor = ept.prot_and_addr_t
        tower = ept.protocol_tower_t(floors=[
            floor(lhs_length=19, protocol_identifier=0x0D, uuid=interface, version=version, rhs_length=2, rhs=0),
            floor(lhs_length=19, protocol_identifier=0x0D, version=2, rhs_length=2, rhs=0),
            floor(lhs_length=1, protocol_identifier=0x0A, rhs_length=2, rhs=0),
            floor(lhs_length=1, protocol_identifier=0x08, rhs_length=2, rhs=port),
            floor(lhs_length=1, protocol_identifier=0x09, rhs_length=4, rhs="0.0.0.0"),
        ])  # fmt: skip
        fields = OBJECT.fields
        octets = bytes(fields[3:5]) + fields[5].to_bytes(6, "big")
        entry = raw.UUID(Data1=fields[0], Data2=fields[1], Data3=fields[2], Data4=octets, **endian)
        tower = raw.twr_p_t(tower_octet_string=bytes(tower), **endian)
        # Real devices send 64 octets, whatever the name's length is.
        annotation = b"VALVE-7".ljust(63) + b"\0"
        return raw.ept_entry_t(object=entry, tower=tower, annotation=annotation, **endian)


def filter_data(block_type, modules):
    """A block of I&M0FilterData, or RealIdentificationData: API, slots, submodules."""
    body = number(1, 2, False) + number(0, 4, False) + number(len(modules), 2, False)
    for slot, subslot, module, submodule in modules:
        body += b"".join(number(*part, False) for part in [(slot, 2), (module, 4), (1, 2), (subslot, 2), (submodule, 4)])
    # RealIdentificationData with APIs is version 1.1.
    version = [1, 1] if block_type == 0x13 else [1, 0]
    return number(block_type, 2, False) + number(len(body) + 2, 2, False) + bytes(version) + body


def port_data(slot, subslot):
    """PDPortDataReal: the port's name, one neighbour, an idle copper line."""

    def text(octets):
        return number(len(octets), 1, False) + octets

    def aligned(octets):
        return octets + bytes(-(len(octets) + 6) % 4)

    body = aligned(b"") + number(slot, 2, False) + number(subslot, 2, False) + text(b"port-001") + b"\1"
    body = aligned(aligned(body) + text(b"port-002") + text(b"press-3.line-1"))
    body = aligned(body + number(0, 4, False) + bytes.fromhex("020000000009"))
    body = aligned(body + number(16, 2, False)) + bytes(8) + bytes([0, 1, 0, 0]) + number(1, 4, False)
    return number(0x020F, 2, False) + number(len(body) + 2, 2, False) + bytes([1, 0]) + body


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("role", choices=["read", "cancel", "lookup", "serve"])
    parser.add_argument("device", metavar="ADDRESS:PORT")
    parser.add_argument("--little", action="store_true", help="send little-endian")
    parser.add_argument("--any-port", action="store_true", help="answers may come from another port")
    parser.add_argument("--follow", action="store_true", help="the same, and go on there")
    parser.add_argument("--record", type=lambda text: int(text, 0), default=0xAFF0, metavar="INDEX")
    parser.add_argument("--fragments", type=int, default=1, metavar="N", help="pieces of the request")
    parser.add_argument("--from-sequence", type=int, default=0, metavar="N")
    parser.add_argument("--timeout", type=float, default=20, metavar="SECONDS")
    parser.add_argument("--answer-from", type=int, default=PNIO_PORT, metavar="PORT")
    parser.add_argument("--mapper", action="store_true", help="the mapper alone knows the port of the rest")
    parser.add_argument("--fragment", type=int, default=0, metavar="OCTETS", help="the longest body")
    arguments = parser.parse_args()
    if arguments.role == "serve":
        Server(arguments).run()
    client = Client(arguments)
    try:
        {"read": read, "cancel": cancel, "lookup": lookup}[arguments.role](client, arguments)
    except TimeoutError:
        client.problems.append("no answer")
    answer = {"found": client.found, "kinds": client.kinds, "problems": sorted(set(client.problems))}
    print(json.dumps(answer))
    return 1 if client.problems else 0


if __name__ == "__main__":
    sys.exit(main())
