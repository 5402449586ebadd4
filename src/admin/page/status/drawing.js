// ── Words ───────────────────────────────────────────────────────────────────────────────────────

const whole = new Intl.NumberFormat("en");
const short = new Intl.NumberFormat("en", { maximumSignificantDigits: 3 });
const rough = new Intl.NumberFormat("en", { maximumSignificantDigits: 2 });

const rate = (value) => (value === null ? "–" : `${short.format(value)} /s`);

function duration(seconds) {
  if (seconds === null) return "–";
  return seconds < 1 ? `${rough.format(seconds * 1000)} ms` : `${rough.format(seconds)} s`;
}

function age(seconds) {
  for (const [unit, length] of [["d", 86400], ["h", 3600], ["min", 60]]) {
    if (seconds >= 2 * length) return `${Math.floor(seconds / length)} ${unit}`;
  }
  return seconds < 10 ? `${seconds.toFixed(1)} s` : `${Math.floor(seconds)} s`;
}

const nodes = (count) => (count === 1 ? "1 node" : `${whole.format(count)} nodes`);

// ── Drawing ─────────────────────────────────────────────────────────────────────────────────────

const $ = (id) => document.getElementById(id);

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** Touches the page only where something changed. */
function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Has these elements in a place, in this order; those that stay are not moved. */
function arrange(place, elements) {
  const wanted = new Set(elements);
  for (const child of [...place.children]) if (!wanted.has(child)) child.remove();
  for (const [i, element] of elements.entries()) {
    if (place.children[i] !== element) place.insertBefore(element, place.children[i] ?? null);
  }
}

function svg(tag, attributes = {}) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

/** A headed figure with a plot of the last minutes. */
class Tile {
  #points = [];
  #paths = [];

  constructor(title, { lines = 0, unit = (value) => short.format(value) } = {}) {
    this.title = title;
    this.unit = unit;
    this.value = make("p", { class: "value" });
    this.note = make("p", { class: "note" });
    const tile = make("div", { class: "tile" }, make("h3", {}, title), this.value, this.note);
    if (lines) {
      this.plot = svg("svg", { class: "plot", viewBox: "0 0 100 40", role: "img",
        preserveAspectRatio: "none" });
      this.plot.append(svg("line", { x1: 0, y1: 39.5, x2: 100, y2: 39.5 }));
      for (let i = 0; i < lines; i += 1) {
        this.#paths.push(svg("path", { class: i ? "second" : "first" }));
        this.plot.append(this.#paths[i]);
      }
      this.most = make("span");
      const axis = make("p", { class: "axis" }, "−5 min", this.most, "now");
      tile.append(this.plot, axis);
    }
    $("tiles").append(tile);
  }

  show(value, note) {
    write(this.value, value);
    write(this.note, note);
  }

  /** Adds a point to each line. */
  add(time, ...values) {
    this.#points.push([time, values]);
    while (this.#points[0][0] < time - PLOT_SECONDS) this.#points.shift();
    const most = Math.max(0, ...this.#points.flatMap(([, values]) => values));
    for (const [i, path] of this.#paths.entries()) {
      let pen = "M";
      const draw = ([at, values]) => {
        if (values[i] === null) return "";
        const x = 100 - (100 * (time - at)) / PLOT_SECONDS;
        const y = 39 - (most ? (37 * values[i]) / most : 0);
        const step = `${pen}${x.toFixed(2)} ${y.toFixed(2)}`;
        pen = "L";
        return step;
      };
      path.setAttribute("d", this.#points.map(draw).join(""));
    }
    write(this.most, most ? `max ${this.unit(most)}` : "");
    const label = `${this.title} of the last 5 minutes: at most ${this.unit(most)}`;
    if (this.plot.getAttribute("aria-label") !== label) this.plot.setAttribute("aria-label", label);
  }
}

const TILES = {
  nodes: new Tile("Nodes that answer", { lines: 1 }),
  requests: new Tile("Requests passed on", { lines: 1, unit: rate }),
  times: new Tile("Response time", { lines: 2, unit: duration }),
  flows: new Tile("Flows", { lines: 1 }),
  dropped: new Tile("Dropped", { lines: 1, unit: rate }),
  passwords: new Tile("Wrong passwords", { lines: 1, unit: rate }),
};

/** How often datagrams were dropped, by reason: of both directions of one place. */
function drops(...directions) {
  const sums = {};
  for (const { dropped_datagrams } of directions) {
    for (const [reason, count] of Object.entries(dropped_datagrams)) {
      sums[reason] = (sums[reason] ?? 0) + count;
    }
  }
  return sums;
}

/** Why requests were not passed on, most frequent first, in words; empty when all were. */
function refusals(...requests) {
  const reasons = Object.entries(drops(...requests)).sort(([, a], [, b]) => b - a);
  const sum = total(Object.fromEntries(reasons));
  const counted = sum === 1 ? "1 request" : `${whole.format(sum)} requests`;
  return sum ? `${counted} refused: ${reasons.map(([reason]) => reason).join(", ")}` : "";
}

/** What the kernel dropped, by the names that `reasons` has for it. */
const named = (place, causes) => ({
  dropped_datagrams: Object.fromEntries(
    Object.entries(causes).map(([cause, count]) => [place + cause, count])),
});

const total = (counts) => Object.values(counts).reduce((a, b) => a + b, 0);

