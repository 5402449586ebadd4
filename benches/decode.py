#!/usr/bin/env python3
"""How fast `pnet-nat decode` reads a capture, beside tshark with deploy/wireshark/pnet.lua.

    cargo build --release
    python3 benches/decode.py target/release/pnet-nat

Makes a capture of a million datagrams: half are requests of 400 clients to 100 nodes, and half are their
answers. Each program reads it ROUNDS times in turn, with its output thrown away; the best time of each
counts. tshark prints a line for each datagram, as decode does, and pairs nothing. Both read the file from
the page cache. Exit code 1: decode is not FACTOR times as fast."""

import os, struct, subprocess, sys, tempfile, time

DATAGRAMS, CLIENTS, NODES, ROUNDS, FACTOR = 1_000_000, 400, 100, 3, 10
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


def write_capture(path):
    pairs = [tuple(exchange(client, client % NODES + 1)) for client in range(CLIENTS)]
    micros = 1_790_000_000 * 1_000_000
    with open(path, "wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
        for number in range(DATAGRAMS // 2):
            # Of two requests that are on their way together, the later one is answered first.
            for octets, after in zip(pairs[number % CLIENTS], (0, 1200 + number % 700)):
                now = micros + number * 2000 + after
                file.write(struct.pack("<IIII", now // 1_000_000, now % 1_000_000, len(octets), len(octets)) + octets)


def seconds(command, **more):
    """How long a command takes, and its memory in MiB."""
    began = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, **more)
    _, status, usage = os.wait4(process.pid, 0)
    took = time.monotonic() - began
    if status != 0:
        sys.exit(f"{command}: status {status}")
    return took, usage.ru_maxrss / 1024


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    with tempfile.TemporaryDirectory() as folder:
        capture = os.path.join(folder, "capture.pcap")
        write_capture(capture)
        print(f"{DATAGRAMS} datagrams, {os.path.getsize(capture) / 1e6:.0f} MB")
        decode = [sys.argv[1], "decode", "--ports", PORTS, capture]
        tshark = ["tshark", "-n", "-r", capture, "-X", f"lua_script:{DISSECTOR}", "-o", f"pnet.udp_ranges:{PORTS}"]
        runs = {"tshark": tshark, "decode": decode, "decode, JSON": decode + ["--format", "json"]}
        best = {}
        for _ in range(ROUNDS):
            for name, command in runs.items():
                took = seconds(command, stderr=subprocess.DEVNULL)
                best[name] = min(best.get(name, took), took)
        for name, (took, memory) in best.items():
            ratio = best["tshark"][0] / took
            print(f"{name:13} {took:7.2f} s {DATAGRAMS / took:10.0f} a second {memory:6.0f} MiB {ratio:6.1f} x")
        return 0 if best["tshark"][0] >= FACTOR * best["decode"][0] else 1


if __name__ == "__main__":
    sys.exit(main())
