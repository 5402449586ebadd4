#!/usr/bin/env python3
"""Draws setup.svg and checks.svg beside this file. They follow the reader's light or dark setting.

    python3 docs/pictures/diagrams.py
"""
from pathlib import Path

STYLE = """
  text { font: 14px system-ui, sans-serif; fill: #1f2328; }
  .dim { fill: #57606a; }
  .bold { font-weight: 600; }
  .small { font-size: 12.5px; }
  .mono { font-family: ui-monospace, monospace; font-size: 13px; }
  .hot { fill: #0b57a4; }
  .out { fill: #a4410b; }
  .box { fill: #f6f8fa; stroke: #8c959f; }
  .inner { fill: #ffffff; stroke: #d0d7de; }
  .mark { fill: #ddf0ff; stroke: #0b57a4; }
  .way { stroke: #0b57a4; stroke-width: 2; fill: none; }
  .tip { fill: #0b57a4; }
  .fall { stroke: #a4410b; stroke-width: 1.5; fill: none; }
  .falltip { fill: #a4410b; }
  .wire { stroke: #8c959f; stroke-width: 2; fill: none; }
  @media (prefers-color-scheme: dark) {
    text { fill: #e6edf3; }
    .dim { fill: #9aa4af; }
    .hot { fill: #79b8ff; }
    .out { fill: #ffa36b; }
    .box { fill: #161b22; stroke: #6e7681; }
    .inner { fill: #0d1117; stroke: #30363d; }
    .mark { fill: #0c2d4a; stroke: #79b8ff; }
    .way { stroke: #79b8ff; }
    .tip { fill: #79b8ff; }
    .fall { stroke: #ffa36b; }
    .falltip { fill: #ffa36b; }
    .wire { stroke: #6e7681; }
  }
"""

# The groups of checks, and in each the drop reason and what is asked. tests/docs looks for each of them.
CHECKS = (
    ("The datagram alone", (
        ("not_unicast", "sent to an address of this router, not to many?"),
        ("too_short", "16 octets or more?"),
        ("too_long", "107 octets or fewer?"),
        ("bad_header", "begins with the header?"),
        ("bad_route", "a route of one of the five formats?"),
        ("bad_length", "as long as it says?"),
        ("route_format", "a format that IP carries?"),
        ("password_missing", "has a password?"),
        ("password_unexpected", "or none, in a remote net?"))),
    ("The sender, without a flow of its own", (
        ("loop", "not from the relay's own port?"),
        ("unanswerable", "can an answer reach it?"),
        ("source_not_allowed", "in allow?"),
        ("throttled", "few enough wrong passwords lately?"))),
    ("The password and the request", (
        ("password_wrong", "a password of this net?"),
        ("broadcast", "no broadcast address in the route?"),
        ("node_mismatch", "names the node of this public port?"))),
    ("Room", (
        ("request_limit", "few enough requests a second?"),
        ("flow_limit", "an open flow, or room for one?"),
        ("upstream_exhausted", "a socket towards the plant?"),
        ("send_failed", "does the system send it?"))),
)


