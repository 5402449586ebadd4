#!/usr/bin/env python3
"""Reads I&M0 to 3 of a PROFINET device, as a controller that was written independently: profinet-py.

    controller.py ADDRESS:PORT [--any-port | --follow] [--connect] [--timeout SECONDS]

profinet-py takes any datagram for the answer. So this script looks at each one itself: who sent it,
and whether its Activity UUID and its sequence number are those of the request. It prints one JSON
object, and exits 0 if every record was read and every answer was right. A controller may take answers
from any port of the device, and may ask on at the port that answered.
"""

import argparse
import json
import sys
import uuid

from profinet import dcp, protocol, rpc
from profinet.exceptions import PNIOError, RPCError, RPCTimeoutError

RECORDS = {0xAFF0: protocol.PNInM0, 0xAFF1: protocol.PNInM1, 0xAFF2: protocol.PNInM2, 0xAFF3: protocol.PNInM3}
NULL_MAC = bytes(6)


class Header:
    """What has to agree between a request and its answer, in either byte order (C706, chapter 12.6)."""

    def __init__(self, octets):
        little = octets[4] & 0x10
        self.order = "little" if little else "big"
        activity = octets[40:56]
        self.activity = uuid.UUID(bytes_le=activity) if little else uuid.UUID(bytes=activity)
        self.sequence = int.from_bytes(octets[64:68], self.order)


class Watched:
    """The controller's socket. It takes down each exchange."""

    def __init__(self, socket, any_port):
        self.socket, self.any_port = socket, any_port
        self.exchanges = []

    def __getattr__(self, name):
        return getattr(self.socket, name)

    def sendto(self, octets, address):
        self.exchanges.append({"asked": "%s:%d" % address, "octets": len(octets)})
        self.asked, self.request = address, Header(octets)
        return self.socket.sendto(octets, address)

    def recvfrom(self, size):
        octets, address = self.socket.recvfrom(size)
        answer, exchange = Header(octets), self.exchanges[-1]
        exchange["answered_from"] = "%s:%d" % address
        exchange["byte_order"] = answer.order
        compared = 1 if self.any_port else 2
        exchange["source_is_right"] = address[:compared] == self.asked[:compared]
        exchange["activity_is_right"] = answer.activity == self.request.activity
        exchange["sequence_is_right"] = answer.sequence == self.request.sequence
        self.answered_from = address
        return octets, address


def text(octets):
    return octets.decode("latin-1").rstrip(" \0") if isinstance(octets, bytes) else octets.rstrip(" \0")


def identification(index, octets):
    """The fields of a record, as the inventory and the tests call them."""
    record = RECORDS[index](octets)
    if index == 0xAFF0:
        revision = (
            record.im_sw_revision_functional_enhancement,
            record.im_sw_revision_bug_fix,
            record.im_sw_revision_internal_change,
        )
        return {
            "vendor_id": "0x%04x" % record.vendor_id,
            "order_id": text(record.order_id),
            "serial_number": text(record.im_serial_number),
            "hardware_revision": str(record.im_hardware_revision),
            "software_revision": chr(record.sw_revision_prefix) + "%d.%d.%d" % revision,
        }
    if index == 0xAFF1:
        return {"function": text(record.im_tag_function), "location": text(record.im_tag_location)}
    if index == 0xAFF2:
        return {"installed": text(record.im_date)}
    return {"descriptor": text(record.im_descriptor)}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("device", metavar="ADDRESS:PORT")
    parser.add_argument("--any-port", action="store_true", help="answers may come from another port")
    parser.add_argument("--follow", action="store_true", help="the same, and ask on there")
    parser.add_argument("--connect", action="store_true", help="only try to connect for supervision")
    parser.add_argument("--timeout", type=float, default=20)
    arguments = parser.parse_args()
    address, port = arguments.device.rsplit(":", 1)

    # Its own search for devices needs raw sockets; the description of this one is made by hand.
    controller = rpc.RPCCon(dcp.DCPDeviceDescription(NULL_MAC, {}), arguments.timeout)
    controller.peer = (address, int(port))
    controller._socket = Watched(controller._socket, arguments.any_port or arguments.follow)
    watched, found, problems = controller._socket, {}, []
    if arguments.connect:
        try:
            controller.connect(NULL_MAC)
            found["connected"] = True
        except RPCTimeoutError:
            problems.append("no answer")
        except RPCError as error:
            problems.append("connect: %s" % error)
    else:
        for index in RECORDS:
            try:
                answer = controller.read_implicit(0, 0, 1, index)
                found.update(identification(index, answer.payload))
            except RPCTimeoutError:
                problems.append("no answer")
                break
            except (PNIOError, RPCError) as error:
                problems.append("record 0x%04x: %s" % (index, error))
                break
            if not watched.exchanges[-1]["source_is_right"]:
                break
            if arguments.follow:
                controller.peer = watched.answered_from
    for exchange in watched.exchanges:
        for check in ("source", "activity", "sequence"):
            if exchange.get(check + "_is_right") is False:
                problems.append("the %s of an answer is wrong" % check)
    json.dump({"found": found, "exchanges": watched.exchanges, "problems": sorted(set(problems))}, sys.stdout)
    print()
    # Its own close() sends a Release, although there was no Connect.
    watched.close()
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
