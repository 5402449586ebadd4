"""The figure of scale.py, as SVG: three quantities over ports, and over live flows.

It follows the reader's light or dark setting.
"""
from math import log10

WIDTH, HEIGHT = 840, 760
PANEL, GAP, LEFT, TOP, ROW = (340, 150), 60, 70, 50, 240
KINDS = (("ports", "public ports (64 flows)"), ("flows", "live flows (125 public ports)"))
QUANTITIES = (
    ("round trips, thousands a second", lambda point: point["rate"] / 1e3),
    ("relay CPU, µs a round trip", lambda point: point["cpu_us"]),
    ("relay memory, MB", lambda point: point["memory"] / 1e6),
)
STYLE = """
  text { font: 13px system-ui, sans-serif; fill: #57606a; }
  .title { font-weight: 600; fill: #1f2328; }
  .value { fill: #0b57a4; }
  .grid { stroke: #d0d7de; }
  .line { stroke: #0b57a4; stroke-width: 2; fill: none; }
  circle { fill: #0b57a4; }
  @media (prefers-color-scheme: dark) {
    text { fill: #9aa4af; }
    .title { fill: #e6edf3; }
    .value { fill: #79b8ff; }
    .grid { stroke: #30363d; }
    .line { stroke: #79b8ff; }
    circle { fill: #79b8ff; }
  }
"""


def draw(points):
    """`points` is {(kind, count): {quantity: value}}."""
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img">',
             "<title>Throughput, CPU time and memory over public ports and live flows</title>",
             f"<style>{STYLE}</style>"]
    for row, (name, value) in enumerate(QUANTITIES):
        top = max(value(point) for point in points.values())
        for column, (kind, axis) in enumerate(KINDS):
            line = [(count, value(point)) for (of, count), point in points.items() if of == kind]
            x, y = LEFT + column * (PANEL[0] + GAP), TOP + row * ROW
            parts += panel(x, y, name, axis, sorted(line), nice(top))
    return "\n".join([*parts, "</svg>\n"])


def panel(left, top, name, axis, line, most):
    """One diagram: counts on a logarithmic axis, values from 0 to `most`."""
    width, height = PANEL
    decades = log10(max(count for count, _ in line))
    x = lambda count: left + 15 + (width - 40) * log10(count) / decades
    y = lambda value: top + height * (1 - value / most)
    yield text(left, top - 14, name, "title", "start")
    for tick in range(5):
        value = most * tick / 4
        yield (f'<line class="grid" x1="{left}" x2="{left + width}" y1="{y(value):.1f}" '
               f'y2="{y(value):.1f}"/>')
        yield text(left - 8, y(value) + 4, f"{value:,.4g}", "", "end")
    corners = " ".join(f"{x(count):.1f},{y(value):.1f}" for count, value in line)
    yield f'<polyline class="line" points="{corners}"/>'
    for count, value in line:
        yield f'<circle cx="{x(count):.1f}" cy="{y(value):.1f}" r="4"/>'
        below = y(value) < top + 22
        yield text(x(count), y(value) + (20 if below else -10), f"{value:,.3g}", "value", "middle")
        yield text(x(count), top + height + 18, f"{count:,}", "", "middle")
    yield text(left + width / 2, top + height + 36, axis, "", "middle")


def text(x, y, words, kind, anchor):
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{words}</text>'


def nice(value):
    """The next round number above."""
    power = 10 ** int(log10(value) // 1)
    return next(step * power for step in (1, 2, 4, 6, 8, 10, 20) if step * power >= value * 1.05)
