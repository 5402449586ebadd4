#!/usr/bin/env python3
"""Measures relays side by side in three network namespaces. See README.md."""
import argparse
import json
import os
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import lab
import report
import speed
from lab import Folder, Load, Nodes, System, find
from systems import SUBNET, SYSTEMS, Site

# nodes, options of the clients, processors for clients : system : nodes, flood
SCENARIOS = {
    "latency": dict(
        about="1 node, 1 flow, 1 request under way", nodes=1, load=["--sockets", 1]),
    "latency-1cpu": dict(
        about="the same with everything on one core: length of the path, without wake-ups across "
              "cores", nodes=1, load=["--sockets", 1], cpus="0:0:0"),
    "throughput": dict(
        about="16 nodes, 64 flows, 16 requests under way in each", nodes=16,
        load=["--sockets", 64, "--window", 16]),
    "throughput-1cpu": dict(
        about="the same with everything on one core: what a round trip costs in all", nodes=16,
        load=["--sockets", 64, "--window", 16], cpus="0:0:0"),
    "thin": dict(
        about="16 nodes, 256 flows, 1 request under way in each: nothing batches by itself",
        nodes=16, load=["--sockets", 256]),
    "thin-1cpu": dict(
        about="the same with everything on one core", nodes=16, load=["--sockets", 256],
        cpus="0:0:0"),
    "many": dict(
        about="16 nodes, 16,000 flows, 1 request under way in each", nodes=16,
        load=["--sockets", 16000]),
    "open": dict(
        about="16 nodes, 64 flows, 30,000 requests/s whatever comes back", nodes=16,
        load=["--sockets", 64, "--rate", 30000]),
    "calm": dict(
        about="16 nodes, 64 flows, 5,000 requests/s", nodes=16,
        load=["--sockets", 64, "--rate", 5000]),
    "flood": dict(
        about="the same while 256 ports send wrong passwords as fast as one core can", nodes=16,
        load=["--sockets", 64, "--rate", 5000], flood=["--sockets", 256]),
}
EDGE_PLANT = f"{SUBNET}254"


def main():
    options = arguments()
    if options.report:
        with open(options.report) as file:
            return show([json.loads(line) for line in file], options)
    if options.list:
        for name, system in SYSTEMS.items():
            print(f"{name:14} {system['about']}{'' if is_here(name) else '  (not installed)'}")
        return
    if os.geteuid() != 0:
        sys.exit("run.py makes network namespaces: run it as root")
    if not options.no_build:
        lab.build()
    for name in [name for name in options.systems if not is_here(name)]:
        print(f"left out: {name} is not installed", file=sys.stderr)
        options.systems.remove(name)
    for stop in (signal.SIGTERM, signal.SIGINT):
        signal.signal(stop, lambda *_: sys.exit("stopped"))
    results = []
    for turn in range(options.rounds):
        for scenario in options.scenarios:
            for name in options.systems:
                result = {"system": name, "scenario": scenario, "round": turn,
                          **run(name, scenario, options)}
                results.append(result)
                if options.out:
                    with open(options.out, "a") as file:
                        file.write(json.dumps(result) + "\n")
                print(report.line(result), file=sys.stderr, flush=True)
    print(f"{lab.machine()}; medians of {options.rounds} rounds of {options.seconds:g} s\n")
    show(results, options)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    names = lambda text: text.split(",")
    parser.add_argument("--systems", type=names, default=list(SYSTEMS), help="comma separated")
    parser.add_argument("--scenarios", type=names, default=list(SCENARIOS), help="comma separated")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=3, help="measured in each run")
    parser.add_argument("--warm-up", type=float, default=1, help="seconds before that")
    parser.add_argument("--no-build", action="store_true", help="take what was built before")
    parser.add_argument("--out", help="append each run to this file, a line of JSON each")
    parser.add_argument("--report", metavar="FILE", help="only show the runs of an earlier --out")
    parser.add_argument("--readme", action="store_true", help="one table, the one of docs/performance.md")
    parser.add_argument("--chart", metavar="FILE", help="write FILE.json and FILE.svg, the chart of the README")
    parser.add_argument("--list", action="store_true", help="list the systems")
    options = parser.parse_args()
    for asked, known in ((options.systems, SYSTEMS), (options.scenarios, SCENARIOS)):
        for name in asked:
            if name not in known:
                parser.error(f"{name}: choose from {', '.join(known)}")
    return options


def is_here(name):
    program = SYSTEMS[name].get("program")
    return program is None or find(program) is not None


def show(results, options):
    if options.chart:
        figures = speed.medians(results, f"{lab.machine()}; medians of {options.rounds} rounds of {options.seconds:g} s")
        Path(options.chart).with_suffix(".json").write_text(json.dumps(figures, indent=2) + "\n")
        speed.write(Path(options.chart).with_suffix(".svg"), figures)
    print(report.readme(results) if options.readme else report.tables(results, SCENARIOS))


def run(name, scenario, options):
    """One system under one load. A run that fails must not end the others."""
    try:
        with Folder() as folder:
            return measure(SYSTEMS[name], SCENARIOS[scenario], folder, options)
    except (RuntimeError, OSError, subprocess.SubprocessError) as error:
        return {"error": str(error)}
    finally:
        lab.remove_network()


def measure(system, scenario, folder, options):
    site = Site(scenario["nodes"], folder)
    nothing = lambda site: []
    plant = [f"-n {{plant}} addr add {node}/24 dev plant0" for _, node in site.pairs]
    lab.build_network([f"-n {{edge}} addr add {EDGE_PLANT}/24 dev plant0", *plant,
                       f"-n {{plant}} route add default via {EDGE_PLANT}"],
                      system.get("forward", False))
    folder.write(system.get("files", lambda site: {})(site))
    for command in system.get("setup", nothing)(site):
        subprocess.run(lab.inside("edge", command), check=True)
    clients, edge, plant = scenario.get("cpus", "::").split(":")
    running, nodes = System(system.get("commands", nothing)(site), folder, edge), Nodes(plant)
    try:
        targets = system["targets"](site) if "targets" in system else site.targets
        lab.wait_until_ready(running, targets, site.nodes)
        result = under_load(running, targets, scenario, clients, options)
        if running.has_ended():
            raise RuntimeError(f"ended during the run: {running.last_words()}")
    finally:
        running.stop()
        counted = nodes.stop()
    return {**result, "wrong_node": counted["wrong_node"]}


def under_load(running, targets, scenario, cpus, options):
    time = ["--warm-up", options.warm_up, "--seconds", options.seconds]
    with ExitStack() as loads:
        flood = None
        if "flood" in scenario:
            longer = ["--seconds", options.warm_up + options.seconds + 0.5]
            flood = loads.enter_context(Load("flood", targets, [*scenario["flood"], *longer]))
        load = Load("client", targets, [*scenario["load"], *time], cpus)
        result = lab.measure(running, loads.enter_context(load))
        return {**result, "flood": flood.result()} if flood else result


if __name__ == "__main__":
    main()
