#!/usr/bin/env python3
"""Measures how the relay's cost grows with public ports and with live flows. See README.md.

Every point is under the same load: 64 clients at once send 16 requests each to a node, wait for all
the answers, and are followed by others. Only how many ports or flows there are differs.
"""
import argparse
import json
import os
import signal
import subprocess
import sys
from statistics import median

import figure
import lab
from lab import PUBLIC, Folder, Load, Nodes, System, find

SECTION = 125  # nodes of a full net
START_PORT = 10_000
ADMIN = "127.0.0.1:9378"
# Public ports; flows, as client sockets and nodes that each of them talks to.
PORTS = [1, 125, 1_000, 8_000]
FLOWS = [(1, 1), (64, 1), (125, 8), (80, 125), (800, 125)]
FLOWS_AT_PORTS = 64
LOAD = ["--window", 16, "--at-once", 64]
# AnyIP: every address of 172.17/16 is a node's. One neighbour serves them all.
PLANT = ["-n {edge} addr add 192.0.2.1/30 dev plant0", "-n {plant} addr add 192.0.2.2/30 dev plant0",
         "-n {edge} route add 172.17.0.0/16 via 192.0.2.2",
         "-n {plant} route add local 172.17.0.0/16 dev lo"]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=3, help="measured at each point")
    parser.add_argument("--no-build", action="store_true", help="take what was built before")
    parser.add_argument("--figure", default=os.path.join(lab.HERE, "scale.svg"))
    options = parser.parse_args()
    if os.geteuid() != 0:
        sys.exit("scale.py makes network namespaces: run it as root")
    if not options.no_build:
        lab.build()
    for stop in (signal.SIGTERM, signal.SIGINT):
        signal.signal(stop, lambda *_: sys.exit("stopped"))
    runs = {}
    for _ in range(options.rounds):
        for ports in PORTS:
            note(runs, "ports", ports, by_ports(ports, options))
        for sockets, nodes in FLOWS:
            note(runs, "flows", sockets * nodes, by_flows(sockets, nodes, options))
    print(f"{lab.machine()}; medians of {options.rounds} rounds of {options.seconds:g} s\n")
    print(table(runs))
    with open(options.figure, "w") as file:
        file.write(figure.draw({key: middle(results) for key, results in runs.items()}))


def note(runs, kind, count, result):
    runs.setdefault((kind, count), []).append(result)
    print(f"{count:7,} {kind}: {result['rate']:9,.0f}/s  {result['cpu_us']:6.2f} us each  "
          f"{result['memory'] / 1e6:6.1f} MB", file=sys.stderr, flush=True)


def middle(results):
    return {key: median(result[key] for result in results)
            for key in ("rate", "cpu_us", "memory", "p50_us", "p99_us", "live")}


def table(runs):
    """The numbers. Ratios are medians of those within each round, for the machine's speed drifts."""
    lines = ["| | live flows | round trips/s | of 64 flows | relay, us each | memory, MB | p50 us | p99 us |",
             "|---|---|---|---|---|---|---|---|"]
    base = runs[("flows", 64)]
    for (kind, count), results in runs.items():
        point = middle(results)
        ratio = median(result["rate"] / of["rate"] for result, of in zip(results, base))
        lines.append(
            f"| {count:,} {kind if count > 1 else kind[:-1]} | {point['live']:,.0f} "
            f"| {point['rate']:,.0f} | {format(ratio, '.2f') if kind == 'flows' else ''} "
            f"| {point['cpu_us']:.2f} | {point['memory'] / 1e6:.1f} | {point['p50_us']:,.0f} "
            f"| {point['p99_us']:,.0f} |")
    return "\n".join(lines)


def by_ports(ports, options):
    """Few flows, spread over the ports."""
    every = max(ports // FLOWS_AT_PORTS, 1)
    asked = [target(number) for number in range(0, ports, every)][:FLOWS_AT_PORTS]
    return run(ports, asked, FLOWS_AT_PORTS, 1, options)


def by_flows(sockets, nodes, options):
    """One full net."""
    return run(SECTION, [target(number) for number in range(SECTION)], sockets, nodes, options)


def run(ports, asked, sockets, per_socket, options):
    with Folder() as folder:
        folder.write({"pnet-nat.toml": configuration(ports), "password": "PNETPASS"})
        try:
            lab.build_network(PLANT)
            command = [find("pnet-nat"), "run", "--config", folder.path("pnet-nat.toml")]
            relay, nodes = System([command], folder), Nodes()
            try:
                targets = ",".join(asked)
                lab.wait_until_ready(relay, asked[0], 1)
                load = ["--sockets", sockets, "--targets-per-socket", per_socket, *LOAD,
                        "--warm-up", 1, "--seconds", options.seconds]
                with Load("client", targets, load) as load:
                    result = lab.measure(relay, load)
                result.update(memory=relay.memory(), live=live_flows())
            finally:
                relay.stop()
                counted = nodes.stop()
        finally:
            lab.remove_network()
    astray = [result[what] for what in ("foreign", "wrong_port", "malformed")]
    if any(astray) or counted["wrong_node"]:
        sys.exit(f"datagrams went astray: {result}, {counted}")
    return result


def live_flows():
    """As the relay itself counts them."""
    ask = f"import urllib.request as r; print(r.urlopen('http://{ADMIN}/metrics').read().decode())"
    metrics = subprocess.run(lab.inside("edge", [sys.executable, "-c", ask]), check=True,
                             capture_output=True, text=True).stdout
    return sum(float(line.split()[-1]) for line in metrics.splitlines()
               if line.startswith("pnet_nat_flows{"))


def target(number):
    """The public port of the node with this number, counted through all nets."""
    net, node = divmod(number, SECTION)
    return f"{PUBLIC}:{start_port(net) + node + 1}@{node + 1}"


def start_port(net):
    return START_PORT + 128 * net


def configuration(ports):
    lines = [f'[public]\nlisten = ["{PUBLIC}"]\n[limits]\nmax_flows = 200000\n'
             f'[admin]\nlisten = "{ADMIN}"\n']
    for net in range(-(-ports // SECTION)):
        nodes = min(ports - net * SECTION, SECTION)
        lines.append(f"""[[udp_range_net]]
name = "section-{net}"
start_port = {start_port(net)}
subnet = "172.17.{net}.0"
nodes = ["1-{nodes}"]
allow = ["0.0.0.0/0"]
max_flows = 200000
  [[udp_range_net.password]]
  name = "bench"
  file = "password"
""")
    return "".join(lines)


if __name__ == "__main__":
    main()
