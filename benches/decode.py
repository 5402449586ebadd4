#!/usr/bin/env python3
"""How fast `pnet-nat decode` reads a capture, beside tshark with deploy/wireshark/pnet.lua.

    cargo build --release
    python3 benches/decode.py target/release/pnet-nat

Makes a capture of a million datagrams: half are requests of 400 clients to 100 nodes, and half are their
answers. A second one has a million RT frames of PROFINET: 100 devices and their controller every 2 ms, with
an alarm, an LLDP frame and a DCP frame among a hundred. Each program reads each of them ROUNDS times in
turn, with its output thrown away; the best time of each counts. tshark prints a line for each datagram, as
decode does, and pairs nothing. Both read the file from the page cache. Exit code 1: decode is not FACTOR
times as fast."""

import os, struct, subprocess, sys, tempfile, time

DATAGRAMS, CLIENTS, NODES, DEVICES, ROUNDS, FACTOR = 1_000_000, 400, 100, 100, 3, 10
BEGIN = 1_790_000_000 * 1_000_000 # microseconds
START_PORT, PORTS = 40000, "40001-40125"
PASSWORD, HEADER = b"x9!Kd-2q", b"\x02\0\0\0"
DISSECTOR = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../deploy/wireshark/pnet.lua")


def packet(source, destination, payload):
    """Ethernet, IPv4, UDP."""
    udp = struct.pack(">HHHH", source[1], destination[1], 8 + len(payload), 0) + payload
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0, source[0], destination[0])
    return bytes([2] * 12) + b"\x08\0" + ip + udp


def exchange(client, node):
    """A request and its answer, PAS Figure 10 with 20 data octets."""
    here, there = (bytes([198, 51, 100, client % 250 + 1]), 50000 + client), (bytes([203, 0, 113, 5]), START_PORT + node)
    data = bytes(range(20))
    asked = bytes([11, node, 5, 2, 33, 0x8B, 0x83, 0x9F, 0, len(data)])
    told = bytes([11, 3, 6, 31, 0x8B, 0x80 | node, 0x82, 0xA1, 0x80, 0, len(data)])
    yield packet(here, there, HEADER + asked + data + PASSWORD)
    yield packet(there, here, HEADER + told + data + PASSWORD)


def write_capture(path, packets):
    """Packets, each with its time in microseconds."""
    with open(path, "wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
        for now, octets in packets:
            file.write(struct.pack("<IIII", now // 1_000_000, now % 1_000_000, len(octets), len(octets)) + octets)


def p_net():
    pairs = [tuple(exchange(client, client % NODES + 1)) for client in range(CLIENTS)]
    for number in range(DATAGRAMS // 2):
        # Of two requests that are on their way together, the later one is answered first.
        for octets, after in zip(pairs[number % CLIENTS], (0, 1200 + number % 700)):
            yield BEGIN + number * 2000 + after, octets


def profinet():
    """RT frames with 40 octets of data, as small devices send them, and what comes beside them."""
    controller = bytes([0x02, 0, 0, 0, 1, 0])
    tag = bytes.fromhex("8100c0008892")
    device = [bytes([0x02, 0, 0, 0, 0, number]) for number in range(DEVICES)]
    alarm = bytes.fromhex("fe01000100011111fffffffe0000") + bytes(28)
    hello = bytes.fromhex("fefe0500010000020001000802020004") + b"plc1" + bytes(24)
    lldp = b"\x02\x04\x07plc\x04\x09\x07port-001\x06\x02\x00\x14\xfe\x09\x00\x12\x0f\x01\x03\x0c\x00\x00\x10\0\0"
    for number in range(DATAGRAMS):
        cycle, place = divmod(number, 2 * DEVICES)
        now = BEGIN + cycle * 2000 + place * 9 + number * 7 % 5
        station = device[place // 2]
        to, source = (controller, station) if place % 2 else (station, controller)
        if number % 100 == 99:
            kind = number // 100 % 3
            payload = (tag + alarm, tag + hello, b"\x88\xcc" + lldp)[kind]
            yield now, to + source + payload
            continue
        head = struct.pack(">H", 0x8000 + place)
        status = struct.pack(">HBB", cycle * 64 % 65536, 0x35, 0)
        yield now, to + source + tag + head + bytes(place + at & 0xFF for at in range(40)) + status


def seconds(command, **more):
    """How long a command takes, and its memory in MiB."""
    began = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, **more)
    _, status, usage = os.wait4(process.pid, 0)
    took = time.monotonic() - began
    if status != 0:
        sys.exit(f"{command}: status {status}")
    return took, usage.ru_maxrss / 1024


def measure(capture, decode, tshark):
    """Prints how fast the programs are. Whether decode is fast enough."""
    runs = {"tshark": tshark, "decode": decode, "decode, JSON": decode + ["--format", "json"]}
    best = {}
    for _ in range(ROUNDS):
        for name, command in runs.items():
            took = seconds(command, stderr=subprocess.DEVNULL)
            best[name] = min(best.get(name, took), took)
    for name, (took, memory) in best.items():
        ratio = best["tshark"][0] / took
        print(f"{name:13} {took:7.2f} s {DATAGRAMS / took:10.0f} a second {memory:6.0f} MiB {ratio:6.1f} x")
    return best["tshark"][0] >= FACTOR * best["decode"][0]


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    is_fast = True
    for name, packets in (("P-NET", p_net()), ("PROFINET", profinet())):
        with tempfile.TemporaryDirectory() as folder:
            capture = os.path.join(folder, "capture.pcap")
            write_capture(capture, packets)
            print(f"{name}: {DATAGRAMS} packets, {os.path.getsize(capture) / 1e6:.0f} MB")
            decode = [sys.argv[1], "decode", "--ports", PORTS, capture]
            tshark = ["tshark", "-n", "-r", capture]
            if name == "P-NET":
                tshark += ["-X", f"lua_script:{DISSECTOR}", "-o", f"pnet.udp_ranges:{PORTS}"]
            is_fast &= measure(capture, decode, tshark)
    return 0 if is_fast else 1


if __name__ == "__main__":
    sys.exit(main())
