// ── Plots ───────────────────────────────────────────────────────────────────────────────────────

/** What the plots show: from what part of the history, how far back, and in words. */
const RANGES = {
  minutes: { history: "hour", seconds: 300, words: "5 minutes" },
  hour: { history: "hour", seconds: 3600, words: "hour" },
  day: { history: "day", seconds: 86400, words: "24 hours" },
};
let range = "minutes";

/** The top of an axis: 1, 2 or 5 times a power of ten. One that still fits stays, so that it does not
 * jump to and fro. */
function topOf(most, before) {
  if (most <= before && most > 0.3 * before) return before;
  if (most <= 0) return 0;
  const power = 10 ** Math.floor(Math.log10(most));
  return [1, 2, 5, 10].map((step) => step * power).find((top) => top >= most * 0.9999);
}

/** A headed figure with a plot. */
class Tile {
  #series; // the names of its lines in the history
  #live = []; // times and values
  #past = { hour: [], day: [] };
  #paths;
  #top = 0;

  constructor(title, series, unit) {
    this.title = title;
    this.#series = series;
    this.unit = unit;
    this.value = make("p", { class: "value" });
    this.note = make("p", { class: "note" });
    this.plot = svg("svg", { class: "plot", viewBox: "0 0 100 40", role: "img",
      preserveAspectRatio: "none" });
    for (const y of [0.5, 20, 39.5]) this.plot.append(svg("line", { x1: 0, y1: y, x2: 100, y2: y }));
    this.#paths = series.map((_, i) => svg("path", { class: i ? "second" : "first" }));
    this.plot.append(...this.#paths);
    this.values = [make("span"), make("span")];
    this.times = [make("span"), make("span"), make("span", {}, "now")];
    $("tiles").append(make("div", { class: "tile" }, make("h3", {}, title), this.value, this.note,
      make("div", { class: "chart" }, make("div", { class: "values" }, ...this.values), this.plot,
        make("div", { class: "times" }, ...this.times))));
  }

  show(value, note) {
    write(this.value, value);
    write(this.note, note);
  }

  /** Takes the history over. What is newer than that was seen by the page itself. */
  fill(time, history) {
    for (const name of ["hour", "day"]) {
      const { step_seconds: step, ...all } = history[name];
      const lines = this.#series.map((series) => all[series]);
      const length = lines[0].length;
      this.#past[name] = Array.from({ length }, (_, i) =>
        [time - (length - 1 - i) * step, lines.map((line) => line[i])]);
    }
  }

  /** Adds a point to each line. */
  add(time, ...values) {
    const before = this.#live.at(-1)?.[0] ?? time;
    if (time - before > pause) this.#live = []; // the history has the time between
    this.#live.push([time, values]);
    while (this.#live[0][0] < time - RANGES.minutes.seconds) this.#live.shift();
  }

  draw(time, anew) {
    if (anew) this.#top = 0;
    const { history, seconds, words } = RANGES[range];
    const live = range === "minutes" ? this.#live : [];
    const since = live[0]?.[0] ?? Infinity;
    const past = this.#past[history].filter(([at]) => at >= time - seconds && at < since);
    const points = [...past, ...live];
    const most = Math.max(0, ...points.flatMap(([, values]) => values));
    this.#top = topOf(most, this.#top);
    for (const [i, path] of this.#paths.entries()) {
      let pen = "M";
      const draw = ([at, values]) => {
        if (values[i] === null) {
          pen = "M";
          return "";
        }
        const x = 100 - (100 * (time - at)) / seconds;
        const y = 39.5 - (this.#top ? (39 * values[i]) / this.#top : 0);
        const step = `${pen}${x.toFixed(2)} ${y.toFixed(2)}`;
        pen = "L";
        return step;
      };
      path.setAttribute("d", points.map(draw).join(""));
    }
    write(this.values[0], this.#top ? this.unit(this.#top, compact) : "");
    write(this.values[1], points.length ? "0" : "");
    const minutes = range === "minutes";
    write(this.times[0], minutes ? "−5 min" : clock(time - seconds));
    write(this.times[1], minutes ? "−2.5 min" : clock(time - seconds / 2));
    const label = `${this.title}, the last ${words}: at most ${this.unit(most, rough)}`;
    if (this.plot.getAttribute("aria-label") !== label) this.plot.setAttribute("aria-label", label);
  }
}

const count = (value, format) => format.format(value);
const perSecond = (value, format) => `${format.format(value)} /s`;
const TILES = {
  nodes: new Tile("Nodes that answer", ["answering_nodes"], count),
  requests: new Tile("Requests passed on", ["requests"], perSecond),
  times: new Tile("Response time", ["median_seconds", "p99_seconds"], duration),
  flows: new Tile("Flows", ["flows"], count),
  dropped: new Tile("Dropped", ["dropped"], perSecond),
  passwords: new Tile("Wrong passwords", ["wrong_passwords"], perSecond),
};

let filled = -Infinity; // when the history was asked for

/** Asks for the history as often as it has something new, and draws. */
async function showPlots(time, anew = false) {
  const { history, seconds } = RANGES[range];
  // Five minutes are seen by the page itself, but for the time before it came and while it was hidden.
  const every = range === "minutes" ? Infinity : { hour: 10, day: 60 }[history];
  if (time - filled >= every || filled === -Infinity) {
    const answer = await ask("api/v1/history");
    epoch = answer.now - time;
    for (const tile of Object.values(TILES)) tile.fill(time, answer);
    filled = time;
  }
  for (const tile of Object.values(TILES)) tile.draw(time, anew);
}

$("range").addEventListener("change", async ({ target }) => {
  range = target.value;
  filled = -Infinity;
  try {
    await showPlots(performance.now() / 1000, true);
  } catch {
    // The next round tells what is wrong.
  }
});

