#!/usr/bin/env python3
"""The chart of run.py, as SVG: round trips of each system, and what a flood leaves of them.

    python3 speed.py docs/pictures/speed.json       draws speed.svg beside it

run.py --chart writes speed.json from its runs, and draws. Follows the reader's light or dark setting.
"""
import json
import sys
from pathlib import Path

import report

OWN = ("pnet-nat-kernel", "pnet-nat")
SYSTEMS = {"pnet-nat-kernel": "pnet-nat, flows in the kernel", "pnet-nat": "pnet-nat on sockets",
           "nginx": "nginx stream", "ideal": "ideal: no checks, no limits",
           "nft-nat": "kernel NAT (nftables)"}
PANELS = (
    ("throughput", "Round trips, nginx = 1", "64 flows × 16 requests under way", " ×"),
    ("thin", "Round trips, nginx = 1", "256 flows × 1 request under way", " ×"),
    ("flood_lost_percent", "Good requests lost in a flood", "256 ports send wrong passwords", " %"),
)
LEFT, PANEL, GAP, TOP, BAR = 210, 190, 40, 60, 30
STYLE = """
  text { font: 13px system-ui, sans-serif; fill: #1f2328; }
  .title { font-weight: 600; }
  .dim { fill: #57606a; font-size: 11px; }
  .axis { stroke: #8c959f; }
  .bar { fill: #afb8c1; }
  .own { fill: #0b57a4; }
  @media (prefers-color-scheme: dark) {
    text { fill: #e6edf3; }
    .dim { fill: #9aa4af; }
    .axis { stroke: #6e7681; }
    .bar { fill: #57606a; }
    .own { fill: #58a6ff; }
  }
"""


def medians(runs, conditions):
    """What the chart shows, of the runs of `run.py --out`."""
    found = {}
    for system in SYSTEMS:
        of = lambda scenario: report.of(runs, system, scenario)
        if not of("throughput"):
            continue
        ratio = lambda scenario: report.median(report.ratios(of(scenario), report.of(runs, "nginx", scenario), "rate"))
        found[system] = {"throughput": round(ratio("throughput"), 2), "thin": round(ratio("thin"), 2),
                         "flood_lost_percent": round(report.middle(of("flood"), "loss_percent"), 1)}
    return {"conditions": conditions, "systems": found}


def draw(figures):
    systems = [name for name in SYSTEMS if name in figures["systems"]]
    width = LEFT + len(PANELS) * (PANEL + GAP)
    height = TOP + BAR * len(systems) + 34
    yield f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" role="img">'
    yield "<title>Round trips of relays and of the kernel's NAT, and what they lose in a flood</title>"
    yield f"<style>{STYLE}</style>"
    for row, name in enumerate(systems):
        y = TOP + BAR * row
        yield text(LEFT - 12, y + 16, SYSTEMS[name], "title" if name in OWN else "", "end")
    for column, (key, title, about, unit) in enumerate(PANELS):
        x = LEFT + column * (PANEL + GAP)
        most = max(figures["systems"][name][key] for name in systems) or 1
        yield text(x, 22, title, "title")
        yield text(x, 40, about, "dim")
        for row, name in enumerate(systems):
            value = figures["systems"][name][key]
            y, long = TOP + BAR * row, (PANEL - 46) * value / most
            kind = "own" if name in OWN else "bar"
            yield f'<rect class="{kind}" x="{x}" y="{y}" width="{long:.1f}" height="22"/>'
            shown = f"{value:.2f}" if unit == " ×" else f"{value:.0f}"
            yield text(x + long + 6, y + 16, shown + unit, "title" if name in OWN else "")
        yield f'<line class="axis" x1="{x}" x2="{x}" y1="{TOP - 6}" y2="{TOP + BAR * len(systems)}"/>'
    yield text(12, height - 10, figures["conditions"], "dim")
    yield "</svg>\n"


def text(x, y, words, kind="", anchor="start"):
    return f'<text class="{kind}" x="{x:.1f}" y="{y}" text-anchor="{anchor}">{words}</text>'


def write(path, figures):
    Path(path).write_text("\n".join(draw(figures)))


if __name__ == "__main__":
    source = Path(sys.argv[1])
    write(source.with_suffix(".svg"), json.loads(source.read_text()))