def setup():
    width, height = 900, 372
    yield from head(width, height, "A remote client reaches node 3 of a plant section through pnet-nat")

    # The client.
    yield box(10, 90, 190, 196)
    yield text(105, 116, "Remote client", "bold", "middle")
    yield text(105, 136, "198.51.100.20", "mono dim", "middle")
    yield box(24, 152, 162, 120, "inner")
    yield text(105, 172, "its IPNetTable row", "small dim", "middle")
    for line, (name, value) in enumerate((("IPAddr", "203.0.113.5"), ("UDPPort", "20000"), ("UsePW", "1"),
                                          ("Nettype", "UDPRange"))):
        yield text(34, 194 + 21 * line, name, "small dim")
        yield text(176, 194 + 21 * line, value, "mono", "end")

    # The router.
    yield box(370, 30, 300, 312)
    yield text(520, 58, "Router", "bold", "middle")
    yield text(380, 24, "203.0.113.5", "mono dim")
    yield text(660, 24, "172.17.17.250", "mono dim", "end")
    yield box(384, 74, 272, 188, "inner")
    yield text(520, 98, "pnet-nat", "bold", "middle")
    yield text(400, 122, "public port", "small dim")
    yield text(640, 122, "server, Secure port", "small dim", "end")
    for line, node in enumerate((1, 3, 33)):
        y = 134 + 40 * line
        yield box(394, y, 252, 32, "mark" if node == 3 else "inner")
        yield text(404, y + 21, f"{20000 + node}", "mono bold" if node == 3 else "mono")
        yield text(460, y + 21, "→", "dim", "middle")
        yield text(636, y + 21, f"172.17.17.{node} : 34379", "mono bold" if node == 3 else "mono", "end")
    yield box(384, 276, 272, 54, "inner")
    yield text(520, 298, "127.0.0.1 : 9378", "mono", "middle")
    yield text(520, 318, "status page, /metrics, API", "small dim", "middle")

    # The plant.
    yield text(830, 58, "Plant section", "bold", "middle")
    yield text(830, 78, "172.17.17.0/24", "mono dim", "middle")
    yield '<path class="wire" d="M 670 190 H 730 M 730 120 V 270 M 730 120 H 770 M 730 190 H 770 M 730 270 H 770"/>'
    for y, node in ((120, 1), (190, 3), (270, 33)):
        yield box(770, y - 24, 120, 48, "mark" if node == 3 else "box")
        yield text(830, y + 5, f"node {node}", "bold" if node == 3 else "", "middle")

    # The request.
    yield '<path class="way" d="M 200 190 H 382"/>' + tip(392, 190)
    yield '<path class="way" d="M 646 190 H 758"/>' + tip(768, 190)
    yield text(285, 142, "Internet", "dim", "middle")
    yield text(285, 162, "to 203.0.113.5 : 20003", "small hot", "middle")
    yield text(285, 178, "with the password", "small hot", "middle")
    yield text(285, 214, "the answer takes", "small dim", "middle")
    yield text(285, 230, "the same way back", "small dim", "middle")
    yield "</svg>\n"


def checks():
    rows = sum(len(group) for _, group in CHECKS)
    width, height = 720, 96 + 26 * rows + 44 * len(CHECKS)
    yield from head(width, height, "The checks of a request in their order, each with its drop reason")
    yield box(150, 6, 300, 32, "mark")
    yield text(300, 27, "a datagram at a public port", "bold", "middle")
    y = 38
    for title, group in CHECKS:
        yield f'<path class="way" d="M 300 {y} V {y + 10}"/>' + tip(300, y + 18, down=True)
        y += 18
        yield box(10, y, 490, 26 + 26 * len(group))
        yield text(24, y + 18, title, "bold")
        y += 26
        for reason, question in group:
            yield text(38, y + 16, question)
            yield f'<path class="fall" d="M 500 {y + 11} H 516"/>' + tip(526, y + 11, kind="falltip")
            yield text(534, y + 16, reason, "mono out")
            y += 26
    yield f'<path class="way" d="M 300 {y} V {y + 10}"/>' + tip(300, y + 18, down=True)
    yield box(150, y + 18, 300, 32, "mark")
    yield text(300, y + 39, "passed on to the node", "bold", "middle")
    yield text(534, 27, "dropped, with the reason", "small dim")
    yield "</svg>\n"


def head(width, height, title):
    yield (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
           f'role="img">')
    yield f"<title>{title}</title>"
    yield f"<style>{STYLE}</style>"


def box(x, y, width, height, kind="box"):
    return f'<rect class="{kind}" x="{x}" y="{y}" width="{width}" height="{height}" rx="6"/>'


def text(x, y, words, kind="", anchor="start"):
    return f'<text class="{kind}" x="{x}" y="{y}" text-anchor="{anchor}">{words}</text>'


def tip(x, y, down=False, kind="tip"):
    """The point of an arrow, which ends there."""
    corners = f"{x},{y} {x - 5},{y - 9} {x + 5},{y - 9}" if down else f"{x},{y} {x - 10},{y - 5} {x - 10},{y + 5}"
    return f'<polygon class="{kind}" points="{corners}"/>'


if __name__ == "__main__":
    for name, lines in (("setup", setup()), ("checks", checks())):
        Path(__file__).with_name(f"{name}.svg").write_text("\n".join(lines))
